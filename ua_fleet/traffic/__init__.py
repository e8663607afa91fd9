"""What a fleet says to do its work: its messages by kind."""

from ua_fleet.traffic.kinds import MessageKind, Traffic

__all__ = ["MessageKind", "Traffic"]
