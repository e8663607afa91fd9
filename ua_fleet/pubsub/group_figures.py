"""What a bridge counts of its PubSubConnections and its WriterGroups, as one field of its status DataSet.

The server shows it as their Diagnostics (OPC 10000-14 9.1.11). One field holds all, since groups come and go: how many
numbers one of them has, then the numbers of one after those of the other. Of several PubSubConnections each tells of
itself; the WriterGroups are those of all, and stand at the first.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

from ua_fleet.pubsub.components import CONNECTION, Component, writer_group
from ua_fleet.pubsub.publisher import Publisher

__all__ = ["FIGURES_FIELD", "GroupFigures", "LinkErrors", "figures_of", "packed", "unpacked"]

FIGURES_FIELD: Final = "PubSubDiagnostics"
"""Name of the field, an array of UInt32."""
MOST_GROUPS: Final = 32
"""WriterGroups that are told of; a bridge has one for each namespace of its robots' data."""
_LARGEST: Final = 0xFFFF_FFFF


class GroupFigures(NamedTuple):
    """Of one WriterGroup, or of a PubSubConnection, whose WriterGroupId is 0."""

    writer_group_id: int
    sent: int = 0
    """NetworkMessages."""
    failed: int = 0
    not_secured: int = 0
    configured: int = 0
    """DataSetWriters."""
    operational: int = 0
    errors: int = 0
    """How often it went into the state Error, ..."""
    from_error: int = 0
    """... and back."""
    by_method: int = 0
    by_parent: int = 0
    paused: int = 0
    disabled: int = 0
    connection: int = 0
    """Its number among those of the bridge."""
    has_problem: int = 0
    """1 while nothing can be sent or received by the connection: its state is Error."""

    @property
    def component(self) -> Component:
        """What these are of."""
        return writer_group(self.writer_group_id) if self.writer_group_id else CONNECTION


_SIZE: Final = len(GroupFigures._fields)


class LinkErrors:
    """How often a PubSubConnection went into the state Error, and back, as far as `look` has seen it."""

    def __init__(self) -> None:
        self.counts: tuple[int, int] = 0, 0
        self.has_problem: bool = False
        """Whether it is in the state Error now."""

    def look(self, problem: str) -> None:
        """Note why nothing can be sent or received now; empty where all is well. To be called each second."""
        has_problem = bool(problem)
        if has_problem != self.has_problem:
            self.has_problem = has_problem
            self.counts = self.counts[0] + has_problem, self.counts[1] + (not has_problem)


def figures_of(
    publisher: Publisher,
    failed: Any,
    not_secured: Any,
    links: Sequence[LinkErrors],
) -> list[GroupFigures]:
    """The figures of a process now.

    Args:
        publisher: its DataSetWriters.
        failed: NetworkMessages that could not be sent, by WriterGroupId.
        not_secured: those that could not be signed or encrypted.
        links: of each of its PubSubConnections.
    """
    configured: dict[int, int] = {}
    operational: dict[int, int] = {}
    for topic, each in publisher.writers.items():
        if each.encode is not None:
            configured[topic[1]] = configured.get(topic[1], 0) + 1
            operational[topic[1]] = operational.get(topic[1], 0) + (not each.is_off)
    components, sent = publisher.switches.components, publisher.sent_messages
    whole = GroupFigures(0)._replace(**_states(components.counts(CONNECTION)))
    made: list[GroupFigures] = []
    for number, link in enumerate(links):
        errors, back = link.counts
        made.append(
            whole._replace(connection=number, errors=errors, from_error=back, has_problem=int(link.has_problem))
        )
    for ns in sorted(configured)[:MOST_GROUPS]:
        group = GroupFigures(ns, sent[ns], failed[ns], not_secured[ns], configured[ns], operational[ns])
        made.append(group._replace(**_states(components.counts(writer_group(ns)))))
    return made


def _states(counts: Any) -> dict[str, int]:
    return {
        "by_method": counts.operational_by_method,
        "by_parent": counts.operational_by_parent,
        "paused": counts.paused_by_parent,
        "disabled": counts.disabled_by_method,
    }


def packed(figures: Iterable[GroupFigures]) -> tuple[int, ...]:
    """The value of the field."""
    return _SIZE, *[min(number, _LARGEST) for each in figures for number in each]


def unpacked(numbers: Sequence[Any]) -> dict[tuple[int, Component], GroupFigures]:
    """The figures by the number of the connection and what they are of; nothing of a value that is none."""
    if numbers[:1] != (_SIZE,) or len(numbers) % _SIZE != 1 or not all(type(number) is int for number in numbers):
        return {}
    made = [GroupFigures(*numbers[start : start + _SIZE]) for start in range(1, len(numbers), _SIZE)]
    return {(each.connection, each.component): each for each in made}
