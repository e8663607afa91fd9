"""The services for subscriptions and monitored items. Each looks first whether the subscription is its session's."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import struct
import time
from collections.abc import Iterable, Sequence
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse, EncodedResponse
from ua_fleet.endpoint.attributes import readable_value
from ua_fleet.endpoint.binary.encoders import NO_OBJECT, encode_extension_object
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.event_fields import EventFields
from ua_fleet.endpoint.filters import (
    EventFilter,
    FilterRefused,
    check_data_filter,
    check_event_filter,
    filter_of,
)
from ua_fleet.endpoint.indexrange import parse_range
from ua_fleet.endpoint.live import check_reader
from ua_fleet.endpoint.monitoring import DataItem, EventItem
from ua_fleet.endpoint.notifications import encode_codes
from ua_fleet.endpoint.request import ServiceRequest, operations
from ua_fleet.endpoint.sessions import PublishRequest
from ua_fleet.endpoint.stack import GOOD, AttributeIds, Refusal, StatusCodes, status
from ua_fleet.endpoint.subscriptions import ClientSubscription, SubscriptionRegistry

__all__ = ["SubscriptionServices", "encode_item_result"]

_SPARE_REQUESTS: Final = 10
"""Publish requests that a session may queue beyond one for each of its subscriptions."""
_NO_HANDLE: Final = 0xFFFFFFFF
"""ClientHandle of a ModifyMonitoredItems of node-opcua's client, which leaves the item's as it is."""
_LONGEST_WAIT_S: Final = 3_600.0
_ITEM_RESULT: Final = struct.Struct("<IIdI")
"""StatusCode, MonitoredItemId, RevisedSamplingInterval, RevisedQueueSize."""


class SubscriptionServices:
    """OPC 10000-4 5.13 and 5.14."""

    def __init__(self, context: EndpointContext, subscriptions: SubscriptionRegistry) -> None:
        self._context, self._limits, self._subscriptions = context, context.limits, subscriptions
        self._aspace = context.iserver.aspace
        self._declared = EventFields(self._aspace)

    def _own(self, request: ServiceRequest, subscription_id: int) -> ClientSubscription:
        subscription = request.session.subscriptions.get(subscription_id)
        if subscription is None:
            raise Refusal(StatusCodes.BadSubscriptionIdInvalid, f"subscription {subscription_id}")
        subscription.touch()
        return subscription

    async def _end_turn(self, request: ServiceRequest, subscription: ClientSubscription | None = None) -> bool:
        """Let others have their turn, if this one is over; raises Refusal when the subscription is gone after that."""
        is_over = request.turns.over
        if is_over:
            await request.turns.end()
            if subscription is not None and request.session.subscriptions.get(subscription.id) is not subscription:
                raise Refusal(
                    StatusCodes.BadSubscriptionIdInvalid, f"subscription {subscription.id} has ended meanwhile"
                )
        return is_over

    async def create_subscription(self, request: ServiceRequest, params: ua.CreateSubscriptionParameters) -> Any:
        """CreateSubscription."""
        if len(request.session.subscriptions) >= self._limits.subscriptions_per_session:
            raise Refusal(StatusCodes.BadTooManySubscriptions)
        subscription = self._subscriptions.create(request.session, request.user, self._limits, params)
        subscription.start()
        self._context.statistics.subscriptions += 1
        response = ua.CreateSubscriptionResponse()
        response.Parameters = ua.CreateSubscriptionResult(subscription.id, *_revised(subscription))  # pyright: ignore[reportArgumentType]
        return response

    async def modify_subscription(self, request: ServiceRequest, params: ua.ModifySubscriptionParameters) -> Any:
        """ModifySubscription."""
        subscription = self._own(request, params.SubscriptionId)
        subscription.revise(
            params.RequestedPublishingInterval,
            # A client that has no wish leaves it out, which is 0.
            params.RequestedLifetimeCount or subscription.lifetime_count,
            params.RequestedMaxKeepAliveCount,
            params.MaxNotificationsPerPublish,
        )
        subscription.usage.modified += 1
        subscription.priority = int(params.Priority)
        response = ua.ModifySubscriptionResponse()
        response.Parameters = ua.ModifySubscriptionResult(*_revised(subscription))  # pyright: ignore[reportArgumentType]
        return response

    async def delete_subscriptions(self, request: ServiceRequest, params: ua.DeleteSubscriptionsParameters) -> Any:
        """DeleteSubscriptions."""
        response = ua.DeleteSubscriptionsResponse()
        for subscription_id in operations(params.SubscriptionIds, self._limits.nodes_per_request):
            subscription = request.session.subscriptions.get(subscription_id)
            if subscription is None:
                self._foreign(request, "DeleteSubscriptions", subscription_id)
                response.Results.append(status(StatusCodes.BadSubscriptionIdInvalid))
            else:
                await self._subscriptions.delete(subscription)
                response.Results.append(GOOD)
            await self._end_turn(request)
        return response

    def _foreign(self, request: ServiceRequest, service: str, subscription_id: int) -> None:
        self._context.audit.refuse(
            request.caller, service, "BadSubscriptionIdInvalid", reason=f"subscription {subscription_id} is not its own"
        )

    async def set_publishing_mode(self, request: ServiceRequest, params: ua.SetPublishingModeParameters) -> Any:
        """SetPublishingMode."""
        response = ua.SetPublishingModeResponse()
        for subscription_id in operations(params.SubscriptionIds, self._limits.nodes_per_request):
            subscription = request.session.subscriptions.get(subscription_id)
            if subscription is None:
                self._foreign(request, "SetPublishingMode", subscription_id)
                response.Parameters.Results.append(status(StatusCodes.BadSubscriptionIdInvalid))
            else:
                subscription.touch()
                subscription.enabled = bool(params.PublishingEnabled)
                if subscription.enabled:
                    subscription.usage.enabled += 1
                else:
                    subscription.usage.disabled += 1
                response.Parameters.Results.append(GOOD)
            await self._end_turn(request)
        return response

    async def publish(self, request: ServiceRequest, params: ua.PublishParameters) -> None:
        """Publish: answered at once if a subscription is late, otherwise when there is something to tell."""
        given = params.SubscriptionAcknowledgements or []
        self.take_publish(request, [(each.SubscriptionId, each.SequenceNumber) for each in given])

    def take_publish(self, request: ServiceRequest, acknowledged: Iterable[tuple[int, int]]) -> None:
        """Publish, with the subscription and sequence number of each message that the client has."""
        session = request.session
        if not session.subscriptions and not session.farewells:
            raise Refusal(StatusCodes.BadNoSubscription)
        results: list[int] = []
        for subscription_id, sequence in acknowledged:
            own = session.subscriptions.get(subscription_id)
            results.append(StatusCodes.BadSubscriptionIdInvalid if own is None else own.acknowledge(sequence))
        session.drop_expired_requests()
        expires_at = time.monotonic() + (request.timeout_s or _LONGEST_WAIT_S)
        waiting = PublishRequest(request.handle, request.request_id, expires_at, encode_codes(results))
        if session.farewells:
            session.answer_with_farewell(waiting, *session.farewells.popleft())
            return
        for late in list(session.late):
            del session.late[late]
            subscription = session.subscriptions.get(late)
            if subscription is not None:
                if subscription.answer(waiting):
                    session.late[late] = None
                return
        if len(session.requests) >= len(session.subscriptions) + _SPARE_REQUESTS:
            session.refuse_request(session.requests.popleft(), StatusCodes.BadTooManyPublishRequests)
        session.requests.append(waiting)

    async def republish(self, request: ServiceRequest, params: ua.RepublishParameters) -> Any:
        """Republish."""
        subscription = self._own(request, params.SubscriptionId)
        subscription.usage.republish_requests += 1
        message = subscription.sent(params.RetransmitSequenceNumber)
        if message is None:
            raise Refusal(StatusCodes.BadMessageNotAvailable)
        subscription.usage.republished += 1
        return EncodedResponse(ua.RepublishResponse, message)

    async def transfer_subscriptions(self, request: ServiceRequest, params: ua.TransferSubscriptionsParameters) -> Any:
        """TransferSubscriptions: only those of the same user, with the same client certificate."""
        response = ua.TransferSubscriptionsResponse()
        # An id that is named ten thousand times is transferred, and its values told, once.
        results: dict[int, ua.TransferResult] = {}
        for subscription_id in operations(params.SubscriptionIds, self._limits.nodes_per_request):
            if subscription_id not in results:
                results[subscription_id] = await self._transferred(
                    request, int(subscription_id), tell=params.SendInitialValues
                )
            response.Parameters.Results.append(results[subscription_id])
            await self._end_turn(request)
        return response

    async def _transferred(self, request: ServiceRequest, subscription_id: int, *, tell: bool) -> ua.TransferResult:
        result = ua.TransferResult()
        try:
            subscription = self._transfer(request, subscription_id)
            result.AvailableSequenceNumbers = subscription.unacknowledged  # pyright: ignore[reportAttributeAccessIssue]
            for item in subscription.reporting() if tell else ():
                item.tell_again()
                await self._end_turn(request, subscription)
        except Refusal as error:
            result.StatusCode = status(error.ua_status)
            self._context.audit.refuse(
                request.caller, "TransferSubscriptions", result.StatusCode.name, reason=str(error)
            )
        return result

    def _transfer(self, request: ServiceRequest, subscription_id: int) -> ClientSubscription:
        subscription = self._subscriptions.find(subscription_id)
        if subscription is None:
            raise Refusal(StatusCodes.BadSubscriptionIdInvalid)
        subscription.usage.transfer_requests += 1
        session = request.session
        same = subscription.owner.name == request.user.name and not request.user.anonymous
        if not same or subscription.owner_certificate != session.client_certificate:
            raise Refusal(StatusCodes.BadUserAccessDenied, f"subscription {subscription_id} is another user's")
        if subscription.session is session:
            return subscription
        if len(session.subscriptions) >= self._limits.subscriptions_per_session:
            raise Refusal(StatusCodes.BadTooManySubscriptions)
        held = [*session.subscriptions.values(), subscription]
        too_many = sum(own.items.event_items for own in held) > self._limits.event_items_per_session
        if too_many or sum(own.items.filter_steps for own in held) > self._limits.filter_steps_per_session:
            raise Refusal(StatusCodes.BadTooManyMonitoredItems, "too many event items of one session")
        subscription.move(session)
        return subscription

    async def create_monitored_items(self, request: ServiceRequest, params: ua.CreateMonitoredItemsParameters) -> Any:
        """CreateMonitoredItems."""
        return await self.create_items(
            request, int(params.SubscriptionId), params.TimestampsToReturn, params.ItemsToCreate
        )

    async def create_items(
        self, request: ServiceRequest, subscription_id: int, wanted_times: int, items: Sequence[Any]
    ) -> ArrayResponse:
        """CreateMonitoredItems of MonitoredItemCreateRequests."""
        subscription = self._own(request, subscription_id)
        timestamps = _timestamps(wanted_times)
        answer = ArrayResponse(ua.CreateMonitoredItemsResponse, self._limits.response_bytes)
        left = self._items_left(subscription)
        for item in operations(items, self._limits.nodes_per_request):
            try:
                if left <= 0:
                    raise Refusal(StatusCodes.BadTooManyMonitoredItems)
                answer.add_small(self._create_item(request, subscription, item, timestamps))
                left -= 1
            except Refusal as error:
                found = error.result if isinstance(error, FilterRefused) else None
                answer.add_small(encode_item_result(error.ua_status, filter_result=found))
            if await self._end_turn(request, subscription):
                left = self._items_left(subscription)  # another session of the user may have had its turn
        return answer

    def _items_left(self, subscription: ClientSubscription) -> int:
        """Monitored items that the subscription's user may still have."""
        return self._limits.monitored_items_per_user - self._subscriptions.items_of(subscription.holder)

    def _create_item(
        self,
        request: ServiceRequest,
        subscription: ClientSubscription,
        wanted: ua.MonitoredItemCreateRequest,
        timestamps: ua.TimestampsToReturn,
    ) -> bytes:
        """Make an item; its encoded MonitoredItemCreateResult."""
        if len(subscription.items) >= self._limits.monitored_items_per_subscription:
            raise Refusal(StatusCodes.BadTooManyMonitoredItems)
        target, parameters = wanted.ItemToMonitor, wanted.RequestedParameters
        wanted.MonitoringMode = _monitoring_mode(wanted.MonitoringMode)
        parameters.Filter = filter_of(parameters)
        if target.NodeId is None or self._aspace.get(target.NodeId) is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        if self._subscriptions.items_on(target.NodeId, subscription.holder) >= self._limits.items_per_node_and_user:
            raise Refusal(StatusCodes.BadTooManyMonitoredItems, "too many items of one user on one node")
        if target.AttributeId == AttributeIds.EventNotifier:
            notifier = self._aspace.read_attribute_value(target.NodeId, AttributeIds.EventNotifier)
            bits = notifier.Value.Value if notifier.Value is not None else None
            if not bits or not int(bits) & 1:
                raise Refusal(StatusCodes.BadNotSupported, "the node has no events")
            watched = sum(own.items.event_items for own in request.session.subscriptions.values())
            if watched >= self._limits.event_items_per_session:
                raise Refusal(StatusCodes.BadTooManyMonitoredItems, "too many items on events")
            event_filter = self._event_filter(request, parameters.Filter)
            size = self._event_queue_size(parameters.QueueSize)
            events = EventItem(subscription, subscription.items.next_id(), wanted, size, event_filter)
            subscription.items.add_events(events)
            return encode_item_result(0, events.id, 0.0, size, event_filter.result)
        check_reader(self._aspace, target.NodeId, target.AttributeId, request.user, encrypted=request.encrypted)
        value = readable_value(self._aspace, target.NodeId, target.AttributeId)
        deadband = check_data_filter(
            self._aspace, parameters.Filter, node_id=target.NodeId, attribute=target.AttributeId, value=value
        )
        index_range = parse_range(target.IndexRange)
        if index_range is not None and target.AttributeId != AttributeIds.Value:
            raise Refusal(StatusCodes.BadIndexRangeInvalid)
        interval_s = self._sampling_s(subscription, target.NodeId, target.AttributeId, parameters)
        size = self._queue_size(parameters.QueueSize)
        data = DataItem(
            subscription,
            subscription.items.next_id(),
            wanted,
            size,
            index_range,
            timestamps,
            self._aspace,
            interval_s=interval_s,
            deadband=deadband,
        )
        if not (code := subscription.items.add_data(data)).is_good():
            raise Refusal(int(code.value))
        return encode_item_result(0, data.id, interval_s * 1000, size)

    def _event_filter(self, request: ServiceRequest, wanted: Any, taken_off: int = 0) -> EventFilter:
        """A filter that all those of the session leave room for; `taken_off` are the steps of the one that goes."""
        made = check_event_filter(self._aspace, wanted, self._limits.filter_elements, self._declared)
        steps = sum(own.items.filter_steps for own in request.session.subscriptions.values()) - taken_off
        if steps + made.cost > self._limits.filter_steps_per_session:
            raise Refusal(
                StatusCodes.BadTooManyMonitoredItems,
                f"the filters of this session would take {steps + made.cost} steps for each event",
            )
        return made

    def _sampling_s(
        self, subscription: ClientSubscription, node_id: ua.NodeId, attribute: int, parameters: ua.MonitoringParameters
    ) -> float:
        """The sampling interval of a data item (OPC 10000-4 5.13.1.2, 7.21); 0 tells each write."""
        wish = float(parameters.SamplingInterval)
        interval_s = wish / 1000 if wish >= 0 else subscription.interval_s
        if attribute == AttributeIds.Value:
            variant = self._aspace.read_attribute_value(node_id, AttributeIds.MinimumSamplingInterval).Value
            least = variant.Value if variant is not None else None
            if isinstance(least, int | float) and least > 0:
                interval_s = max(interval_s, least / 1000)
        return min(interval_s, self._limits.sampling_interval_s)

    def _queue_size(self, requested: int) -> int:
        return min(max(int(requested), 1), self._limits.queue_size)

    def _event_queue_size(self, requested: int) -> int:
        """With 0 the server decides (OPC 10000-4 7.21)."""
        most = self._limits.event_queue_size
        return min(int(requested) or most, most)

    async def modify_monitored_items(self, request: ServiceRequest, params: ua.ModifyMonitoredItemsParameters) -> Any:
        """ModifyMonitoredItems."""
        subscription = self._own(request, params.SubscriptionId)
        timestamps = _timestamps(params.TimestampsToReturn)
        response = ua.ModifyMonitoredItemsResponse()
        for wanted in operations(params.ItemsToModify, self._limits.nodes_per_request):
            try:
                result = self._modify_item(request, subscription, wanted, timestamps)
            except Refusal as error:
                result = ua.MonitoredItemModifyResult(status(error.ua_status))
                _tell_filter(result, error)
            response.Results.append(result)
            await self._end_turn(request, subscription)
        return response

    def _modify_item(
        self,
        request: ServiceRequest,
        subscription: ClientSubscription,
        wanted: ua.MonitoredItemModifyRequest,
        timestamps: ua.TimestampsToReturn,
    ) -> Any:
        item = subscription.items.get(wanted.MonitoredItemId)
        parameters = wanted.RequestedParameters
        if item is None:
            raise Refusal(StatusCodes.BadMonitoredItemIdInvalid)
        parameters.Filter = filter_of(parameters)
        result: Any = ua.MonitoredItemModifyResult()
        if isinstance(item, EventItem):
            item.filter = self._event_filter(request, parameters.Filter, item.filter.cost)
            if item.filter.result is not None:
                result.FilterResult = item.filter.result
        elif isinstance(item, DataItem):
            value = self._aspace.read_attribute_value(item.node_id, item.attribute)
            deadband = check_data_filter(
                self._aspace, parameters.Filter, node_id=item.node_id, attribute=item.attribute, value=value
            )
            item.set_filter(parameters.Filter, deadband)
            item.set_interval(self._sampling_s(subscription, item.node_id, item.attribute, parameters))
            item.timestamps = timestamps
            result.RevisedSamplingInterval = item.interval_s * 1000
        if parameters.ClientHandle != _NO_HANDLE:
            item.client_handle = parameters.ClientHandle
        item.discard_oldest = bool(parameters.DiscardOldest)
        revised = self._event_queue_size if isinstance(item, EventItem) else self._queue_size
        item.resize(revised(parameters.QueueSize))
        result.RevisedQueueSize = item.queue_size
        return result

    async def set_monitoring_mode(self, request: ServiceRequest, params: ua.SetMonitoringModeParameters) -> Any:
        """SetMonitoringMode."""
        subscription = self._own(request, params.SubscriptionId)
        mode = _monitoring_mode(params.MonitoringMode)
        response = ua.SetMonitoringModeResponse()
        for item_id in operations(params.MonitoredItemIds, self._limits.nodes_per_request):
            await self._end_turn(request, subscription)
            item = subscription.items.get(item_id)
            if item is None:
                response.Parameters.Results.append(status(StatusCodes.BadMonitoredItemIdInvalid))
                continue
            subscription.set_mode(item, mode)
            response.Parameters.Results.append(GOOD)
        return response

    async def set_triggering(self, request: ServiceRequest, params: ua.SetTriggeringParameters) -> Any:
        """SetTriggering: links are removed first, then added."""
        subscription = self._own(request, params.SubscriptionId)
        operations([*params.LinksToRemove, *params.LinksToAdd], self._limits.nodes_per_request)
        items = subscription.items
        triggering = items.get(params.TriggeringItemId)
        if triggering is None:
            raise Refusal(StatusCodes.BadMonitoredItemIdInvalid, f"monitored item {params.TriggeringItemId}")
        response = ua.SetTriggeringResponse()
        for linked_id in params.LinksToRemove:
            response.Parameters.RemoveResults.append(items.remove_link(triggering, linked_id))
            await self._end_turn(request, subscription)
        for linked_id in params.LinksToAdd:
            result = items.add_link(triggering, linked_id, self._limits.triggering_links)
            response.Parameters.AddResults.append(result)
            await self._end_turn(request, subscription)
        return response

    async def delete_monitored_items(self, request: ServiceRequest, params: ua.DeleteMonitoredItemsParameters) -> Any:
        """DeleteMonitoredItems."""
        subscription = self._own(request, params.SubscriptionId)
        response = ua.DeleteMonitoredItemsResponse()
        for item_id in operations(params.MonitoredItemIds, self._limits.nodes_per_request):
            response.Results.append(subscription.remove(item_id))
            await self._end_turn(request, subscription)
        return response


def _tell_filter(result: Any, error: Refusal) -> None:
    """Say which part of a filter is wrong."""
    if isinstance(error, FilterRefused):
        result.FilterResult = error.result


def encode_item_result(
    code: int, item_id: int = 0, interval_ms: float = 0.0, queue_size: int = 0, filter_result: Any = None
) -> bytes:
    """A MonitoredItemCreateResult (OPC 10000-4 5.13.2.2)."""
    fixed = _ITEM_RESULT.pack(code, item_id, interval_ms, queue_size)
    return fixed + (NO_OBJECT if filter_result is None else encode_extension_object(filter_result))


def _revised(subscription: ClientSubscription) -> tuple[float, int, int]:
    return subscription.interval_s * 1000, subscription.lifetime_count, subscription.keep_alive_count


def _timestamps(value: Any) -> ua.TimestampsToReturn:
    try:
        timestamps = ua.TimestampsToReturn(value)
    except ValueError as error:
        raise Refusal(StatusCodes.BadTimestampsToReturnInvalid) from error
    if timestamps == ua.TimestampsToReturn.Invalid:
        raise Refusal(StatusCodes.BadTimestampsToReturnInvalid)
    return timestamps


def _monitoring_mode(value: Any) -> ua.MonitoringMode:
    try:
        return ua.MonitoringMode(value)
    except ValueError as error:
        raise Refusal(StatusCodes.BadMonitoringModeInvalid) from error
