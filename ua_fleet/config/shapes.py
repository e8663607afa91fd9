"""Rules between the keys of one model, as JSON Schema says them: for editors, beside the validators that hold them.

A model takes them as a class argument, `class X(Model, frozen=True, json_schema_extra=exactly_one("a", "b"))`.
"""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.topics import FIRST_VENDOR_SPACE

__all__ = ["VENDOR_SPACE", "all_of", "at_least_one", "exactly_one", "given", "implies", "limited_to", "none_of"]

Schema = dict[str, Any]

VENDOR_SPACE: Final[Schema] = {"minimum": FIRST_VENDOR_SPACE, "maximum": 0xFFFF}
"""The spaces of PLCs, controllers, TCP robots and computers with devices."""


def given(key: str, *empty: Any) -> Schema:
    """The key stands there with a value, which is neither null nor one of `empty`."""
    return {"required": [key], "properties": {key: {"not": {"enum": [None, *empty]}}}}


def exactly_one(*keys: str, empty: tuple[Any, ...] = ()) -> Schema:
    """One of the keys is given, and no other of them."""
    return {"oneOf": [given(key, *empty) for key in keys]}


def at_least_one(*keys: str, empty: tuple[Any, ...] = ()) -> Schema:
    """One of the keys is given, or several."""
    return {"anyOf": [given(key, *empty) for key in keys]}


def none_of(*keys: str, empty: tuple[Any, ...] = ()) -> Schema:
    """None of the keys is given."""
    return {"not": at_least_one(*keys, empty=empty)}


def implies(condition: Schema, then: Schema) -> Schema:
    """Where the one holds, the other does."""
    return {"if": condition, "then": then}


def limited_to(key: str, *values: Any) -> Schema:
    """The key stands there with one of these values."""
    return {"required": [key], "properties": {key: {"enum": list(values)}}}


def all_of(*rules: Schema) -> Schema:
    """All of these hold."""
    return {"allOf": list(rules)}
