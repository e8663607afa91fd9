"""The PubSub connections of one process: what it sends goes where it belongs, and what comes is told with its way.

    data, announcements, probes    by all connections
    an Action, a setpoint          by those on which its bridge is, and by which Actions go
    what has an address            by the connection that the address names: the one by which the question came

With several connections, the addresses of senders begin with the name of the connection, as in `site|10.0.0.7`. With
one, nothing is added, and nothing stands between the process and its transport.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.origins import NO_ORIGINS, Origins
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.envelopes import Envelopes
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.transport.base import Address, KnowsItself, Receive, Transport, TransportStats
from ua_fleet.transport.party import Brokered, Party, answers_of
from ua_fleet.transport.sealed import SealedSender, Watched
from ua_fleet.wire.security import SecurityMode, read_security

__all__ = ["Connection", "Connections", "Hears", "Sender"]

_BETWEEN: Final = "|"
"""Between the name of a connection and what its transport calls a sender; no name has it."""


class Hears(Protocol):
    """Takes what comes; must not raise and must not block."""

    def __call__(self, datagram: bytes, sender: Address, /, *, is_fresh: bool = True, connection: int = 0) -> None:
        """Take a datagram; `is_fresh` and `connection` as in `Subscriber.receive`."""
        ...


@dataclass(frozen=True, slots=True)
class Connection:
    """One of them."""

    name: str
    transport: Transport
    envelope: Envelope
    takes_actions: bool = True
    """Whether Actions and setpoints go by it."""
    barred: frozenset[int] = frozenset()
    """Spaces that do not come by it."""
    relayed: Origins = NO_ORIGINS
    """What comes by it by relays alone."""


class Connections:
    """See the module."""

    def __init__(
        self,
        connections: Sequence[Connection],
        routes: Mapping[int, Sequence[int]] | None = None,
        setpoint_groups: Mapping[int, int] | None = None,
    ) -> None:
        """Put them together; no transport is started.

        Args:
            connections: at least one.
            routes: by which of them the Actions for a space go; without one, by all that take Actions.
            setpoint_groups: spaces by the WriterGroups of the server's setpoints for them.
        """
        self.all = tuple(connections)
        self.envelopes = Envelopes([connection.envelope for connection in self.all])
        self._routes, self._setpoint_groups = routes or {}, setpoint_groups or {}
        self._with_actions = tuple([number for number, each in enumerate(self.all) if each.takes_actions])
        self._numbers = {connection.name: number for number, connection in enumerate(self.all)}
        self._answers = [answers_of(connection.transport) for connection in self.all]

    @property
    def are_brokered(self) -> bool:
        """Whether any goes over a broker, which may hold messages back for as long as it likes."""
        return any(isinstance(connection.transport, Brokered) for connection in self.all)

    @property
    def must_be_verified(self) -> bool:
        """Whether an Action is signed by whichever connection it goes."""
        return all(self.all[number].envelope.mode is not SecurityMode.NONE for number in self._with_actions)

    @property
    def stats(self) -> TransportStats:
        """The figures of all together; there is a problem where nothing goes by any of them."""
        if len(self.all) == 1:
            return self.all[0].transport.stats
        whole = TransportStats(problem=self.problem if all(self.problems) else "")
        for connection in self.all:
            stats = connection.transport.stats
            whole.sent += stats.sent
            whole.received += stats.received
            whole.send_failed += stats.send_failed
            whole.kernel_drops += stats.kernel_drops
            whole.receive_buffer_bytes += stats.receive_buffer_bytes
        return whole

    @property
    def problem(self) -> str:
        """What does not work of any of them."""
        return "; ".join(filter(None, self.problems))

    @property
    def problems(self) -> list[str]:
        """Why nothing can be sent or received now by each of them; empty where all is well."""
        return [connection.transport.stats.problem for connection in self.all]

    def count_drops(self, counters: Counters) -> None:
        """Put what the kernel or a broker dropped into a process's counters."""
        for connection in self.all:
            connection.transport.stats.count_drops(counters)
        whole = self.stats
        counters.drops[Drop.KERNEL], counters.drops[Drop.SEND_FAILED] = whole.kernel_drops, whole.send_failed

    def speak_for(
        self,
        publisher_id: int,
        hears: Hears,
        names_of: Callable[[int], tuple[str, str] | None],
        taken_over: Callable[[], None] = lambda: None,
    ) -> None:
        """Tell the transports over brokers for whom they speak; before `start`.

        Args:
            publisher_id: of the process.
            hears: takes what brokers have kept.
            names_of: the names of the WriterGroup and the DataSetWriter with an id.
            taken_over: told that another process has connected to a broker as this one.
        """
        for number, connection in enumerate(self.all):
            transport, envelope = connection.transport, connection.envelope
            if isinstance(transport, Brokered):
                transport.speak_for(
                    Party(
                        publisher_id=publisher_id,
                        seal=envelope.seal,
                        token=envelope.sending_token,
                        is_secured=envelope.mode is not SecurityMode.NONE,
                        names_of=names_of,
                        receive_kept=self._hearing(number, partial(hears, is_fresh=False)),
                        taken_over=taken_over,
                        setpoint_groups=self._setpoint_groups,
                    )
                )

    async def start(self, hears: Hears) -> None:
        """Open all of them, and hand each datagram to `hears` from now on; raises TransportError."""
        for number, connection in enumerate(self.all):
            await connection.transport.start(self._hearing(number, hears))

    async def close(self) -> None:
        """Release everything. Safe to call twice."""
        async with AsyncExitStack() as closing:
            for connection in self.all:
                closing.push_async_callback(connection.transport.close)

    def _hearing(self, number: int, hears: Callable[..., None]) -> Receive:
        if len(self.all) == 1:
            return hears
        head = f"{self.all[number].name}{_BETWEEN}"

        def heard(datagram: bytes, sender: Address) -> None:
            hears(datagram, (head + sender[0], sender[1]), connection=number)

        return heard

    def placed(self, address: Address) -> tuple[int, Address]:
        """The connection that an address of a sender names, and what its transport calls it."""
        if len(self.all) == 1:
            return 0, address
        name, _, host = address[0].partition(_BETWEEN)
        return self._numbers[name], (host, address[1])

    def answer_address(self, response_address: str | None, sender: Address) -> Address | None:
        """Where the response to a request goes, of its ResponseAddress and where it came from; None: nowhere."""
        number, plain = self.placed(sender)
        answer = self._answers[number](response_address, plain)
        if answer is None or len(self.all) == 1:
            return answer
        return f"{self.all[number].name}{_BETWEEN}{answer[0]}", answer[1]

    @property
    def know_themselves(self) -> bool:
        """Whether all can tell their own messages from those of others."""
        return all(isinstance(connection.transport, KnowsItself) for connection in self.all)

    def is_own(self, sender: Address) -> bool:
        """Whether what came from there was sent by this process."""
        number, plain = self.placed(sender)
        transport = self.all[number].transport
        return isinstance(transport, KnowsItself) and transport.is_own(plain)

    def ways(self, plain: bytes) -> Sequence[int]:
        """By which of several connections a plain message to all goes."""
        heard = read_security(plain)
        space: int | str | None = heard.publisher_id
        if not heard.is_action:
            is_setpoint = space == SERVER_SPACE and not heard.is_discovery
            space = self._setpoint_groups.get(heard.writer_group_id or 0) if is_setpoint else None
            if space is None:
                return range(len(self.all))
        return self._routes.get(space, self._with_actions) if isinstance(space, int) else self._with_actions


class Sender:
    """Sends the plain messages of a process by its connections, each with a sender of its own."""

    def __init__(self, connections: Connections, senders: Sequence[SealedSender], counters: Counters) -> None:
        """`counters` counts what goes nowhere."""
        self._connections, self._senders, self._counters = connections, tuple(senders), counters
        self.failed, self.not_secured = senders[0].failed, senders[0].not_secured
        """As those of a SealedSender, of all connections together."""
        for sender in senders[1:]:
            sender.failed, sender.not_secured = self.failed, self.not_secured
        self.send: Callable[..., None] = self._send if len(senders) > 1 else senders[0].send
        """Sends a plain message to all, or to one address alone; without a key it is dropped and counted."""

    def watch(self, watched: Watched) -> None:
        """Tell of each message that is sent, and by each connection; for who looks at messages."""
        for sender in self._senders:
            sender.watched = watched

    def oldest_s(self) -> float:
        """How long ago the message came that waits longest; 0 where none does."""
        return max(sender.oldest_s() for sender in self._senders)

    def close(self) -> None:
        """Send nothing more of what waits."""
        for sender in self._senders:
            sender.close()

    def _send(self, datagram: bytes, address: Address | None = None) -> None:
        if address is not None:
            number, plain = self._connections.placed(address)
            self._senders[number].send(datagram, plain)
            return
        ways = self._connections.ways(datagram)
        if not ways:
            self._counters.drop(Drop.NOT_ITS_CONNECTION)
        for number in ways:
            self._senders[number].send(datagram)
