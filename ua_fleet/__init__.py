"""ua_fleet: a mixed fleet of robots as one OPC UA server, with bridges over OPC UA PubSub."""

__version__ = "0.1.0"
