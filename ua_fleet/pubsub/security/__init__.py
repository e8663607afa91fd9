"""Message security around the codec: which key, which nonce, what was replayed, and chunks.

An `Envelope` for each process, between the transport on one side, publisher and subscriber on the other:

    envelope.install(group_id, keys, now)        # for each of envelope.keys_wanted(now)
    envelope.seal(datagram, now)                 -> datagrams to send
    envelope.open(datagram, now)                 -> the plain datagram, None where chunks are missing; raises Refused
    envelope.poll(now)                           # at envelope.next_deadline()
"""

from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces, NonceReservations, NoncesUnavailable
from ua_fleet.pubsub.security.refused import DatagramRefused

__all__ = [
    "DatagramRefused",
    "Envelope",
    "GroupKeys",
    "MemoryNonces",
    "NonceReservations",
    "NoncesUnavailable",
    "command_group",
    "telemetry_group",
]
