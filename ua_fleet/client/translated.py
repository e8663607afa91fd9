# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""asyncua's errors as ours."""

from __future__ import annotations

import asyncio
import os
import socket
from typing import Any, Final
from urllib.parse import urlsplit

from asyncua import ua
from asyncua.ua.uaerrors import UaError, UaStatusCodeError

from ua_fleet.errors import AccessRefused, NotConnected, SendTimeout, UaFleetError
from ua_fleet.printing import config_option
from ua_fleet.values import StatusCode

__all__ = ["NodeNotFound", "quietly", "translated"]

_LOG_IN: Final = "the server wants a user and a password; log in: ua-fleet login --user NAME"
_REMEDIES: Final = {
    ua.StatusCodes.BadUserAccessDenied: "user or password is wrong, or the user's role does not allow this; "
    "see: ua-fleet user list{file}",
    ua.StatusCodes.BadIdentityTokenRejected: _LOG_IN,
    ua.StatusCodes.BadIdentityTokenInvalid: _LOG_IN,
    ua.StatusCodes.BadSecurityChecksFailed: "the server does not trust this client's certificate; "
    "on the server run: ua-fleet cert trust --last --show{file}",
    ua.StatusCodes.BadCertificateUntrusted: "the server does not trust this client's certificate; "
    "on the server run: ua-fleet cert trust --last --show{file}",
    ua.StatusCodes.BadServerTooBusy: "the server has too many requests; try again in some seconds",
    ua.StatusCodes.BadTcpServerTooBusy: "clients at this address use too much of the server without a login; "
    "try again in some seconds",
    ua.StatusCodes.BadNotWritable: "clients may not write this node",
    ua.StatusCodes.BadTypeMismatch: "the node has another type",
    ua.StatusCodes.BadOutOfRange: "the value is outside the node's range",
}
"""`{file}` is where a command needs the file of the fleet that it is about."""


class NodeNotFound(UaFleetError):
    """There is no such node."""

    ua_status = StatusCode.BAD_NODE_ID_UNKNOWN
    remedy = "Take an existing one; `ua-fleet browse` shows all nodes."


async def quietly(ending: Any) -> None:
    """End something that may have ended by itself when the connection went."""
    try:
        await ending
    except (UaError, OSError, TimeoutError, asyncio.CancelledError) as error:
        if isinstance(error, asyncio.CancelledError) and not _is_asyncuas():
            raise


def _is_asyncuas() -> bool:
    """Whether a CancelledError is that of a request whose connection went, and nobody has cancelled us."""
    task = asyncio.current_task()
    return task is not None and not task.cancelling()


def _why(error: OSError) -> str:
    """Why nobody answers, where the system says it; asyncio's own texts are addresses in Python's notation."""
    if isinstance(error, socket.gaierror):
        return f" ({(error.strerror or str(error)).lower()})"
    return f" ({os.strerror(error.errno).lower()})" if error.errno else ""


class translated:  # noqa: N801  (reads like a function where it is used)
    """Turns asyncua's and the socket's errors into ours."""

    def __init__(self, endpoint: str, prefix: str = "") -> None:
        self._endpoint, self._prefix = endpoint, prefix

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UaStatusCodeError):
            remedy = _REMEDIES.get(error.code, "").format(file=config_option())
            name = ua.StatusCode(error.code).name
            text = f"{self._prefix}{name}" + (f": {remedy}" if remedy else "")
            if error.code in (ua.StatusCodes.BadNodeIdUnknown, ua.StatusCodes.BadNodeIdInvalid):
                raise NodeNotFound(text) from error
            raise AccessRefused(error.code, text) from error
        if isinstance(error, asyncio.CancelledError) and _is_asyncuas():
            raise NotConnected(f"the connection to {self._endpoint} was lost") from error
        if isinstance(error, TimeoutError):
            raise SendTimeout(f"{self._endpoint} did not answer in time") from error
        if isinstance(error, OSError):
            address = urlsplit(self._endpoint).netloc or self._endpoint
            raise NotConnected(
                f"the server at {address} does not answer{_why(error)}; start it with: ua-fleet serve{config_option()}"
            ) from error
        if isinstance(error, UaError):
            raise NotConnected(f"{self._endpoint}: {error or type(error).__name__}") from error
