"""Changes of the fleet's state onto its nodes, and events between them: each is done when it is told.

A turn of the server writes `BATCH` values. What a turn has to write beyond that (a bridge that falls silent with ten
thousand values, a message with as many fields) waits for the next turns. A value that need not be written (`can_wait`)
gives way to the next one of its node; any other one waits before that one, and both behind what waits already. Events
are told behind the values that wait. The faults of a few robots, in a flood of values that thousands of monitored items
watch, would else have all of it written at once. Nodes come at once, and go when nothing waits.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from math import inf
from typing import Final

from ua_fleet.endpoint.at_once import do_at_once
from ua_fleet.endpoint.convert import data_value
from ua_fleet.fleet.changes import (
    CapacitiesChanged,
    Change,
    RobotAdded,
    RobotRemoved,
    SourceAdded,
    SourceQuarantined,
    SourceReleased,
    SourceRemoved,
    ValueChanged,
)
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.operation.skills.tracker import SkillTransitioned
from ua_fleet.values import ARRAY, BuiltinType, datetime_from_ticks, ticks_from_datetime

__all__ = ["BATCH", "Projection"]

TellCapacities = Callable[[CapacitiesChanged, Sequence[str], Sequence[str]], None]
"""Makes the event of capacities that a robot has gained, and of those that it has lost."""

_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
BATCH: Final = 250
"""Writes of a turn: about 3 ms of work."""
EVENT: Final = 25
"""An event, or any other change that is no value, takes as long as so many writes."""
WATCHERS: Final = 4
"""Monitored items to tell that take as long as a write."""
LARGEST_BATCH: Final = 500
"""The same while much waits, so that it is written within a second."""
MOST_WAITING: Final = 20_000
"""Events, and values that must be told before the last one of their node. For one more, the first of all that waits is
done at once."""


class Projection:
    """Writes changes to nodes in the order in which they are told.

    A value goes straight into what asyncua holds for the node, and to the monitored items that watch it: its own write
    method would compare the type once more, and take the value away from a node that becomes Bad.
    """

    def __init__(
        self,
        nodes: FleetNodes,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        *,
        tell: Callable[[SkillTransitioned], None] = lambda _moved: None,
        tell_capacities: TellCapacities = lambda _change, _gained, _lost: None,
        sooner: Callable[[], None] = lambda: None,
        mistakes: Mistakes | None = None,
    ) -> None:
        """Make a projection onto built nodes.

        Args:
            nodes: the fleet's.
            now: time of the server.
            tell: makes the event of a skill.
            tell_capacities: makes the event of capacities gained and lost.
            sooner: called when something begins to wait for `poll`.
            mistakes: counts what has cost a change; its own without.
        """
        self._nodes, self._now, self._tell, self._tell_capacities = nodes, now, tell, tell_capacities
        self._sooner = sooner
        self._mistakes = mistakes or Mistakes()
        self._values = nodes.values
        self._left: float = BATCH
        """Writes that this turn has left."""
        self._pending: OrderedDict[object, ValueChanged | Callable[[], None]] = OrderedDict()
        """What waits for a turn: the last value of each node, by its id, others of it, and what follows on values."""
        self._extra = 0
        """How many of these are not the last value of a node."""
        self._ticks: int | None = None
        self._source_time: datetime | None = None
        """The time of the source that was written last, as ticks and as asyncua has it: a message has one."""

    @property
    def waiting(self) -> int:
        """Values, and what follows on them, that wait for a turn."""
        return len(self._pending)

    # Turns.

    def begin_turn(self) -> None:
        """The server begins with something else, a datagram for example: it may write a batch."""
        self._left = BATCH

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        return now if self._pending else None

    def poll(self, now: float) -> None:
        """Write a batch of what waits."""
        del now
        self._write_waiting(max(BATCH, min(len(self._pending) // 8, LARGEST_BATCH)))

    # Changes.

    def write(self, change: ValueChanged, *, ahead: bool = False) -> None:
        """Write a value to its node, and tell who watches it: now, or, where it is not `ahead`, when its turn comes."""
        if (self._left <= 0 or self._pending) and not ahead:
            self._hold(change)
            return
        self._left -= 1
        held = self._values.get(change.key) or self._nodes.value(change.key)
        if held is None:
            return
        try:
            ticks = change.source_timestamp
            if ticks != self._ticks:
                self._source_time = None if ticks is None else datetime_from_ticks(ticks)
                self._ticks = ticks
            value = data_value(change.type, change.value, change.status, self._source_time, self._now())
            held.value = value
        except Exception as error:  # noqa: BLE001 - what is behind it has nothing to do with it
            self._mistakes.caught("values", error, node=str(change.key))
            return
        if held.is_watched:
            watchers = tuple(held.datachange_callbacks.items())
            for handle, tell in watchers:
                try:
                    do_at_once(tell(handle, value))
                except Exception as error:  # noqa: BLE001 - one client's item must not keep the others from the value
                    self._mistakes.caught("monitored items", error)
            self._left -= len(watchers) // WATCHERS

    def write_ahead(self, change: ValueChanged) -> None:
        """Write a value now, whatever waits: one that somebody's safety hangs on. A node has all its values so."""
        self.write(change, ahead=True)

    def put(self, change: Change | SkillTransitioned) -> None:
        """Show any change: a value and an event in their turn, another node at once."""
        if type(change) is ValueChanged:
            self.write(change)
            return
        what = type(change).__name__
        if isinstance(change, SkillTransitioned | CapacitiesChanged):
            self.then(lambda: self._apply(change), what)
            return
        if isinstance(change, SourceRemoved | RobotRemoved):
            self._write_waiting(inf)  # what waits may be about them
            self._left = 0
        self._do(lambda: self._apply(change), what)

    def then(self, action: Callable[[], None], what: str = "") -> None:
        """Do something, e.g. tell an event, once all that was told before is written: now, if nothing waits."""
        if not self._pending:
            self._do(action, what)
            return
        self._hold_extra(lambda: self._do(action, what))
        self._keep_bound()

    def _do(self, action: Callable[[], None], what: str) -> None:
        try:
            action()
        except Exception as error:  # noqa: BLE001 - as above
            self._mistakes.caught("projection", error, what=what or type(action).__name__)
        self._left -= EVENT

    def _hold(self, change: ValueChanged) -> None:
        """Keep a value for one of the next turns."""
        is_first = not self._pending
        before = self._pending.pop(change.key, None)
        if isinstance(before, ValueChanged) and not (before.can_wait and change.can_wait):
            self._hold_extra(before)
        self._pending[change.key] = change
        self._keep_bound()
        if is_first:
            self._sooner()

    def _hold_extra(self, what: ValueChanged | Callable[[], None]) -> None:
        self._pending[object()] = what
        self._extra += 1

    def _keep_bound(self) -> None:
        """Do one thing for each that came beyond the bound, so that the memory for what waits has one too."""
        if self._extra > MOST_WAITING:
            self._do_first()

    def _write_waiting(self, count: float) -> None:
        self._left = count
        while self._pending and self._left > 0:
            self._do_first()

    def _do_first(self) -> None:
        key, first = self._pending.popitem(last=False)
        self._extra -= type(key) is object
        if isinstance(first, ValueChanged):
            self.write_ahead(first)
        else:
            first()

    def _set_capacities(self, change: CapacitiesChanged) -> None:
        gained, lost = self._nodes.set_capacities(change.robot, change.holds)
        if not gained and not lost:
            return
        key, ticks = change.robot.part("Capacities"), ticks_from_datetime(self._now())
        self.write_ahead(ValueChanged(key, _TEXTS, change.holds, 0, ticks, False))
        self._tell_capacities(change, gained, lost)

    def _apply(self, change: Change | SkillTransitioned) -> None:
        match change:
            case SkillTransitioned():
                self._tell(change)
            case SourceAdded():
                self._nodes.add_source(change.data_set)
            case SourceRemoved():
                self._nodes.remove_source(change.data_set)
            case SourceQuarantined():
                self._nodes.add_quarantined(change)
            case SourceReleased():
                self._nodes.remove_quarantined(change.topic)
            case CapacitiesChanged():
                self._set_capacities(change)
            case RobotAdded():
                self._nodes.add_robot(change.robot)
            case RobotRemoved():
                self._nodes.remove_robot(change.robot)
            case _:
                pass
