"""How datagrams travel: UDP, and an in-memory network that loses, delays and duplicates."""

from ua_fleet.transport.base import Address, Receive, Transport, TransportStats
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork
from ua_fleet.transport.udp import UdpTransport, parse_url

__all__ = [
    "Address",
    "MemoryEndpoint",
    "MemoryNetwork",
    "Receive",
    "Transport",
    "TransportStats",
    "UdpTransport",
    "parse_url",
]
