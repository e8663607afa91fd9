"""What the server itself says of robots, bridges and its own traffic."""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.fleet.changes import Change, Noticed, ValueChanged
from ua_fleet.fleet.model import BridgeModel, FleetModel, RobotModel, RobotState, drop_field
from ua_fleet.values import BuiltinType, NodeId

__all__ = ["BridgeStatus", "RobotStatus", "Traffic"]

_BOOLEAN: Final = int(BuiltinType.BOOLEAN)
_INT32: Final = int(BuiltinType.INT32)
_UINT64: Final = int(BuiltinType.UINT64)
_DATETIME: Final = int(BuiltinType.DATETIME)


def _said(key: NodeId, kind: int, value: Any, wall_ticks: int | None) -> ValueChanged:
    return ValueChanged(key, kind, value, 0, wall_ticks, False)


class BridgeStatus:
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


class RobotStatus:
    """Whether a robot can be reached: while any of its own sources is alive.

    Its fault node is one of them: its bridge has it from the robot, and says when the robot is not reached. SkillStatus
    is none, which a bridge publishes of robots that it does not reach.

    A robot without data of its own can be reached while its bridge can; without a bridge that is known, while its
    SkillStatus is heard. Offline goes before Faulted, and that before Busy.
    """

    __slots__ = (
        "alive",
        "bridge",
        "busy",
        "faulted",
        "last_update",
        "model",
        "shown",
        "silent",
        "sources",
        "told_silent",
        "told_update",
    )

    def __init__(self, model: RobotModel, bridge: BridgeStatus | None) -> None:
        self.model = model
        self.bridge = bridge
        self.sources = tuple([data_set.topic for data_set in model.data_sets if not data_set.writable])
        if self.sources and model.fault is not None:
            self.sources += (model.fault.topic,)
        if not self.sources and bridge is None and model.skill_status is not None:
            self.sources = (model.skill_status,)
        self.alive = 0
        self.busy = False
        """Whether it runs a skill."""
        self.faulted = False
        """Whether it has a fault that is more than its silence."""
        self.silent: set[str] = set()
        """Names of the sources that have been alive and are not."""
        self.told_silent: set[str] = set()
        self.shown: RobotState | None = None
        self.last_update: int | None = None
        self.told_update: int | None = None

    def source_changed(self, name: str, alive: bool, wall_ticks: int) -> list[Change]:
        """One of the robot's own sources is heard again, or not any more."""
        self.alive += 1 if alive else -1
        if alive:
            self.silent.discard(name)
        else:
            self.silent.add(name)
        return self.state(wall_ticks)

    def state(self, wall_ticks: int) -> list[Change]:
        """State, where it has changed."""
        is_online = self.alive > 0 if self.sources else self.bridge is not None and bool(self.bridge.online)
        state = RobotState.OFFLINE
        if is_online:
            state = RobotState.FAULTED if self.faulted else RobotState.BUSY if self.busy else RobotState.IDLE
        if state is self.shown:
            return []
        self.shown = state
        return [_said(self.model.part("State"), _INT32, int(state), wall_ticks)]

    def tick(self, wall_ticks: int) -> list[Change]:
        """State and LastUpdate, where they have moved, and what the log is told of silent sources."""
        changes = self.state(wall_ticks)
        if self.last_update != self.told_update:
            self.told_update = self.last_update
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


class Traffic:
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
        } | {drop_field(drop.value): counters.drops[drop] for drop in Drop}
        moved = [(name, value) for name, value in now.items() if self._told.get(name) != value]
        self._told = now
        return [_said(self._model.traffic(name), _UINT64, value, wall_ticks) for name, value in moved]
