"""What a fleet says to do its work: its messages by kind, and how many the published equations expect."""

from ua_fleet.traffic.kinds import EQUATION_12_KINDS, Kind, Traffic

__all__ = ["EQUATION_12_KINDS", "Kind", "Traffic"]
