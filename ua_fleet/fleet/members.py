"""What the server itself says of robots, bridges and its own traffic."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from ua_fleet.counters import OF_BRIDGES, Counters
from ua_fleet.fleet.changes import Change, Noticed, ValueChanged
from ua_fleet.fleet.model import BridgeModel, FleetModel, RobotModel, RobotState, drop_field
from ua_fleet.fleet.moved import MovedRobots
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import BuiltinType, NodeId, StatusCode

__all__ = ["BridgeLiveness", "RobotLiveness", "ServerCounters"]

_BOOLEAN: Final = int(BuiltinType.BOOLEAN)
_INT32: Final = int(BuiltinType.INT32)
_UINT64: Final = int(BuiltinType.UINT64)
_DATETIME: Final = int(BuiltinType.DATETIME)
_WAITING: Final = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)
_NOT_WANTED: Final = int(StatusCode.UNCERTAIN_LAST_USABLE_VALUE)
"""What a bridge says of a value that it would read if somebody wanted it."""


def _said(key: NodeId, kind: int, value: Any, wall_ticks: int | None) -> ValueChanged:
    return ValueChanged(key, kind, value, 0, wall_ticks, False)


class BridgeLiveness:
    """Whether the server hears a bridge."""

    __slots__ = ("last_seen", "model", "online", "told_last_seen")

    def __init__(self, model: BridgeModel) -> None:
        self.model = model
        self.online: bool | None = None
        self.last_seen: int | None = None
        self.told_last_seen: int | None = None

    def set_online(self, online: bool, wall_ticks: int) -> list[Change]:
        """The bridge's own status DataSet is heard, or not any more."""
        if online == self.online:
            return []
        self.online = online
        text = "is there" if online else "is silent: its status is Bad_NoCommunication"
        return [
            _said(self.model.part("Online"), _BOOLEAN, online, wall_ticks),
            Noticed(not online, f"bridge {self.model.name} {text}", bridge=self.model.name),
        ]

    def tick(self, wall_ticks: int) -> list[Change]:
        """LastSeen, where it has moved; at the first tick also that the bridge has not been heard yet."""
        changes: list[Change] = []
        if self.online is None:
            self.online = False
            changes.append(_said(self.model.part("Online"), _BOOLEAN, False, wall_ticks))
        if self.last_seen != self.told_last_seen:
            self.told_last_seen = self.last_seen
            changes.append(_said(self.model.part("LastSeen"), _DATETIME, self.last_seen, wall_ticks))
        return changes


class RobotLiveness:
    """Whether a robot can be reached: while any of its own sources is alive.

    Its fault node is one of them: its bridge has it from the robot, and says when the robot is not reached. SkillStatus
    is none, which a bridge publishes of robots that it does not reach.

    A robot without data of its own can be reached while its bridge can; without a bridge that is known, while its
    SkillStatus is heard. Offline goes before Faulted, and that before Busy.
    """

    __slots__ = (
        "_moved",
        "alive",
        "bridge",
        "driven_by",
        "faulted",
        "last_update",
        "model",
        "quality",
        "shown",
        "shown_since",
        "silent",
        "skills",
        "sources",
        "told_silent",
        "told_update",
    )

    def __init__(self, model: RobotModel, bridge: BridgeLiveness | None, moved: MovedRobots) -> None:
        """Know a robot.

        Args:
            model: it.
            bridge: it is reached by, where that is known.
            moved: gets its name when something of it has changed that a list of robots shows.
        """
        self.model = model
        self.bridge = bridge
        self._moved = moved
        moved.add(model.name)
        self.sources = tuple([each.topic for each in model.data_sets if each.topic.space != SERVER_SPACE])
        if self.sources and model.fault is not None:
            self.sources += (model.fault.topic,)
        if not self.sources and bridge is None and model.skill_status is not None:
            self.sources = (model.skill_status,)
        self.alive = 0
        self.skills: tuple[str, ...] = ()
        """Those that it is at."""
        self.driven_by = ""
        """By whom it is driven by hand, in words; empty: nobody."""
        self.faulted = False
        """Whether it has a fault that is more than its silence."""
        self.silent: set[str] = set()
        """Names of the sources that have been alive and are not."""
        self.told_silent: set[str] = set()
        self.shown: RobotState | None = None
        self.shown_since: int | None = None
        self.last_update: int | None = None
        self.told_update: int | None = None
        self.quality: int | None = None
        """The worst status of its own sources (`quality_of_values`); None where that has to be looked at anew."""

    def source_changed(self, name: str, alive: bool, wall_ticks: int) -> list[Change]:
        """One of the robot's own sources is heard again, or not any more."""
        self.alive += 1 if alive else -1
        if alive:
            self.silent.discard(name)
        else:
            self.silent.add(name)
        return self.state(wall_ticks)

    def has_moved(self, *, quality: bool = False) -> None:
        """Something of it has changed that a list of robots shows; `quality`: the status of a value."""
        self._moved.add(self.model.name)
        if quality:
            self.quality = None

    def quality_of_values(self, statuses: Iterable[int]) -> int:
        """The worst of the statuses that its values have.

        What has never come says nothing of now, nor does what is read on demand and nobody wants: they count where
        there is nothing else. A robot without data of its own is as its bridge is.
        """
        if self.quality is None or not self.sources:
            uncounted = {_WAITING}
            if self.bridge is not None and self.bridge.model.reads_on_demand:
                uncounted.add(_NOT_WANTED)
            if self.sources:
                known = list(dict.fromkeys(statuses))
            else:
                online = None if self.bridge is None else self.bridge.online
                known = [_WAITING if online is None else 0 if online else _NO_COMMUNICATION]
            counted = [status for status in known if status not in uncounted] or known
            self.quality = max(counted, key=lambda status: status >> 30, default=_WAITING)
        return self.quality

    def state(self, wall_ticks: int) -> list[Change]:
        """State, where it has changed."""
        is_online = self.alive > 0 if self.sources else self.bridge is not None and bool(self.bridge.online)
        state = RobotState.OFFLINE
        if is_online:
            is_busy = bool(self.skills or self.driven_by)
            state = RobotState.FAULTED if self.faulted else RobotState.BUSY if is_busy else RobotState.IDLE
        if state is self.shown:
            return []
        self.shown, self.shown_since = state, wall_ticks
        self.has_moved()
        return [_said(self.model.part("State"), _INT32, int(state), wall_ticks)]

    def tick(self, wall_ticks: int) -> list[Change]:
        """State and LastUpdate, where they have moved, and what the log is told of silent sources."""
        changes = self.state(wall_ticks)
        if self.last_update != self.told_update:
            self.told_update = self.last_update
            self.has_moved()
            changes.append(_said(self.model.part("LastUpdate"), _DATETIME, self.last_update, wall_ticks))
        if self.silent != self.told_silent:
            self.told_silent = set(self.silent)
            changes.append(self._notice())
        return changes

    def _notice(self) -> Noticed:
        name = self.model.name
        if not self.silent:
            return Noticed(False, f"robot {name} is there, with all its sources", robot=name)
        if self.alive == 0:
            return Noticed(True, f"robot {name} is silent: its nodes are Bad_NoCommunication", robot=name)
        return Noticed(True, f"robot {name} is silent in part: {', '.join(sorted(self.silent))}", robot=name)


_DROPS: Final = tuple([(drop_field(drop.value), drop) for drop in OF_BRIDGES])
"""What counts them, by the names of their nodes."""


class ServerCounters:
    """The server's own counters as nodes."""

    def __init__(self, model: FleetModel) -> None:
        self._model = model
        self._told: dict[str, int] = {}

    def tick(self, counters: Counters, wall_ticks: int) -> list[Change]:
        """The counters that have moved."""
        now = {
            "MessagesIn": counters.messages_in,
            "MessagesOut": counters.messages_out,
            "Gaps": counters.gaps,
            "Looped": counters.looped,
        } | {name: counters.drops[drop] for name, drop in _DROPS}
        moved = [(name, value) for name, value in now.items() if self._told.get(name) != value]
        self._told = now
        return [_said(self._model.traffic(name), _UINT64, value, wall_ticks) for name, value in moved]
