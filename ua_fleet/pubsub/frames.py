"""What the fields of a frame must be: of the types that the metadata says, deltas applied to their key frame."""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FieldMetaData, FrameKind

__all__ = ["merge_delta", "types_fit"]

_IN_PLACE: Final = frozenset((BuiltinType.NULL, BuiltinType.STATUS_CODE, BuiltinType.DATA_VALUE))
"""What may stand in place of a value: nothing, the reason why there is none, or a value with its own status."""
_FIELD_COLUMNS: Final = (
    ("field_status", 0),
    ("field_source_timestamps", None),
    ("field_server_timestamps", None),
    ("field_source_picoseconds", None),
    ("field_server_picoseconds", None),
)


def types_fit(types: tuple[int, ...], fields: tuple[FieldMetaData, ...]) -> bool:
    """Whether fields with these type codes may stand for `fields`. The slow way, where they are not the same."""
    return len(types) == len(fields) and all(map(_fits, types, fields))


def _fits(code: int, field: FieldMetaData) -> bool:
    if code in _IN_PLACE:
        return True
    builtin = code & ~(ARRAY | DIMENSIONS)
    if field.builtin_type not in (builtin, BuiltinType.VARIANT):
        return False
    rank = field.value_rank
    if not code & ARRAY:
        return rank < 0  # scalar, scalar or one dimension, any
    if code & DIMENSIONS:
        return rank > 1 or rank in (0, -2)  # as many dimensions as said, one or more, any
    return rank in (1, 0, -2, -3)


def merge_delta(base: DataSetMessage, delta: DataSetMessage) -> DataSetMessage | None:
    """The key frame that a delta frame makes of the frame before it; None if it names a field that is not there."""
    indices = delta.indices or ()
    if any(index >= len(base.values) for index in indices):
        return None
    types, values = list(base.types), list(base.values)
    for position, index in enumerate(indices):
        types[index] = delta.types[position]
        values[index] = delta.values[position]
    columns: dict[str, Any] = {}
    for name, default in _FIELD_COLUMNS:
        old, new = getattr(base, name), getattr(delta, name)
        if old is None and new is None:
            continue
        column = [default] * len(values) if old is None else list(old)
        for position, index in enumerate(indices):
            column[index] = default if new is None else new[position]
        columns[name] = tuple(column)
    return delta._replace(
        kind=FrameKind.KEY.value,
        types=tuple(types),
        values=tuple(values),
        indices=None,
        encoding=(FieldEncoding.DATA_VALUE if columns else FieldEncoding.VARIANT).value,
        **columns,
    )
