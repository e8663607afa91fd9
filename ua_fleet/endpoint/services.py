"""Which services there are for a session, and what they share."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from ua_fleet.endpoint.attributes import AttributeServices
from ua_fleet.endpoint.audit_events import AuditEvents
from ua_fleet.endpoint.binary.browse import BrowsePlan
from ua_fleet.endpoint.binary.call import CallPlan
from ua_fleet.endpoint.binary.history_read import HistoryReadPlan
from ua_fleet.endpoint.binary.monitored_items import CreateMonitoredItemsPlan, PublishPlan
from ua_fleet.endpoint.binary.read import ReadPlan
from ua_fleet.endpoint.binary.write import WritePlan
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.history import HistoryServices
from ua_fleet.endpoint.methods import MethodServices
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.session_services import SessionServices
from ua_fleet.endpoint.sessions import Sessions
from ua_fleet.endpoint.stack import ObjectIds
from ua_fleet.endpoint.subscription_services import SubscriptionServices
from ua_fleet.endpoint.subscriptions import SubscriptionRegistry
from ua_fleet.endpoint.views import ViewServices
from ua_fleet.endpoint.writes import WriteServices

__all__ = ["Services", "encoding"]


@dataclass(frozen=True, slots=True)
class Service:
    """One service."""

    parameters: Any
    """asyncua's class of the request's parameters."""
    handle: Callable[[ServiceRequest, Any], Awaitable[Any]]
    """Serves a request."""
    plan: Callable[[ServiceRequest, bytes, int], Awaitable[Any]] | None = None
    """Serves a request from its bytes, which begin their parameters there; None for what is left to `handle`."""


def encoding(name: str) -> int:
    """Identifier of the encoding of a service's request."""
    return int(getattr(ObjectIds, f"{name}Request_Encoding_DefaultBinary"))


class Services:
    """The services of one server, by the identifier of their request's encoding."""

    def __init__(self, context: EndpointContext, subscriptions: SubscriptionRegistry) -> None:
        self.context = context
        self.sessions = Sessions()
        self.events = events = AuditEvents(subscriptions, lambda: context.server_id)
        self.session = SessionServices(context, self.sessions, subscriptions, events)
        attributes, writes = AttributeServices(context), WriteServices(context, events)
        self.methods = methods = MethodServices(context, events)
        views = ViewServices(context)
        subs, history = SubscriptionServices(context, subscriptions), HistoryServices(context)
        plans: dict[str, Callable[[ServiceRequest, bytes, int], Awaitable[Any]]] = {
            "Read": ReadPlan(context, attributes.read_one, attributes.is_readable).serve,
            "Write": WritePlan(context, writes).serve,
            "Call": CallPlan(context, methods).serve,
            "Browse": BrowsePlan(context, views).serve,
            "HistoryRead": HistoryReadPlan(context, history).serve,
            "CreateMonitoredItems": CreateMonitoredItemsPlan(context, subs).serve,
            "Publish": PublishPlan(context, subs).serve,
        }
        self.table: dict[int, Service] = {
            encoding(name): Service(parameters, handle, plans.get(name))
            for name, parameters, handle in (
                ("Read", ua.ReadParameters, attributes.read),
                ("Write", ua.WriteParameters, writes.write),
                ("HistoryRead", ua.HistoryReadParameters, history.history_read),
                ("Browse", ua.BrowseParameters, views.browse),
                ("BrowseNext", ua.BrowseNextParameters, views.browse_next),
                (
                    "TranslateBrowsePathsToNodeIds",
                    ua.TranslateBrowsePathsToNodeIdsParameters,
                    views.translate_browse_paths,
                ),
                ("RegisterNodes", ua.RegisterNodesParameters, views.register_nodes),
                ("UnregisterNodes", ua.UnregisterNodesParameters, views.unregister_nodes),
                ("Call", ua.CallParameters, methods.call),
                ("CreateSubscription", ua.CreateSubscriptionParameters, subs.create_subscription),
                ("ModifySubscription", ua.ModifySubscriptionParameters, subs.modify_subscription),
                ("DeleteSubscriptions", ua.DeleteSubscriptionsParameters, subs.delete_subscriptions),
                ("SetPublishingMode", ua.SetPublishingModeParameters, subs.set_publishing_mode),
                ("TransferSubscriptions", ua.TransferSubscriptionsParameters, subs.transfer_subscriptions),
                ("Publish", ua.PublishParameters, subs.publish),
                ("Republish", ua.RepublishParameters, subs.republish),
                ("CreateMonitoredItems", ua.CreateMonitoredItemsParameters, subs.create_monitored_items),
                ("ModifyMonitoredItems", ua.ModifyMonitoredItemsParameters, subs.modify_monitored_items),
                ("SetMonitoringMode", ua.SetMonitoringModeParameters, subs.set_monitoring_mode),
                ("SetTriggering", ua.SetTriggeringParameters, subs.set_triggering),
                ("DeleteMonitoredItems", ua.DeleteMonitoredItemsParameters, subs.delete_monitored_items),
            )
        }
