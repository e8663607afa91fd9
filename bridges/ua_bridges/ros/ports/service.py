"""A skill that is a service: its response is the end. A service cannot be asked afterwards, or stopped.

How it is called is the affair of each ROS.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from ua_bridges.ros.ports.port import Graph_contra, SkillPort
from ua_bridges.ros.skill_values import ResponseReader
from ua_bridges.ros.skills import ServiceSkill, SkillSpec
from ua_bridges.ros.topic_mapping import absolute
from ua_fleet.bridge.driver import DriverEvent
from ua_fleet.bridge.executing import Ended, Executing

__all__ = ["ServicePort"]


class ServicePort(SkillPort[Graph_contra]):
    """See the module."""

    _reader: ResponseReader

    def __init__(
        self, spec: SkillSpec, way: ServiceSkill, executing: Executing, put: Callable[[DriverEvent], None]
    ) -> None:
        super().__init__(spec, executing, put)
        self._way, self._name = way, absolute(way.name)
        self._no_service = f"there is no service {self._name}; start the robot's node"
        self.cannot_stop = f"the service {self._name} cannot be stopped after it is called"

    @abstractmethod
    def _is_there(self) -> bool:
        """Whether there is a server now."""

    @abstractmethod
    def _called(self, execution_id: bytes) -> None:
        """A call is over."""

    def _look(self, now: float) -> str:
        return "" if self._is_there() else self._no_service

    def _responded(self, execution_id: bytes, response: Any) -> None:
        """The server has answered, perhaps too late."""
        opened = self._executing.get(execution_id)
        self._end(execution_id, None if opened is None else self._reader.read(response, opened.arguments))

    def _end(self, execution_id: bytes, ended: Ended | None) -> None:
        """How an execution ends; nothing is said of one that nobody waits for any more."""
        self._called(execution_id)
        if ended is None or self._executing.get(execution_id) is None:
            self._executing.unasked(execution_id, self._name)
        else:
            self._executing.end(execution_id, ended)

    def _ask(self, execution_id: bytes, now: float) -> None:
        said = f"a service such as {self._name} cannot be asked afterwards; see what the robot did"
        self._executing.forget(execution_id, said)

    def _stop(self, execution_id: bytes, now: float) -> None:
        """A service cannot be stopped."""
