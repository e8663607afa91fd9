"""Bytes of one TCP connection: bounded before anything else is known about the client.

A connection owns one buffer of 64 KiB and nothing more: while it is full the socket is not read, so that the client
waits and not our memory. Frames are cut out of it as they are processed, one after the other.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from typing import Final, Protocol

from ua_fleet.endpoint.arrival import Arrival
from ua_fleet.endpoint.limits import CHUNK_BYTES

__all__ = ["FrameError", "Handler", "TcpConnection"]

_HEAD: Final = struct.Struct("<3scI")
"""Message type, chunk type and size (OPC 10000-6 7.1.2.2)."""
_HEADER: Final = _HEAD.size
_TYPES: Final = (b"HEL", b"OPN", b"MSG", b"CLO")
_OPENING: Final = (b"HEL", b"OPN")
_MAX_HELLO: Final = 8_192
"""A Hello is 32 bytes and a URL of at most 4,096 (OPC 10000-6 7.1.2.3)."""
_WRITE_HIGH: Final = 1024 * 1024
_TURN_S: Final = 0.005
"""Longest time that one connection's requests are served before others get their turn."""


class FrameError(Exception):
    """A frame that must not be read on; `code` is the StatusCode for the client."""

    def __init__(self, code: int, reason: str) -> None:
        self.code = code
        super().__init__(reason)


BAD_TCP_MESSAGE_TYPE_INVALID: Final = 0x807E_0000
BAD_TCP_MESSAGE_TOO_LARGE: Final = 0x8080_0000


class Handler(Protocol):
    """What stands behind a connection."""

    def room(self) -> int:
        """Bytes that the next frame may have."""
        ...

    def process_opening(self, frame: bytes) -> None:
        """Process a Hello or an OpenSecureChannel, for which nothing has to be waited."""
        ...

    async def process(self, frame: bytes) -> bool:
        """Process one frame; False ends the connection."""
        ...

    def refuse(self, error: FrameError) -> None:
        """A frame broke the rules; the connection is closed after this."""
        ...

    async def closed(self) -> None:
        """The connection is gone."""
        ...


class TcpConnection(asyncio.BufferedProtocol):
    """One TCP connection.

    Its first Hello and OpenSecureChannel are processed when they come, since nothing has to be waited for. Its task
    begins with whatever comes then: a request, a second frame at once, a mistake, or the end.
    """

    def __init__(
        self,
        accept: Callable[[TcpConnection], bool],
        make_handler: Callable[[TcpConnection], Handler],
        started: Callable[[TcpConnection, asyncio.Task[None]], None],
    ) -> None:
        self._buffer = memoryview(bytearray(CHUNK_BYTES))
        self._start = self._end = 0
        self._arrival = Arrival()
        """What `_serve` waits for, while it waits for a frame."""
        self._awaited = 0
        """Bytes of that frame, as far as they are known."""
        self._writable = asyncio.Event()
        self._writable.set()
        self._accept, self._make_handler, self._started = accept, make_handler, started
        self._handler: Handler | None = None
        """What waits for the task to begin; None once it has."""
        self._openings_left = len(_OPENING)
        self._failure: Exception | None = None
        """What the task begins with: why the connection ends."""
        self._transport: asyncio.Transport | None = None
        self._reading = True
        self._over = False
        self.opened_at = time.monotonic()
        self.stalled_since: float | None = None
        self.peer = ""
        """`address:port` of the client."""
        self.address = ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Ask whether the connection may stay, and begin to serve it."""
        assert isinstance(transport, asyncio.Transport)
        peer = transport.get_extra_info("peername") or ("unknown", 0)
        self.address, self.peer = str(peer[0]), f"{peer[0]}:{peer[1]}"
        self._transport = transport
        transport.set_write_buffer_limits(high=_WRITE_HIGH)
        if not self._accept(self):
            transport.abort()
            return
        self._awaited = _HEADER
        self._handler = self._make_handler(self)

    @property
    def server_address(self) -> tuple[str, int] | None:
        """Address and port of our side, an IPv6 address in brackets: asyncua makes URLs of them."""
        name = self._transport.get_extra_info("sockname") if self._transport else None
        if not name:
            return None
        return (f"[{name[0]}]" if ":" in name[0] else str(name[0])), int(name[1])

    @property
    def over(self) -> bool:
        """Whether the client has gone, or is to go."""
        return self._over

    @property
    def writable(self) -> bool:
        """Whether the client keeps up with what is sent to it."""
        return self._writable.is_set() and not self._over

    def get_buffer(self, sizehint: int) -> memoryview:
        """The room left; what is already processed makes place first."""
        if self._end == CHUNK_BYTES:
            self._compact()
        return self._buffer[self._end :]

    def _compact(self) -> None:
        rest = bytes(self._buffer[self._start : self._end])
        self._buffer[: len(rest)] = rest
        self._start, self._end = 0, len(rest)

    def buffer_updated(self, nbytes: int) -> None:
        """Bytes have arrived; a full buffer stops the socket."""
        self._end += nbytes
        if self._end - self._start == CHUNK_BYTES and self._transport is not None:
            self._transport.pause_reading()
            self._reading = False
        elif self._end - self._start < self._awaited:
            return
        if self._handler is None:
            self._arrival.now()
        elif not self._opened(self._handler):
            self._begin()

    def _opened(self, handler: Handler) -> bool:
        """Process a frame that opens the connection, as far as it is here; False where the task is to go on."""
        try:
            size = self._announced(handler.room())
            if not size or self._end - self._start < size:
                self._awaited = size or _HEADER
                return True
            if not self._openings_left or bytes(self._buffer[self._start : self._start + 3]) not in _OPENING:
                return False
            self._openings_left -= 1
            self._awaited = _HEADER
            handler.process_opening(self._take(size))
        except Exception as error:  # noqa: BLE001 - raised again by the task, which has a place for each
            self._failure = error
            return False
        return self._start == self._end

    def _raise_failure(self) -> None:
        """Raise what has gone wrong before the task began."""
        failure, self._failure = self._failure, None
        try:
            if failure is not None:
                raise failure
        finally:
            del failure  # its traceback has this frame: together they would keep the buffer until garbage is collected

    def _begin(self) -> None:
        """Begin the task that serves the connection to its end."""
        handler, self._handler = self._handler, None
        if handler is not None:
            task = asyncio.create_task(self._serve(handler), name=f"connection {self.peer}")
            self._started(self, task)

    def _wake(self) -> None:
        """Have `_serve` look at what there is now."""
        self._begin()
        self._arrival.soon()

    def eof_received(self) -> bool:
        """The client has sent all it will send."""
        self._over = True
        self._wake()
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """The socket is closed; what waits for it wakes up."""
        self._over = True
        self._wake()
        self._writable.set()

    def pause_writing(self) -> None:
        """The client does not read its responses."""
        self._writable.clear()
        self.stalled_since = time.monotonic()

    def resume_writing(self) -> None:
        """The client reads again."""
        self._writable.set()
        self.stalled_since = None

    async def taken(self) -> None:
        """Wait until the client has taken what was sent, but for the last of it, or has gone."""
        await self._writable.wait()

    def send(self, data: bytes) -> None:
        """Send bytes, unless the connection is gone."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)

    def close(self) -> None:
        """Close after what has been sent; nothing more is read."""
        self._over = True
        self._wake()
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """Close at once."""
        self.close()
        if self._transport is not None:
            self._transport.abort()

    async def _serve(self, handler: Handler) -> None:
        try:
            self._raise_failure()
            turn = time.monotonic()
            while (frame := await self._next_frame(handler)) is not None:
                if not await handler.process(frame):
                    break
                if not self._writable.is_set():
                    await self.taken()
                if time.monotonic() - turn > _TURN_S:
                    # A client with a buffer full of requests lets the others have their turn.
                    await asyncio.sleep(0)
                    turn = time.monotonic()
        except FrameError as error:
            handler.refuse(error)
        finally:
            self.close()
            # What stands behind a connection refers to itself: it would keep the buffer until garbage is collected.
            self._buffer, self._start, self._end = memoryview(b""), 0, 0
            await handler.closed()

    async def _next_frame(self, handler: Handler) -> bytes | None:
        while not self._over:
            size = self._announced(handler.room())
            if size and self._end - self._start >= size:
                return self._take(size)
            # One that comes in pieces is looked at when it has begun, and when all of it is here.
            self._awaited = size or _HEADER
            await self._arrival
        return None

    def _announced(self, room: int) -> int:
        """Size of the frame that has begun, 0 while its header is not here; raises FrameError."""
        if self._end - self._start < _HEADER:
            return 0
        size: int
        kind, chunk, size = _HEAD.unpack_from(self._buffer, self._start)
        if kind not in _TYPES or chunk not in (b"F", b"C", b"A"):
            raise FrameError(BAD_TCP_MESSAGE_TYPE_INVALID, "no OPC UA message")
        least = _HEADER + 4
        if kind == b"HEL":
            room, least = min(room, _MAX_HELLO), _HEADER
        if not least < size <= min(room, CHUNK_BYTES):
            raise FrameError(BAD_TCP_MESSAGE_TOO_LARGE, f"a frame of {size} bytes, {room} are allowed")
        return size

    def _take(self, size: int) -> bytes:
        frame = bytes(self._buffer[self._start : self._start + size])
        self._start += size
        if self._start == self._end:
            self._start = self._end = 0
        if not self._reading and self._transport is not None:
            self._reading = True
            self._transport.resume_reading()
        return frame
