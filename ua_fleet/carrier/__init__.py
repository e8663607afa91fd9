"""Runs that a bridge carries: the holder of `carrying` with the engine of scenarios, in the process of the bridge.

It stands above the kit and beside no driver: the command that starts a bridge brings it.
"""

from ua_fleet.carrier.side import carrier_of

__all__ = ["carrier_of"]
