"""Write, by what AccessLevel, the user's role and the gate allow (OPC 10000-4 5.11.4)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import dataclasses
import struct
from datetime import UTC, datetime
from typing import Any, Final, Self

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.attributes import WRITE, access_level
from ua_fleet.endpoint.audit import summary
from ua_fleet.endpoint.audit_events import AuditEvents
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.data_values import MOST_PICOSECONDS
from ua_fleet.endpoint.indexrange import parse_range, replace_range
from ua_fleet.endpoint.request import ServiceRequest, operations
from ua_fleet.endpoint.stack import GOOD, AttributeIds, Refusal, StatusCodes, name_of, shown, status_of
from ua_fleet.endpoint.users import Role

__all__ = ["WriteServices", "Writes"]

_CODE: Final = struct.Struct("<I")
_GOOD: Final = bytes(4)


class WriteServices:
    """Writes for all sessions of one server."""

    def __init__(self, context: EndpointContext, events: AuditEvents) -> None:
        self._context, self._events = context, events

    async def write(self, request: ServiceRequest, params: ua.WriteParameters) -> Any:
        """Write."""
        nodes = operations(params.NodesToWrite, self._context.limits.nodes_per_request)
        with self.begin(request) as writes:
            for node in nodes:
                await writes.one(node)
                if request.turns.over:
                    await writes.end_turn()
        return writes.answer

    def begin(self, request: ServiceRequest) -> Writes:
        """The writes of a request, in which each operation is done."""
        return Writes(self._context, self._events, request)

    def is_writable(self, node_id: ua.NodeId) -> bool:
        """Whether AccessLevel and UserAccessLevel let a node's value be written."""
        return bool(access_level(self._context.iserver.aspace, node_id) & WRITE)


class Writes:
    """The writes of one request, and what is told of them; as a context it is over also where the client goes away."""

    __slots__ = ("_aspace", "_context", "_events", "_gate", "_lines", "_may_write", "_request", "answer", "told")

    def __init__(self, context: EndpointContext, events: AuditEvents, request: ServiceRequest) -> None:
        self._context, self._events, self._request = context, events, request
        self._aspace, self._gate = context.iserver.aspace, context.gate
        self._may_write = request.user.role.covers(Role.OPERATOR)
        self._lines: list[dict[str, Any]] = []
        self.answer = ArrayResponse(ua.WriteResponse, context.limits.response_bytes)
        self.told = events.wanted
        """Whether engineers are told of each write, with the value before it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """All operations are done, or no more of them will be."""
        if self._gate is not None:
            self._gate.request_done()
        self._record()

    async def end_turn(self) -> None:
        """Let others have their turn; raises Refusal where the request is not to go on."""
        self._record()  # the lines of ten thousand writes in one piece would be one long turn
        await self._request.turns.end()
        self.told = self._events.wanted

    def _record(self) -> None:
        self._context.statistics.writes += len(self._lines)
        self._context.audit.record_all("write", self._request.caller, self._lines)
        self._lines = []

    async def one(self, wanted: ua.WriteValue) -> None:
        """Do an operation by all rules."""
        told = self.told
        before = self._aspace.read_attribute_value(wanted.NodeId, AttributeIds.Value).Value if told else None
        code = await self._write(wanted)
        if told:
            self._events.written(self._request.who, wanted, before if code == 0 else None, code)
        attribute = wanted.AttributeId
        more = {} if attribute == AttributeIds.Value else {"attribute": str(attribute)}
        self._done(shown(wanted.NodeId), wanted.Value, code, **more)

    def value(self, node_id: ua.NodeId, node_text: str, held: Any, given: ua.DataValue) -> None:
        """Do an operation on the value of a node that may be written, and that nobody watches.

        Args:
            node_id: of the node.
            node_text: the same for the log.
            held: holds a value of the same type, and nothing has to be called when it gets another one.
            given: the whole value, fresh.
        """
        try:
            self._check_given(given)
            code = self._refused_by_gate(node_id, given)
            if not code:
                _complete(given)
                held.value = given
                if self._gate is not None:
                    self._gate.written(node_id, given, self._request.user)
        except Exception as error:  # noqa: BLE001 - what is no refusal is logged with its traceback
            code = self._mistake(node_id, error)
        self._done(node_text, given, code)

    def _done(self, node_text: str, given: ua.DataValue | None, code: int, **more: str) -> None:
        """Add the result of an operation, and its line for the log."""
        variant = given.Value if given is not None else None
        line = {"node": node_text, "value": summary(variant.Value if variant is not None else None), **more}
        line["status"] = name_of(code) if code else "Good"
        self._lines.append(line)
        self.answer.add_small(_CODE.pack(code) if code else _GOOD)

    async def _write(self, wanted: ua.WriteValue) -> int:
        """StatusCode of one write."""
        node_id = wanted.NodeId
        try:
            self._check_node(wanted)
            self._check_given(wanted.Value)
            value = self._whole(wanted)
            if code := self._refused_by_gate(node_id, value):
                return code
            _complete(value)
            result = await self._aspace.write_attribute_value(node_id, AttributeIds.Value, value)
            if result.is_good() and self._gate is not None:
                self._gate.written(node_id, value, self._request.user)
            return int(result.value)
        except Exception as error:  # noqa: BLE001 - what is no refusal is logged with its traceback
            return self._mistake(node_id, error)

    def _mistake(self, node_id: ua.NodeId, error: Exception) -> int:
        if (known := status_of(error)) is not None:
            return known
        # Whatever goes wrong behind the gate, the client's connection and its other writes go on.
        self._context.mistakes.caught("writes", error, node=shown(node_id))
        return int(StatusCodes.BadInternalError)

    def _check_node(self, wanted: ua.WriteValue) -> None:
        """Refuse what a node does not let anybody write."""
        node = self._aspace.get(wanted.NodeId)
        if node is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if wanted.AttributeId not in node.attributes:
            raise Refusal(StatusCodes.BadAttributeIdInvalid)
        if wanted.AttributeId != AttributeIds.Value or not access_level(self._aspace, wanted.NodeId) & WRITE:
            raise Refusal(StatusCodes.BadNotWritable)

    def _check_given(self, given: ua.DataValue | None) -> None:
        """Refuse what this user may not write, and what is no value."""
        if not self._may_write:
            raise Refusal(StatusCodes.BadUserAccessDenied)
        if given is None or given.Value is None or given.Value.Value is None:
            raise Refusal(StatusCodes.BadTypeMismatch)
        if given.StatusCode is not None and not given.StatusCode.is_good():
            raise Refusal(StatusCodes.BadWriteNotSupported)

    def _refused_by_gate(self, node_id: ua.NodeId, value: ua.DataValue) -> int:
        """StatusCode with which the model behind the nodes refuses a value; 0 where it takes it."""
        return 0 if self._gate is None else int(self._gate.check_write(node_id, value, self._request.user))

    def _whole(self, wanted: ua.WriteValue) -> ua.DataValue:
        """What the node shall have after a write: the value given, or its own with a part of it replaced."""
        given: ua.DataValue = wanted.Value
        index_range = parse_range(wanted.IndexRange)
        before = self._aspace.read_attribute_value(wanted.NodeId, AttributeIds.Value).Value
        variant = _as_bytes(given.Value, before)
        if index_range is not None:
            variant = replace_range(before, index_range, variant)
        return given if variant is given.Value else dataclasses.replace(given, Value=variant)


def _as_bytes(given: Any, before: ua.Variant | None) -> Any:
    """A ByteString for an array of Byte is such an array (OPC 10000-4 5.11.4.2)."""
    is_bytes = given.VariantType == ua.VariantType.ByteString and isinstance(given.Value, bytes)
    if is_bytes and before is not None and before.VariantType == ua.VariantType.Byte and isinstance(before.Value, list):
        return ua.Variant(list(given.Value), ua.VariantType.Byte, is_array=True)
    return given


def _complete(value: Any) -> None:
    """Give a value that a request has brought, and nobody else has yet, what it leaves out: it is written now."""
    now = datetime.now(UTC)
    value.StatusCode = value.StatusCode or GOOD
    value.SourcePicoseconds = _finer(value.SourceTimestamp, value.SourcePicoseconds)
    value.ServerPicoseconds = _finer(value.ServerTimestamp, value.ServerPicoseconds)
    value.SourceTimestamp = value.SourceTimestamp or now
    value.ServerTimestamp = value.ServerTimestamp or now


def _finer(time: Any, picoseconds: Any) -> Any:
    """The picoseconds of a time that a client gives; without a time they say nothing."""
    return None if time is None or picoseconds is None else min(picoseconds, MOST_PICOSECONDS)
