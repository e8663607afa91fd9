# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Calls of Methods that ask the server for its reasons."""

from __future__ import annotations

from typing import Any, Final

from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_from_binary

from ua_fleet.errors import AccessRefused

__all__ = ["call"]

_OPERATION_ADDITIONAL_INFO: Final = 0x80
"""Bit of ReturnDiagnostics (OPC 10000-4 7.33)."""


async def call(client: Client, wanted: ua.CallMethodRequest) -> list[ua.Variant]:
    """Call a Method; its output arguments.

    Raises:
        AccessRefused: the server refuses the call, and says why.
        asyncua's errors: it refuses it without a word, or the connection was lost.
    """
    request = ua.CallRequest()
    request.Parameters.MethodsToCall = [wanted]
    request.RequestHeader.ReturnDiagnostics = ua.UInt32(_OPERATION_ADDITIONAL_INFO)
    protocol = client.uaclient.protocol
    if protocol is None:
        raise ConnectionError("the connection is closed")
    response: Any = struct_from_binary(ua.CallResponse, await protocol.send_request(request))
    response.ResponseHeader.ServiceResult.check()
    (result,) = response.Results
    if not result.StatusCode.is_good() and (infos := response.DiagnosticInfos) and infos[0].AdditionalInfo:
        raise AccessRefused(int(result.StatusCode.value), str(infos[0].AdditionalInfo))
    result.StatusCode.check()
    return list(result.OutputArguments or ())
