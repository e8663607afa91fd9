# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""What belongs to the values of Variables: their types, units, ranges, and the names of enumerations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from asyncua import ua

from ua_fleet.client.batches import Batches

__all__ = ["ValueDetails", "type_names", "value_details"]

_HAS_PROPERTY: Final = int(ua.ObjectIds.HasProperty)
_UNITS: Final = "EngineeringUnits"
_RANGE: Final = "EURange"
_BUILTIN: Final = 25
"""DataTypes of namespace 0 up to here are built-in types; asyncua names them."""
_NUMBER: Final = 24
"""BaseDataType: a Variable that has any type."""


@dataclass(frozen=True, slots=True)
class ValueDetails:
    """How the values of a Variable are to be read."""

    unit: str = ""
    names: Mapping[int, str] = field(default_factory=dict[int, str])
    """Of the values of an enumeration."""
    low: float | None = None
    high: float | None = None
    """The range that its values are in, where it has one."""


async def type_names(batches: Batches, node_ids: Sequence[ua.NodeId]) -> list[str | None]:
    """The DataTypes of Variables by their names, arrays with `[]`; None of what is none."""
    types = await _data_types(batches, node_ids)
    ranks = await batches.read(node_ids, ua.AttributeIds.ValueRank)
    others = list({one for one in types if one is not None and not _is_builtin(one)})
    told = await batches.read(others, ua.AttributeIds.BrowseName)
    known = {one: _value(data).Name for one, data in zip(others, told, strict=True) if _value(data) is not None}
    found: list[str | None] = []
    for one, rank in zip(types, ranks, strict=True):
        if one is None:
            found.append(None)
            continue
        name = ua.VariantType(int(str(one.Identifier))).name if _is_builtin(one) else known.get(one, one.to_string())
        dimensions = _value(rank)
        found.append(f"{name}[]" if isinstance(dimensions, int) and dimensions >= 0 else name)
    return found


async def value_details(batches: Batches, node_ids: Sequence[ua.NodeId]) -> list[ValueDetails]:
    """Units, ranges, and names of enumerations, of Variables in their order."""
    types = await _data_types(batches, node_ids)
    others = list({one for one in types if one is not None and not _is_builtin(one)})
    names = dict(zip(others, await _enumerations(batches, others), strict=True))
    properties = await _units_and_ranges(batches, node_ids)
    return [
        ValueDetails(unit, names.get(one, {}) if one is not None else {}, low, high)
        for (unit, low, high), one in zip(properties, types, strict=True)
    ]


async def _units_and_ranges(
    batches: Batches, node_ids: Sequence[ua.NodeId]
) -> list[tuple[str, float | None, float | None]]:
    answers = await batches.browse(node_ids, references=_HAS_PROPERTY)
    named = [{str(child.BrowseName.Name): child.NodeId for child in children} for children in answers]
    wanted = [one[name] for one in named for name in (_UNITS, _RANGE) if name in one]
    told = dict(zip(wanted, await batches.read(wanted), strict=True))
    found: list[tuple[str, float | None, float | None]] = []
    for one in named:
        unit = _value(told[one[_UNITS]]) if _UNITS in one else None
        range_ = _value(told[one[_RANGE]]) if _RANGE in one else None
        text = getattr(getattr(unit, "DisplayName", None), "Text", None)
        found.append((str(text or ""), getattr(range_, "Low", None), getattr(range_, "High", None)))
    return found


async def _enumerations(batches: Batches, types: Sequence[ua.NodeId]) -> list[dict[int, str]]:
    strings = await _properties(batches, types, "EnumStrings")
    values = await _properties(batches, types, "EnumValues")
    wanted = [one or other for one, other in zip(strings, values, strict=True)]
    told = iter(await batches.read([one for one in wanted if one is not None]))
    return [_names(_value(next(told))) if one is not None else {} for one in wanted]


def _names(told: Any) -> dict[int, str]:
    names: dict[int, str] = {}
    entries: list[Any] = told if isinstance(told, list) else []
    for number, one in enumerate(entries):
        if isinstance(one, ua.LocalizedText):
            names[number] = str(one.Text or "")
        elif isinstance(one, ua.EnumValueType):
            names[int(one.Value)] = str(one.DisplayName.Text or "")
    return names


async def _properties(batches: Batches, node_ids: Sequence[ua.NodeId], name: str) -> list[ua.NodeId | None]:
    answers = await batches.browse(node_ids, references=_HAS_PROPERTY)
    return [next((child.NodeId for child in children if child.BrowseName.Name == name), None) for children in answers]


async def _data_types(batches: Batches, node_ids: Sequence[ua.NodeId]) -> list[ua.NodeId | None]:
    told = [_value(data) for data in await batches.read(node_ids, ua.AttributeIds.DataType)]
    return [one if isinstance(one, ua.NodeId) else None for one in told]


def _is_builtin(data_type: ua.NodeId) -> bool:
    number = data_type.Identifier
    return data_type.NamespaceIndex == 0 and isinstance(number, int) and 0 < number <= _BUILTIN and number != _NUMBER


def _value(data: ua.DataValue) -> Any:
    return None if data.Value is None else data.Value.Value
