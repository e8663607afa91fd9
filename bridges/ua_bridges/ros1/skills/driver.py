# pyright: basic, reportMissingImports=false
"""The ROS 1 driver whose robots have skills."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from ua_bridges.ros.ports import Listened, RobotSkills, SkilledDriver, port_maker
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros1.classes import MessageType
from ua_bridges.ros1.feed import Feed, Read
from ua_bridges.ros1.master import SystemState
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.session import Ros1Driver
from ua_bridges.ros1.skills.action import ActionPort
from ua_bridges.ros1.skills.graph import Ros1Graph, ros1_name
from ua_bridges.ros1.skills.service import ServicePort
from ua_bridges.ros1.skills.thread import SkillThread
from ua_fleet.bridge.driver import Inlet
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline

__all__ = ["SkilledRos1Driver"]

_NOTHING = SystemState({}, {}, {})


class _SkillFeed:
    """What a port hears, handed over to the skills' thread. See Feed."""

    topic = None

    def __init__(self, listened: Listened, call: Callable[[Callable[[], None]], None]) -> None:
        self._listened, self._call, self._wanted = listened, call, ros1_name(listened.type)

    def announce(self, kind: MessageType, latched: bool) -> None:
        """See Feed."""
        name, wanted = self._listened.name, self._wanted
        said = "" if kind.name == wanted else f"{name} carries {kind.name}, and not {wanted}; correct `type`"
        self._call(partial(self._listened.source, said))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        is_wanted, call, heard = kind.name == self._wanted, self._call, self._listened.heard

        def read(message: object, received_ns: int, own: bool) -> None:
            if is_wanted and not own:
                call(partial(heard, message))

        return read

    def lost(self) -> None:
        """See Feed."""
        self._call(partial(self._listened.source, f"nobody publishes {self._listened.name}; start the robot's node"))


class SkilledRos1Driver(SkilledDriver, Ros1Driver):
    """See HaltingDriver and SuspendingDriver in `ua_fleet.bridge.driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str, specs: Sequence[SkillSpec]) -> None:
        super().__init__(config, bridge_name)
        self._specs = specs
        self._skill_thread: SkillThread | None = None
        self._graph: Ros1Graph | None = None
        self._offers = tuple([spec.offer() for spec in specs])

    def _skill_feeds(self, node: RosNode, inlet: Inlet) -> Iterable[tuple[str, Feed]]:
        self._skill_thread = thread = SkillThread()
        self._skills = skills = RobotSkills(self._specs, port_maker(ServicePort, ActionPort), inlet.put, thread.call)
        self._graph = graph = Ros1Graph(
            node.name,
            self._bridge.master_uri,
            lambda: self._watch.state if self._watch is not None else _NOTHING,
            thread.call,
        )
        skills.opened(graph)
        thread.start(skills.turn)
        return [(listened.name, _SkillFeed(listened, thread.call)) for port in skills for listened in port.listened()]

    def _spoken(self) -> Mapping[str, str]:
        return self._graph.spoken if self._graph is not None else {}

    async def stop(self) -> None:
        """See Driver."""
        thread, self._skill_thread = self._skill_thread, None
        if thread is not None:
            await asyncio.to_thread(thread.stop)
            for port in self._skills:
                if isinstance(port, ServicePort):
                    port.close()
        await super().stop()

    def _check_node(self) -> None:
        if self._skill_thread is None or self._node is None or self._node.was_shut_down:
            raise RobotOffline(f"the bridge is not in its graph: {self.status().detail}")
