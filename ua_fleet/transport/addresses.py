"""Addresses as OPC 10000-14 7.3.2 writes them: `opc.udp://<host>:<port>`, an IPv6 address in brackets."""

from __future__ import annotations

import ipaddress
from typing import Final

from ua_fleet.errors import TransportError
from ua_fleet.transport.base import Address

__all__ = ["answer_address", "host_and_port", "parse_url"]

_SCHEME: Final = "opc.udp://"


def host_and_port(host: str, port: int) -> str:
    """Both as a URL has them: an IPv6 address stands in brackets (RFC 3986 3.2.2)."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def parse_url(url: str) -> Address:
    """Host and port of `opc.udp://host:port`."""
    host, separator, port = url.removeprefix(_SCHEME).rstrip("/").rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1] if ":" in host else ""
    elif ":" in host:
        host = ""  # an IPv6 address stands in brackets (RFC 3986 3.2.2)
    is_port = port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65_536
    if not url.startswith(_SCHEME) or not separator or not host or not is_port:
        raise TransportError(
            f"{url!r} is no PubSub address; write {_SCHEME}<host>:<port>, e.g. {_SCHEME}224.0.2.14:4840, with an IPv6 "
            f"address in brackets, e.g. {_SCHEME}[ff15::ea7]:4840"
        )
    return host, int(port)


def answer_address(response_address: str | None, sender: Address) -> Address | None:
    """Where the response to a message goes (OPC 10000-14 7.3.2.3); None for an address that is not answered.

    Only literal addresses of one host, of the sender's IP version: a name would have to be looked up by the event
    loop, and a group or a broadcast address would let one small request reach many. Nor may another machine send us to
    our own loopback. An IPv6 address that counts on one link alone is one of the link that the message came over.

    Args:
        response_address: the ResponseAddress of the ActionHeader; the sender is answered without one.
        sender: where the message came from.
    """
    if not response_address:
        return sender
    try:
        host, port = parse_url(response_address)
        address, came_from = ipaddress.ip_address(host), ipaddress.ip_address(sender[0])
    except (TransportError, ValueError):
        return None
    if address.version != came_from.version or (address.is_loopback and not came_from.is_loopback):
        return None
    if address.is_multicast or address.is_unspecified:
        return None
    if isinstance(address, ipaddress.IPv6Address):
        link = sender[0].partition("%")[2]
        if address.scope_id is not None or address.ipv4_mapped is not None or (address.is_link_local and not link):
            return None
        return (f"{address}%{link}" if address.is_link_local else host), port
    return None if address.is_reserved else (host, port)
