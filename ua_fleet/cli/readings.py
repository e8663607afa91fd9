"""How `read`, `write` and `watch` show values: a line for each, or an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, tzinfo
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ua_fleet.cli.output import print_json, write_line
from ua_fleet.cli.screen import ColorWhen, has_colours
from ua_fleet.cli.table import Cell, Colour, painted
from ua_fleet.cli.value_text import ValueStyle, age_text, moment_text, status_words, value_text
from ua_fleet.values import StatusCode

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient, Reading, SelectedNode

__all__ = [
    "Full",
    "ReadingLines",
    "Utc",
    "has_never_come",
    "reading_json",
    "status_cell",
    "styles_of",
    "waiting_text",
    "zone_of",
]

Full = Annotated[bool, typer.Option("--full", help="Show long texts, arrays and bytes in full.")]
Utc = Annotated[bool, typer.Option("--utc", help="Show times in UTC instead of local time. JSON always has UTC.")]

MOST_DETAILS: Final = 2_000
"""Nodes whose units are asked for: more values than that are read by programs."""


def zone_of(is_utc: bool) -> tzinfo | None:
    """The zone that times are shown in; None is the local one."""
    return UTC if is_utc else None


async def styles_of(
    client: FleetClient, node_ids: Sequence[str], *, is_full: bool, zone: tzinfo | None
) -> dict[str, ValueStyle]:
    """How the values of nodes are to be shown, by NodeId."""
    asked = node_ids[:MOST_DETAILS]
    details = dict(zip(asked, await client.details(asked), strict=True))
    styles: dict[str, ValueStyle] = {}
    for node_id in node_ids:
        one = details.get(node_id)
        style = ValueStyle(is_full=is_full, zone=zone)
        styles[node_id] = style if one is None else replace(style, unit=one.unit, names=one.names)
    return styles


def has_never_come(reading: Reading) -> bool:
    """Whether a Variable has no value yet, and says that it waits for one."""
    return reading.status == StatusCode.BAD_WAITING_FOR_INITIAL_DATA


def waiting_text(number: int) -> str:
    """What is said of values that are not shown since there are none yet."""
    have = "value has" if number == 1 else "values have"
    return f"{number} {have} never come (BadWaitingForInitialData)"


def status_cell(reading: Reading) -> Cell:
    """What is to be said of a value's StatusCode."""
    words = status_words(reading.status, reading.status_text)
    return Cell(words, {0: None, 1: Colour.WARNING}.get(reading.status >> 30, Colour.BAD))


def reading_json(name: str, reading: Reading, style: ValueStyle) -> dict[str, Any]:
    """A value as an object; nothing of it is cut."""
    return {
        "node": name,
        "node_id": reading.node_id,
        "value": reading.value,
        "type": reading.type_name,
        "unit": style.unit or None,
        "status": reading.status_text,
        "source_time": reading.source_time.isoformat() if reading.source_time else None,
        "server_time": reading.server_time.isoformat() if reading.server_time else None,
    }


@dataclass(frozen=True, slots=True)
class ReadingLines:
    """Prints values, one a line."""

    styles: dict[str, ValueStyle] = field(default_factory=dict[str, ValueStyle])
    """By NodeId."""
    zone: tzinfo | None = None
    colours: bool = False
    as_json: bool = False

    @classmethod
    async def of(
        cls,
        client: FleetClient,
        nodes: Sequence[SelectedNode],
        *,
        full: bool = False,
        utc: bool = False,
        color: ColorWhen = ColorWhen.AUTO,
        as_json: bool = False,
    ) -> ReadingLines:
        """For some nodes, with their units."""
        zone = zone_of(utc)
        styles = await styles_of(client, [node.node_id for node in nodes], is_full=full, zone=zone)
        return cls(styles, zone, has_colours(color), as_json)

    def show(self, name: str, reading: Reading, *, arrived: datetime | None = None) -> None:
        """Print a value with its quality and time; with the time of its arrival also how old it was then."""
        style = self.styles.get(reading.node_id) or ValueStyle(zone=self.zone)
        time = reading.source_time or reading.server_time
        if self.as_json:
            shown = reading_json(name, reading, style)
            if arrived is not None:
                shown["age_s"] = (arrived - time).total_seconds() if time is not None else None
            print_json(shown)
            return
        status = status_cell(reading)
        parts = [f"{painted(name, Colour.HEAD, colours=self.colours)} = "]
        parts[0] += painted(value_text(reading.value, reading.type_name, style), None, colours=False)
        if status.text:
            parts.append(painted(status.text, status.colour, colours=self.colours))
        if time is not None:
            parts.append(painted(moment_text(time, self.zone), Colour.FAINT, colours=self.colours))
        if arrived is not None:
            parts.append(painted(f"{age_text(time, arrived)} old", Colour.FAINT, colours=self.colours))
        write_line("  ".join(parts))
