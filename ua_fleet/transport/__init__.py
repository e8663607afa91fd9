"""How messages travel: UDP, MQTT brokers, and an in-memory network that loses, delays and duplicates.

Nothing is offered here: who needs an address need not import sockets and keys.
"""
