# pyright: basic, reportMissingImports=false
"""A skill that is a ROS 2 service."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

from ua_bridges.ros.ports import ServicePort
from ua_bridges.ros.skill_values import RequestFiller, ResponseReader
from ua_bridges.ros.skills import ServiceSkill, SkillSpec
from ua_bridges.ros2.skills.calls import Calls
from ua_bridges.ros2.skills.graph import Ros2Graph, find_type, part_schema
from ua_fleet.bridge.driver import DriverEvent, Execution
from ua_fleet.bridge.executing import Executing, Open

__all__ = ["Ros2ServicePort"]

GONE_S: Final = 1.0
"""A server that is missing for so long will not answer what it was asked before."""


class Ros2ServicePort(ServicePort[Ros2Graph]):
    """See the module."""

    def __init__(
        self, spec: SkillSpec, way: ServiceSkill, executing: Executing, put: Callable[[DriverEvent], None]
    ) -> None:
        super().__init__(spec, way, executing, put)
        self._asked: set[bytes] = set()
        self._gone_at: float | None = None

    def _open(self, graph: Ros2Graph) -> None:
        way = self._way
        self._class = find_type(way.type, "srv")
        self._filler = RequestFiller(self.spec, way, part_schema(f"{way.type}_Request", self._class.Request))
        self._filler.check(self._class.Request())
        self._reader = ResponseReader(self.spec, way, way.success, self._class.Response())
        self._calls = Calls(graph.node, self._class, self._name)

    def _request_of(self, execution: Execution) -> Any:
        return self._filler.fill(self._class.Request(), execution.values)

    def _is_there(self) -> bool:
        return self._calls.is_ready

    def _tell(self, execution_id: bytes, request: Any, now: float) -> None:
        self._asked.add(execution_id)
        self._executing.progress(execution_id, 0.0)
        self._calls.call(request, partial(self._responded, execution_id))

    def _called(self, execution_id: bytes) -> None:
        self._asked.discard(execution_id)

    def turn(self, now: float) -> None:
        """See SkillPort."""
        super().turn(now)
        if not self._asked or not self.absent:
            self._gone_at = None
        elif self._gone_at is None:
            self._gone_at = now + GONE_S
        elif now >= self._gone_at:
            for execution_id in self._asked:
                self._executing.forget(execution_id, f"the server of {self._name} went before it answered")
            self._asked.clear()

    def _give_up(self, opened: Open, now: float) -> None:
        self._asked.discard(opened.execution_id)
        super()._give_up(opened, now)
