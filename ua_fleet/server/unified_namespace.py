"""The Unified Namespace of a server: feeds `ua_fleet.uns`, and carries it to its broker."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import structlog

from ua_fleet.config.namespace_schema import UnifiedNamespaceConfig
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.fleet.changes import Change, RobotAdded, RobotRemoved, ValueChanged
from ua_fleet.fleet.commands import Publication
from ua_fleet.fleet.model import RobotModel, RobotState
from ua_fleet.fleet.summaries import SummaryRecord
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.namespace_nodes import NamespaceFigures, NamespaceNodes
from ua_fleet.transport.mqtt.address import parse_broker_url
from ua_fleet.transport.mqtt.credentials import Credentials
from ua_fleet.uns.namespace import Namespace
from ua_fleet.uns.topics import NamespaceTopics

if TYPE_CHECKING:
    from ua_fleet.transport.mqtt.transport import MqttTransport

__all__ = ["NamespacePublisher", "make_namespace"]

PERIOD_S: Final = 1.0
"""Of the figures."""
_LOOP: Final = "Unified Namespace"
"""By this name its mistakes are counted."""
_log: Any = structlog.get_logger("ua_fleet.server")


class NamespacePublisher:
    """A part of the server (`server.attached.NamespacePart`), and of its timetable."""

    def __init__(
        self, namespace: Namespace, transport: MqttTransport, url: str, nodes: NamespaceNodes, mistakes: Mistakes
    ) -> None:
        """Connect them.

        Args:
            namespace: with the robots that there are.
            transport: of the broker, not started yet.
            url: of the broker.
            nodes: show how it stands.
            mistakes: counts what has cost a value.
        """
        transport.carry(namespace)
        self._namespace, self._transport, self._url = namespace, transport, url
        self._nodes, self._mistakes = nodes, mistakes
        self._loop = asyncio.get_running_loop()
        self._counters = Counters()
        self._pump_is_due = False
        self._next_at = 0.0

    async def start(self) -> None:
        """Connect from now on; a broker that is away is waited for."""
        await self._transport.start(lambda _datagram, _sender: None)

    async def close(self) -> None:
        """Say that nothing is of now any more, as far as the broker takes it in a second, and disconnect."""
        self._namespace.end()
        await self._transport.close()

    @property
    def problem(self) -> str:
        """Why nothing is published; empty while it is."""
        return self._transport.stats.problem

    @property
    def counters(self) -> Counters:
        """What was not published, by cause."""
        self._transport.stats.count_drops(self._counters)
        return self._counters

    @property
    def figures(self) -> NamespaceFigures:
        """How it stands now."""
        problem, namespace = self.problem, self._namespace
        return NamespaceFigures(
            not problem, problem or self._url, namespace.topics, namespace.waiting, namespace.published
        )

    # What the server tells.

    def value_changed(self, change: ValueChanged) -> None:
        """See NamespacePart."""
        try:
            self._namespace.changed(change, self._loop.time())
        except Exception as error:  # noqa: BLE001 - the server goes on without this value here
            self._mistakes.caught(_LOOP, error, node=str(change.key))
        self._pump_soon()

    def changed(self, change: Change) -> None:
        """See NamespacePart."""
        with self._mistakes.guard(_LOOP):
            if isinstance(change, RobotAdded):
                self._namespace.add(change.robot)
            elif isinstance(change, RobotRemoved):
                self._namespace.remove(change.robot.name)
            else:
                return
        self._pump_soon()

    def written(self, publication: Publication) -> None:
        """See NamespacePart."""
        topic, types, values, ticks = publication
        with self._mistakes.guard(_LOOP, topic=topic.name):
            self._namespace.written(topic, types, values, ticks, self._loop.time())
        self._pump_soon()

    def told(self, summary: SummaryRecord) -> None:
        """How a robot stands."""
        with self._mistakes.guard(_LOOP, robot=summary.name):
            state = RobotState(summary.state).name.lower()
            self._namespace.told(summary.name, state, summary.task, summary.fault)
        self._pump_soon()

    # Time: see TimedPart.

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next."""
        del now
        due = self._namespace.next_deadline()
        return self._next_at if due is None else min(due, self._next_at)

    def poll(self, now: float) -> None:
        """Publish the values whose turn has come, and show the figures."""
        self._namespace.poll(now)
        self._pump()
        if now >= self._next_at:
            self._next_at = now + PERIOD_S
            self._nodes.show(self.figures, self.counters.drops)

    def _pump_soon(self) -> None:
        """Publish what has changed in the next turn of the event loop, all of it together."""
        if not self._pump_is_due:
            self._pump_is_due = True
            self._loop.call_soon(self._pump)

    def _pump(self) -> None:
        self._pump_is_due = False
        with self._mistakes.guard(_LOOP):
            self._transport.pump()


def make_namespace(
    config: FleetConfig,
    folder: Path,
    robots: Iterable[RobotModel],
    nodes: Callable[[], NamespaceNodes],
    mistakes: Mistakes,
    wall_ticks: Callable[[], int],
) -> NamespacePublisher | None:
    """The Unified Namespace of a fleet; None where none is configured.

    Args:
        config: of the fleet.
        folder: of `fleet.yaml`, to which its files are relative.
        robots: that are there.
        nodes: makes the nodes that show how it stands.
        mistakes: of the server.
        wall_ticks: the wall clock.

    Raises:
        TransportError: a file of the broker's cannot be used.
    """
    section = config.unified_namespace
    if section is None:
        return None
    from ua_fleet.transport.mqtt.transport import MqttTransport

    namespace = Namespace(
        NamespaceTopics(section.topic, section.site, config.fleet.name),
        section.payload,
        rate_hz=section.rate_hz,
        expiry_s=section.expiry_s,
        max_payload_bytes=section.max_payload_bytes,
        wall_ticks=wall_ticks,
    )
    for robot in robots:
        namespace.add(robot)
    transport = MqttTransport(
        section.url,
        credentials=_credentials(section, folder),
        more_urls=section.broker.nodes,
        client_id=f"ua-fleet-{config.fleet.name}-namespace",
    )
    return NamespacePublisher(namespace, transport, section.url, nodes(), mistakes)


def _credentials(section: UnifiedNamespaceConfig, folder: Path) -> Credentials:
    broker, has_tls = section.broker, parse_broker_url(section.url).has_tls
    if not has_tls:
        _log.warning("the Unified Namespace goes without TLS: who sees the network reads all values", url=section.url)
    return Credentials.read(
        folder,
        user=broker.user,
        password_file=broker.password_file,
        ca_file=broker.ca_file,
        certificate_file=broker.certificate_file,
        key_file=broker.key_file,
        has_tls=has_tls,
        section="unified_namespace.broker",
    )
