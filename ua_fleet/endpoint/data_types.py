"""Which built-in types values of a DataType have on the wire."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.stack import ObjectIds, ns0

__all__ = ["DataTypes"]

_ABSTRACT: Final[dict[int, frozenset[int]]] = {
    24: frozenset(range(1, 26)),
    26: frozenset(range(2, 12)),
    27: frozenset((2, 4, 6, 8)),
    28: frozenset((3, 5, 7, 9)),
    29: frozenset((6,)),
}
"""Built-in types that fit BaseDataType, Number, Integer, UInteger and Enumeration (OPC 10000-3 8)."""
_STRUCTURE: Final = frozenset((22,))
_HAS_SUBTYPE: Final = ns0(ObjectIds.HasSubtype)
_DEEPEST: Final = 50


class DataTypes:
    """The DataTypes of an address space."""

    def __init__(self, aspace: AddressSpace) -> None:
        self._aspace = aspace
        self._known: dict[ua.NodeId, frozenset[int]] = {}

    def builtin_types(self, data_type: ua.NodeId) -> frozenset[int]:
        """The built-in types that values of a DataType have on the wire; none for what is no DataType."""
        known = self._known.get(data_type)
        if known is not None:
            return known
        current: ua.NodeId | None = data_type
        found = frozenset[int]()
        for _ in range(_DEEPEST):
            if current is None:
                break
            identifier = current.Identifier
            if current.NamespaceIndex == 0 and isinstance(identifier, int) and identifier <= 29:
                found = _ABSTRACT.get(identifier, frozenset((identifier,)))
                break
            node = self._aspace.get(current)
            parents = (
                ref.NodeId
                for ref in (node.references if node is not None else ())
                if not ref.IsForward and ref.ReferenceTypeId == _HAS_SUBTYPE
            )
            current = next(parents, None)
        self._known[data_type] = found
        return found

    def is_structure(self, data_type: ua.NodeId) -> bool:
        """Whether it is Structure or a subtype of it."""
        return self.builtin_types(data_type) == _STRUCTURE
