"""Addresses as OPC 10000-14 7.3.2 writes them: `opc.udp://<host>:<port>`."""

from __future__ import annotations

import ipaddress
from typing import Final

from ua_fleet.errors import TransportError
from ua_fleet.transport.base import Address

__all__ = ["answer_address", "parse_url"]

_SCHEME: Final = "opc.udp://"


def parse_url(url: str) -> Address:
    """Host and port of `opc.udp://host:port`."""
    host, separator, port = url.removeprefix(_SCHEME).rstrip("/").rpartition(":")
    is_port = port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65_536
    if not url.startswith(_SCHEME) or not separator or not host or not is_port:
        raise TransportError(
            f"{url!r} is no PubSub address; write {_SCHEME}<host>:<port>, e.g. {_SCHEME}224.0.2.14:4840"
        )
    return host, int(port)


def answer_address(response_address: str | None, sender: Address) -> Address | None:
    """Where the response to a message goes (OPC 10000-14 7.3.2.3); None for an address that is not answered.

    Only literal IPv4 addresses of one host: a name would have to be looked up by the event loop, and a group or a
    broadcast address would let one small request reach many. Nor may another machine send us to our own loopback.

    Args:
        response_address: the ResponseAddress of the ActionHeader; the sender is answered without one.
        sender: where the message came from.
    """
    if not response_address:
        return sender
    try:
        host, port = parse_url(response_address)
        address = ipaddress.IPv4Address(host)
        is_stranger = address.is_loopback and not ipaddress.IPv4Address(sender[0]).is_loopback
    except (TransportError, ValueError):
        return None
    if is_stranger or address.is_multicast or address.is_unspecified or address.is_reserved:
        return None
    return host, port
