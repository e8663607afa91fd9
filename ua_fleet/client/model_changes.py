# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""That nodes have come or gone, as the server tells it (GeneralModelChangeEvent, OPC 10000-3 9.32.7)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable
from contextlib import asynccontextmanager
from typing import Any, Final

from asyncua import ua
from asyncua.common.subscription import Subscription

from ua_fleet.client.subscriptions import Feed, Subscriptions
from ua_fleet.errors import NotConnected

__all__ = ["ModelChanges", "model_changes"]

_TOGETHER_S: Final = 0.1
"""Changes that come one after another are one: a robot that is registered is told node by node."""


class ModelChanges(Feed[bool]):
    """The subscription's handler: one place, since that something has changed is told once."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(1)
        self._endpoint = endpoint

    def event_notification(self, event: Any) -> None:
        """Called by asyncua with each event."""
        self.put(True)

    async def wait(self) -> None:
        """Return when nodes have come or gone since the last wait; raises NotConnected when the connection is lost."""
        if await self.next() is None:
            self.lose()
            raise NotConnected(f"the connection to {self._endpoint} was lost")
        await asyncio.sleep(_TOGETHER_S)


@asynccontextmanager
async def model_changes(endpoint: str, subscriptions: Subscriptions, period_ms: float) -> AsyncGenerator[ModelChanges]:
    """Subscribe until the context is left."""
    changes = ModelChanges(endpoint)
    wanted = ua.EventFilter()
    operand = ua.SimpleAttributeOperand()
    operand.TypeDefinitionId = ua.NodeId(ua.Int32(ua.ObjectIds.BaseEventType))
    operand.BrowsePath = [ua.QualifiedName("EventType", 0)]
    operand.AttributeId = ua.AttributeIds.Value
    wanted.SelectClauses = [operand]
    element = ua.ContentFilterElement()
    element.FilterOperator = ua.FilterOperator.OfType
    kind = ua.NodeId(ua.Int32(ua.ObjectIds.GeneralModelChangeEventType))
    element.FilterOperands = [ua.LiteralOperand(Value=ua.Variant(kind))]
    wanted.WhereClause.Elements.append(element)

    def begin(subscription: Subscription) -> Awaitable[object]:
        return subscription.subscribe_events(ua.ObjectIds.Server, evfilter=wanted, queuesize=1)

    async with subscriptions.open(changes, period_ms, begin):
        yield changes
