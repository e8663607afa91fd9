"""What an alarm is: what it watches, and what it is to say. Its state is another matter (`condition`)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

from ua_fleet.operation.alarms.levels import Levels
from ua_fleet.values import NodeId

__all__ = ["DEFAULT_SEVERITY", "MORE_SEVERE", "AlarmDefinition", "AlarmKind", "WatchedCertificate"]

DEFAULT_SEVERITY: Final = 500
MORE_SEVERE: Final = 200
"""By which the severity of HighHigh and LowLow is above that of High and Low."""
_MOST_SEVERE: Final = 1000
NO_LIMITS: Final = Levels()


class AlarmKind(StrEnum):
    """The types of alarms that the server makes."""

    LEVEL = "ExclusiveLevelAlarmType"
    OFF_NORMAL = "OffNormalAlarmType"
    CERTIFICATE = "CertificateExpirationAlarmType"


class WatchedCertificate(NamedTuple):
    """A certificate, and what is to be said of it."""

    der: bytes
    expires_at: float
    """Seconds since 1970."""
    limit_s: float
    """So long before its end it is an alarm (ExpirationLimit)."""
    notice: str
    """What is wrong with it, and what to do; empty while its end is far."""


@dataclass(frozen=True, slots=True)
class AlarmDefinition:
    """One alarm."""

    id: str
    """Unique in the server, e.g. `ur3.temperature`: its node is `Fleet.Alarms.<id>`."""
    kind: AlarmKind
    source: NodeId
    """The node that it is about (SourceNode)."""
    source_name: str
    """For people."""
    watched: NodeId | None
    """The node whose value decides (InputNode); None where something else does."""
    levels: Levels = NO_LIMITS
    normal: bool = False
    """Of a Boolean: the value without an alarm."""
    delay_s: float = 0.0
    """For so long a value has to be beyond a limit before that is an alarm (OnDelay)."""
    severity: int = DEFAULT_SEVERITY
    """1 to 1000, of High, Low and off-normal."""
    needs_confirmation: bool = False
    """Whether it has a ConfirmedState: then it is retained until it is confirmed, too."""
    unit: str = ""
    robot: str = ""
    """The robot whose fault it is; empty where it is no fault."""
    certificate: WatchedCertificate | None = None
    """What a CertificateExpirationAlarm is about."""
    capacities: tuple[str, ...] = ()
    """Those that it takes away from the robot while it is active."""

    def severity_at(self, level: int) -> int:
        """The severity of a level."""
        return min(self.severity + (MORE_SEVERE if abs(level) > 1 else 0), _MOST_SEVERE)
