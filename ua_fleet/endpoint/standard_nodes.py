"""The standard's own nodes, as asyncua makes them, in less memory."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import sys
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.ua.attribute_ids import AttributeIds

from ua_fleet.endpoint.compact_nodes import HeldValue

__all__ = ["forget_makers", "share_attributes"]

_MAKERS: Final = "asyncua.server.standard_address_space"


def share_attributes(space: AddressSpace) -> None:
    """Let nodes that have an attribute in common hold one object for it; a Value stays a node's own.

    Nobody writes any other attribute from now on: clients may not, and this server does not.
    """
    shared: dict[tuple[Any, ...], HeldValue] = {}
    for node_id in space.keys():  # noqa: SIM118 - an AddressSpace is no mapping
        attributes: dict[AttributeIds, Any] = space[node_id].attributes
        for attribute, held in attributes.items():
            if isinstance(held, HeldValue) or attribute in (AttributeIds.Value, AttributeIds.NodeId):
                continue  # one that is ours is shared already
            if held.value_callback is not None:
                continue
            variant = held.value.Value
            content = _content(variant.Value)
            if content is None or held.datachange_callbacks:
                continue
            key = (variant.VariantType, type(variant.Value), content)
            known = shared.get(key)
            if known is None:
                known = shared[key] = HeldValue(held.value)
            attributes[attribute] = known


def _content(value: Any) -> Any:
    """What makes a value equal to another one of its type; None for what is not shared."""
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, ua.LocalizedText):
        return value.Text, value.Locale
    if isinstance(value, ua.QualifiedName):
        return value.Name, value.NamespaceIndex
    return None


def forget_makers() -> None:
    """Give back what the code takes that has made the standard's nodes; it is loaded anew for another server."""
    for name in [name for name in sys.modules if name.startswith(f"{_MAKERS}.")]:
        parent, _, own = name.rpartition(".")
        # Its functions hold their module and it holds them: they would wait for a garbage collection, which is paused.
        sys.modules.pop(name).__dict__.clear()
        if (package := sys.modules.get(parent)) is not None and hasattr(package, own):
            delattr(package, own)
