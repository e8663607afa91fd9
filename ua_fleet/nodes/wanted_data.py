"""The server's side of `ua_fleet.fleet.wanted`: which data clients subscribe to, or a run needs."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Final

from asyncua import ua

from ua_fleet.fleet.commands import Publication
from ua_fleet.fleet.model import BridgeModel, RobotModel
from ua_fleet.fleet.wanted import WANTED_FIELDS, wanted_topic
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["WantedData"]

LOOK_S: Final = 0.2
"""Period in which subscriptions are looked at; they begin and end in too many ways to be told of each."""
RENEW_S: Final = 1.0
"""What is wanted is told anew so often: a bridge that did not hear the server for a while forgets it."""


class WantedData:
    """What is wanted of each bridge that reads on demand. See `server.attached.WantedPart`."""

    def __init__(
        self,
        bridges: Iterable[BridgeModel],
        robots: Callable[[], Iterable[RobotModel]],
        values: Mapping[NodeId, Any],
        needed: Callable[[], Collection[NodeId]],
        *,
        publish: Callable[[Publication], None],
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Look after the bridges that read on demand.

        Args:
            bridges: all of the fleet.
            robots: all that are there now.
            values: what holds the value of each node, with the callbacks of its monitored items.
            needed: the nodes whose values a run needs now.
            publish: sends a DataSet.
            clock: monotonic seconds.
            wall_ticks: the time of the wall clock.
        """
        self._topics = {
            bridge.name: wanted_topic(bridge.status.topic)
            for bridge in bridges
            if bridge.reads_on_demand and bridge.status is not None
        }
        self._robots, self._values, self._needed = robots, values, needed
        self._publish, self._clock, self._wall_ticks = publish, clock, wall_ticks
        self._told: dict[str, tuple[int, ...]] = {}
        self._look_at: float | None = None
        self._renew_at = 0.0

    def sources(self) -> list[tuple[str, Topic, tuple[FieldMetaData, ...]]]:
        """What is to be announced: name, topic and fields."""
        return [(f"{name} wanted", topic, WANTED_FIELDS) for name, topic in self._topics.items()]

    def begin(self) -> None:
        """The sources are announced: tell of them from now on."""
        if self._topics:
            self._look_at = self._clock()

    def poll(self) -> None:
        """Tell what has changed."""
        if self._look_at is None or self._clock() < self._look_at:
            return
        self._look_at = self._clock() + LOOK_S
        is_due = self._clock() >= self._renew_at
        if is_due:
            self._renew_at = self._clock() + RENEW_S
        needed = self._needed()
        wanted: dict[str, list[int]] = {name: [] for name in self._topics}
        for robot in self._robots():
            ids = wanted.get(robot.bridge)
            if ids is None:
                continue
            for data_set in robot.data_sets:
                fields = [field.key for field in data_set.fields]
                if not data_set.writable and any(key in needed or self._is_watched(key) for key in fields):
                    ids.append(data_set.topic.id)
        for name, ids in wanted.items():
            said = tuple(sorted(ids))
            if self._told.get(name) != said or (said and is_due):
                self._told[name] = said
                types = (int(BuiltinType.UINT16 | ARRAY),)
                self._publish(Publication(self._topics[name], types, (said,), self._wall_ticks()))

    def due_in_s(self) -> float | None:
        """After how many seconds `poll` is to be called next, or None."""
        return None if self._look_at is None else max(self._look_at - self._clock(), 0.0)

    def _is_watched(self, key: NodeId) -> bool:
        """Whether a monitored item takes the node's values: one that is disabled does not."""
        held = self._values.get(key)
        if held is None:
            return False
        items = [getattr(callback, "__self__", None) for callback in held.datachange_callbacks.values()]
        return any(getattr(item, "mode", None) is not ua.MonitoringMode.Disabled for item in items)
