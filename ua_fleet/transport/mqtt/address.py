"""Addresses of MQTT brokers (OPC 10000-14 7.3.4.3): `mqtt://<host>[:<port>]`, and `mqtts://` with TLS."""

from __future__ import annotations

from typing import Final, NamedTuple

from ua_fleet.errors import TransportError

__all__ = ["BrokerAddress", "is_broker_url", "parse_broker_url"]

_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}


class BrokerAddress(NamedTuple):
    """Where a broker listens."""

    host: str
    port: int
    has_tls: bool


def is_broker_url(url: str) -> bool:
    """Whether a URL names a broker, and no UDP address."""
    return url.partition("://")[0] in _PORTS


def parse_broker_url(url: str) -> BrokerAddress:
    """Host and port of a broker's URL; raises TransportError for anything else, also for one with a user in it."""
    scheme, separator, place = url.partition("://")
    if scheme not in _PORTS or not separator:
        raise TransportError(f"{_shown(url)!r} is no broker; write mqtt://<host>:<port>, or mqtts:// for TLS")
    if "@" in place:
        raise TransportError(
            f"{_shown(url)!r} has a user in it, and URLs are shown in logs; "
            "write `broker.user` and `broker.password_file`"
        )
    place = place.removesuffix("/")
    host, port = place, ""
    if place.startswith("["):  # an IPv6 address
        host, closing, rest = place[1:].partition("]")
        if not closing or (rest and not rest.startswith(":")):
            raise TransportError(f"{url!r} is no broker; write an IPv6 address as mqtt://[::1]:1883")
        port = rest[1:]
    elif ":" in place:
        host, _, port = place.rpartition(":")
    if not host or "/" in host or (":" in host and not place.startswith("[")):
        raise TransportError(f"{url!r} is no broker; write {scheme}://<host>:<port>")
    if not port and place.endswith(":"):
        raise TransportError(f"{url!r} has no port after the colon; write {scheme}://{host}:{_PORTS[scheme]}")
    if port and not (port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65_536):
        raise TransportError(f"{url!r}: {port} is no port (1 to 65535)")
    return BrokerAddress(host, int(port) if port else _PORTS[scheme], scheme == "mqtts")


def _shown(url: str) -> str:
    """A URL without what stands before an `@`, which may be a password."""
    scheme, separator, place = url.partition("://")
    return f"{scheme}{separator}...@{place.rpartition('@')[2]}" if "@" in place else url
