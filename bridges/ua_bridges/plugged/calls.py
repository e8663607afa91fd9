"""Values as arguments of D-Bus methods. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from ua_bridges.plugged.bus import Answer, Method
from ua_bridges.plugged.config import Call
from ua_bridges.plugged.data import as_type
from ua_fleet.bridge.executing import Ended, ended_text
from ua_fleet.config.base import ScalarType
from ua_fleet.values import StatusCode

__all__ = ["ended_of", "method_of"]

_SIGNATURES: Final[Mapping[ScalarType, str]] = {
    ScalarType.BOOLEAN: "b",
    ScalarType.SBYTE: "n",
    ScalarType.BYTE: "y",
    ScalarType.INT16: "n",
    ScalarType.UINT16: "q",
    ScalarType.INT32: "i",
    ScalarType.UINT32: "u",
    ScalarType.INT64: "x",
    ScalarType.UINT64: "t",
    ScalarType.FLOAT: "d",
    ScalarType.DOUBLE: "d",
    ScalarType.STRING: "s",
}
"""D-Bus has no signed byte and no single-precision number: the next larger type stands for them."""


def method_of(call: Call, types: Sequence[ScalarType], values: Sequence[Any], timeout_s: float) -> Method:
    """A call with its arguments."""
    signature = "".join([_SIGNATURES[kind] for kind in types])
    return Method(call.name, call.path, call.interface or call.name, call.member, signature, tuple(values), timeout_s)


def ended_of(answer: Answer, results: Mapping[str, ScalarType]) -> Ended:
    """How an execution ends that was a call."""
    if answer.problem:
        status = StatusCode.BAD_TIMEOUT if answer.is_unknown else StatusCode.BAD_UNEXPECTED_ERROR
        return Ended(status, (), ended_text(answer.problem))
    if len(answer.values) != len(results):
        if not results:
            return Ended(StatusCode.GOOD)
        said = f"it is done; it returned {len(answer.values)} values, and the skill has {len(results)} results"
        return Ended(StatusCode.UNCERTAIN, (), said)
    values = [as_type(name, kind, value) for (name, kind), value in zip(results.items(), answer.values, strict=True)]
    for value in values:
        if isinstance(value, ValueError):
            return Ended(StatusCode.UNCERTAIN, (), f"it is done; its result is not known: {value}")
    return Ended(StatusCode.GOOD, tuple(values))
