"""CreateMonitoredItems (OPC 10000-4 5.13.2) and Publish (5.14.5) from the bytes of a request.

`subscription_services` has the rules, and says its results as bytes.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.operations import COUNT, OperationReader
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.request import ANSWERED_LATER, ServiceRequest
from ua_fleet.endpoint.scan import steps_of
from ua_fleet.endpoint.subscription_services import SubscriptionServices

__all__ = ["CreateMonitoredItemsPlan", "PublishPlan"]

_BEFORE_ITEMS: Final = struct.Struct("<IIi")
"""SubscriptionId, TimestampsToReturn, number of ItemsToCreate."""
_AROUND: Final = sum(part.step.memory for part in steps_of(ua.CreateMonitoredItemsParameters) if not part.is_array)


class CreateMonitoredItemsPlan:
    """New items for all sessions of one server."""

    def __init__(self, context: EndpointContext, services: SubscriptionServices) -> None:
        self._operations = OperationReader(ua.MonitoredItemCreateRequest, context.limits, _BEFORE_ITEMS, around=_AROUND)
        self._services = services

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> ArrayResponse | None:
        """The response; None for a request that is refused as a whole, which is left to those who know why.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        begun = self._operations.begin(data, start)
        if begun is None:
            return None
        scan, (subscription_id, times, count) = begun
        items = await self._operations.all(scan, count, request.turns, self._operations.whole)
        return await self._services.create_items(request, subscription_id, times, items)


class PublishPlan:
    """Publish requests of all sessions of one server."""

    def __init__(self, context: EndpointContext, services: SubscriptionServices) -> None:
        self._operations = OperationReader(ua.SubscriptionAcknowledgement, context.limits)
        self._services = services

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> Any:
        """ANSWERED_LATER; None for a request that is refused as a whole, which is left to those who know why.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: the session has no subscription.
        """
        acknowledged: list[tuple[int, int]] = []
        if data[start : start + COUNT.size] not in _NONE:
            begun = self._operations.begin(data, start)
            if begun is None:
                return None
            _, (count,) = begun
            numbers = struct.unpack_from(f"<{2 * count}I", data, start + COUNT.size)
            acknowledged = list(zip(numbers[::2], numbers[1::2], strict=True))
        self._services.take_publish(request, acknowledged)
        return ANSWERED_LATER


_NONE: Final = (COUNT.pack(0), COUNT.pack(-1))
"""No acknowledgement, or a null array of them."""
