"""What the bridges' own nodes say of the robots behind them: whether a bridge is there, and reaches its robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.printing import config_option, utc_text
from ua_fleet.values import NodeId

__all__ = ["BridgesSeen"]

_LINKED: Final = "Connected"
"""The field of a bridge's status that says whether it reaches its robots."""


class BridgesSeen:
    """The bridges of a fleet; none has been heard yet."""

    def __init__(self, model: FleetModel, robots: Mapping[str, RobotModel], wall_s: Callable[[], float]) -> None:
        """Look at the bridges of a model.

        Args:
            model: the fleet's.
            robots: by name; those that come and go later are seen in it.
            wall_s: seconds since 1970, which nobody sets.
        """
        self._robots, self._wall_s = robots, wall_s
        self._online = {bridge.part("Online"): bridge.name for bridge in model.bridges}
        """By the nodes that say whether they are heard."""
        self._linked: dict[NodeId, str] = {
            field.key: bridge.name
            for bridge in model.bridges
            for field in (bridge.status.fields if bridge.status is not None else ())
            if field.name == _LINKED
        }
        """By the nodes that say whether they reach their robots."""
        self._away = dict.fromkeys(self._online.values(), wall_s())
        """Since when bridges are not heard, the server's start at the earliest."""
        self._apart: set[str] = set()
        """Bridges that do not reach their robots."""

    def comes_or_goes(self, change: ValueChanged) -> str | None:
        """The bridge that is heard with this change, or is not any more; None where it is about something else."""
        bridge = self._online.get(change.key)
        if bridge is not None and change.value:
            self._away.pop(bridge, None)
        elif bridge is not None:
            self._away.setdefault(bridge, self._wall_s())
        return bridge

    def linked(self, change: ValueChanged) -> tuple[str, bool] | None:
        """The bridge whose link this change is about, and whether it reaches its robots."""
        bridge = self._linked.get(change.key)
        return None if bridge is None else (bridge, change.value is not False)

    def set_link(self, bridge: str, *, reaches: bool) -> bool:
        """A bridge reaches its robots, or has lost one of them; whether that is new."""
        if reaches is (bridge not in self._apart):
            return False
        (self._apart.discard if reaches else self._apart.add)(bridge)
        return True

    def is_apart(self, robot: str) -> bool:
        """Whether a robot's bridge has lost it, or another of its robots: what it said last is not what they say."""
        known = self._robots.get(robot)
        return known is not None and known.bridge in self._apart

    def why_silent(self, robot: str) -> str:
        """Why nothing is heard of a robot, as far as its bridge says it, and what to do; empty where none is known."""
        known = self._robots.get(robot)
        if known is None or known.bridge not in self._online.values():
            return ""
        bridge = known.bridge
        if (since := self._away.get(bridge)) is not None:
            return (
                f"its bridge {bridge} is not there since {utc_text(since)}; run it: "
                f"ua-fleet bridge {bridge}{config_option()}"
            )
        if bridge in self._apart:
            return f"its bridge {bridge} is there, and does not reach it; see to the robot, and to the network between"
        return f"its bridge {bridge} is there; see to the robot"
