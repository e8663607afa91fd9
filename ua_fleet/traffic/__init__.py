"""What a fleet says to do its work: its messages by kind."""

from ua_fleet.traffic.kinds import Kind, Traffic

__all__ = ["Kind", "Traffic"]
