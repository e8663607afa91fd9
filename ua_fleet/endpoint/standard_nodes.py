"""The standard's own nodes, as asyncua makes them, in less memory."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, Final

from asyncua import ua
from asyncua.ua.attribute_ids import AttributeIds

from ua_fleet.endpoint.compact_nodes import BuiltNode, HeldValue

__all__ = ["forget_makers", "share_attributes"]

_MAKERS: Final = "asyncua.server.standard_address_space"
_OWN: Final = (AttributeIds.Value, AttributeIds.NodeId)
_PLAIN: Final = (int, float, str)


def share_attributes(nodes: Mapping[ua.NodeId, Any]) -> None:
    """Let nodes that have an attribute in common hold one object for it; a Value stays a node's own.

    Nobody writes any other attribute from now on: clients may not, and this server does not.
    """
    shared: dict[tuple[Any, ...], HeldValue] = {}
    for node in nodes.values():
        if isinstance(node, BuiltNode):
            continue  # one of ours shares them already
        attributes: dict[AttributeIds, Any] = node.attributes
        for attribute, held in attributes.items():
            if isinstance(held, HeldValue) or attribute in _OWN or held.value_callback is not None:
                continue
            variant = held.value.Value
            content = _content(variant.Value)
            if content is None or held.datachange_callbacks:
                continue
            # What is shared keeps the type, so that no other one has its id; its hash would be that of a text.
            key = (id(variant.VariantType), type(variant.Value), content)
            known = shared.get(key)
            if known is None:
                known = shared[key] = HeldValue(held.value)
            attributes[attribute] = known


def _content(value: Any) -> Any:
    """What makes a value equal to another one of its type; None for what is not shared."""
    if isinstance(value, _PLAIN):
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
