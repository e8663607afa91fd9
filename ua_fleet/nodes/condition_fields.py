"""Fields of conditions as Variants: what all kinds of them have in common (OPC 10000-9 5.2, 5.3)."""

from __future__ import annotations

from collections.abc import Iterator

from ua_fleet.values import BuiltinType, LocalizedText, NodeId, Variant

__all__ = ["flag", "node", "number", "status_field", "string", "text", "time_of", "two_state"]


def text(value: str) -> Variant:
    """A LocalizedText."""
    return Variant(int(BuiltinType.LOCALIZED_TEXT), LocalizedText(value))


def string(value: str) -> Variant:
    """A String."""
    return Variant(int(BuiltinType.STRING), value)


def flag(value: bool) -> Variant:
    """A Boolean."""
    return Variant(int(BuiltinType.BOOLEAN), value)


def node(value: NodeId) -> Variant:
    """A NodeId."""
    return Variant(int(BuiltinType.NODE_ID), value)


def number(kind: BuiltinType, value: float) -> Variant:
    """A number of a type."""
    return Variant(int(kind), value)


def time_of(ticks: int | None) -> Variant:
    """A DateTime; null for None."""
    return Variant(int(BuiltinType.DATETIME), ticks)


def two_state(name: str, value: bool, true: str, false: str) -> Iterator[tuple[str, Variant]]:
    """A TwoStateVariable with its Id."""
    yield name, text(true if value else false)
    yield f"{name}/Id", flag(value)


def status_field(name: str, value: Variant, ticks: int | None) -> Iterator[tuple[str, Variant]]:
    """A ConditionVariable with its SourceTimestamp."""
    yield name, value
    yield f"{name}/SourceTimestamp", time_of(ticks)
