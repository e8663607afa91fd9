"""What `watch` knows of the values that come: the last of each node, how many come, and how old they are. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from typing import TYPE_CHECKING, Final

from ua_fleet.cli.readings import has_never_come, status_cell
from ua_fleet.cli.table import Cell, Colour
from ua_fleet.cli.value_text import ValueStyle, age_text, clock_text, value_text

if TYPE_CHECKING:
    from ua_fleet.client import Reading, SelectedNode

__all__ = ["WINDOW_S", "Watched"]

WINDOW_S: Final = 5.0
"""Over so long values are counted for their rate."""


@dataclass(slots=True)
class _Values:
    last: Reading | None = None
    count: int = 0
    """Since the beginning, without the first one, which was there before."""
    times: deque[float] = field(default_factory=deque[float])


class Watched:
    """The nodes that are watched, in their order."""

    def __init__(self, nodes: Sequence[SelectedNode], styles: Mapping[str, ValueStyle], *, now: float) -> None:
        """Nothing has come yet.

        Args:
            nodes: what is watched.
            styles: how values are shown, by NodeId.
            now: seconds of any clock that goes on evenly.
        """
        self._nodes, self._styles, self._began = nodes, styles, now
        self._values = {node.node_id: _Values() for node in nodes}

    def take(self, change: Reading, now: float) -> None:
        """A value has come."""
        values = self._values[change.node_id]
        if values.last is not None:
            values.count += 1
            values.times.append(now)
        values.last = change

    def rates(self, now: float) -> list[tuple[SelectedNode, float, int]]:
        """Each node with how many of its values come in a second, and how many have come."""
        over = min(WINDOW_S, max(now - self._began, 1.0))
        told: list[tuple[SelectedNode, float, int]] = []
        for node in self._nodes:
            values = self._values[node.node_id]
            while values.times and values.times[0] <= now - WINDOW_S:
                values.times.popleft()
            told.append((node, len(values.times) / over, values.count))
        return told

    def rows(
        self, now: float, clock: datetime, zone: tzinfo | None, *, with_rate: bool, with_age: bool
    ) -> tuple[list[list[Cell]], int]:
        """A table of the last value of each node, with its heading; and how many below Objects have never had one.

        Args:
            now: of the same clock as before.
            clock: the time of day, for ages.
            zone: that times are shown in; None is the local one.
            with_rate: whether to tell how many values come.
            with_age: whether to tell how old they are.
        """
        heading = ["node", "value", *(["per s"] if with_rate else []), "age" if with_age else "time", "status"]
        rows = [[Cell(name, Colour.HEAD) for name in heading]]
        waiting = 0
        for node, rate, _ in self.rates(now):
            last = self._values[node.node_id].last
            style = self._styles.get(node.node_id)
            if not node.is_named and (last is None or has_never_come(last)):
                waiting += 1
                continue
            time = None if last is None else last.source_time or last.server_time
            rows.append(
                [
                    Cell(node.name, keeps_end=True),
                    Cell("-" if last is None else value_text(last.value, last.type_name, style)),
                    *([Cell(f"{rate:.1f}")] if with_rate else []),
                    Cell(age_text(time, clock)) if with_age else Cell(clock_text(time, clock, zone), Colour.FAINT),
                    Cell("nothing came yet", Colour.FAINT) if last is None else status_cell(last),
                ]
            )
        return rows, waiting
