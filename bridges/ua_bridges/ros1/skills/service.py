# pyright: basic, reportMissingImports=false
"""A skill that is a ROS 1 service.

Each call has a thread and a connection of its own. When it takes too long, the connection stays for a while, so that a
late answer is counted, and the server does not fail when it gives it.
"""

from __future__ import annotations

import contextlib
import io
import socket
import struct
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import genpy
import structlog

from ua_bridges.ros.ports import ServicePort
from ua_bridges.ros.schema import schema_from_definition
from ua_bridges.ros.skill_values import RequestFiller, ResponseReader
from ua_bridges.ros.skills import ServiceSkill, SkillSpec
from ua_bridges.ros1.classes import needed_service, response_layout
from ua_bridges.ros1.master import RosMaster
from ua_bridges.ros1.skills.exchange import CallFailed, CallLost, NotAsked, exchange
from ua_bridges.ros1.skills.graph import Ros1Graph, ros1_name
from ua_fleet.bridge.driver import DriverEvent, Execution
from ua_fleet.bridge.executing import Ended, Executing, Open, ended_text
from ua_fleet.errors import NotConnected, SkillRejected
from ua_fleet.values import StatusCode

__all__ = ["Ros1ServicePort"]

MOST_LATE: Final = 16
"""Calls that may still be answered after their time was over; the oldest is given up then."""

_log = structlog.get_logger("ua_bridges.ros1")


class _Call:
    """One call, in its thread."""

    def __init__(self, work: Callable[[_Call], None], name: str) -> None:
        self._lock = threading.Lock()
        self._link: socket.socket | None = None
        self._is_over = False
        threading.Thread(target=work, args=(self,), name=f"ros1-call {name}", daemon=True).start()

    def connected(self, link: socket.socket) -> None:
        """It has its connection."""
        with self._lock:
            self._link = link
            if self._is_over:
                raise ConnectionAbortedError("the bridge stops")

    def end(self) -> None:
        """Nobody waits for it any more."""
        with self._lock:
            self._is_over = True
            if self._link is not None:
                with contextlib.suppress(OSError):  # it has ended by itself
                    self._link.shutdown(socket.SHUT_RDWR)


class Ros1ServicePort(ServicePort[Ros1Graph]):
    """See the module."""

    def __init__(
        self, spec: SkillSpec, way: ServiceSkill, executing: Executing, put: Callable[[DriverEvent], None]
    ) -> None:
        super().__init__(spec, way, executing, put)
        self._calls: dict[bytes, _Call] = {}
        self._late: dict[bytes, None] = {}
        self._uri: str | None = None
        """Where the service was found last, for a time without a master."""

    def _open(self, graph: Ros1Graph) -> None:
        self._graph = graph
        name = ros1_name(self._way.type)
        cls: Any = needed_service(name)
        self._class = cls
        self._request_class = request = cls._request_class
        schema = schema_from_definition(f"{name}Request", request._full_text)  # noqa: SLF001 - genpy's name for it
        self._filler = RequestFiller(self.spec, self._way, schema)
        self._filler.check(request())
        response_layout(cls)  # its arrays are bounded by what comes
        self._reader = ResponseReader(self.spec, self._way, self._way.success, cls._response_class())

    def _request_of(self, execution: Execution) -> bytes:
        content = io.BytesIO()
        try:
            self._filler.fill(self._request_class(), execution.values).serialize(content)
        except (genpy.SerializationError, struct.error) as error:
            raise SkillRejected(f"the request of {self._name} cannot hold that: {error}") from error
        return content.getvalue()

    def _is_there(self) -> bool:
        return self._name in self._graph.state().services

    def _tell(self, execution_id: bytes, request: bytes, now: float) -> None:
        self._calls[execution_id] = _Call(partial(self._work, execution_id, request), self._name)

    def _work(self, execution_id: bytes, request: bytes, call: _Call) -> None:
        """In the call's thread."""
        answered: Callable[[], None]
        try:
            response = exchange(
                self._find(),
                self._name,
                self._class,
                self._graph.node_name,
                request,
                call.connected,
                lambda: self._graph.call(partial(self._asked, execution_id)),
            )
            answered = partial(self._responded, execution_id, response)
        except NotAsked as error:
            answered = partial(self._end, execution_id, Ended(error.status, (), ended_text(str(error))))
        except CallFailed as error:
            said = ended_text(str(error))
            answered = partial(self._end, execution_id, Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said))
        except CallLost as error:
            answered = partial(self._lose, execution_id, ended_text(f"{error}; see what the robot does"))
        except Exception as error:  # noqa: BLE001 - whatever it is, somebody waits for the end
            _log.exception("a service was not called as it should be", service=self._name)
            answered = partial(
                self._lose, execution_id, f"a mistake of the bridge ({error!r}); see what the robot does"
            )
        self._graph.call(answered)

    def _find(self) -> str:
        master = RosMaster(self._graph.master_uri, self._graph.node_name)
        try:
            self._uri = master.service_uri(self._name)
        except NotConnected as error:
            if self._uri is None:
                raise NotAsked(StatusCode.BAD_NO_COMMUNICATION, str(error)) from error
        finally:
            master.close()
        if self._uri is None:
            raise NotAsked(StatusCode.BAD_NO_COMMUNICATION, self._no_service)
        return self._uri

    def _asked(self, execution_id: bytes) -> None:
        if self._executing.get(execution_id) is not None:
            self._executing.progress(execution_id, 0.0)

    def _lose(self, execution_id: bytes, why: str) -> None:
        self._called(execution_id)
        if self._executing.get(execution_id) is not None:  # a call that was given up is lost when its link ends
            self._executing.forget(execution_id, why)

    def _called(self, execution_id: bytes) -> None:
        self._calls.pop(execution_id, None)
        self._late.pop(execution_id, None)

    def _give_up(self, opened: Open, now: float) -> None:
        super()._give_up(opened, now)
        self._late[opened.execution_id] = None
        if len(self._late) > MOST_LATE:
            oldest = next(iter(self._late))
            del self._late[oldest]
            if (call := self._calls.get(oldest)) is not None:
                call.end()

    def close(self) -> None:
        """End all calls."""
        for call in list(self._calls.values()):
            call.end()
