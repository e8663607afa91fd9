"""Where a client comes from, for all that is counted or limited by address."""

from __future__ import annotations

import ipaddress
from functools import lru_cache
from typing import Final

__all__ = ["networks", "origin"]

_HOST_BITS_V6: Final = 64
"""An IPv6 host has a network of its own, and may take any address of it."""
_NETWORK_BITS: Final = {4: 24, 6: 48}
"""What one who has more than one address is given, as a rule."""
_WIDE_BITS: Final = {4: 16, 6: 32}


@lru_cache(maxsize=1024)
def origin(address: str) -> str:
    """What an address counts as: an IPv4 address as itself, also in its mapped form; an IPv6 address as its /64."""
    try:
        parsed = _parsed(address)
    except ValueError:
        return address
    if parsed.version == 4 or parsed.is_loopback or parsed.is_link_local:
        return str(parsed)
    return _network(parsed, _HOST_BITS_V6)


@lru_cache(maxsize=1024)
def networks(address: str) -> tuple[str, str, str]:
    """What an address counts as (`origin`), its network and its wide network: /24 and /16, or /48 and /32 of IPv6."""
    own = origin(address)
    try:
        parsed = _parsed(address)
    except ValueError:
        return own, f"network of {own}", f"wide network of {own}"
    return own, _network(parsed, _NETWORK_BITS[parsed.version]), _network(parsed, _WIDE_BITS[parsed.version])


def _parsed(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """An address; one of IPv4 also where it is written as one of IPv6. Raises ValueError."""
    parsed = ipaddress.ip_address(address.partition("%")[0])
    return parsed.ipv4_mapped or parsed if isinstance(parsed, ipaddress.IPv6Address) else parsed


def _network(address: ipaddress.IPv4Address | ipaddress.IPv6Address, bits: int) -> str:
    return str(ipaddress.ip_network((address, bits), strict=False))
