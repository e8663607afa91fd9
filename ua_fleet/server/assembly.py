"""One server put together: the core's ground, its parts with what clients see of them, and the hub.

Parts are made before the hub, since it is given them; what they ask of it is looked up when they ask.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.config.connections import unstartable
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import weaknesses
from ua_fleet.endpoint.certificates import CertificateInfo
from ua_fleet.endpoint.expiry import CertificateWatch
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.fleet.commands import Publication
from ua_fleet.fleet.model import FleetModel
from ua_fleet.fleet.summaries import SummaryRecord
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring import Monitor
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.change_events import tell_capacities
from ua_fleet.nodes.client_writes import ClientWrites
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.namespace_nodes import NamespaceNodes
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.recent_message_methods import RecentMessageMethods
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.nodes.skill_events import tell_transition
from ua_fleet.nodes.skill_methods import SkillMethods
from ua_fleet.nodes.summary_nodes import SummaryNodes
from ua_fleet.nodes.wanted_data import WantedData
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.operation.robots.offers import ClientOffers
from ua_fleet.operation.robots.roster import RobotRegistry
from ua_fleet.operation.runs.activity import RobotActivities
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.skills.router import SkillRouter
from ua_fleet.operation.skills.tracker import SkillChange, SkillTransitioned
from ua_fleet.pubsub.recent import RecentMessages
from ua_fleet.pubsub.subscriber import LoopRule
from ua_fleet.server.alarm_setup import certificate_alarms, make_alarms
from ua_fleet.server.attached import Clocked, Ground, HistoryPart, NoHistory, NoNamespace, Parts, TimedPart
from ua_fleet.server.figures import ServerFigures
from ua_fleet.server.ground import PubSubEnds, make_ground
from ua_fleet.server.history import HistoryService
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.pubsub_model import PubSubModel
from ua_fleet.server.pubsub_setup import make_pubsub_model
from ua_fleet.server.robot_setup import connect_roster, make_offers
from ua_fleet.server.run_log import RunLog
from ua_fleet.server.scenario_setup import make_scenarios
from ua_fleet.server.skill_ends import SkillEnds
from ua_fleet.server.teleoperation.service import TeleoperationService
from ua_fleet.server.teleoperation.setup import make_teleoperation
from ua_fleet.server.timer import Timer
from ua_fleet.server.unified_namespace import NamespacePublisher, make_namespace
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.transport.base import Transport
from ua_fleet.transport.sealed import Sent

__all__ = ["Assembly", "Given"]

_log: Final[Any] = structlog.get_logger("ua_fleet.server")


@dataclass(frozen=True, slots=True)
class Given:
    """What a server is put together from."""

    config: FleetConfig
    """The checked `fleet.yaml`."""
    config_dir: Path
    """Its folder."""
    model: FleetModel
    """Of the configuration, with the robots of the roster."""
    server: HardenedServer
    """The OPC UA endpoint, with its types loaded."""
    nodes: FleetNodes
    """Of the model, built."""
    roster: RobotRegistry
    records: ServerRecords
    monitor: Monitor
    """Tells of the server."""
    keys: KeySource | None
    """Where the keys of message security come from."""
    history: HistoryService | None = None
    """What is kept of values."""


class Assembly:
    """The parts of one server. It is not started yet."""

    def __init__(
        self, given: Given, transports: Transport | Sequence[Transport], rule: LoopRule, sent: Sent | None
    ) -> None:
        """Put a server together.

        Args:
            given: what is there.
            transports: one for each of the server's connections, not started yet.
            rule: the loop rule.
            sent: told of each message that is sent.

        Raises:
            ConfigError: no key source is configured, or what stands in the state folder cannot be used.
            StorageUnavailable: a file in which the server records something cannot be read.
        """
        config, server = given.config, given.server
        for line in (*weaknesses(config), *unstartable(config)):
            _log.warning(line)
        self._given, self._config, self._server, self._nodes = given, config, server, given.nodes
        self._mistakes, self._timer = given.monitor.mistakes, Timer()
        self._clock = asyncio.get_running_loop().time
        self._history: HistoryPart = given.history or NoHistory()
        if given.history is not None:
            given.history.sooner = self._timer.sooner
        self._state_dir = given.config_dir / config.server.state_dir
        self._ends, self._run_log, self._activities = SkillEnds(given.monitor), RunLog(), RobotActivities()
        self._pubsub = PubSubEnds(config, self._state_dir, transports, self._clock, sent)
        self.ground = self._make_ground(rule)
        self._events = ServerEvents(server.iserver)
        self._projection = self._make_projection()
        self.teleoperation = self._make_teleoperation()
        self.namespace = self._make_namespace()
        offers = make_offers(self._hub, given.records.executions)
        requests = SkillRouter(self.ground.skills, offers)
        methods = self._make_methods(requests)
        self._scenarios, self._carried, view = self._make_scenarios(requests)
        self.alarms = self._make_alarms(view)
        connect_roster(
            given.roster,
            offers,
            server,
            self._hub,
            self.ground,
            given.nodes,
            self._projection,
            methods,
            self._scenarios,
        )
        self.hub = self._make_hub(offers)
        for robot in given.roster:
            offers.follow(robot)
        server.context.mistakes = self._mistakes
        server.gate = ClientWrites(
            self.ground.commands,
            given.nodes,
            self.hub.publish,
            self.hub.flush_soon,
            wall_ticks,
            self._history.record,
        )

    def tell_monitor(self) -> None:
        """Have the monitor tell of the server: it serves."""
        figures = ServerFigures(
            self.hub,
            self.ground,
            self._server,
            self._scenarios,
            self._run_log,
            self._ends,
            self.namespace,
            self._given.history,
            self.alarms,
        )
        figures.tell(self._given.monitor)

    # What parts ask of the hub.

    def _hub(self) -> Hub:
        return self.hub

    def _concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self.hub.concluded(execution_id, outcome)

    def _show_skills(self, changes: Iterable[SkillChange]) -> None:
        self.hub.show_skills(changes)

    def _publish(self, publication: Publication) -> None:
        self.hub.publish(publication)

    # The parts.

    def _make_ground(self, rule: LoopRule) -> Ground:
        return make_ground(
            self._config,
            self._given.model,
            self._pubsub,
            self._given.records.requests,
            self._mistakes,
            rule=rule,
            told=self._concluded,
            sooner=self._timer.sooner,
            clock=self._clock,
            wall_ticks=wall_ticks,
        )

    def _make_projection(self) -> Projection:
        def tell_skill(change: SkillTransitioned) -> None:
            self._ends.moved(change)
            tell_transition(self._events, change)

        return Projection(
            self._nodes,
            tell=tell_skill,
            tell_capacities=lambda change, gained, lost: tell_capacities(
                self._events, change, gained, lost, wall_ticks()
            ),
            sooner=self._timer.sooner,
            mistakes=self._mistakes,
        )

    def _make_teleoperation(self) -> TeleoperationService:
        def driven(robot: str, told: str) -> None:
            self.hub.set_driven(robot, told)
            self._scenarios.driven(robot, told and f"is {told}")

        return make_teleoperation(
            self._given.model,
            self._server,
            self.ground,
            self._timer,
            self._projection,
            driven,
            must_be_verified=self._pubsub.connections.must_be_verified,
        )

    def _make_namespace(self) -> NamespacePublisher | None:
        factory = NodeFactory(self._server.iserver.aspace, self._nodes.ns)
        factory.values = self._nodes.values
        return make_namespace(
            self._config,
            self._given.config_dir,
            self._given.model.robots,
            lambda: NamespaceNodes(factory, self._projection.write, wall_ticks),
            self._mistakes,
            wall_ticks,
        )

    def _make_methods(self, requests: SkillRouter) -> SkillMethods:
        methods = SkillMethods(
            self._server,
            requests,
            self.ground.tracker,
            put=self._show_skills,
            clock=self._clock,
            wall_ticks=wall_ticks,
            driven_by=self.teleoperation.driven_by,
        )
        for robot in self._given.model.robots:
            methods.add(robot)
        return methods

    def _make_scenarios(self, requests: SkillRouter) -> tuple[ScenarioService, CarriedRuns, ScenarioView]:
        return make_scenarios(
            self._config,
            self._given.model,
            self._server,
            self._hub,
            self.ground,
            self._timer,
            self._nodes,
            self._given.records.runs,
            self._projection,
            self._given.config_dir / self._config.scenarios.folder,
            requests,
            self._run_log,
            self._activities,
            must_be_verified=self._pubsub.connections.must_be_verified,
        )

    def _make_alarms(self, view: ScenarioView) -> AlarmService:
        factory = NodeFactory(self._server.iserver.aspace, self._nodes.ns)
        factory.values = self._nodes.values
        return make_alarms(
            self._config,
            self._given.model,
            self._server,
            factory,
            self._events,
            self._projection,
            self._timer,
            self._given.records.alarms,
            self._scenarios,
            view,
            self._carried,
        )

    def _tell_certificates(self, found: Sequence[tuple[CertificateInfo, str]]) -> None:
        self.alarms.certificates(certificate_alarms(found))

    def _make_hub(self, offers: ClientOffers) -> Hub:
        recent = RecentMessages()
        RecentMessageMethods(
            self._server,
            NodeFactory(self._server.iserver.aspace, self._nodes.ns),
            recent,
            is_encrypted=self._pubsub.envelopes.are_encrypted,
        ).build()
        parts = Parts(
            nodes=self._projection,
            runs=self._scenarios,
            teleoperation=self.teleoperation,
            registry=self._given.roster,
            wanted=self._make_wanted(),
            model=self._make_model(),
            namespace=self.namespace or NoNamespace(),
            history=self._history,
            carried=self._carried,
            alarms=self.alarms,
            timed=self._make_timed(offers),
        )
        return Hub(
            self._config,
            self._pubsub,
            self.ground,
            parts,
            timer=self._timer,
            recent=recent,
            mistakes=self._mistakes,
            keys=self._given.keys,
        )

    def _make_model(self) -> PubSubModel:
        return make_pubsub_model(
            self._config,
            self._server,
            self._nodes.ns,
            self.ground,
            self._pubsub,
            self._timer,
            self._hub,
        )

    def _make_wanted(self) -> WantedData:
        return WantedData(
            self._given.model.bridges,
            lambda: self.ground.state.robots,
            self._nodes.values,
            self._scenarios.needed_values,
            publish=self._publish,
            clock=self._clock,
            wall_ticks=wall_ticks,
        )

    def _make_timed(self, offers: ClientOffers) -> dict[str, TimedPart]:
        factory = NodeFactory(self._server.iserver.aspace, self._nodes.ns)
        factory.values = self._nodes.values
        put = self._projection.write
        timed: dict[str, TimedPart] = {}
        told: Callable[[SummaryRecord], None] | None = None
        if self.namespace is not None:
            timed["Unified Namespace"], told = self.namespace, self.namespace.told
        state, activities = self.ground.state, self._activities
        summaries = SummaryNodes(factory, state, activities, put, wall_ticks, self._mistakes, told)
        summaries.build()
        mistakes = self._nodes.show_mistakes(self._mistakes, put, self._clock, wall_ticks)
        return timed | {
            "ClientOffers": Clocked(offers),
            "summaries": summaries,
            "CertificateWatch": Clocked(CertificateWatch(self._state_dir, self._clock, found=self._tell_certificates)),
            "MistakeNodes": Clocked(mistakes),
        }
