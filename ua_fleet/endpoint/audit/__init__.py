"""The audit log: who did what, and what was refused, in files whose lines are chained, and at a syslog server."""

from ua_fleet.endpoint.audit.caller import Caller, summary
from ua_fleet.endpoint.audit.log import AuditLog

__all__ = ["AuditLog", "Caller", "summary"]
