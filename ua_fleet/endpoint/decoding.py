"""From the bytes of a request to its parameters: scanned, then decoded by asyncua, operation by operation."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import contextlib
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, NamedTuple

from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import from_binary

from ua_fleet.endpoint.binary.decoders import PLAIN, decode_plain
from ua_fleet.endpoint.data_values import in_asyncuas_order
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.scan import Scan, TypeStep, steps_of
from ua_fleet.endpoint.stack import DECODE_ERRORS, Refusal, StatusCodes
from ua_fleet.endpoint.turns import Turns
from ua_fleet.wire.builtin import decode_byte_string, decode_node_id, decode_string
from ua_fleet.wire.cursor import Cursor

__all__ = [
    "BYTES_BEFORE_SESSION",
    "OPERATIONS_BEFORE_SESSION",
    "Hello",
    "OpenRequest",
    "RequestHead",
    "decode_hello",
    "decode_open",
    "decode_operation",
    "decode_parameters",
    "decode_request_head",
    "operations_of",
    "share_of",
]

BYTES_BEFORE_SESSION: Final = 1024 * 1024
"""Memory that the parameters of a request may take before a session is active."""
OPERATIONS_BEFORE_SESSION: Final = 100
"""Elements of an array of such a request, e.g. LocaleIds."""
_SHARE: Final = 4
"""Part of the memory for a request that structures and texts of one operation may take: 16 MB are built in 0.1 s."""
MOST_ENTRY: Final = 200
"""Of an AuditEntryId no more is kept."""
_HELLO: Final = struct.Struct("<5I")
_TIME_HANDLE_DIAGNOSTICS: Final = struct.Struct("<qII")
_COMMON_HEAD: Final = struct.Struct("<BBHBHi32sqIIiI3s")
"""Type, token and header of a request as most are: with a session, no AuditEntryId and no AdditionalHeader."""
_EARLY_HEAD: Final = struct.Struct("<BBHBBqIIiI3s")
"""The same without a session."""
_OPEN_SECURE_CHANNEL: Final = 446
"""Id of OpenSecureChannelRequest's encoding."""


@dataclass(frozen=True, slots=True)
class Hello:
    """What is used of a Hello (OPC 10000-6 7.1.2.3)."""

    receive_buffer: int
    send_buffer: int
    max_message: int
    max_chunks: int


class RequestHead(NamedTuple):
    """Type and RequestHeader of a request (OPC 10000-4 7.33)."""

    kind: int
    """Identifier of the request's encoding in the base namespace, -1 for another one."""
    token: bytes | None
    """Opaque identifier of the AuthenticationToken; None for one that no session of this server can have."""
    handle: int
    timeout_hint_ms: int
    audit_entry: str = ""
    """AuditEntryId, with which the client finds the request in its own log; shortened."""
    diagnostics: int = 0
    """ReturnDiagnostics: which DiagnosticInfos the client asks for."""


@dataclass(frozen=True, slots=True)
class OpenRequest:
    """An OpenSecureChannel request (OPC 10000-4 5.6.2)."""

    head: RequestHead
    renewal: bool
    mode: int
    nonce: bytes
    lifetime_ms: int


def decode_hello(data: bytes) -> Hello:
    """The body of a Hello; raises RemoteWireError."""
    cursor = Cursor(data)
    _, receive_buffer, send_buffer, max_message, max_chunks = cursor.unpack(_HELLO)
    decode_string(cursor)
    return Hello(receive_buffer, send_buffer, max_message, max_chunks)


def decode_open(data: bytes) -> OpenRequest:
    """The body of an OpenSecureChannel message; raises RemoteWireError or Refusal."""
    cursor = Cursor(data)
    if (plain := _plain_early_head(data)) is not None:
        head, cursor.position = plain, _EARLY_HEAD.size
    else:
        head = _decode_head(cursor)
    if head.kind != _OPEN_SECURE_CHANNEL:
        raise Refusal(StatusCodes.BadDecodingError, f"request {head.kind} in an OpenSecureChannel message")
    cursor.uint32()  # ClientProtocolVersion
    renewal, mode = cursor.uint32(), cursor.uint32()
    nonce = decode_byte_string(cursor) or b""
    if renewal > 1:
        raise Refusal(StatusCodes.BadRequestTypeInvalid, f"request type {renewal}")
    if not 1 <= mode <= 3:
        raise Refusal(StatusCodes.BadSecurityModeRejected, f"security mode {mode}")
    return OpenRequest(head, renewal == 1, mode, nonce, cursor.uint32())


def decode_request_head(body: Buffer) -> RequestHead:
    """Type and header of a request; the buffer goes on to the parameters. Raises RemoteWireError or Refusal.

    AdditionalHeader is passed by its length and never decoded: this server knows no such header.
    """
    data = bytes(body)
    if len(data) >= _COMMON_HEAD.size:
        form, namespace, kind, token_form, _, size, token, _, handle, diagnostics, entry, hint, header = (
            _COMMON_HEAD.unpack_from(data)
        )
        if (form, namespace, token_form, size, entry, header) == (1, 0, 5, 32, -1, b"\0\0\0"):
            body.skip(_COMMON_HEAD.size)
            return RequestHead(kind, token, handle, hint, "", diagnostics)
    if (head := _plain_early_head(data)) is not None:
        body.skip(_EARLY_HEAD.size)
        return head
    cursor = Cursor(data)
    head = _decode_head(cursor)
    body.skip(cursor.position)
    return head


def _plain_early_head(data: bytes) -> RequestHead | None:
    """Type and header of a request without a session; None where they have not the form that nearly all have."""
    if len(data) < _EARLY_HEAD.size:
        return None
    form, namespace, kind, token_form, token_id, _, handle, diagnostics, entry, hint, header = _EARLY_HEAD.unpack_from(
        data
    )
    if (form, namespace, token_form, token_id, entry, header) != (1, 0, 0, 0, -1, b"\0\0\0"):
        return None
    return RequestHead(kind, None, handle, hint, "", diagnostics)


def _decode_head(cursor: Cursor) -> RequestHead:
    namespace, identifier = decode_node_id(cursor)
    _, token = decode_node_id(cursor)
    _, handle, diagnostics = cursor.unpack(_TIME_HANDLE_DIAGNOSTICS)
    audit_entry = (decode_string(cursor) or "")[:MOST_ENTRY]
    timeout_hint = cursor.uint32()
    decode_node_id(cursor)
    encoding = cursor.byte()
    if encoding > 2:
        raise Refusal(StatusCodes.BadDecodingError, f"an AdditionalHeader with encoding {encoding}")
    if encoding:
        cursor.take(cursor.length(1) or 0)
    kind = identifier if namespace == 0 and isinstance(identifier, int) else -1
    opaque = token if isinstance(token, bytes) else None
    return RequestHead(kind, opaque, handle, timeout_hint, audit_entry, diagnostics)


def share_of(memory: int) -> int:
    """Of the memory for a request, what structures and texts of one operation may take."""
    return memory // _SHARE


def operations_of(
    data: bytes, position: int, count: int, step: TypeStep, limits: EndpointLimits, *, around: int = 0
) -> Scan | None:
    """A scan that stands where so many operations of a request begin.

    None where it is refused as a whole, by those who say why: there are none, or more than limits or bytes allow.

    Args:
        data: the whole request.
        position: where they begin.
        count: how many there are, as the request says.
        step: how one is walked.
        limits: of the endpoint.
        around: bytes of memory that the other parameters take.
    """
    memory = limits.request_memory_bytes
    if not 0 < count <= limits.nodes_per_request or count * step.least > len(data) - position:
        return None
    return Scan(data, position, len(data), memory) if count * step.memory + around <= memory else None


async def decode_parameters(
    structure: Any, body: Buffer, *, most_operations: int, most_memory: int, turns: Turns | None = None
) -> Any:
    """The parameters of a request as asyncua's dataclass.

    Args:
        structure: the class of the parameters.
        body: what follows the RequestHeader.
        most_operations: elements that an array of the parameters may have, i.e. operations.
        most_memory: bytes of memory that the decoded parameters may take.
        turns: of the request; without them it is decoded at once.

    Raises:
        Refusal: no valid encoding, too many operations, or more than the limits allow.
    """
    data = bytes(body)
    scan = Scan(data, 0, len(data), most_memory)
    share = share_of(most_memory) if turns is not None else most_memory
    rest = Buffer(data)
    values: dict[str, Any] = {}
    for part in steps_of(structure):
        scan.share = share
        if not part.is_array:
            scan.charge_built(part.step.memory)
            values[part.name] = decode_operation(part.kind, part.step.walk, scan, rest)
            continue
        step = part.element
        assert step is not None
        count = scan.count(step.least)
        if count > most_operations:
            raise Refusal(StatusCodes.BadTooManyOperations, f"{count} operations, the limit is {most_operations}")
        rest.skip(4)
        elements: list[Any] = []
        for _ in range(count):
            scan.share = share
            scan.charge_built(step.memory)
            elements.append(decode_operation(part.kind, step.walk, scan, rest))
            if turns is not None and turns.over:
                await turns.end()
        # A null array is an empty one here, so that no service has to tell them apart.
        values[part.name] = elements
    try:
        return structure(**values)
    except DECODE_ERRORS as error:
        raise Refusal(StatusCodes.BadDecodingError, f"{structure.__name__}: {type(error).__name__}") from error


def decode_operation(kind: Any, walk: Any, scan: Scan, rest: Buffer) -> Any:
    """One value of a request: at once where it is plain; else walked, then built by asyncua.

    The buffer stands where the scan does.

    Raises:
        Refusal: no valid encoding, or more than the scan's budget.
    """
    start = rest.cur_pos
    if kind in PLAIN and (plain := decode_plain(kind, scan.data, start)) is not None:
        value, scan.position, memory = plain
        scan.charge_built(memory)
        rest.skip(scan.position - start)
        return value
    walk(scan)
    if scan.misplaced:
        # Of this operation alone: a request may have ten thousand.
        given = scan.data[start : scan.position]
        source = Buffer(in_asyncuas_order(given, [at - start for at in scan.misplaced]))
        scan.misplaced.clear()
        value = _built(kind, source)
        rest.skip(source.cur_pos)
    else:
        value = _built(kind, rest)
    if rest.cur_pos != scan.position:
        # The scan vouches only for what it has read in the same way.
        raise Refusal(StatusCodes.BadDecodingError, f"{kind.__name__}: ambiguous encoding")
    return value


def _built(kind: Any, source: Buffer) -> Any:
    """What asyncua makes of bytes that have been scanned."""
    try:
        # An enumeration is checked by its service, which has a StatusCode for a number that is none of it.
        is_enumeration = isinstance(kind, type) and issubclass(kind, IntEnum)
        return _enumerated(kind, from_binary("Int32", source)) if is_enumeration else from_binary(kind, source)
    except DECODE_ERRORS as error:
        raise Refusal(StatusCodes.BadDecodingError, f"{kind.__name__}: {type(error).__name__}") from error


def _enumerated(kind: type[IntEnum], number: int) -> int:
    with contextlib.suppress(ValueError):
        return kind(number)
    return number
