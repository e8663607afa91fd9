"""How datagrams travel: UDP, and an in-memory network that loses, delays and duplicates."""

from ua_fleet.transport.addresses import answer_address, parse_url
from ua_fleet.transport.base import Address, Receive, Transport, TransportStats
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork
from ua_fleet.transport.sealed import SealedSender, Sent
from ua_fleet.transport.udp import UdpTransport

__all__ = [
    "Address",
    "MemoryEndpoint",
    "MemoryNetwork",
    "Receive",
    "SealedSender",
    "Sent",
    "Transport",
    "TransportStats",
    "UdpTransport",
    "answer_address",
    "parse_url",
]
