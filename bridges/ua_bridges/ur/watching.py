"""Reads the controller's state in a thread, for as long as the driver runs; connects again with back-off."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import structlog

from ua_bridges.ur.config import UrBridgeConfig
from ua_bridges.ur.library.child import ChildEnded, ChildFailed, LibraryChild, NoAnswer
from ua_bridges.ur.state import ControllerClock, State, WallClock, stop_of
from ua_bridges.ur.telemetry import Telemetry
from ua_fleet.bridge.driver import DriverEvent, DriverStatus, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = ["Faults", "Watcher"]

_START_S: Final = 5.0
"""Python and the library are there within this."""
_WAKE_S: Final = 0.2
"""A stop is noticed within this."""
_PORT: Final = 30004
"""Of RTDE."""
_PROBE_S: Final = 1.0
_HEAD: Final = struct.Struct(">HB")
"""Of a package: its size, and its kind."""
FAULT_FIELDS: Final = (make_field("fault", BuiltinType.STRING),)

_log = structlog.get_logger(__name__)


class SaidSample(NamedTuple):
    """A sample of the child; see `library.receiving`."""

    received_s: float
    lost: int
    stamp: float
    values: dict[str, Any]


class SaidNote(NamedTuple):
    """What the child says of itself."""

    error: str
    note: str


class Faults:
    """What the robot says of its faults while it is connected: one line, which is empty while it has none.

    A fault that is announced means that the robot stands, so others may take over at once. So only a stop of its safety
    system is one, and only once the arm stands; without a connection nothing is known, and the source is lost.
    """

    def __init__(self, topics: tuple[Topic, ...], label: str, put: Callable[[DriverEvent], None]) -> None:
        self._topics, self._label, self._put = topics, label, put
        self._said: str | None = None

    def seen(self, state: State) -> None:
        """A sample."""
        text = stop_of(state)
        if text == self._said or (text and not self._said and not state.stands):
            return
        for topic in self._topics:
            if self._said is None:
                self._put(SourceFound(topic, self._label, FAULT_FIELDS))
            self._put(SampleRead(topic, (text,), state.source_time_ns))
        self._said = text

    def lost(self) -> None:
        """There is no connection any more."""
        if self._said is not None:
            self._said = None
            for topic in self._topics:
                self._put(SourceLost(topic))


class Watcher:
    """See the module."""

    def __init__(
        self,
        config: UrBridgeConfig,
        frequency_hz: float,
        variables: Mapping[str, list[Any]],
        telemetry: Telemetry,
        faults: Faults,
        offenders: Offenders,
    ) -> None:
        self._config, self._telemetry, self._faults, self._offenders = config, telemetry, faults, offenders
        priority = config.real_time_priority or 0
        self._arguments = (config.address, f"{frequency_hz:g}", str(priority), json.dumps(variables))
        self._wall_clock = WallClock()
        self._stopping = threading.Event()
        self._has_noted = False
        self._detail = f"connecting to {config.address}"
        self.state: State | None = None
        """The last sample; None while there is no connection."""
        self.losses = 0
        """How often the connection was lost."""
        self._thread = threading.Thread(target=self._run, name=f"ur state {config.address}", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End soon."""
        self._stopping.set()

    def join(self) -> None:
        """Wait for the end."""
        self._thread.join()

    def status(self) -> DriverStatus:
        """See Driver."""
        is_connected = self.state is not None and not self._stopping.is_set()
        return DriverStatus(is_connected, self._detail, aside=self._offenders.told(time.monotonic()))

    def _run(self) -> None:
        least, most = self._config.retry_s
        wait, told, pause_s = least, "", 0.0
        while not self._stopping.is_set():
            is_ours = False
            offence = reason = ""
            try:
                self._watch()
                continue
            except ChildFailed as error:
                reason = f"{self._config.address}: {_remedy(str(error))}"
                offence = self._offence_of(error)
            except Exception as error:  # noqa: BLE001 - whatever it is, the robot is watched again
                is_ours = True
                offence = f"a mistake of the bridge ({error!r}); report its log"
                if offence not in told:
                    _log.exception("the state was not read", controller=self._config.address)
            if offence:
                pause_s = self._offenders.put_aside(self._config.address, offence, time.monotonic())
                reason = f"{self._config.address}: {offence}; it is put aside, and tried again"
            if self.state is not None:
                self.losses += 1
                if not is_ours:
                    wait, told = least, ""
            self.state, self._detail = None, reason
            self._telemetry.lost()
            self._faults.lost()
            if reason != told:
                told = reason
                _log.debug("no connection to the controller", reason=reason)  # the bridge says what it comes to
            if offence:
                self._stopping.wait(pause_s)
                continue
            self._stopping.wait(wait)
            wait = min(wait * 2, most)

    def _offence_of(self, error: ChildFailed) -> str:
        """What the controller does that none should; empty where it is merely away, or refuses something."""
        if isinstance(error, ChildEnded):
            return "what it sends at port 30004 ends ur-rtde"
        if isinstance(error, NoAnswer) and self.state is None and self._says_rubbish():
            return "what it says at port 30004 is no RTDE"
        return ""

    def _says_rubbish(self) -> bool:
        """Whether the controller answers the first request of RTDE, and not as it should; one that hangs is silent."""
        try:
            with socket.create_connection((self._config.address, _PORT), _PROBE_S) as link:
                link.sendall(_HEAD.pack(_HEAD.size + 2, ord("V")) + b"\0\2")
                said = b""
                while len(said) < _HEAD.size:
                    more = link.recv(_HEAD.size - len(said))
                    if not more:
                        return False
                    said += more
        except OSError:
            return False
        size, kind = _HEAD.unpack(said)
        return (size, kind) != (_HEAD.size + 1, ord("V")) and kind != ord("M")

    def _watch(self) -> None:
        """Read until it ends; returns when the driver stops.

        Raises:
            ChildFailed: there is no connection any more.
        """
        clock = ControllerClock(self._config.answer_timeout_s)
        child = LibraryChild("receiving", *self._arguments)
        try:
            limit = _START_S
            while (said := self._line(child, limit)) is not None:
                limit = self._config.answer_timeout_s
                if isinstance(said, SaidSample):
                    self._take(said, clock)
                elif said.error:
                    raise ChildFailed(said.error)
                elif said.note and not self._has_noted:
                    self._has_noted = True
                    _log.warning("the state is read without its priority", reason=said.note)
        finally:
            child.end()

    def _line(self, child: LibraryChild, limit: float) -> SaidSample | SaidNote | None:
        deadline = time.monotonic() + limit
        while not self._stopping.is_set():
            left = deadline - time.monotonic()
            try:
                said: Any = child.line(min(max(left, 0.0), _WAKE_S))
            except NoAnswer:
                if left <= _WAKE_S:
                    raise NoAnswer(f"the controller sends nothing for {limit:g} s") from None
            else:
                is_sample = isinstance(said, list)
                return SaidSample(*said) if is_sample else SaidNote(said.get("error", ""), said.get("note", ""))
        return None

    def _take(self, said: SaidSample, clock: ControllerClock) -> None:
        taken_s = clock.taken_s(said.stamp, said.received_s)
        self._wall_clock.looked_at(time.monotonic_ns(), time.time_ns(), time.monotonic_ns())
        state = State(said.stamp, self._wall_clock.unix_ns(taken_s), taken_s, said.values)
        if self.state is None:
            self._detail = f"connected to {self._config.address}"
            _log.debug("connected to the controller", controller=self._config.address)
        self.state = state
        self._telemetry.sampled(state, said.lost)
        self._faults.seen(state)


def _remedy(text: str) -> str:
    """The library's words with what to do about them."""
    line = " ".join(text.split())
    if "Could not connect" in line:
        return "nothing answers at port 30004; check the address, and that the controller is on"
    return line
