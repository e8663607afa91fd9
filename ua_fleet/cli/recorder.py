"""What `ua-fleet pubsub record` hears, into a file."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from ua_fleet.errors import RemoteWireError
from ua_fleet.recording.files import RecordingWriter
from ua_fleet.recording.records import MOST_DATAGRAM_BYTES, Record, RecordingBroken
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.party import Brokered, tool_party
from ua_fleet.wire import encode_probe, read_security
from ua_fleet.wire.messages import Probe, ProbeKind

__all__ = ["Recorder"]

ASK_AFTER_S: Final = (0.2, 2.0)
"""A publisher that was heard is asked for its metadata after so long, twice, since one datagram may be lost."""
MOST_ASKED: Final = 1024
"""Publishers that are asked. Anybody can write any PublisherId."""
FLUSH_S: Final = 1.0


class Recorder:
    """Records what several transports receive, until the file is full."""

    def __init__(
        self, writer: RecordingWriter, transports: Sequence[Transport], key_of: Callable[[bytes], str]
    ) -> None:
        """`key_of` names the key that a datagram is secured with."""
        self._writer, self._transports, self._key_of = writer, transports, key_of
        self._asked: set[tuple[int, int | str, int]] = set()
        self.datagrams = 0
        self.too_large = 0
        """Messages that a recording cannot hold."""
        self.is_full = False
        self.broken: RecordingBroken | None = None
        """Why the file takes no more, where that is not its bound."""
        self._full = asyncio.Event()

    async def record(self, begun: Callable[[], None]) -> None:
        """Record until the file is full, or cancelled; then the transports are closed. `begun`: all are heard now."""
        try:
            for number, transport in enumerate(self._transports):
                if isinstance(transport, Brokered):
                    transport.speak_for(tool_party(partial(self._receive, number, is_kept=True)))
                await transport.start(partial(self._receive, number))
            begun()
            while not self._full.is_set():
                try:
                    async with asyncio.timeout(FLUSH_S):
                        await self._full.wait()
                except TimeoutError:
                    self._flush()
        finally:
            self._flush()
            for transport in self._transports:
                await transport.close()

    def _flush(self) -> None:
        try:
            self._writer.flush()
        except RecordingBroken as error:
            self.is_full, self.broken = True, error
            self._full.set()

    def _receive(self, number: int, datagram: bytes, sender: Address, *, is_kept: bool = False) -> None:
        if self.is_full:
            return
        if len(datagram) > MOST_DATAGRAM_BYTES:
            self.too_large += 1
            return
        record = Record(time.time_ns(), number, sender, self._key_of(datagram), datagram, is_kept)
        try:
            self.is_full = not self._writer.write(record)
        except RecordingBroken as error:
            self.is_full, self.broken = True, error
        if self.is_full:
            self._full.set()
            return
        self.datagrams += 1
        self._ask(datagram, number)

    def _ask(self, datagram: bytes, number: int) -> None:
        """Have a publisher that is new announce its metadata, so that the file can be read by itself."""
        try:
            heard = read_security(datagram)
        except RemoteWireError:
            return
        publisher_id = heard.publisher_id
        if publisher_id is None or heard.is_discovery or heard.is_action or len(self._asked) >= MOST_ASKED:
            return
        known = (heard.publisher_id_type, publisher_id, number)
        if known in self._asked:
            return
        self._asked.add(known)
        probe = encode_probe(Probe(publisher_id, heard.publisher_id_type, ProbeKind.DATA_SET_META_DATA.value))
        loop = asyncio.get_running_loop()
        for delay_s in ASK_AFTER_S:
            loop.call_later(delay_s, self._transports[number].send, probe)
