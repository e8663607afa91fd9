"""UDP over IPv4 or IPv6, multicast and unicast (OPC 10000-14 7.3.2).

Multicast: every member sends to the group and hears the group, itself included unless it is told not to (see
`own_filter.py`). The receiving socket is bound to the group's address, so it gets nothing of other groups on the same
port, and shares the port with other processes.
Unicast: we listen on the interface's address and send to the URL's host; only one process can listen on an address.

Two sockets share the port that we send from. One is connected, so that the kernel need not look up the way for each
datagram; a connected socket hears its peer only, and no datagram comes from a group. The other one hears what is sent
to that port, and sends to single addresses: a response to an ActionRequest goes to where the request came from
(OPC 10000-14 7.3.2.3).

An interface is looked up again each second: when it went and came back, or has another address, the sockets follow.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import socket
import struct
import time
from collections import deque
from collections.abc import Collection
from typing import Final

import structlog

from ua_fleet.errors import TransportError
from ua_fleet.transport.addresses import parse_url
from ua_fleet.transport.base import Address, Receive, TransportStats
from ua_fleet.transport.families import IPV4, Family, family_of
from ua_fleet.transport.interfaces import Interface, find_interface, interface_state
from ua_fleet.transport.own_filter import attach_own_filter
from ua_fleet.wire.outline import is_action

__all__ = ["UdpTransport"]

_LARGEST_DATAGRAM: Final = 65_536
_BATCH: Final = 64
"""Datagrams that are read at each wake-up at most, so that the event loop gets on."""
_BATCH_BYTES: Final = 256 * 1024
"""Bytes of them: a description of 300 fields takes 40 KB, and some milliseconds to read."""
_TURN_S: Final = 0.005
"""Time for which they are handed on, before others have theirs."""
_CHECK_PERIOD_S: Final = 1.0
_WARNING_PERIOD_S: Final = 60.0
_SEND_BUFFER_BYTES: Final = 1024 * 1024

# Linux's numbers, which Python has no names for.
_SO_RCVBUFFORCE: Final = 33
_SO_MEMINFO: Final = 55
_MEMINFO_DROPS: Final = 8

_log = structlog.get_logger(__name__)


class UdpTransport:
    """A Transport over one UDP port and one interface."""

    def __init__(
        self,
        url: str,
        interface: str,
        *,
        ttl: int = 1,
        receive_buffer_bytes: int = 4 * 1024 * 1024,
        hears_itself: bool = True,
        urgent_heads: Collection[bytes] = (),
    ) -> None:
        """Prepare a transport; nothing is opened before `start`.

        Args:
            url: `opc.udp://<host>:<port>`.
            interface: name or address of the network interface, or a subnet with an address of it.
            ttl: router hops that a multicast datagram may make.
            receive_buffer_bytes: wanted size of the receive buffer; `stats` says what the kernel gave.
            hears_itself: whether what it sends to a group comes back; otherwise not, where the kernel can keep it out.
            urgent_heads: how datagrams begin that are handed on first, as Actions are; all of one length.
        """
        self._hears_itself = hears_itself
        self._urgent_heads = frozenset(urgent_heads)
        self._head_bytes = len(next(iter(self._urgent_heads), b""))
        self.stats = TransportStats()
        self._url = url
        self._host, self._port = parse_url(url)
        self._interface_name = interface
        self._family: Family = IPV4
        self._ttl = ttl
        self._wanted_buffer_bytes = receive_buffer_bytes
        self._is_multicast = False
        self._waiting: deque[tuple[bytes, Address]] = deque()
        """What was read, and is handed on in the next turns."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._receive: Receive | None = None
        self._interface: Interface | None = None
        self._receiver: socket.socket | None = None
        self._sender: socket.socket | None = None
        self._direct: socket.socket | None = None
        """At the sender's port: hears answers, sends to one address."""
        self._own: deque[Address] = deque(maxlen=4)
        """Where this transport has sent from, the latest last."""
        self._state = b""
        """The interface's state when it was last looked up; empty where it is to be looked up."""
        self._timer: asyncio.TimerHandle | None = None
        self._joined_index: int | None = None
        """Index of the interface on which the group was joined."""
        self._send_failing = False
        self._earlier_drops = 0
        """Kernel drops of receivers that were closed."""
        self._is_filtered = False
        """Whether the receiver's filter drops what the sender sends."""
        self._filtered = 0
        """Datagrams that it has dropped, which the kernel counts among the receiver's drops."""
        self._warned_at = float("-inf")
        self._warned_drops = 0

    def is_own(self, sender: Address) -> bool:
        """See KnowsItself. What was sent before the sender was opened anew may still be in the receive buffer."""
        return sender in self._own

    async def start(self, receive: Receive) -> None:
        """Open the sockets and hand each datagram to `receive` from now on."""
        loop = self._loop = asyncio.get_running_loop()
        self._receive = receive
        self._host = await self._resolve(loop)
        self._family = family_of(self._host)
        self._is_multicast = ipaddress.ip_address(self._host).is_multicast
        try:
            self._open(self._find_interface())
        except BaseException:
            await self.close()
            raise
        self._timer = loop.call_later(_CHECK_PERIOD_S, self._check)
        self._say_opened()

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send to all members, or to one address alone, from the same port. Never blocks.

        What the kernel refuses is counted. The address must be a literal one: a name would be looked up in the loop.
        """
        if address is not None:
            self._send_to(datagram, address)
            return
        sender = self._sender
        if sender is None:
            self.stats.send_failed += 1
            return
        try:
            sender.send(datagram)
        except OSError as error:
            self._send_again(sender, datagram, error)
        else:
            self.stats.sent += 1
            self._filtered += self._is_filtered

    async def close(self) -> None:
        """Release everything. Safe to call twice."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._close_receiver()
        self._close_sender()
        self._waiting.clear()

    async def _resolve(self, loop: asyncio.AbstractEventLoop) -> str:
        try:
            found = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)
        except socket.gaierror as error:
            raise TransportError(
                f"{self._url}: {self._host} is no IP address and no known host name ({error.strerror})"
            ) from error
        found.sort(key=lambda one: one[0] != socket.AF_INET)  # of a name that has both, as it always was
        return str(found[0][4][0])

    def _find_interface(self) -> Interface:
        return find_interface(self._interface_name, self._family.version, self._host)

    def _open(self, interface: Interface) -> None:
        """Open both sockets for an interface as it is now."""
        self._state = b""
        if not interface.is_up:
            name = interface.name
            raise TransportError(f"network interface {name} is down; bring it up: ip link set {name} up")
        if self._receiver is None or not self._is_multicast:
            self._close_receiver()
            self._open_receiver(interface)
        if self._is_multicast:
            self._join(interface)
        self._close_sender()
        self._open_sender(interface)
        self._interface = interface

    def _open_receiver(self, interface: Interface) -> None:
        address = self._host if self._is_multicast else interface.address
        receiver = self._family.open()
        try:
            if self._is_multicast:
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
                self._family.only_joined(receiver)
            self._enlarge(receiver)
            receiver.bind(self._family.sockaddr(address, self._port, interface))
        except OSError as error:
            receiver.close()
            raise self._bind_error(address, error) from error
        self._receiver = receiver
        self._read(receiver)

    def _read(self, opened: socket.socket) -> None:
        assert self._loop is not None
        self._loop.add_reader(opened.fileno(), self._drain, opened)

    def _enlarge(self, receiver: socket.socket) -> None:
        """Get the largest receive buffer up to the wanted size; above rmem_max that takes CAP_NET_ADMIN."""
        wanted = self._wanted_buffer_bytes
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted)
        if receiver.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) < 2 * wanted:
            with contextlib.suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted)
        # The kernel doubles what it is asked for, for its own accounting (man 7 socket).
        self.stats.receive_buffer_bytes = receiver.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2

    def _bind_error(self, address: str, error: OSError) -> TransportError:
        place = f"{address} port {self._port}"
        if error.errno == errno.EADDRINUSE:
            remedy = f"stop the program that holds it (ss -ulpn sport = :{self._port}) or choose another port"
            return TransportError(f"{place} is in use; {remedy}")
        if error.errno in (errno.EACCES, errno.EPERM):
            remedy = "choose a port above 1023, or grant CAP_NET_BIND_SERVICE"
            return TransportError(f"no permission to listen on {place}; {remedy}")
        return TransportError(f"cannot listen on {place}: {error.strerror}")

    def _join(self, interface: Interface) -> None:
        assert self._receiver is not None
        family = self._family
        if self._joined_index is not None:
            family.leave(self._receiver, self._host, self._joined_index)
            self._joined_index = None
        try:
            family.join(self._receiver, self._host, interface.index)
        except OSError as error:
            if error.errno == errno.ENOBUFS:
                remedy = f"raise it: {family.more_groups}"
                raise TransportError(f"cannot join {self._host}: too many groups; {remedy}") from error
            raise TransportError(f"cannot join {self._host} on {interface.name}: {error.strerror}") from error
        self._joined_index = interface.index

    def _open_sender(self, interface: Interface) -> None:
        family = self._family
        sender = family.open()
        try:
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            if self._is_multicast:
                family.send_through(sender, interface, self._ttl)
            sender.bind(family.sockaddr(interface.address, 0, interface))
            direct = _beside(sender, family)
        except OSError as error:
            sender.close()
            raise self._route_error(interface, error) from error
        try:
            sender.connect(family.sockaddr(self._host, self._port, interface))
        except OSError as error:
            sender.close()
            direct.close()
            raise self._route_error(interface, error) from error
        self._sender, self._direct = sender, direct
        self._own.append(family.address(sender.getsockname()))
        if self._is_multicast and self._receiver is not None and not self._hears_itself:
            self._is_filtered = attach_own_filter(self._receiver, sender)
        self._read(direct)
        self._send_failing = False

    def _route_error(self, interface: Interface, error: OSError) -> TransportError:
        place = f"{self._host} through {interface.name}"
        if error.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH):
            kind = "multicast route" if self._is_multicast else "route"
            remedy = self._family.new_route(None if self._is_multicast else self._host, interface.name)
            return TransportError(f"no {kind} to {place}; add one: {remedy}")
        if error.errno in (errno.EACCES, errno.EPERM):
            return TransportError(f"no permission to send to {place}; look at the firewall's rules for output")
        return TransportError(f"cannot send to {place}: {error.strerror}")

    def _drain(self, receiver: socket.socket) -> None:
        """Read what is there, up to a bound, urgent ones first; the event loop calls again while there is more."""
        receive, stats, values = self._receive, self.stats, self._waiting
        address = None if self._family is IPV4 else self._family.address
        assert receive is not None
        if values:
            return  # they come first
        recvfrom = receiver.recvfrom
        left = _BATCH_BYTES
        for _ in range(_BATCH):
            try:
                datagram, sender = recvfrom(_LARGEST_DATAGRAM)
            except OSError:  # no more, or closed by `receive`; a broken interface is seen by the check
                break
            stats.received += 1
            left -= len(datagram)
            if address is not None:
                sender = address(sender)
            if is_action(datagram) or datagram[: self._head_bytes] in self._urgent_heads:
                receive(datagram, sender)
            else:
                values.append((datagram, sender))
            if left <= 0:
                break
        self._hand_on()

    def _hand_on(self) -> None:
        """Hand on what was read, for a turn; the rest in the next one, so that the event loop gets on."""
        receive, values, clock = self._receive, self._waiting, time.monotonic
        assert receive is not None
        assert self._loop is not None
        until = clock() + _TURN_S
        try:
            while values:
                receive(*values.popleft())
                if clock() >= until:
                    break
        finally:
            if values:
                self._loop.call_soon(self._hand_on)

    def _send_again(self, sender: socket.socket, datagram: bytes, error: OSError) -> None:
        """After a refusal: an ICMP answer to an earlier datagram is reported here once, then the way is free."""
        if error.errno == errno.ECONNREFUSED:
            try:
                sender.send(datagram)
            except OSError as again:
                error = again
            else:
                self.stats.sent += 1
                self._filtered += self._is_filtered
                return
        self.stats.send_failed += 1
        if error.errno not in (errno.EAGAIN, errno.ENOBUFS, errno.EMSGSIZE, errno.ECONNREFUSED):
            self._send_failing = True

    def _send_to(self, datagram: bytes, address: Address) -> None:
        """What fails here is the address's matter, not the interface's: only the count says so."""
        if self._direct is not None:
            with contextlib.suppress(OSError, OverflowError, ValueError):
                self._direct.sendto(datagram, self._family.target(address))
                self.stats.sent += 1
                return
        self.stats.send_failed += 1

    def _check(self) -> None:
        """Each second: follow the interface, and ask the kernel for its drops."""
        assert self._loop is not None
        self._timer = self._loop.call_later(_CHECK_PERIOD_S, self._check)
        self._count_kernel_drops()
        before, sender = self._interface, self._sender
        is_working = sender is not None and not self._send_failing
        try:
            state = b"" if sender is None or before is None else interface_state(sender, before)
            if is_working and state and state == self._state:
                return
            interface = self._find_interface()
            if is_working and interface == before:
                self._state = state
                return
            self._open(interface)
        except (TransportError, OSError) as error:
            self.stats.problem = str(error)
            if before is not None:
                self._interface = None
                _log.warning("pubsub interface lost", url=self._url, reason=str(error))
            return
        self.stats.problem = ""
        if before is None:
            _log.info("pubsub interface back", url=self._url, interface=interface.name, address=interface.address)

    def _say_opened(self) -> None:
        assert self._interface is not None
        granted, wanted = self.stats.receive_buffer_bytes, self._wanted_buffer_bytes
        _log.info(
            "pubsub transport open",
            url=self._url,
            interface=self._interface.name,
            address=self._interface.address,
            receive_buffer_bytes=granted,
        )
        if granted < wanted:
            _log.warning(
                "receive buffer smaller than wanted",
                granted_bytes=granted,
                wanted_bytes=wanted,
                remedy=f"sysctl -w net.core.rmem_max={wanted}",
            )

    def _count_kernel_drops(self) -> None:
        """SO_MEMINFO costs half a microsecond; /proc/net/udp 47, and SO_RXQ_OVFL 0.3 for each datagram."""
        drops = sum(_drops(opened) for opened in (self._receiver, self._direct) if opened is not None)
        drops += self._earlier_drops - self._filtered
        self.stats.kernel_drops = max(self.stats.kernel_drops, drops)  # what was sent just now may not be there yet
        assert self._loop is not None
        now = self._loop.time()
        if self.stats.kernel_drops > self._warned_drops and now - self._warned_at >= _WARNING_PERIOD_S:
            _log.warning(
                "kernel dropped datagrams",
                url=self._url,
                dropped=self.stats.kernel_drops - self._warned_drops,
                receive_buffer_bytes=self.stats.receive_buffer_bytes,
            )
            self._warned_at, self._warned_drops = now, self.stats.kernel_drops

    def _close_receiver(self) -> None:
        if self._receiver is not None:
            self._end_reading(self._receiver)
            self._receiver = None

    def _close_sender(self) -> None:
        if self._sender is not None:
            self._sender.close()
            self._sender = None
        if self._direct is not None:
            self._end_reading(self._direct)
            self._direct = None

    def _end_reading(self, opened: socket.socket) -> None:
        self._earlier_drops += _drops(opened)
        assert self._loop is not None
        self._loop.remove_reader(opened.fileno())
        opened.close()


def _beside(sender: socket.socket, family: Family) -> socket.socket:
    """A socket at the port of a bound one, which must not be connected yet. No third one can come to that port."""
    direct = family.open()
    try:
        for each in (sender, direct):  # after the sender's bind: before, the kernel might share a foreign port with us
            each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        direct.bind(sender.getsockname())
        for each in (sender, direct):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    except OSError:
        direct.close()
        raise
    return direct


def _drops(opened: socket.socket) -> int:
    """Datagrams that the kernel dropped at a socket."""
    with contextlib.suppress(OSError, struct.error):
        memory = opened.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
        return int(struct.unpack_from("I", memory, 4 * _MEMINFO_DROPS)[0])
    return 0
