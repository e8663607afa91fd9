"""What one process does to every datagram: outgoing ones are secured, incoming ones verified, before they count.

    seal    [chunks] -> for each: the current key of its group, a nonce of its own, encrypt, sign
    open    own data? -> mode -> key of its group and token -> verify, decrypt -> replay -> [chunks]

It fails closed. What does not pass is a `DatagramRefused` with the counter it belongs to, and nothing of it is handed
on. Only what was verified changes anything here: replay windows, the wish for keys that a publisher's ForceKeyReset
is, chunks.

Probes are sent unsecured and taken so: they carry nothing but the wish for an answer, and answers are paced. A probe
that somebody signed is verified like everything else, but not checked for replay: its sender does not stand in it.
One in chunks is refused where there is security: it would take the place of those of messages that were verified, and
ours always fit into a datagram.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from random import Random
from struct import Struct
from typing import Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.groups import Group, KeyGroups, command_group, telemetry_group
from ua_fleet.pubsub.security.keyring import GroupKeys, Token
from ua_fleet.pubsub.security.nonces import NonceReservations, NonceSequence, NoncesUnavailable, nonce_prefix
from ua_fleet.pubsub.security.reassembly import Reassembly
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.wire.chunks import ChunkReader, split, split_one_by_one
from ua_fleet.wire.header import (
    HAS_EXTENDED_FLAGS_1,
    HAS_EXTENDED_FLAGS_2,
    IS_CHUNK,
    MESSAGE_TYPE_BITS,
    MessageType,
)
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.security import MOST_ADDED_BYTES, NONCE_BYTES, SecuredDatagram, SecurityMode, read_security

__all__ = ["Envelope"]

_NONE: Final = SecurityMode.NONE
_UINT16: Final = PublisherIdType.UINT16.value
_PROBE: Final = MessageType.PROBE << 2
_THE_PUBLISHER: Final = 0
_ANY_MEMBER: Final = -1
_NOBODY: Final = -2
_ANOTHER: Final = -3
"""Whose replay window counts: see `replay.py`."""
_read_nonce = Struct("<H2xI").unpack


class Envelope:
    """Seals and opens the datagrams of one process."""

    def __init__(
        self,
        own_space: int,
        counters: Counters,
        *,
        mode: SecurityMode,
        nonces: NonceReservations,
        relaxed_replay: Collection[int] = (),
        max_datagram_bytes: int = 65_507,
        max_message_bytes: int = 4 * 1024 * 1024,
        past_keys: int = 1,
        asks_for_all: bool = False,
        setpoint_groups: Mapping[int, int] | None = None,
        publisher_ids: PublisherIds | None = None,
        relayed: Mapping[int, str] | None = None,
        speaks_under: str | None = None,
        random: Random | None = None,
    ) -> None:
        """Make an envelope without keys.

        Args:
            own_space: the PublisherId of this process.
            counters: what is not sent and what chunks lose is counted here; what is refused, by who calls `open`.
            mode: what is sent has it, what is received has at least it. With NONE there are only chunks.
            nonces: where sequence numbers are reserved.
            relaxed_replay: PublisherIds whose data, but no command, is taken without a replay check.
            max_datagram_bytes: longer messages are sent as chunks.
            max_message_bytes: bound of what is put together from chunks.
            past_keys: KeyLifetimes for which a key that was replaced is taken.
            asks_for_all: whether keys are wanted of publishers that are only heard, too. Anybody can write any
                PublisherId, so this is for keys that nobody has to be asked for.
            setpoint_groups: spaces by the WriterGroups of the server's setpoints for them, which the keys of the
                commands of these spaces secure.
            publisher_ids: of spaces that have another PublisherId on the wire than their number.
            relayed: the SecurityGroups of relays, by the PublisherIds whose data comes by them alone.
            speaks_under: of a relay: the group that secures what it forwards, in whose name it may be.
            random: where the random part of nonces comes from.
        """
        random = random or Random()  # noqa: S311 - this part of a nonce need not be a secret (table 156)
        self.problem = ""
        """Why something could not be sent; empty when the last message could."""
        self._own_space, self._counters, self._mode, self._nonces = own_space, counters, mode, nonces
        self._most_bytes = max_datagram_bytes - (MOST_ADDED_BYTES if mode is not _NONE else 0)
        self._prefix = nonce_prefix(own_space, random.getrandbits(16))
        self._groups = KeyGroups(past_keys, frozenset(relaxed_replay), takes_all=asks_for_all)
        self._telemetry: Mapping[int | str | None, Group] = self._groups.telemetry
        self._setpoint_groups = setpoint_groups or {}
        self._ids = publisher_ids
        self._own_group = speaks_under or telemetry_group(own_space)
        self._is_relay = speaks_under is not None
        self._siblings: tuple[Envelope, ...] = ()
        self._reassembly = Reassembly(counters, max_message_bytes)
        self._chunks = ChunkReader()
        self._chunked = random.getrandbits(16)
        """MessageSequenceNumber of the last message that was sent as chunks."""
        if mode is not _NONE:
            self._groups.want(self._own_group)
            for publisher_id, group_id in (relayed or {}).items():
                self._groups.entrust(publisher_id, group_id)

    @property
    def mode(self) -> SecurityMode:
        """What messages have at least."""
        return self._mode

    @property
    def max_plain_bytes(self) -> int:
        """The longest plain message that goes as one datagram; longer ones go as chunks."""
        return self._most_bytes - (0 if self._ids is None else self._ids.most_added_bytes)

    def know(self, others: Iterable[Envelope]) -> None:
        """Take no message that one of the process's other connections has taken: no nonce goes by two of them."""
        self._siblings = tuple([other for other in others if other is not self])

    def _is_carried(self, group_id: str, token_id: int, sender: int, number: int) -> bool:
        """Whether a message was taken by another connection, under its nonce."""
        return any(other.has_taken(group_id, token_id, sender, number) for other in self._siblings)

    def has_taken(self, group_id: str, token_id: int, sender: int, number: int) -> bool:
        """Whether a message was taken here, under its nonce."""
        group = self._groups.get(group_id)
        token = None if group is None else group.keyring.tokens.get(token_id)
        return token is not None and token.windows.has(sender, number)

    def want(self, group_id: str) -> None:
        """Need the keys of a group from now on."""
        self._groups.want(group_id)

    def groups_wanted(self) -> list[str]:
        """All groups that keys are needed of, our own data's first."""
        return [group.group_id for group in self._groups]

    def keys_wanted(self, now: float) -> list[str]:
        """The groups whose keys are to be fetched now."""
        return [group.group_id for group in self._groups if group.keyring.is_wanted(now)]

    def keys_last_s(self, now: float) -> dict[str, float]:
        """For how many seconds the keys of each group are enough, where there are any."""
        lasts = {group.group_id: group.keyring.lasts_s(now) for group in self._groups}
        return {group_id: lasts_s for group_id, lasts_s in lasts.items() if lasts_s is not None}

    def install(self, group_id: str, keys: GroupKeys, now: float) -> None:
        """Take keys of a group, the current one first. Raises LocalWireError for keys of the wrong length."""
        self._groups.want(group_id).keyring.install(keys, now)

    def seal(self, datagram: bytes, now: float) -> list[bytes]:
        """The datagrams to send for a plain message; none, counted as NO_KEY, where there is no key or no nonce.

        Raises LocalWireError for what cannot be secured or split.
        """
        if self._ids is not None:
            datagram = self._ids.outward(datagram)
        if self._mode is _NONE:
            return [datagram] if len(datagram) <= self._most_bytes else self._split(datagram)
        heard = self._read(datagram)
        if heard.mode is not _NONE:
            raise LocalWireError("a message that is secured already")
        if heard.is_discovery and _is_probe(datagram):
            if len(datagram) > self._most_bytes:
                raise LocalWireError(f"a probe of {len(datagram)} bytes, which goes as one datagram or not at all")
            return [datagram]
        group = self._group_to_send(heard)
        token = group.keyring.sending(now) if group is not None else None
        if group is None or token is None:
            return self._not_sent(heard, group)
        sequence = group.sequence
        if sequence is None or sequence.token_id != token.token_id:
            sequence = NonceSequence(self._nonces, group.group_id, token.token_id, self._prefix)
            group.sequence = sequence
        try:
            if len(datagram) <= self._most_bytes:
                sealed = [
                    token.key.protect(datagram, heard.payload_offset, token.token_id, sequence.next(now), self._mode)
                ]
            else:
                sealed = self._seal_chunks(datagram, token, sequence, now)
        except NoncesUnavailable as error:
            self.problem = str(error)
            self._counters.drop(Drop.NO_KEY)
            return []
        if self.problem:
            self.problem = ""
        return sealed

    def _read(self, datagram: bytes) -> SecuredDatagram:
        """What a message says of its sender and its security, the sender by its space."""
        heard = read_security(datagram)
        return heard if self._ids is None else self._ids.named(heard)

    def open(self, datagram: bytes, now: float, *, is_fresh: bool = True) -> bytes | None:
        """The plain and whole message that a datagram is or completes; None where chunks are missing.

        None too for the Actions of others, in whose group we are not: on multicast everybody hears them. What is not
        fresh, since a broker has kept it, is verified and changes nothing here: it neither needs a nonce that was not
        used nor uses one. Only discovery messages may be so, and no chunks.

        Raises:
            Refused: it was not let in.
            RemoteWireError: it is malformed.
        """
        plain = self._open(datagram, now) if is_fresh else self._open_kept(datagram, now)
        return plain if plain is None or self._ids is None else self._ids.inward(plain)

    def _open(self, datagram: bytes, now: float) -> bytes | None:
        if self._mode is _NONE:
            if len(datagram) > 2 and datagram[0] & HAS_EXTENDED_FLAGS_1 and datagram[1] & HAS_EXTENDED_FLAGS_2:
                return self._open_unsecured(datagram, now)
            return datagram
        heard = self._read(datagram)
        if heard.is_action or heard.is_discovery:
            return self._open_other(heard, now)
        publisher_id = heard.publisher_id
        if publisher_id == self._own_space:
            raise DatagramRefused(Drop.LOOP, heard)
        if publisher_id == SERVER_SPACE and self.is_setpoint(heard):
            return self._open_setpoints(heard, now)
        if heard.mode is not self._mode and heard.mode < self._mode:
            raise DatagramRefused(Drop.NOT_SECURED, heard, self._mode)
        group = self._telemetry.get(publisher_id) or self._meet(heard)
        return self._verified(heard, group, _THE_PUBLISHER, now)

    def is_setpoint(self, heard: SecuredDatagram) -> bool:
        """Whether a message is of a WriterGroup of the server's setpoints."""
        is_known = heard.publisher_id == SERVER_SPACE and heard.writer_group_id in self._setpoint_groups
        return is_known and not (heard.is_action or heard.is_discovery)

    def _open_setpoints(self, heard: SecuredDatagram, now: float) -> bytes | None:
        """Open setpoints; None where we are not in the group of the commands of their bridge."""
        group = self._groups.commands.get(self._setpoint_groups[heard.writer_group_id or 0])
        if group is None:
            return None
        if heard.mode < self._mode:
            raise DatagramRefused(Drop.NOT_SECURED, heard, self._mode)
        if heard.datagram[0] & HAS_EXTENDED_FLAGS_1 and heard.datagram[1] & HAS_EXTENDED_FLAGS_2:
            raise DatagramRefused(
                Drop.UNSUPPORTED, heard, self._mode
            )  # a chunk could be joined with those of other keys
        return self._verified(heard, group, _ANY_MEMBER, now)

    def _open_kept(self, datagram: bytes, now: float) -> bytes:
        """Open an announcement that a broker has kept."""
        heard = self._read(datagram)
        if not heard.is_discovery or datagram[2] & IS_CHUNK:
            raise DatagramRefused(Drop.RETAINED, heard, self._mode)
        if heard.publisher_id == self._own_space:
            raise DatagramRefused(Drop.LOOP, heard)
        if self._mode is _NONE:
            return datagram
        if heard.mode < self._mode:
            raise DatagramRefused(Drop.NOT_SECURED, heard, self._mode)
        group = self._telemetry.get(heard.publisher_id) or self._meet(heard)
        if now >= group.keyring.changes_at:
            group.keyring.advance(now)
        token = group.keyring.tokens.get(heard.token_id)
        if token is None:
            group.keyring.ask()
            # Under each new key its publisher says it again, so that with a key that is over nothing is lost.
            cause = Drop.RETAINED if group.keyring.is_over(heard.token_id) else Drop.UNKNOWN_TOKEN
            raise DatagramRefused(cause, heard, self._mode, group.group_id)
        try:
            return token.key.unprotect(heard)
        except RemoteWireError:
            raise DatagramRefused(Drop.BAD_SIGNATURE, heard, self._mode, group.group_id) from None

    def sending_token(self, now: float) -> int:
        """The SecurityTokenId of what is sent now; 0 where there is none."""
        group = self._groups.get(self._own_group)
        token = None if group is None else group.keyring.sending(now)
        return 0 if token is None else token.token_id

    def is_of_another(self, datagram: bytes, now: float) -> bool:
        """Whether data with our PublisherId may be another process's.

        Without security it may. Otherwise it needs our group's signature, and a nonce that is not of this process: what
        is ours and somebody sends again is no sign of another one.
        """
        if self._mode is _NONE:
            return True
        try:
            heard = self._read(datagram)
        except RemoteWireError:
            return False
        group = self._telemetry.get(self._own_space)
        if group is None or heard.mode < self._mode or heard.nonce[: len(self._prefix)] == self._prefix:
            return False
        try:
            return self._verified(heard, group, _ANOTHER, now) is not None
        except (DatagramRefused, RemoteWireError):
            return False

    def _open_unsecured(self, datagram: bytes, now: float) -> bytes | None:
        """Without security: a chunk is taken in, unless it is our own. The subscriber looks at all else."""
        if not datagram[2] & IS_CHUNK:
            return datagram
        chunk = self._chunks.read(datagram)
        if chunk is None:
            return datagram
        sender = chunk if self._ids is None else self._ids.named(chunk)
        if sender.publisher_id == self._own_space and not chunk.is_action:
            raise DatagramRefused(Drop.LOOP, self._read(datagram))
        return self._reassembly.add(chunk, now)

    def _open_other(self, heard: SecuredDatagram, now: float) -> bytes | None:
        """Open an Action, which may come from ourselves, an announcement or a probe."""
        is_probe = heard.is_discovery and _is_probe(heard.datagram)
        if heard.is_action:
            group = self._groups.commands.get(_space_of(heard))
            if group is None:
                return None
        elif is_probe and heard.mode is _NONE:
            if heard.datagram[2] & IS_CHUNK:
                raise DatagramRefused(Drop.NOT_SECURED, heard, self._mode)
            return heard.datagram
        elif not is_probe and heard.publisher_id == self._own_space:
            raise DatagramRefused(Drop.LOOP, heard)
        else:
            group = None
        if heard.mode < self._mode and not is_probe:
            raise DatagramRefused(Drop.NOT_SECURED, heard, self._mode)
        if group is None:
            group = self._telemetry.get(heard.publisher_id) or self._meet(heard)
        if is_probe:
            sender = _NOBODY
        elif heard.is_action:
            sender = _ANY_MEMBER
        else:
            sender = _THE_PUBLISHER
        return self._verified(heard, group, sender, now)

    def _verified(self, heard: SecuredDatagram, group: Group, sender: int, now: float) -> bytes | None:
        keyring = group.keyring
        if now >= keyring.changes_at:
            keyring.advance(now)
        token = keyring.tokens.get(heard.token_id)
        if token is None:
            return self._open_unknown(heard, group, now)
        try:
            plain = token.key.unprotect(heard)
        except RemoteWireError:
            raise DatagramRefused(Drop.BAD_SIGNATURE, heard, self._mode, group.group_id) from None
        if not group.is_relaxed and sender != _NOBODY:
            nonce = heard.nonce
            if len(nonce) != NONCE_BYTES:
                raise DatagramRefused(Drop.REPLAYED, heard, self._mode, group.group_id)
            space, number = _read_nonce(nonce)
            who = space if sender == _ANY_MEMBER else sender
            is_carried = bool(self._siblings) and self._is_carried(group.group_id, heard.token_id, who, number)
            if is_carried or not token.windows.take(who, number):
                raise DatagramRefused(Drop.REPLAYED, heard, self._mode, group.group_id)
        if heard.force_key_reset:
            keyring.ask()
        if plain[1] & HAS_EXTENDED_FLAGS_2 and plain[0] & HAS_EXTENDED_FLAGS_1:
            return self._joined(plain, now)
        return plain

    def poll(self, now: float) -> None:
        """Give up chunks whose message takes too long."""
        self._reassembly.poll(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None. Keys change by themselves when a message needs them."""
        return self._reassembly.next_deadline()

    def _group_to_send(self, message: SecuredDatagram) -> Group | None:
        publisher_id = message.publisher_id
        if message.publisher_id_type != _UINT16 or type(publisher_id) is not int:
            return None
        if message.is_action:
            return self._groups.commands.get(publisher_id)
        if publisher_id == SERVER_SPACE and (space := self._setpoint_groups.get(message.writer_group_id or 0)):
            return self._groups.commands.get(space)
        return self._groups.get(self._own_group) if self._is_relay else self._groups.telemetry.get(publisher_id)

    def _not_sent(self, message: SecuredDatagram, group: Group | None) -> list[bytes]:
        self._counters.drop(Drop.NO_KEY)
        if group is not None:
            self.problem = f"no key of {group.group_id}, or it expired; check that the key source is reachable"
        else:
            group_id = self._name_of_group(message)
            self.problem = f"this process is not in the SecurityGroup {group_id}"
        return []

    def _name_of_group(self, message: SecuredDatagram) -> str:
        publisher_id, space = message.publisher_id, self._setpoint_groups.get(message.writer_group_id or 0)
        if not isinstance(publisher_id, int):
            return "a PublisherId that is no space"
        if publisher_id == SERVER_SPACE and space is not None and not message.is_action:
            return command_group(space)
        return command_group(publisher_id) if message.is_action else telemetry_group(publisher_id)

    def _split(self, datagram: bytes) -> list[bytes]:
        self._chunked = (self._chunked + 1) & 0xFFFF
        return split(datagram, self._most_bytes, self._chunked)

    def parts(self, datagram: bytes, clock: Callable[[], float]) -> Iterator[bytes]:
        """The datagrams to send for a plain message, each made when it is asked for; see `seal`.

        It ends before the last one where there is no key or no nonce any more.
        """
        if self._ids is not None:
            datagram = self._ids.outward(datagram)
        self._chunked = (self._chunked + 1) & 0xFFFF
        for chunk in split_one_by_one(datagram, self._most_bytes, self._chunked):
            sealed = self.seal(chunk, clock())
            if not sealed:
                return
            yield from sealed

    def _seal_chunks(self, datagram: bytes, token: Token, sequence: NonceSequence, now: float) -> list[bytes]:
        return [
            token.key.protect(
                chunk, read_security(chunk).payload_offset, token.token_id, sequence.next(now), self._mode
            )
            for chunk in self._split(datagram)
        ]

    def _meet(self, heard: SecuredDatagram) -> Group:
        """The group of a publisher whose keys we did not want before."""
        publisher_id = _space_of(heard)
        group = self._telemetry.get(publisher_id) or self._groups.hear(publisher_id)
        if group is None:
            raise DatagramRefused(Drop.UNKNOWN_TOKEN, heard, self._mode)
        return group

    def _open_unknown(self, heard: SecuredDatagram, group: Group, now: float) -> bytes | None:
        """A message whose token we do not have, or one that names none."""
        if heard.token_id or heard.nonce:
            group.keyring.ask()
            raise DatagramRefused(Drop.UNKNOWN_TOKEN, heard, self._mode, group.group_id)
        # The second form of a message that is only signed (table 154): nothing in it tells it from a replay.
        if not group.is_relaxed:
            raise DatagramRefused(Drop.REPLAYED, heard, self._mode, group.group_id)
        for token in group.keyring.around_current():
            try:
                return self._joined(token.key.unprotect(heard), now)
            except RemoteWireError:
                continue
        raise DatagramRefused(Drop.BAD_SIGNATURE, heard, self._mode, group.group_id)

    def _joined(self, plain: bytes, now: float) -> bytes | None:
        chunk = self._chunks.read(plain)
        return plain if chunk is None else self._reassembly.add(chunk, now)


def _is_probe(datagram: bytes) -> bool:
    """Of a discovery message, whose three bytes of flags are always there."""
    return datagram[2] & MESSAGE_TYPE_BITS == _PROBE


def _space_of(heard: SecuredDatagram) -> int:
    """The PublisherId as a space; only those have SecurityGroups."""
    publisher_id = heard.publisher_id
    if heard.publisher_id_type != _UINT16 or type(publisher_id) is not int:
        raise DatagramRefused(Drop.UNKNOWN_SOURCE, heard)
    return publisher_id
