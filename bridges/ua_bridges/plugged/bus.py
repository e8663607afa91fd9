"""D-Bus: signals of sensors, and methods of actuators. A thread of its own with an event loop, since the library
connects in a coroutine and a bridge has no tasks beside the runner's.

A signal is subscribed to only while somebody needs it, as TalkRoBots 3.2.2 has it. It is taken from the owner of the
sensor's well-known name alone, for which the bus vouches.
"""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

from dbus_fast import (
    AuthError,
    BusType,
    DBusError,
    InvalidAddressError,
    Message,
    MessageFlag,
    MessageType,
    SignatureBodyMismatchError,
)
from dbus_fast.aio import MessageBus

from ua_fleet.bridge.offenders import Offenders

__all__ = ["Answer", "Bus", "Method", "Signal"]

RETRY_S: Final = 1.0
CONNECT_S: Final = 5.0
MOST_WAITING: Final = 64
"""Signals of one sensor that wait for the bridge's loop; then the oldest goes, and is counted."""
_BUS: Final = "org.freedesktop.DBus"
_BUS_PATH: Final = "/org/freedesktop/DBus"
_FAILURES: Final = (OSError, EOFError, AuthError, DBusError, InvalidAddressError, TimeoutError)
_REPLIES: Final = (MessageType.METHOD_RETURN, MessageType.ERROR)
_TYPES: Final = {"system": BusType.SYSTEM, "session": BusType.SESSION}

logger = logging.getLogger(__name__)


class _NoMessage(Exception):
    """The bus sends what is none; a bus has to check what it forwards."""


class Signal(NamedTuple):
    """A signal of a sensor."""

    sender: str
    """Well-known name of its program."""
    interface: str
    member: str

    @property
    def rule(self) -> str:
        """The match rule that subscribes to it."""
        return f"type='signal',sender='{self.sender}',interface='{self.interface}',member='{self.member}'"


class Method(NamedTuple):
    """One call of a method."""

    name: str
    path: str
    interface: str
    member: str
    signature: str
    body: tuple[Any, ...]
    timeout_s: float


class Answer(NamedTuple):
    """What a call came to: values, or why there are none."""

    values: tuple[Any, ...] = ()
    problem: str = ""
    is_unknown: bool = False
    """Whether the method may have done its work all the same."""


class _Open(NamedTuple):
    done: Callable[[Answer], None]
    timer: asyncio.TimerHandle


class Bus:
    """One connection to a bus, made again where it is lost. Its callbacks are called in the loop of `start`."""

    def __init__(
        self,
        address: str,
        names: Iterable[str],
        *,
        owned: Callable[[str, bool], None],
        heard: Callable[[Signal, Sequence[Any], int], None],
        dropped: Callable[[Signal, int], None],
        offenders: Offenders,
    ) -> None:
        """Make a connection that is not begun.

        Args:
            address: `system`, `session` or an address.
            names: the well-known names that matter.
            owned: told when a name has got an owner, or has none any more.
            heard: told of a signal that is followed: its arguments and the time, ns since 1970.
            dropped: told how many signals came too quickly.
            offenders: has the bus by the name `D-Bus` while it is put aside.
        """
        self._address, self._names = address, sorted(set(names))
        self._owned, self._heard, self._dropped, self._offenders = owned, heard, dropped, offenders
        self._thread: threading.Thread | None = None
        self._is_stopped = False
        self._lock = threading.Lock()
        """Over what both threads touch: the three that follow."""
        self._waiting: dict[Signal, deque[tuple[Sequence[Any], int]]] = {}
        self._lost: dict[Signal, int] = {}
        self._is_flushing = False
        # Of the bus's own thread:
        self._bus: MessageBus | None = None
        self._followed: set[Signal] = set()
        self._owners: dict[str, str] = {}
        self._calls: dict[int, _Open] = {}
        self._said = self._mistake = ""
        self.is_connected = False
        self.detail = "D-Bus: not connected yet"
        """What it is connected to, or why it is not and what to do."""

    # Of the bridge's loop

    def start(self) -> None:
        """Begin, and go on until `stop`."""
        self._outer = asyncio.get_running_loop()
        self._inner = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="dbus", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it; it has ended soon after. Safe to call twice."""
        if self._thread is not None and not self._is_stopped:
            self._is_stopped = True
            self._in_thread(self._cancel)

    def follow(self, signal: Signal, is_followed: bool) -> None:
        """Subscribe to a signal, or no more."""
        self._in_thread(self._follow, signal, is_followed)

    def call(self, method: Method, done: Callable[[Answer], None]) -> None:
        """Call a method; `done` is called once."""
        self._in_thread(self._call, method, partial(self._in_outer, done))

    def _in_thread(self, do: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: there is nothing left to do
            self._inner.call_soon_threadsafe(do, *arguments)

    def _flush(self) -> None:
        with self._lock:
            self._is_flushing = False
            waiting, self._waiting = self._waiting, {}
            lost, self._lost = self._lost, {}
        if self._is_stopped:
            return
        for signal, count in lost.items():
            self._dropped(signal, count)
        for signal, kept in waiting.items():
            for body, time_ns in kept:
                self._heard(signal, body, time_ns)

    # Of the thread

    def _in_outer(self, do: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the bridge's loop is closed
            self._outer.call_soon_threadsafe(do, *arguments)

    def _run(self) -> None:
        with contextlib.suppress(asyncio.CancelledError), asyncio.Runner(loop_factory=lambda: self._inner) as runner:
            runner.run(self._connect_for_ever())

    def _cancel(self) -> None:
        for task in asyncio.all_tasks(self._inner):
            task.cancel()

    async def _connect_for_ever(self) -> None:
        while True:
            pause_s = RETRY_S
            try:
                async with asyncio.timeout(CONNECT_S):
                    bus = await self._connected()
                await self._live(bus)
                why = "it is lost"
            except _FAILURES as error:
                why = _reason(error)
            except _NoMessage as error:
                why = f"{error}; it is put aside, and tried again"
                pause_s = self._offenders.put_aside("D-Bus", str(error), time.monotonic())
            except Exception as error:  # whatever it is, the bus is tried again
                why = f"a mistake of the bridge ({error!r}); report its log; it tries again"
                pause_s = self._offenders.put_aside("D-Bus", why, time.monotonic())
                if why != self._mistake:
                    self._mistake = why
                    logger.exception("D-Bus: the connection was not kept")
            self._say(f"D-Bus: no connection to {self._address}: {why}", is_good=False)
            await asyncio.sleep(pause_s)

    async def _connected(self) -> MessageBus:
        kind = _TYPES.get(self._address)
        address = None if kind is not None else self._address
        return await MessageBus(bus_address=address, bus_type=kind or BusType.SESSION).connect()

    async def _live(self, bus: MessageBus) -> None:
        """Work on a connection until it is lost; raises why, where that is known."""
        self._bus = bus
        try:
            bus.add_message_handler(self._take)
            for name in self._names:
                rule = f"type='signal',sender='{_BUS}',interface='{_BUS}',member='NameOwnerChanged',arg0='{name}'"
                self._tell_bus("AddMatch", rule)
            for signal in self._followed:
                self._tell_bus("AddMatch", signal.rule)
            self._say(f"D-Bus: connected to {self._address}", is_good=True)
            for name in self._names:
                owner = await bus.call(_to_bus("GetNameOwner", name))
                if owner.message_type is MessageType.METHOD_RETURN:
                    self._owner(name, str(owner.body[0]))
            await _ended(bus)
        finally:
            self._bus = None
            for name in list(self._owners):
                self._owner(name, "")
            for serial in list(self._calls):
                self._end(serial, Answer(problem="the D-Bus was lost before it answered", is_unknown=True))
            bus.disconnect()
            with contextlib.suppress(*_FAILURES, _NoMessage):
                async with asyncio.timeout(1.0):
                    await _ended(bus)

    def _say(self, detail: str, *, is_good: bool) -> None:
        self.is_connected, self.detail = is_good, detail
        if detail != self._said and not self._is_stopped:
            self._said = detail
            logger.debug("%s", detail)  # the bridge says what it comes to

    def _owner(self, name: str, owner: str) -> None:
        if self._owners.get(name, "") == owner:
            return
        if owner:
            self._owners[name] = owner
        else:
            self._owners.pop(name, None)
        self._in_outer(self._owned, name, bool(owner))

    def _tell_bus(self, member: str, argument: str) -> None:
        assert self._bus is not None
        message = _to_bus(member, argument)
        message.flags = MessageFlag.NO_REPLY_EXPECTED
        self._bus.send(message)

    def _follow(self, signal: Signal, is_followed: bool) -> None:
        if is_followed == (signal in self._followed):
            return
        (self._followed.add if is_followed else self._followed.discard)(signal)
        if self._bus is not None:
            self._tell_bus("AddMatch" if is_followed else "RemoveMatch", signal.rule)

    def _call(self, method: Method, done: Callable[[Answer], None]) -> None:
        if self._bus is None:
            done(Answer(problem=self.detail))
            return
        serial = self._bus.next_serial()
        try:
            message = Message(
                destination=method.name,
                path=method.path,
                interface=method.interface,
                member=method.member,
                signature=method.signature,
                body=list(method.body),
                serial=serial,
            )
            timer = self._inner.call_later(method.timeout_s, self._timed_out, serial)
            self._calls[serial] = _Open(done, timer)
            self._bus.send(message)
        except (SignatureBodyMismatchError, ValueError) as error:
            self._end(serial, Answer(problem=f"the arguments cannot be sent: {error}"))

    def _timed_out(self, serial: int) -> None:
        self._end(serial, Answer(problem="it did not answer in time", is_unknown=True))

    def _end(self, serial: int, answer: Answer) -> None:
        opened = self._calls.pop(serial, None)
        if opened is not None:
            opened.timer.cancel()
            opened.done(answer)

    def _take(self, message: Message) -> bool:
        """A message from the bus; whether it was for us alone."""
        if message.message_type in _REPLIES:
            serial = message.reply_serial
            if serial not in self._calls:
                return False
            if message.message_type is MessageType.ERROR:
                text = str(message.body[0]) if message.body else ""
                self._end(serial, Answer(problem=f"{message.error_name}: {text}".rstrip(": ")))
            else:
                self._end(serial, Answer(tuple(message.body)))
            return True
        if message.message_type is not MessageType.SIGNAL:
            return False
        if (message.sender, message.member) == (_BUS, "NameOwnerChanged"):
            name, _, owner = message.body
            if name in self._names:
                self._owner(name, owner)
            return False
        for signal in self._followed:
            if (signal.interface, signal.member) == (message.interface, message.member) and message.sender == (
                self._owners.get(signal.sender)
            ):
                self._keep(signal, message.body)
        return False

    def _keep(self, signal: Signal, body: Sequence[Any]) -> None:
        """Hand a signal to the bridge's loop; of a flood the latest."""
        with self._lock:
            kept = self._waiting.setdefault(signal, deque(maxlen=MOST_WAITING))
            if len(kept) == MOST_WAITING:
                self._lost[signal] = self._lost.get(signal, 0) + 1
            kept.append((body, time.time_ns()))
            if self._is_flushing:
                return
            self._is_flushing = True
        self._in_outer(self._flush)


async def _ended(bus: Any) -> None:
    """Wait until the connection is gone; raises why, where it was lost."""
    try:
        await bus.wait_for_disconnect()
    except (asyncio.CancelledError, *_FAILURES):
        raise
    except Exception as error:
        raise _NoMessage(f"the bus sends what is no message of D-Bus ({type(error).__name__})") from error


def _to_bus(member: str, argument: str) -> Message:
    return Message(destination=_BUS, path=_BUS_PATH, interface=_BUS, member=member, signature="s", body=[argument])


def _reason(error: BaseException) -> str:
    if isinstance(error, FileNotFoundError | ConnectionRefusedError):
        return "no process listens there; start the bus, or correct `bus`"
    if isinstance(error, InvalidAddressError):
        return f"{error}; is the bridge in a session? give `bus` an address"
    if isinstance(error, AuthError):
        return f"it does not let this user in ({error})"
    return str(error) or type(error).__name__
