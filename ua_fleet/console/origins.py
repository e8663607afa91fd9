"""Where a request comes from: its address, the host and scheme that the browser sees, whether its Origin is our own.

Pure. X-Forwarded headers count where the peer is one of the trusted proxies, and nowhere else.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

__all__ = ["RequestOrigin", "TrustedProxies", "is_allowed_host", "is_own_origin", "source_of"]

_HOST: Final = re.compile(r"([a-z0-9._-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?")
"""Name and port, in lower case. A browser writes names of other letters in ASCII."""
_ONE_NETWORK: Final = 64
"""Of the 128 bits of an IPv6 address so many are a network's; the others are chosen by whoever is in it."""
LOOPBACK_NAMES: Final = ("localhost", "127.0.0.1", "[::1]")


@dataclass(frozen=True, slots=True)
class RequestOrigin:
    """How the browser sees the console."""

    address: str
    """Of the browser."""
    scheme: str
    host: str
    """With the port, as in the address bar."""


class TrustedProxies:
    """The reverse proxies that are believed."""

    def __init__(self, networks: Sequence[str]) -> None:
        self._networks = [ipaddress.ip_network(one, strict=False) for one in networks]

    def is_trusted(self, address: str) -> bool:
        """Whether this peer is one of them."""
        try:
            peer = _address(address)
        except ValueError:
            return False
        return any(peer in network for network in self._networks)

    def seen(self, peer: str, scheme: str, headers: Mapping[str, str]) -> RequestOrigin:
        """What a request says, by the peer's address, the scheme of the connection, and headers in lower case."""
        host = headers.get("host", "")
        if not self.is_trusted(peer):
            return RequestOrigin(peer, scheme, host.lower())
        forwarded = headers.get("x-forwarded-proto", "").split(",")[-1].strip().lower()
        shown_host = headers.get("x-forwarded-host", "").split(",")[-1].strip()
        return RequestOrigin(
            self._client(peer, headers.get("x-forwarded-for", "")),
            forwarded if forwarded in ("http", "https") else scheme,
            (shown_host or host).lower(),
        )

    def _client(self, peer: str, forwarded: str) -> str:
        """The last address that no trusted proxy has: each one adds the peer that it saw."""
        address = peer
        for one in reversed([part.strip() for part in forwarded.split(",") if part.strip()]):
            try:
                ipaddress.ip_address(one)
            except ValueError:
                return address  # what comes before is anybody's word
            address = one
            if not self.is_trusted(one):
                return address
        return address


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """An address; one of IPv4 as itself where a socket of both, as on `[::]`, shows it as `::ffff:192.0.2.1`."""
    address = ipaddress.ip_address(text)
    return getattr(address, "ipv4_mapped", None) or address


def source_of(address: str) -> str:
    """For what an address counts: itself, or its network where it is of IPv6, since one machine has all of that."""
    try:
        peer = _address(address)
    except ValueError:
        return address
    if isinstance(peer, ipaddress.IPv4Address):
        return str(peer)
    return str(ipaddress.IPv6Network((int(peer), _ONE_NETWORK), strict=False))


def is_allowed_host(host: str, allowed: Sequence[str], *, is_loopback: bool) -> bool:
    """Whether the Host that a browser sees is one by which the console may be reached (against DNS rebinding)."""
    found = _HOST.fullmatch(host)
    if found is None:
        return False
    name = found[1]
    return name in [one.lower() for one in allowed] or (is_loopback and name in LOOPBACK_NAMES)


def is_own_origin(origin: str, seen: RequestOrigin) -> bool:
    """Whether the header Origin is that of the console's own page."""
    return origin.lower() == f"{seen.scheme}://{seen.host}"
