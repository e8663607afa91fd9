# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Values of structured DataTypes, by the definition that the server gives of them (OPC 10000-3 8.48).

Fields go by their names, so that a client and a server of different versions agree on those that both know. asyncua
has one class for each name and for all servers, so nothing is registered there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

from asyncua import ua

from ua_fleet.client.batches import Batches
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import BuiltinType, datetime_from_ticks
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.structure import array_decoder
from ua_fleet.wire.variant import DECODERS, SMALLEST

__all__ = ["StructureLayout", "Structures", "layout_of", "read_layout"]

_SIMPLE: Final = {
    ua.ObjectIds.Counter: BuiltinType.UINT32,
    ua.ObjectIds.IntegerId: BuiltinType.UINT32,
    ua.ObjectIds.Duration: BuiltinType.DOUBLE,
    ua.ObjectIds.NumericRange: BuiltinType.STRING,
    ua.ObjectIds.UtcTime: BuiltinType.DATETIME,
    ua.ObjectIds.LocaleId: BuiltinType.STRING,
}
"""DataTypes of the standard that are another name for a built-in type."""
_MOST_TYPES: Final = 1_000
"""Encodings that are remembered."""
_NULL_TIME: Final = datetime(1601, 1, 1, tzinfo=UTC)


class _Field(NamedTuple):
    name: str
    decode: Callable[[Cursor], Any]
    kind: BuiltinType | None
    """Of a scalar; None of an array."""


class StructureLayout:
    """How the values of one DataType are read."""

    def __init__(self, encoding: ua.NodeId, fields: Sequence[_Field]) -> None:
        self.encoding, self._fields = encoding, tuple(fields)

    def read(self, value: Any) -> dict[str, Any] | None:
        """The fields of a value by their names, times in UTC (None where there is none) and StatusCodes as numbers.

        None of what is no value of the type. Raises RemoteWireError where its bytes are not as the server describes
        them.
        """
        if isinstance(value, ua.ExtensionObject):
            if value.TypeId != self.encoding or value.Body is None:
                return None
            cursor = Cursor(value.Body)
            told = {field.name: field.decode(cursor) for field in self._fields}
            for field in self._fields:
                if field.kind is BuiltinType.DATETIME:
                    told[field.name] = datetime_from_ticks(told[field.name]) if told[field.name] else None
            return told
        # asyncua knows the type, e.g. in the process of the server.
        if value is None or any(not hasattr(value, field.name) for field in self._fields):
            return None
        return {field.name: _plain(getattr(value, field.name)) for field in self._fields}

    def shown(self, value: ua.ExtensionObject) -> Any:
        """A value of the type as its fields, with StatusCodes as asyncua has them; as it is where it cannot be read."""
        try:
            told = self.read(value)
        except RemoteWireError:
            return value
        if told is None:
            return value
        for field in self._fields:
            if field.kind is BuiltinType.STATUS_CODE:
                told[field.name] = ua.StatusCode(ua.UInt32(told[field.name]))
        return told


class Structures:
    """Structures of one server, whose layouts are asked for when a value of them is met. Raises asyncua's errors."""

    def __init__(self, batches: Batches) -> None:
        self._batches = batches
        self._layouts: dict[ua.NodeId, StructureLayout | None] = {}
        """By their encodings; None of those that nobody can read."""

    def is_new(self, value: Any) -> bool:
        """Whether a value is, or begins with, a structure that was not met before."""
        first = value[0] if isinstance(value, list) and value else value
        return isinstance(first, ua.ExtensionObject) and first.TypeId not in self._layouts

    async def shown(self, node_id: ua.NodeId, value: Any) -> Any:
        """The value of a Variable, with its structures as mappings of their fields."""
        if self.is_new(value):
            (told,) = await self._batches.read([node_id], ua.AttributeIds.DataType)
            layout = None if told.Value is None else await read_layout(self._batches, told.Value.Value)
            if len(self._layouts) >= _MOST_TYPES:
                self._layouts.clear()
            # Others may have met it meanwhile, and asked too.
            self._layouts.setdefault((value[0] if isinstance(value, list) else value).TypeId, None)
            if layout is not None:
                self._layouts[layout.encoding] = layout
        if isinstance(value, list):
            return [self._one(each) for each in value]
        return self._one(value)

    def _one(self, value: Any) -> Any:
        layout = self._layouts.get(value.TypeId) if isinstance(value, ua.ExtensionObject) else None
        return value if layout is None else layout.shown(value)


def _plain(value: Any) -> Any:
    if isinstance(value, datetime):
        moment = value if value.tzinfo is not None else value.replace(tzinfo=UTC)
        return None if moment == _NULL_TIME else moment
    return int(value.value) if isinstance(value, ua.StatusCode) else value


async def read_layout(batches: Batches, data_type: ua.NodeId) -> StructureLayout | None:
    """The layout of a structure that a server describes; None of what is none."""
    (told,) = await batches.read([data_type], ua.AttributeIds.DataTypeDefinition)
    definition = told.Value.Value if told.Value is not None else None
    if not isinstance(definition, ua.StructureDefinition) or definition.StructureType != ua.StructureType.Structure:
        return None
    types = [field.DataType for field in definition.Fields]
    others = list({one for one in types if _builtin(one) is None})
    kinds = await batches.read(others, ua.AttributeIds.DataTypeDefinition)
    enumerations = {
        one
        for one, kind in zip(others, kinds, strict=True)
        if kind.Value is not None and isinstance(kind.Value.Value, ua.EnumDefinition)
    }
    return layout_of(definition, enumerations)


def layout_of(definition: ua.StructureDefinition, enumerations: Collection[ua.NodeId]) -> StructureLayout:
    """The layout of a structure, up to the first field of a type that is neither built in nor an enumeration."""
    fields: list[_Field] = []
    for field in definition.Fields:
        kind = BuiltinType.INT32 if field.DataType in enumerations else _builtin(field.DataType)
        if kind is None or field.ValueRank not in (-1, 1):
            break
        decode = DECODERS[kind]
        if field.ValueRank == 1:
            decode = array_decoder(SMALLEST[kind], decode)
        fields.append(_Field(str(field.Name), decode, None if field.ValueRank == 1 else kind))
    return StructureLayout(definition.DefaultEncodingId, fields)


def _builtin(data_type: ua.NodeId) -> BuiltinType | None:
    number = data_type.Identifier
    if data_type.NamespaceIndex != 0 or not isinstance(number, int):
        return None
    if number in _SIMPLE:
        return _SIMPLE[number]
    return BuiltinType(number) if 1 <= number <= BuiltinType.LOCALIZED_TEXT else None
