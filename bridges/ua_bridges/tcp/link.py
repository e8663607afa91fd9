"""The socket to a robot: made, kept and made again. All of it runs in the event loop, and nothing of it waits.

Bytes are written where they are made, without a task between: a command leaves within some microseconds.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Protocol

from ua_bridges.tcp.config import address_of, host_and_port
from ua_bridges.tcp.data import Put
from ua_fleet.bridge.driver import Dropped
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop

__all__ = ["APPEARS_S", "Link", "Session"]

APPEARS_S: Final = 3.0
"""What is begun while the robot is not connected waits so long from the start, or the loss, for the connection."""
FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 5.0
STEADY_S: Final = 2.0
"""A connection that is lost sooner does not end the growing of the pauses."""
CONNECT_S: Final = 5.0
"""A connection that is not there by then is tried anew."""
MOST_UNSENT: Final = 1 << 20
"""Bytes that a robot may leave unread."""
MOST_STRANGERS: Final = 16
"""Addresses that are told when they were refused; what comes from more of them is counted."""
_READ: Final = 65_536
_KEEP_ALIVE: Final = ((socket.TCP_KEEPIDLE, 2), (socket.TCP_KEEPINTVL, 1), (socket.TCP_KEEPCNT, 3))
"""A robot whose cable is out is noticed within five seconds when nothing is sent; else within _UNSENT_MS of that."""
_UNSENT_MS: Final = 5000

logger = logging.getLogger(__name__)


class Session(Protocol):
    """What is said on a connection; pure."""

    def connected(self, now: float) -> None:
        """The robot is there."""
        ...

    def lost(self, now: float) -> None:
        """It is gone."""
        ...

    def received(self, data: bytes, now: float, time_ns: int) -> None:
        """Bytes from the robot."""
        ...

    def turn(self, now: float) -> float | None:
        """Do what is due; when to be called again."""
        ...


class Link:
    """One connection to one robot, which it accepts or which we accept from it."""

    def __init__(
        self,
        who: str,
        offenders: Offenders,
        connect: str | None,
        listen: str | None = None,
        peer: str | None = None,
        put: Put = lambda _: None,
    ) -> None:
        """Either `connect` or `listen` is given, as `host:port`; `peer` alone, an IP address, may connect.

        `offenders` has the connection by the name `who` while its robot is put aside. `put` counts who is refused.
        """
        self._who, self._offenders, self._put, self._peer = who, offenders, put, peer
        self._peer_address = address_of(peer) if peer is not None else None
        self._strangers: set[str] = set()
        self._refusals, self._last_refused = 0, ""
        self._address = host_and_port(connect or listen or "")
        self._listens = listen is not None
        self._session: Session | None = None
        self._listener: socket.socket | None = None
        self._socket: socket.socket | None = None
        self._is_up = False
        self._up_at = 0.0
        self._unsent = bytearray()
        self._pause_s = FIRST_PAUSE_S
        self._timers: dict[Callable[[], None], asyncio.TimerHandle] = {}
        self._resolving: asyncio.Future[Any] | None = None
        self._which = 0
        """Which of the robot's addresses is tried next; the one that it was reached at is the first again."""
        self._is_stopped = False
        self._said, self._mistake = "not started", ""

    @property
    def detail(self) -> str:
        """What it is connected to, or why not and what to do; and how many others were refused."""
        if not self._refusals:
            return self._said
        last = f"{self._refusals}, the last from {self._last_refused}"
        return f"{self._said}; connections refused, since only {self._peer} may connect: {last}"

    # Life

    def start(self, session: Session) -> None:
        """Begin, and go on until `stop`."""
        self._loop = asyncio.get_running_loop()
        self._session = session
        self._again()

    def stop(self) -> None:
        """Leave the robot and release everything. Safe to call twice."""
        self._is_stopped = True
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()
        if self._resolving is not None:
            self._resolving.cancel()
        self._down("stopped")
        if self._listener is not None:
            self._loop.remove_reader(self._listener.fileno())
            self._listener.close()
            self._listener = None

    def _in(self, seconds: float, do: Callable[[], None]) -> None:
        """Have something done later; of the same only the last counts."""
        if (before := self._timers.pop(do, None)) is not None:
            before.cancel()
        if not self._is_stopped:
            self._timers[do] = self._loop.call_later(max(seconds, 0.0), self._do, do)

    def _do(self, step: Callable[..., None], *arguments: Any) -> None:
        """Do what the event loop calls. Whatever goes wrong in it ends the connection, and it is made again."""
        try:
            step(*arguments)
        except OSError as error:
            self._begin_anew(_reason(error), self._pause_s)
        except Exception as error:  # logged once; the connection is made anew
            why = f"a mistake of the bridge ({error!r}); report its log"
            if why != self._mistake:
                self._mistake = why
                logger.exception("%s: the connection was not kept", self._who)
            self._begin_anew(why, self._offenders.put_aside(self._who, why, time.monotonic()))

    def _begin_anew(self, why: str, pause_s: float) -> None:
        if self._is_up:
            self._down(why)
        else:
            self._hang_up()
            self._say(f"no connection to {self._where()}: {why}")
        if self._listener is None:
            self._in(pause_s, self._again)

    def _say(self, detail: str) -> None:
        """One line for each change."""
        if detail != self._said:
            self._said = detail
            logger.debug("%s: %s", self._who, detail)  # the bridge says what it comes to

    # Connecting

    def _again(self) -> None:
        if self._listens:
            self._listen()
        else:
            host, port = self._address
            find = partial(socket.getaddrinfo, host, port, type=socket.SOCK_STREAM)
            self._resolving = found = self._loop.run_in_executor(None, find)
            found.add_done_callback(partial(self._do, self._resolved))

    def _resolved(self, found: asyncio.Future[Any]) -> None:
        if found.cancelled() or self._is_stopped:
            return
        self._resolving = None
        if found.exception() is not None:
            self._later(
                f"the host name {self._address[0]} is not known; correct it in fleet.yaml, or in the name service"
            )
            return
        known = found.result()
        family, kind, protocol, _, address = known[self._which % len(known)]
        self._which += 1
        self._socket = made = socket.socket(family, kind, protocol)
        made.setblocking(False)
        self._prepare(made)
        try:
            made.connect(address)
        except (BlockingIOError, InterruptedError):
            self._loop.add_writer(made.fileno(), self._do, self._connected)
            self._in(CONNECT_S, self._too_long)
        except OSError as error:
            self._refused(error)
        else:
            self._connected()

    def _too_long(self) -> None:
        self._refused(TimeoutError(f"no answer within {CONNECT_S:g} s"))

    def _connected(self) -> None:
        made = self._socket
        assert made is not None
        self._loop.remove_writer(made.fileno())
        if (timer := self._timers.pop(self._too_long, None)) is not None:
            timer.cancel()
        code = made.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            self._refused(OSError(code, _reason(OSError(code))))
        elif made.getsockname() == made.getpeername():  # TCP connects a port to itself when no process listens there
            self._refused(ConnectionRefusedError("no process listens"))
        else:
            self._which -= 1
            self._up()

    def _hang_up(self) -> None:
        made, self._socket = self._socket, None
        if made is not None:
            self._loop.remove_reader(made.fileno())
            self._loop.remove_writer(made.fileno())
            made.close()

    def _refused(self, error: OSError) -> None:
        self._hang_up()
        self._later(f"no connection to {self._where()}: {_reason(error)}; see that the robot is on and listens there")

    def _later(self, why: str) -> None:
        self._say(why)
        self._in(self._pause_s, self._again)
        self._pause_s = min(self._pause_s * 2, LONGEST_PAUSE_S)

    def _listen(self) -> None:
        host, port = self._address
        try:
            self._listener = made = socket.create_server(
                (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=4
            )
        except OSError as error:
            self._later(f"cannot listen on {self._where()}: {_reason(error)}; free the port, or take another one")
            return
        made.setblocking(False)
        self._loop.add_reader(made.fileno(), self._do, self._accept)
        self._say(f"waiting on {self._where()} for the robot's program; start it")

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            accepted, address = self._listener.accept()
        except OSError:
            return
        if address_of(address[0]) != self._peer_address:
            accepted.close()
            self._refuse(address[0])
            return
        if self._offenders.is_aside(self._who, time.monotonic()):
            accepted.close()
            return
        if self._socket is not None:
            self._down("the robot's program connected anew")
        accepted.setblocking(False)
        self._prepare(accepted)
        self._socket = accepted
        self._up()

    def _refuse(self, stranger: str) -> None:
        """Count a connection that is none of the robot's. The bridge says so once for each address, of some."""
        self._refusals, self._last_refused = self._refusals + 1, stranger
        if len(self._strangers) < MOST_STRANGERS:
            self._strangers.add(stranger)
        told = f"{self._who}: refused a connection from {stranger}; only {self._peer} may connect"
        self._put(Dropped(Drop.UNKNOWN_SOURCE, detail=told if stranger in self._strangers else ""))

    @staticmethod
    def _prepare(made: socket.socket) -> None:
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in _KEEP_ALIVE:
            made.setsockopt(socket.IPPROTO_TCP, option, value)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNSENT_MS)

    def _where(self) -> str:
        host, port = self._address
        return f"{host}:{port}"

    # Connected

    def _up(self) -> None:
        assert self._socket is not None
        assert self._session is not None
        self._is_up, self._up_at = True, time.monotonic()
        self._unsent.clear()
        self._loop.add_reader(self._socket.fileno(), self._do, self._readable)
        self._say(f"connected to {self._where()}" if not self._listens else f"{self._peer} is connected")
        self._session.connected(time.monotonic())
        self._turn()

    def _down(self, why: str) -> None:
        self._hang_up()
        if self._is_up:
            self._is_up = False
            if not self._is_stopped:
                if time.monotonic() >= self._up_at + STEADY_S:
                    self._pause_s = FIRST_PAUSE_S
                lost = f"the connection to the robot is lost: {why}"
                if self._listens:
                    self._say(lost)
                else:
                    self._later(lost)
            assert self._session is not None
            self._session.lost(time.monotonic())

    def reset(self, why: str) -> None:
        """End the connection, since nothing sensible can follow on it; it is made again."""
        self._down(why)

    def misbehaves(self, why: str) -> None:
        """End the connection, since the robot says what none should; it is made again after a while."""
        pause_s = self._offenders.put_aside(self._who, why, time.monotonic())
        self._down(f"{why}; it is put aside for {pause_s:g} s")
        if not self._listens:
            self._in(pause_s, self._again)

    def _readable(self) -> None:
        assert self._socket is not None
        assert self._session is not None
        try:
            data = self._socket.recv(_READ)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._down(_reason(error))
            return
        if not data:
            self._down("the robot closed it")
            return
        self._session.received(data, time.monotonic(), time.time_ns())
        self._turn()

    def write(self, data: bytes) -> bool:
        """Send bytes, at once where the kernel takes them; False where it is over: none has gone out then."""
        made = self._socket
        if made is None or not self._is_up:
            return False
        if self._unsent:
            if len(self._unsent) + len(data) > MOST_UNSENT:
                self._loop.call_soon(self._do, self._broken, made, "it does not read what it is sent")
                return False
            self._unsent += data
            return True
        try:
            sent = made.send(data)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError as error:
            self._loop.call_soon(self._do, self._broken, made, _reason(error))
            return False
        if sent < len(data):
            self._unsent += data[sent:]
            self._loop.add_writer(made.fileno(), self._do, self._writable)
        return True

    def _broken(self, made: socket.socket, why: str) -> None:
        if self._socket is made:
            self._down(why)

    def _writable(self) -> None:
        assert self._socket is not None
        try:
            sent = self._socket.send(self._unsent)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._down(_reason(error))
            return
        del self._unsent[:sent]
        if not self._unsent:
            self._loop.remove_writer(self._socket.fileno())

    # Time

    def _turn(self) -> None:
        self.look(time.monotonic())

    def look(self, now: float) -> None:
        """Something was begun: see when the session is due."""
        assert self._session is not None
        due = self._session.turn(now)
        if due is None or self._is_stopped:
            return
        timer = self._timers.get(self._turn)
        # One that comes earlier is left as it is: to look once too often costs less than to set it for each byte.
        if timer is None or timer.when() > due or timer.when() <= self._loop.time():
            self._in(due - now, self._turn)


def _reason(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
