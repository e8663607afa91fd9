"""The information model of PubSub of one server: what it shows follows from its parts, and its Methods switch them.

    Enable, Disable    of the server's own components: at once; of a bridge's: an Action to the bridge
    Reset              the counters of a Diagnostics Object begin anew

It is looked at each second: what is new is made, what is gone is removed, and who watches a value is told.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import structlog
from asyncua import ua

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.node_builder import NodeBuilder
from ua_fleet.endpoint.stack import ObjectIds, Refusal, StatusCodes, ns0
from ua_fleet.endpoint.users import Role, current_user
from ua_fleet.nodes.pubsub_nodes import PubSubNodes
from ua_fleet.operation.pubsub.bridges import AnnouncedConnection, MetaDataOf, key_of
from ua_fleet.operation.pubsub.connections import Resets, ServerConnection, ServerFacts, state_counters
from ua_fleet.operation.pubsub.description import Description, Diagnostics, small_counts
from ua_fleet.operation.pubsub.further import FurtherConnection
from ua_fleet.operation.pubsub.root import describe_root
from ua_fleet.operation.pubsub.told import ToldDiagnostics
from ua_fleet.pubsub.application import MQTT_JSON, MQTT_UADP, UDP_UADP
from ua_fleet.pubsub.components import CONNECTION, Component, Components
from ua_fleet.pubsub.events import ActionReceived, AnnouncementReceived, SubscriberEvent
from ua_fleet.server.bridge_switches import BridgeSwitchRequests
from ua_fleet.topics import Topic
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.messages import ProbeKind

__all__ = ["PubSubModel"]

PERIOD_S: Final = 1.0
LOOK_S: Final = 10.0
"""How often bridges are asked for what they send and have not announced, or whether they are there, where they send no
status."""
_ENABLE: Final = ns0(ObjectIds.PubSubStatusType_Enable)
_DISABLE: Final = ns0(ObjectIds.PubSubStatusType_Disable)
_RESET: Final = ns0(ObjectIds.PubSubDiagnosticsType_Reset)
_RESET_ROOT: Final = ns0(ObjectIds.PublishSubscribe_Diagnostics_Reset)
_ROOT: Final = ns0(ObjectIds.PublishSubscribe)

_log: Any = structlog.get_logger("ua_fleet.server")


class PubSubModel:
    """See the module; `server.attached.ModelPart`."""

    def __init__(
        self,
        server: HardenedServer,
        ns: int,
        facts: ServerFacts,
        bridges: Mapping[str, int],
        *,
        further: Mapping[str, Sequence[str]] = MappingProxyType({}),
        status_topics: Mapping[str, Topic],
        requests: BridgeSwitchRequests,
        is_heard: Callable[[str], bool],
        hear: Callable[[Sequence[SubscriberEvent]], None],
        send: Callable[[bytes], None],
        clock: Callable[[], float],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Make the nodes of a server that is not started yet.

        Args:
            server: gets the Methods.
            ns: namespace of the ids.
            facts: of the server's own PubSubConnection.
            bridges: the spaces of the bridges by their names.
            further: the names of the connections that each bridge, or the server under the empty name, has besides one.
            status_topics: of the bridges that tell of themselves, by name.
            requests: ask a bridge.
            is_heard: whether a bridge is heard.
            hear: takes what the end of DataSetReaders brings.
            send: sends a plain message.
            clock: monotonic seconds.
            wall_ticks: the wall clock.
        """
        self._facts, self._is_heard, self._requests = facts, is_heard, requests
        self._hear, self._send, self._clock, self._wall_ticks = hear, send, clock, wall_ticks
        self._resets = Resets()
        self.own = ServerConnection(facts, self._resets)
        subscriber = facts.subscriber

        def metadata(topic: Topic) -> Any:
            heard = subscriber.writers.get(topic)
            return None if heard is None else heard.metadata

        self.bridges: dict[int, AnnouncedConnection] = {}
        self._told: dict[int, ToldDiagnostics] = {}
        for name, space_id in bridges.items():
            self._show_bridge(name, space_id, status_topics.get(name), metadata)
        self._were_heard: set[int] = set()
        self._look_at = clock() + LOOK_S
        space = server.iserver.aspace
        firsts: dict[str, ServerConnection | AnnouncedConnection] = {"": self.own}
        firsts |= {name: self.bridges[each] for name, each in bridges.items()}
        self._further = [
            FurtherConnection(first, connection, number)
            for name, first in firsts.items()
            for number, connection in enumerate(further.get(name, ()), 1)
        ]
        self.nodes = PubSubNodes(space, NodeBuilder(space), ns, [self.own, *self.bridges.values(), *self._further])
        self.nodes.fill_root(_ROOT, self._root())
        self._next_at = clock()
        self._link(server)

        async def tell() -> None:
            await self.nodes.tell()

        server.context.housekeeping.append(tell)

    def _show_bridge(self, name: str, space: int, status: Topic | None, metadata: MetaDataOf) -> None:
        heard = self._facts.subscriber.writers

        def is_heard() -> bool:
            return self._is_heard(name)

        told = self._told[space] = ToldDiagnostics(
            key_of(name),
            lambda: None if status is None else heard.get(status),
            is_heard,
            partial(self._facts.address, space),
            self._resets,
        )
        self.bridges[space] = AnnouncedConnection(
            name, space, metadata=metadata, is_heard=is_heard, told=told, status=status
        )

    def _link(self, server: HardenedServer) -> None:
        for method, call in ((_ENABLE, self._enable), (_DISABLE, self._disable), (_RESET, self._reset)):
            server.link_method(server.get_node(method), call)
            server.require_role(method, Role.ENGINEER)
        server.link_method(server.get_node(_RESET_ROOT), self._reset_root)
        server.require_role(_RESET_ROOT, Role.ENGINEER)
        server.context.waiting_methods.update((_ENABLE, _DISABLE))

    # What the core brings.

    def follow(self, event: SubscriberEvent) -> None:
        """Take what bridges announce."""
        if isinstance(event, AnnouncementReceived):
            announcement = event.announcement
            if isinstance(announcement, ActionMetaDataAnnouncement):
                self._requests.announced(announcement)
                self._ask_who_is_silent(announcement)
            publisher_id = announcement.publisher_id
            if isinstance(publisher_id, int) and (bridge := self.bridges.get(publisher_id)) is not None:
                bridge.heard(announcement, self._clock(), is_fresh=event.is_fresh)

    def _ask_who_is_silent(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Ask a bridge for its PubSubConnection that is not known, and perhaps Disabled.

        Such a bridge sends nothing else, so it never counts as heard; without this nobody could enable it again.
        """
        space = announcement.publisher_id
        if isinstance(space, int) and (bridge := self.bridges.get(space)) is not None and not bridge.is_announced:
            self._facts.subscriber.want(space, ProbeKind.PUBSUB_CONNECTIONS, self._clock())

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        self._requests.receive(event, now)

    def poll(self, now: float) -> None:
        """Ask bridges that have come for their configuration, and show what has changed."""
        self._requests.commands.poll(now)
        if now < self._next_at:
            return
        self._next_at = now + PERIOD_S
        must_look = now >= self._look_at
        if must_look:
            self._look_at = now + LOOK_S
        for space, bridge in self.bridges.items():
            bridge.look(now)
            if not self._is_heard(bridge.name):
                self._were_heard.discard(space)
                if must_look and bridge.is_muted:
                    self._facts.subscriber.want(space, ProbeKind.PUBSUB_CONNECTIONS, now)
            elif space not in self._were_heard:
                self._were_heard.add(space)
                self._facts.subscriber.want(space, ProbeKind.PUBSUB_CONNECTIONS, now)
                self._requests.want(bridge.name)
            elif must_look and bridge.is_announced and bridge.lacks(self._sent_by(space)):
                self._facts.subscriber.want(space, ProbeKind.DATA_SET_WRITER_CONFIGURATION, now)
        self.own.look()
        self.nodes.refresh()

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next."""
        del now
        asked = self._requests.commands.next_deadline()
        return self._next_at if asked is None else min(asked, self._next_at)

    def _sent_by(self, space: int) -> Iterator[Topic]:
        """The sources that a bridge was heard to send; those that others send in its place have another key."""
        return (
            each.topic for topic, each in self._facts.subscriber.writers.items() if topic[0] == space == each.key[0]
        )

    # Methods.

    async def _enable(self, parent: ua.NodeId) -> list[ua.Variant]:
        return await self._switch(parent, is_enabled=True)

    async def _disable(self, parent: ua.NodeId) -> list[ua.Variant]:
        return await self._switch(parent, is_enabled=False)

    async def _switch(self, parent: ua.NodeId, *, is_enabled: bool) -> list[ua.Variant]:
        found = self.nodes.component(parent, "Status")
        # The type has the Methods too, but no state; a further connection has a state, but no Methods.
        if found is None or isinstance(found[0], FurtherConnection):
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no component of PubSub")
        connection, component = found
        if isinstance(connection, AnnouncedConnection):
            await self._requests(connection.name, component, is_enabled=is_enabled)
            if connection.has(component):
                connection.switched(component, is_enabled=is_enabled)
        else:
            self._switch_own(component, is_enabled=is_enabled)
        user = current_user.get()
        _log.warning(
            "PubSub was switched",
            component=str(parent.Identifier).removesuffix(".Status"),
            state="enabled" if is_enabled else "disabled",
            by=user.name if user is not None else "",
        )
        return []

    def _switch_own(self, component: Component, *, is_enabled: bool) -> None:
        publisher, subscriber = self._facts.publisher, self._facts.subscriber
        now = self._clock()
        datagrams: list[bytes] = []
        is_reader = component[:1] == ("R",)
        if is_enabled:
            if not is_reader:
                datagrams = publisher.switches.enable(component, now=now)
            if is_reader or component == CONNECTION:
                subscriber.enable(component)
        else:
            if not is_reader:
                datagrams = publisher.switches.disable(component, timestamp=self._wall_ticks(), now=now)
            if is_reader or component == CONNECTION:
                self._hear(subscriber.disable(component))
        for datagram in datagrams:
            self._send(datagram)

    async def _reset(self, parent: ua.NodeId) -> list[ua.Variant]:
        found = self.nodes.component(parent, "Diagnostics")
        if found is None:
            raise Refusal(StatusCodes.BadNodeIdInvalid, "no component of PubSub")
        connection, component = found
        if isinstance(connection, FurtherConnection):
            if not connection.reset(component):
                raise Refusal(StatusCodes.BadNodeIdInvalid, "nothing is counted there")
        elif not isinstance(connection, AnnouncedConnection):
            self.own.reset(component)
        elif not self._told[connection.space].reset(component):
            raise Refusal(StatusCodes.BadNodeIdInvalid, "the bridge counts nothing there")
        return []

    async def _reset_root(self, _parent: ua.NodeId) -> list[ua.Variant]:
        return []  # its counters are those of its state, which never changes

    def _root(self) -> Description:
        own = self.own
        live = {
            **small_counts(own.configured, own.operational, "DataSetWriters"),
            **small_counts(lambda: own.all_readers()[0], lambda: own.all_readers()[1], "DataSetReaders"),
        }

        def has_failed() -> bool:
            return bool(own.diagnostics(CONNECTION).total(errors=True)) or any(
                connection.has_failed() for connection in self._further
            )

        return describe_root(
            [UDP_UADP, MQTT_UADP, MQTT_JSON],
            Diagnostics(state_counters(Components(), CONNECTION), live, has_failed),
        )
