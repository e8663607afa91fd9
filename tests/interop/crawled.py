"""Whether what a client has read of Variables contradicts what their attributes say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

__all__ = ["CrawledVariable", "contradictions"]

_ANY: Final = "i=24"
_ABSTRACT: Final = {
    "i=24": set(range(26)),
    "i=26": set(range(2, 12)),
    "i=27": {2, 4, 6, 8},
    "i=28": {3, 5, 7, 9},
    "i=29": {6},
}
_BUILTIN: Final = _ABSTRACT | {f"i={number}": {number} for number in range(1, 26) if number != 24}


@dataclass(frozen=True, slots=True)
class CrawledVariable:
    """A Variable or VariableType whose Value was Good."""

    node_id: str
    data_type: str
    value_rank: int
    builtin_type: int
    """Of the value, by its number in OPC 10000-6."""
    dimensions: int
    """Of the value; 0 for a scalar."""
    is_null: bool


def contradictions(variables: Iterable[CrawledVariable], supertypes: Mapping[str, str]) -> list[str]:
    """What contradicts itself, a line for each: a value that is missing, or is not what DataType and ValueRank say."""
    found: list[str] = []
    for variable in variables:
        fitting = _builtin_types(variable.data_type, supertypes)
        if variable.is_null:
            if variable.data_type != _ANY and not (variable.dimensions and variable.builtin_type in fitting):
                found.append(f"{variable}: Null and Good")
        elif variable.builtin_type not in fitting:
            found.append(f"{variable}: a value of another type")
        elif not _is_shape(variable.value_rank, variable.dimensions):
            found.append(f"{variable}: a value of another rank")
    return found


def _builtin_types(data_type: str, supertypes: Mapping[str, str]) -> set[int]:
    current: str | None = data_type
    while current is not None and current not in _BUILTIN:
        current = supertypes.get(current)
    return _BUILTIN.get(current or "", set())


def _is_shape(value_rank: int, dimensions: int) -> bool:
    """ValueRank (OPC 10000-3 5.6.2): -3 scalar or one dimension, -2 any, -1 scalar, 0 one or more, n as many."""
    if value_rank == -3:
        return dimensions <= 1
    if value_rank == -2:
        return True
    return dimensions >= 1 if value_rank == 0 else dimensions == max(value_rank, 0)
