"""Events of the Server object: what UaExpert's event view, and every client that subscribes to the Server, sees.

asyncua's events do not bubble up from the node that they are about, so all are emitted here, with that node as
SourceNode.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.common.events import Event
from asyncua.server.internal_server import InternalServer

from ua_fleet.endpoint.at_once import do_at_once
from ua_fleet.endpoint.convert import node_id, to_variant
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.values import NodeId, Variant, datetime_from_ticks

__all__ = ["EventFields", "ServerEvents"]

EventFields = Mapping[str, Variant]
"""Fields of an event by their browse path, e.g. `FromState/Id`."""

_SERVER: Final = ns0(ObjectIds.Server)


class ServerEvents:
    """Emits events."""

    def __init__(self, iserver: InternalServer) -> None:
        self._iserver = iserver

    def emit(
        self,
        event_type: ua.NodeId,
        *,
        source: NodeId,
        source_name: str,
        message: str,
        severity: int,
        ticks: int,
        fields: EventFields,
        subscription_id: int | None = None,
        item_id: int | None = None,
    ) -> None:
        """Tell all who have subscribed to the Server, or one subscription.

        Args:
            event_type: its type; the fields of BaseEventType are made here.
            source: the node that it is about.
            source_name: name of that for people.
            message: one line for people.
            severity: 1 to 1000.
            ticks: when it happened.
            fields: those of the type and its supertypes; fields of BaseEventType replace those that are made here.
            subscription_id: the subscription that alone is told.
            item_id: the MonitoredItem of it that alone is told.
        """
        event = Event(_SERVER)
        now = datetime.now(UTC)
        for name, value, kind in (
            ("EventId", secrets.token_bytes(16), ua.VariantType.ByteString),
            ("EventType", event_type, ua.VariantType.NodeId),
            ("SourceNode", node_id(source), ua.VariantType.NodeId),
            ("SourceName", source_name, ua.VariantType.String),
            ("Time", datetime_from_ticks(ticks), ua.VariantType.DateTime),
            ("ReceiveTime", now, ua.VariantType.DateTime),
            ("Message", ua.LocalizedText(message), ua.VariantType.LocalizedText),
            ("Severity", severity, ua.VariantType.UInt16),
        ):
            event.add_property(name, value, kind)
        for name, field in fields.items():
            variant: Any = to_variant(field.type, field.value) if field.type else ua.Variant()
            event.add_property(name, variant.Value, variant.VariantType)
        registry: Any = self._iserver.subscription_service
        if item_id is None:
            do_at_once(registry.trigger_event(event, subscription_id))
        elif (subscription := registry.subscriptions.get(subscription_id)) is not None:
            do_at_once(subscription.monitored_item_srv.trigger_event(event, item_id))
