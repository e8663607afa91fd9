"""A relay: a process that forwards DataSetMessages from one PubSub connection of a fleet to another.

    transport -> RelayCore.receive(connection, datagram) -> what is to be sent by which connection -> transport

`core.py` is pure, and decides; `runner.py` is its event loop.
"""

from ua_fleet.relay.core import Forwarded, RelayCore, RelayedConnection
from ua_fleet.relay.runner import run_relay

__all__ = ["Forwarded", "RelayCore", "RelayedConnection", "run_relay"]
