"""Errors as the page gets them: one line, the StatusCode, and the HTTP status that says whose matter it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pydantic import ValidationError

from ua_fleet.client import NodeNotFound, NotDone
from ua_fleet.errors import NotConnected, RobotOffline, SendTimeout, SkillRejected, UaFleetError
from ua_fleet.printing import harmless
from ua_fleet.values import StatusCode, status_name

__all__ = ["OperationRefused", "invalid_parameters", "refused_by", "shown_error"]

_HTTP: Final[Mapping[int, int]] = {
    StatusCode.BAD_USER_ACCESS_DENIED: 403,
    StatusCode.BAD_NOT_WRITABLE: 403,
    StatusCode.BAD_NODE_ID_UNKNOWN: 404,
    StatusCode.BAD_NODE_ID_INVALID: 404,
    StatusCode.BAD_NOT_FOUND: 404,
    StatusCode.BAD_INVALID_ARGUMENT: 400,
    StatusCode.BAD_TYPE_MISMATCH: 400,
    StatusCode.BAD_OUT_OF_RANGE: 400,
    StatusCode.BAD_CONFIGURATION_ERROR: 400,
    StatusCode.BAD_NOT_SUPPORTED: 400,
    StatusCode.BAD_TIMEOUT: 504,
    StatusCode.BAD_NOT_CONNECTED: 503,
    StatusCode.BAD_COMMUNICATION_ERROR: 502,
}
"""Of StatusCodes; others are 409: the server has refused for now."""
_RETURNED: Final = {1: 404, 2: 400, 3: 409, 4: 409}
"""Of the ReturnStatus of the server's Methods."""
_HEAD, _TAIL = 350, 100
"""Characters of a message, where it has more than both: it may repeat a text of 1 MB that somebody has given."""


def _told(text: str) -> str:
    """A message in one line that is no page long: what is wrong stands at its beginning, what to do at its end."""
    line = harmless(text)
    left = len(line) - _HEAD - _TAIL
    return line if left <= 0 else f"{line[:_HEAD]}… ({left} characters left out) …{line[-_TAIL:]}"


class OperationRefused(UaFleetError):
    """What the console answers in place of a result."""

    remedy = "Load the page again and log in."

    def __init__(
        self,
        http_status: int,
        message: str,
        *,
        code: int | None = None,
        field: str = "",
        problems: list[dict[str, Any]] | None = None,
        retry_after_s: float = 0.0,
    ) -> None:
        super().__init__(message)
        self.http_status, self.field, self.problems = http_status, field, problems
        self.retry_after_s = retry_after_s
        self.code = code

    @property
    def body(self) -> dict[str, Any]:
        """The object `error` of the answer."""
        shown: dict[str, Any] = {"message": _told(str(self))}
        if self.code is not None:
            shown |= {"status": status_name(self.code), "code": self.code}
        if self.field:
            shown["field"] = _told(self.field)
        if self.problems is not None:
            shown["problems"] = self.problems
        return shown


def refused_by(error: UaFleetError, *, method: str = "") -> OperationRefused:
    """What the page is told of an error.

    Args:
        error: of the client, or ours.
        method: what the server was asked for, which is named where rights are missing.
    """
    if isinstance(error, OperationRefused):
        return error
    code = int(error.ua_status)
    status = _HTTP.get(code, 409)
    message = str(error).split("\n")[0]
    if isinstance(error, NotDone):
        status = _RETURNED.get(error.return_status, 409)
    elif isinstance(error, NodeNotFound):
        status = 404
    elif isinstance(error, NotConnected):
        status = 503
    elif isinstance(error, SendTimeout):
        status = 504
    elif isinstance(error, RobotOffline) or (isinstance(error, SkillRejected) and status not in (400, 403)):
        status = 409
    if code == StatusCode.BAD_USER_ACCESS_DENIED:
        what = f"your role does not allow {method}" if method else "your role does not allow this"
        message = f"{what} (BadUserAccessDenied); ask an engineer of this fleet for a role that does"
    if code == StatusCode.BAD_SECURITY_CHECKS_FAILED:
        # Many people come by the console's certificate, so it is trusted in another way than that of one client.
        trust = "ua-fleet cert trust --last --show --gateway console"
        message = f"the server does not trust this console's certificate; on the server run: {trust}"
    problems = getattr(error, "problems", None)
    shown: list[dict[str, Any]] | None = None
    if problems is not None:
        shown = [
            {"line": getattr(one, "line", 0), "message": _told(str(getattr(one, "text", one)))} for one in problems
        ]
    return OperationRefused(status, message, code=code, field=getattr(error, "argument", ""), problems=shown)


def invalid_parameters(error: ValidationError, what: str) -> OperationRefused:
    """What the page is told of parameters that are none."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    field = ".".join(str(part) for part in first["loc"])
    said = f"{what}: {field + ': ' if field else ''}{first['msg']}"
    return OperationRefused(400, said, code=int(StatusCode.BAD_INVALID_ARGUMENT), field=field)


def shown_error(error: UaFleetError) -> dict[str, Any]:
    """The object `error` of a feed."""
    return refused_by(error).body
