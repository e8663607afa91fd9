"""The Action by which a bridge is asked to disable or enable what it sends (OPC 10000-14 9.1.10).

Each bridge has it, at a DataSetWriterId that no DataSet should have. The server alone may ask for it.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.components import CONNECTION, Component, writer, writer_group
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = [
    "SWITCH",
    "SWITCH_ID",
    "SWITCH_REQUEST",
    "component_of",
    "switch_arguments",
    "switch_topic",
]

SWITCH: Final = "SwitchPubSub"
SWITCH_ID: Final = 0xFFFF
"""Its DataSetWriterId: the largest that there is."""
SWITCH_REQUEST: Final = (
    make_field("WriterGroupId", BuiltinType.UINT16),
    make_field("DataSetWriterId", BuiltinType.UINT16),
    make_field("Enable", BuiltinType.BOOLEAN),
)
"""0 in place of an id means all of them; it is no valid id."""


def switch_topic(space: int, ns: int) -> Topic:
    """The Action of a bridge; `ns` is the fleet's namespace."""
    return Topic(space, ns, SWITCH_ID)


def switch_arguments(component: Component, *, is_enabled: bool) -> dict[str, int | bool]:
    """The arguments that name a component of what a bridge sends."""
    ns, writer_id = (*[int(number) for number in component[1:]], 0, 0)[:2]
    return {"WriterGroupId": ns, "DataSetWriterId": writer_id, "Enable": is_enabled}


def component_of(ns: int, writer_id: int) -> Component:
    """The component that arguments name."""
    if not ns:
        return CONNECTION
    return writer(ns, writer_id) if writer_id else writer_group(ns)
