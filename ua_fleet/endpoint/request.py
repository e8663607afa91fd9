"""One request of a client, as the services get it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.audit_events import Who
from ua_fleet.endpoint.sessions import Session
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.turns import Turns
from ua_fleet.endpoint.users import User

__all__ = ["ANSWERED_LATER", "ServiceRequest", "operations"]


ANSWERED_LATER: Final = object()
"""What a plan gives for a response that comes later, or has been sent already."""


class ServiceRequest(NamedTuple):
    """A request on an active session."""

    session: Session
    user: User
    caller: Caller
    handle: int
    request_id: int
    timeout_s: float
    """TimeoutHint of the request; 0 is none."""
    encrypted: bool
    """Whether nobody else can read what is asked and answered."""
    turns: Turns
    """Ended between operations, so that others have theirs."""
    audit_entry: str = ""
    """AuditEntryId of the request."""
    wants_reasons: bool = False
    """Whether the client asks for the AdditionalInfo of operations (ReturnDiagnostics)."""

    @property
    def who(self) -> Who:
        """Who asked, for an AuditEvent."""
        return Who(self.caller, self.audit_entry)


def operations(items: Sequence[Any] | None, limit: int) -> Sequence[Any]:
    """The operations of a request; raises Refusal for none and for too many (OPC 10000-4 5.3)."""
    if not items:
        raise Refusal(StatusCodes.BadNothingToDo)
    if len(items) > limit:
        raise Refusal(StatusCodes.BadTooManyOperations, f"{len(items)} operations, the limit is {limit}")
    return items
