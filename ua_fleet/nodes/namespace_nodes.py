"""How the Unified Namespace stands, as nodes below the fleet's Object: `Fleet/UnifiedNamespace`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from ua_fleet.counters import Drop
from ua_fleet.endpoint.convert import data_value, raw_id
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.values import BuiltinType, NodeId, QualifiedName

__all__ = ["NAMESPACE_DROPS", "NamespaceFigures", "NamespaceNodes"]

OBJECT: Final = "Fleet.UnifiedNamespace"
NAMESPACE_DROPS: Final = (Drop.BROKER_AWAY, Drop.BROKER_REFUSED, Drop.CONVERSION, Drop.RATE_LIMITED)
"""Why a value is not published."""
_UINT64: Final = int(BuiltinType.UINT64)


class NamespaceFigures(NamedTuple):
    """Of one moment."""

    connected: bool
    detail: str
    """The broker, or why it is not connected."""
    topics: int
    waiting: int
    """Topics whose newest value the broker does not have."""
    published: int
    """Messages that the broker has acknowledged."""


_NAMES: Final = ("Connected", "Detail", "Topics", "Waiting", "Published")
_TYPES: Final = tuple(
    map(int, (BuiltinType.BOOLEAN, BuiltinType.STRING, BuiltinType.UINT32, BuiltinType.UINT32, _UINT64))
)


class NamespaceNodes:
    """These nodes."""

    def __init__(self, parts: NodeFactory, put: Callable[[ValueChanged], None], wall_ticks: Callable[[], int]) -> None:
        """Make them, without values yet.

        Args:
            parts: of the fleet's namespace; its values are those that `put` writes to.
            put: has a value written.
            wall_ticks: the wall clock.
        """
        self._parts, self._put, self._wall_ticks = parts, put, wall_ticks
        self._shown: dict[NodeId, Any] = {}
        names = QualifiedName(parts.names_ns, "UnifiedNamespace")
        parts.builder.add_object(parts.id(OBJECT), names, parts.id("Fleet"), STANDARD["BaseObjectType"])
        drops = QualifiedName(parts.names_ns, "Drops")
        parts.builder.add_object(parts.id(f"{OBJECT}.Drops"), drops, parts.id(OBJECT), STANDARD["FolderType"])
        for name, kind in zip(_NAMES, _TYPES, strict=True):
            self._make(self._key(name), name, OBJECT, kind)
        for cause in NAMESPACE_DROPS:
            self._make(self._key(f"Drops.{cause.value}"), cause.value, f"{OBJECT}.Drops", _UINT64)

    def show(self, figures: NamespaceFigures, drops: Mapping[str, int]) -> None:
        """Show what has changed."""
        for name, kind, value in zip(_NAMES, _TYPES, figures, strict=True):
            self._show(self._key(name), kind, value)
        for cause in NAMESPACE_DROPS:
            self._show(self._key(f"Drops.{cause.value}"), _UINT64, drops.get(cause.value, 0))

    def _key(self, name: str) -> NodeId:
        return NodeId(self._parts.ns, f"{OBJECT}.{name}")

    def _make(self, key: NodeId, name: str, parent: str, kind: int) -> None:
        initial = {int(BuiltinType.BOOLEAN): False, int(BuiltinType.STRING): ""}.get(kind, 0)
        held = data_value(kind, initial, 0, self._parts.now, self._parts.now)
        self._parts.variable(key, name, self._parts.id(parent), raw_id(kind), held, own_name=True)
        self._shown[key] = initial

    def _show(self, key: NodeId, kind: int, value: Any) -> None:
        if self._shown[key] != value:
            self._shown[key] = value
            self._put(ValueChanged(key, kind, value, 0, self._wall_ticks(), False))
