"""The periods of one PubSub connection, and VersionTime."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.values import TICKS_PER_SECOND

__all__ = ["PubSubTiming", "version_time"]

_VERSION_EPOCH_TICKS: Final = 125_911_584_000_000_000
"""2000-01-01 UTC in ticks."""


@dataclass(frozen=True, slots=True)
class PubSubTiming:
    """The periods that writers keep and readers expect, in seconds."""

    keep_alive_s: float = 1.0
    """KeepAliveTime: a writer that has sent nothing for so long says that its source lives (6.2.6.3)."""
    receive_timeout_s: float = 3.0
    """MessageReceiveTimeout: a source that was not heard for so long is silent (6.2.9.6)."""
    repeat_interval_s: float = 5.0
    """A writer sends its last message again with this period."""
    announce_interval_s: float = 60.0
    """DiscoveryAnnounceRate: metadata is announced again so often, for who does not probe (6.4.1.2.3)."""
    status_interval_s: float = 10.0
    """A process says so often that it is Operational; each time it says when the next one comes (7.2.4.6.7)."""


def version_time(wall_ticks: int) -> int:
    """VersionTime: seconds since 2000-01-01 UTC as UInt32, at least 1 (OPC 10000-14 6.2.3.2.6, OPC 10000-4 7.44)."""
    return min(max((wall_ticks - _VERSION_EPOCH_TICKS) // TICKS_PER_SECOND, 1), 0xFFFF_FFFF)
