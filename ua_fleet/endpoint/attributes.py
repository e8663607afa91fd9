"""Read, by what AccessLevel and the user's role allow (OPC 10000-4 5.11.2)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.answers import ArrayResponse, rough_bytes
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.data_types import DataTypes
from ua_fleet.endpoint.indexrange import apply_range, parse_range
from ua_fleet.endpoint.live import check_reader, reader_refused
from ua_fleet.endpoint.monitoring import with_timestamps
from ua_fleet.endpoint.request import ServiceRequest, operations
from ua_fleet.endpoint.stack import AttributeIds, Refusal, StatusCodes, shown, status
from ua_fleet.endpoint.users import Role, User

__all__ = ["AttributeServices", "access_level", "readable_value"]


READ: Final = 1 << ua.AccessLevel.CurrentRead.value
WRITE: Final = 1 << ua.AccessLevel.CurrentWrite.value
WRITE_ANYTHING: Final = WRITE | 1 << ua.AccessLevel.StatusWrite.value | 1 << ua.AccessLevel.TimestampWrite.value
HISTORY: Final = 1 << ua.AccessLevel.HistoryRead.value


def access_level(aspace: AddressSpace, node_id: ua.NodeId) -> int:
    """What AccessLevel and UserAccessLevel of a variable allow together."""
    allowed = 0xFF
    for attribute in (AttributeIds.AccessLevel, AttributeIds.UserAccessLevel):
        variant = aspace.read_attribute_value(node_id, attribute).Value
        allowed &= int(variant.Value) if variant is not None and variant.Value is not None else 0
    return allowed


def readable_value(aspace: AddressSpace, node_id: ua.NodeId, attribute: Any) -> ua.DataValue:
    """An attribute's value; raises Refusal where clients may not read it."""
    value = aspace.read_attribute_value(node_id, attribute)
    if attribute == AttributeIds.Value and not access_level(aspace, node_id) & READ:
        code = value.StatusCode
        unknown = code is not None and int(code.value) in (
            StatusCodes.BadNodeIdUnknown,
            StatusCodes.BadAttributeIdInvalid,
        )
        raise Refusal(int(code.value) if unknown and code is not None else StatusCodes.BadNotReadable)
    return value


class AttributeServices:
    """OPC 10000-4 5.11.2; Write is in `writes`, HistoryRead in `history`."""

    def __init__(self, context: EndpointContext) -> None:
        self._context, self._limits = context, context.limits
        self._aspace = context.iserver.aspace
        self._types = DataTypes(self._aspace)

    async def read(self, request: ServiceRequest, params: ua.ReadParameters) -> Any:
        """Read."""
        nodes = operations(params.NodesToRead, self._limits.nodes_per_request)
        if params.MaxAge < 0:
            raise Refusal(StatusCodes.BadMaxAgeInvalid)
        wanted = params.TimestampsToReturn
        if not isinstance(wanted, ua.TimestampsToReturn) or wanted == ua.TimestampsToReturn.Invalid:
            raise Refusal(StatusCodes.BadTimestampsToReturnInvalid)
        answer = ArrayResponse(ua.ReadResponse, self._limits.response_bytes)
        for node in nodes:
            self.read_one(request, node, wanted, answer)
            await request.turns.end(answer.size)
        return answer

    def read_one(self, request: ServiceRequest, wanted: ua.ReadValueId, times: Any, answer: ArrayResponse) -> None:
        """Do one operation of a Read, and add its result.

        What depends on the user, on the NodeId or on the time is in `_readable`; `binary.read` asks it for everything
        that may. A rule that is added there is held against what that knows without asking.
        """
        value = with_timestamps(self._read(wanted, request.user, encrypted=request.encrypted), times)
        name = partial(_named, wanted)
        answer.add(value, _no_value, self._context.misfit, name, least=rough_bytes(value))

    def is_readable(self, node_id: ua.NodeId) -> bool:
        """Whether AccessLevel and UserAccessLevel let a node's value be read."""
        return bool(access_level(self._aspace, node_id) & READ)

    def _read(self, wanted: ua.ReadValueId, user: User, *, encrypted: bool) -> ua.DataValue:
        try:
            return self._readable(wanted, user, encrypted=encrypted)
        except Refusal as error:
            return _no_value(error.ua_status)
        except Exception as error:  # noqa: BLE001 - a mistake about one node must not cost the client the others
            self._context.mistakes.caught("reads", error, node=shown(wanted.NodeId))
            return _no_value(StatusCodes.BadInternalError)

    def _readable(self, wanted: ua.ReadValueId, user: User, *, encrypted: bool) -> ua.DataValue:
        attribute = wanted.AttributeId
        check_reader(self._aspace, wanted.NodeId, attribute, user, encrypted=encrypted)
        value = readable_value(self._aspace, wanted.NodeId, attribute)
        if wanted.IndexRange:
            if attribute != AttributeIds.Value:
                raise Refusal(StatusCodes.BadIndexRangeInvalid)
            index_range = parse_range(wanted.IndexRange)
            assert index_range is not None
            value = apply_range(value, index_range)
        encoding = wanted.DataEncoding
        if encoding is not None and encoding.Name:
            self._check_encoding(encoding, wanted)
        if attribute == AttributeIds.UserExecutable and not self._callable(user, wanted.NodeId):
            return _but(value, lambda _: False)
        if attribute == AttributeIds.UserAccessLevel and not user.role.covers(Role.OPERATOR):
            value = _but(value, lambda level: level & ~WRITE_ANYTHING)
        if attribute == AttributeIds.UserAccessLevel and reader_refused(
            self._aspace, wanted.NodeId, user, encrypted=encrypted
        ):
            value = _but(value, lambda level: level & ~(READ | HISTORY))
        return value

    def _callable(self, user: User, method_id: ua.NodeId) -> bool:
        """Whether a user may call a method, and there is one: those of the standard's types are declarations alone."""
        node = self._aspace.get(method_id)
        return node is not None and node.call is not None and self._context.may_call(user, method_id)

    def _check_encoding(self, encoding: ua.QualifiedName, wanted: ua.ReadValueId) -> None:
        """Only a value that is a Structure can have an encoding (OPC 10000-4 7.39.2)."""
        variant = self._aspace.read_attribute_value(wanted.NodeId, AttributeIds.DataType).Value
        is_structure = variant is not None and self._types.is_structure(variant.Value)
        if wanted.AttributeId != AttributeIds.Value or not is_structure:
            raise Refusal(StatusCodes.BadDataEncodingInvalid)
        if encoding.Name != "Default Binary" or encoding.NamespaceIndex:
            raise Refusal(StatusCodes.BadDataEncodingUnsupported)


def _no_value(code: int) -> ua.DataValue:
    return ua.DataValue(StatusCode=status(code))


def _named(wanted: ua.ReadValueId) -> str:
    return f"{shown(wanted.NodeId)} attribute {wanted.AttributeId}"


def _but(value: ua.DataValue, change: Callable[[Any], Any]) -> ua.DataValue:
    """What an attribute that says what a user may do says to this one."""
    variant = value.Value
    if variant is None or variant.Value is None:
        return value
    return dataclasses.replace(value, Value=ua.Variant(change(variant.Value), variant.VariantType))
