"""The audit log: who did what, and what was refused, in files whose lines are chained, and at a syslog server."""

from ua_fleet.server.audit.caller import Caller, summary
from ua_fleet.server.audit.log import AuditLog

__all__ = ["AuditLog", "Caller", "summary"]
