"""NumericRange (OPC 10000-4 7.27): a part of an array, a String or a ByteString, as clients read and write it."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import dataclasses
import re
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.stack import Refusal, StatusCodes, status

__all__ = ["IndexRange", "apply_range", "is_small", "parse_range", "replace_range"]

IndexRange = tuple[slice, ...]
MAX_DIMENSIONS: Final = 8
_PART = re.compile(r"(\d{1,9})(?::(\d{1,9}))?", re.ASCII)


def parse_range(text: str | None) -> IndexRange | None:
    """The slices of a range, or None without one; raises Refusal for what is no range."""
    if not text:
        return None
    parts = text.split(",") if len(text) <= 200 else []
    slices: list[slice] = []
    for part in parts:
        match = _PART.fullmatch(part)
        if match is None:
            break
        first = int(match[1])
        last = first if match[2] is None else int(match[2])
        if match[2] is not None and last <= first:
            break
        slices.append(slice(first, last + 1))
    if not slices or len(slices) != len(parts) or len(slices) > MAX_DIMENSIONS:
        raise Refusal(StatusCodes.BadIndexRangeInvalid, f"index range {text[:40]!r}")
    return tuple(slices)


def is_small(wanted: IndexRange, most: int) -> bool:
    """Whether a part has one dimension and at most so many elements."""
    return len(wanted) == 1 and wanted[0].stop - wanted[0].start <= most


def apply_range(value: ua.DataValue, wanted: IndexRange) -> ua.DataValue:
    """A new DataValue with the part alone, or with Bad_IndexRangeNoData; the one given is not changed."""
    variant = value.Value
    if variant is None or variant.Value is None:
        return value
    content = _nested(variant)
    part = _cut(content, wanted) if isinstance(content, list | tuple | str | bytes) else None
    if part is None or len(part) == 0:
        return dataclasses.replace(value, Value=None, StatusCode=status(StatusCodes.BadIndexRangeNoData))
    # The dimensions of a part are those of its nested lists.
    cut = ua.Variant(part, variant.VariantType, is_array=variant.is_array)
    return dataclasses.replace(value, Value=cut)


def replace_range(variant: ua.Variant | None, wanted: IndexRange, given: ua.Variant) -> ua.Variant:
    """A new Variant in which a part is the one that a client writes; raises Refusal where it does not fit."""
    if variant is None or variant.Value is None:
        raise Refusal(StatusCodes.BadIndexRangeNoData, "no value that has parts")
    content, part = _nested(variant), _nested(given)
    if not isinstance(content, list | tuple | str | bytes):
        raise Refusal(StatusCodes.BadIndexRangeNoData, "a value without parts")
    is_array = isinstance(content, list | tuple)
    if given.VariantType != variant.VariantType or is_array != isinstance(part, list | tuple):
        raise Refusal(StatusCodes.BadTypeMismatch, "a part of another type than the value")
    return ua.Variant(_replaced(content, wanted, part), variant.VariantType, is_array=is_array)


def _nested(variant: ua.Variant) -> Any:
    """The value of a Variant, a matrix as the lists of its rows."""
    content: Any = variant.Value
    dimensions = variant.Dimensions or []
    if len(dimensions) < 2 or not isinstance(content, list | tuple) or (content and isinstance(content[0], list)):
        return content
    for length in reversed(dimensions[1:]):
        content = [content[at : at + length] for at in range(0, len(content), max(length, 1))]
    return content


def _replaced(content: Any, wanted: IndexRange, part: Any) -> Any:
    place, inner = wanted[0], wanted[1:]
    if not isinstance(content, list | tuple | str | bytes) or place.stop > len(content):
        raise Refusal(StatusCodes.BadIndexRangeNoData, "a part outside the value")
    is_text = isinstance(content, str | bytes)
    if inner and is_text:
        raise Refusal(StatusCodes.BadIndexRangeNoData, "more dimensions than the value has")
    fits = type(part) is type(content) if is_text else isinstance(part, list | tuple)
    if not fits or len(part) != place.stop - place.start:
        raise Refusal(StatusCodes.BadIndexRangeDataMismatch, "a part of another size than the range")
    if is_text:
        return content[: place.start] + part + content[place.stop :]
    rows = zip(content[place], part, strict=True)
    whole = list(content)
    whole[place] = [_replaced(row, inner, new) for row, new in rows] if inner else [_like(*pair) for pair in rows]
    return whole


def _like(row: Any, new: Any) -> Any:
    """What is written in place of a row or an element, which has to have its size."""
    if isinstance(row, list) != isinstance(new, list):
        raise Refusal(StatusCodes.BadTypeMismatch, "a part of other dimensions than the value")
    if isinstance(row, list) and len(row) != len(new):
        raise Refusal(StatusCodes.BadIndexRangeDataMismatch, "rows of another length than the value's")
    return new


def _cut(content: Any, wanted: IndexRange) -> Any:
    """The part of nested lists, or of a String or ByteString as the innermost; None where there is none."""
    if not isinstance(content, list | tuple | str | bytes):
        return None
    part = content[wanted[0]]
    if len(wanted) == 1 or len(part) == 0:
        return part
    if isinstance(part, str | bytes):
        return None
    rows = [_cut(row, wanted[1:]) for row in part]
    return None if any(row is None or len(row) == 0 for row in rows) else rows
