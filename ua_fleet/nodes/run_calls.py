"""What the Methods of scenarios, decisions and faults have in common: codes of refusals, whose place a call takes."""

from __future__ import annotations

from ua_fleet.endpoint.origin import origin
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.errors import JudgementsInvalid, ScenarioInvalid, UaFleetError
from ua_fleet.nodes.method_factory import NOT_FOUND, NOT_POSSIBLE, NOT_VALID, caller
from ua_fleet.operation.runs.library import ScenarioUnknown

__all__ = ["code_of", "whose_place"]


def code_of(error: UaFleetError) -> int:
    """The ReturnStatus of a refusal."""
    if isinstance(error, ScenarioUnknown):
        return NOT_FOUND
    if isinstance(error, ScenarioInvalid | JudgementsInvalid):
        return NOT_VALID
    return NOT_POSSIBLE


def whose_place() -> str:
    """Whose place a call takes: the user's, or that of an address without one."""
    session, user = current_session.get(), caller()
    return f"at {origin(session.address)}" if user.anonymous and session is not None else user.name
