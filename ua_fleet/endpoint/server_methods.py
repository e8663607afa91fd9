"""Methods of the Server object for a client's own subscriptions: GetMonitoredItems, ResendData (OPC 10000-5 9.1, 9.2).

Who may subscribe may call them. A client that came back has lost what its items are called, or what they told: the one
says which there are, the other tells the values again.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import time
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.sessions import current_session
from ua_fleet.endpoint.stack import ObjectIds, Refusal, StatusCodes, ns0
from ua_fleet.endpoint.subscriptions import ClientSubscription, SubscriptionRegistry
from ua_fleet.endpoint.turns import TURN_S

__all__ = ["ServerMethods"]

_GET_MONITORED_ITEMS: Final = ns0(ObjectIds.Server_GetMonitoredItems)
_RESEND_DATA: Final = ns0(ObjectIds.Server_ResendData)


class ServerMethods:
    """The implementations; the caller is the session whose request is worked on."""

    def __init__(self, subscriptions: SubscriptionRegistry) -> None:
        self._subscriptions = subscriptions

    def link(self, space: AddressSpace, context: EndpointContext) -> None:
        """Put them behind their nodes, for every user."""
        for node_id, implementation in (
            (_GET_MONITORED_ITEMS, self.get_monitored_items),
            (_RESEND_DATA, self.resend_data),
        ):
            space[node_id].call = implementation
            context.method_rules[node_id] = lambda _: True

    async def get_monitored_items(self, _parent: ua.NodeId, subscription_id: ua.Variant) -> list[ua.Variant]:
        """Ids of a subscription's items, and the client's handles of them."""
        items: list[Any] = list(self._own(subscription_id).items)
        return [
            ua.Variant([item.id for item in items], ua.VariantType.UInt32, is_array=True),
            ua.Variant([item.client_handle for item in items], ua.VariantType.UInt32, is_array=True),
        ]

    async def resend_data(self, _parent: ua.NodeId, subscription_id: ua.Variant) -> list[ua.Variant]:
        """Tell the values of a subscription's reporting items again, as they are now; others have turns meanwhile.

        What is told counts for the user's queues, as all values do.
        """
        began = time.monotonic()
        for item in self._own(subscription_id).reporting():
            item.tell_again()
            if time.monotonic() - began > TURN_S:
                await asyncio.sleep(0)
                self._own(subscription_id)
                began = time.monotonic()
        return []

    def _own(self, subscription_id: ua.Variant) -> ClientSubscription:
        subscription = self._subscriptions.find(int(subscription_id.Value))
        if subscription is None:
            raise Refusal(StatusCodes.BadSubscriptionIdInvalid)
        session = current_session.get()
        if session is None or subscription.session is not session:
            raise Refusal(StatusCodes.BadUserAccessDenied, f"subscription {subscription.id} is another session's")
        subscription.touch()
        return subscription
