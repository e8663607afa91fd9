"""Recorded messages opened with the keys of their time.

A recording may be older than its keys: which key is current now means nothing for it, and a message that was sent twice
was received twice. So each message is opened by the key that it names, if that can be had.
"""

from __future__ import annotations

from collections.abc import Mapping

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.recording.records import Record, key_name
from ua_fleet.wire.outline import is_action
from ua_fleet.wire.security import MessageKey, SecurityMode, read_security

__all__ = ["RecordedOpener"]


class RecordedOpener:
    """Opens records, and puts chunks together."""

    def __init__(
        self,
        counters: Counters,
        own_space: int,
        *,
        setpoint_groups: Mapping[int, int],
        max_message_bytes: int,
        one_key: MessageKey | None = None,
        publisher_ids: PublisherIds | None = None,
    ) -> None:
        """Make an opener without keys.

        Args:
            counters: what is not opened is counted here.
            own_space: a space that nothing recorded is of.
            setpoint_groups: WriterGroups of setpoints, which are not opened.
            max_message_bytes: of what is put together from chunks.
            one_key: opens all that is secured, whatever it names.
            publisher_ids: of spaces that have another PublisherId on the wire.
        """
        self.keys: dict[str, MessageKey] = {}
        """By the name that records have."""
        self.left_out = 0
        """Actions and setpoints, which nobody plays back."""
        self._counters, self._one_key, self._ids = counters, one_key, publisher_ids
        self._setpoint_groups = dict(setpoint_groups)
        self._chunks = Envelope(
            own_space,
            counters,
            mode=SecurityMode.NONE,
            nonces=MemoryNonces(),
            max_message_bytes=max_message_bytes,
            publisher_ids=publisher_ids,
        )

    def name(self, datagram: bytes) -> str:
        """The name of the key that a datagram needs; empty for none."""
        return key_name(datagram if self._ids is None else self._ids.inward(datagram), self._setpoint_groups)

    def open(self, record: Record, now: float) -> bytes | None:
        """The plain and whole message that a record is or completes; None for what is left out or cannot be opened."""
        datagram = record.datagram
        try:
            heard = read_security(datagram)
            if self._is_command(datagram, heard.publisher_id, heard.writer_group_id, heard.is_discovery):
                self.left_out += 1
                return None
            if heard.mode is not SecurityMode.NONE:
                key = self._one_key or self.keys.get(self.name(datagram))
                if key is None:
                    self._counters.drop(Drop.SECURED)
                    return None
                datagram = key.unprotect(heard)
            return self._chunks.open(datagram, now)
        except DatagramRefused as refused:
            self._counters.drop(refused.drop)
        except RemoteWireError as error:
            if error.cause == "signature":
                self._counters.drop(Drop.BAD_SIGNATURE)
            else:
                self._counters.drop_malformed(error.cause)
        return None

    def _is_command(
        self, datagram: bytes, publisher_id: int | str | None, writer_group_id: int | None, is_discovery: bool
    ) -> bool:
        if is_action(datagram):
            return True
        return publisher_id == 0 and not is_discovery and (writer_group_id or 0) in self._setpoint_groups
