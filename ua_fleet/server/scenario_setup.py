"""Runs of scenarios put together with what a server shows of them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import structlog

from ua_fleet.config.nodes import events_topic
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.turns import Places
from ua_fleet.fleet.model import FleetModel
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.carried_methods import CarriedMethods
from ua_fleet.nodes.decision_methods import DecisionMethods
from ua_fleet.nodes.dialogs import DialogNodes
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.place_nodes import add_places, places_of
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.published_events import PublishedEvents
from ua_fleet.nodes.robot_methods import RobotMethods
from ua_fleet.nodes.scenario_methods import ScenarioMethods
from ua_fleet.nodes.scenario_nodes import ScenarioNodes
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.runs.activity import RobotActivities
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.runs.task_calls import Requests
from ua_fleet.operation.skills.commands import JOURNALED_PACE, SkillCommands
from ua_fleet.orchestrator import Output, RunChanged
from ua_fleet.server.attached import Ground
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.run_log import RunLog
from ua_fleet.server.timer import Timer
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.storage.run_journal import RunJournal

__all__ = ["make_scenarios"]


def make_scenarios(
    config: FleetConfig,
    model: FleetModel,
    server: HardenedServer,
    hub: Callable[[], Hub],
    ground: Ground,
    timer: Timer,
    fleet: FleetNodes,
    journal: RunJournal,
    projection: Projection,
    folder: Path,
    requests: Requests,
    log: RunLog,
    activities: RobotActivities,
    *,
    must_be_verified: bool,
) -> tuple[ScenarioService, CarriedRuns, ScenarioView]:
    """Let a server run scenarios, and have bridges carry them; it is not started yet.

    Args:
        config: the fleet's.
        model: of its nodes.
        server: gets the nodes and Methods.
        hub: carries data; it is made later.
        ground: what is known of the fleet.
        timer: is to call what is due.
        fleet: the nodes that are there.
        journal: of runs and faults.
        projection: writes values to nodes.
        folder: of the scenarios' files.
        requests: asks robots.
        log: is told of everything that happens.
        activities: are, too.
        must_be_verified: only signed responses of bridges are taken.

    Raises:
        StorageUnavailable: the journal cannot be read.
    """
    parts = NodeFactory(server.iserver.aspace, model.ns)
    parts.values = fleet.values
    names = {bridge.space: name for name, bridge in config.bridges.items()}
    nodes = ScenarioNodes(parts, projection.write, wall_ticks, names)
    nodes.build()
    add_places(parts, places_of(config))
    topic = events_topic(config)
    published = None if topic is None else PublishedEvents(topic, lambda event: hub().publish_event(event))
    events = ServerEvents(server.iserver)
    dialogs = DialogNodes(parts, events, projection, wall_ticks)
    view = ScenarioView(nodes, events, projection, wall_ticks, published, dialogs)

    def show(output: Output) -> None:
        view.show(output)
        run = view.runs.get(output.run_id) if isinstance(output, RunChanged) else None
        activities.take(output, None if run is None else run.state)
        log.take(output)

    clock = asyncio.get_running_loop().time
    service = ScenarioService(
        config,
        model,
        journal,
        requests,
        folder=folder,
        show=show,
        forgotten=view.forget_run,
        requested=lambda key, execution_id: hub().show_skills(
            ground.tracker.requested(key, execution_id, wall_ticks())
        ),
        sooner=timer.sooner,
        clock=clock,
        wall_s=time.time,
        capacities=ground.state.capacities,
        mistakes=ground.mistakes,
        log=structlog.get_logger("ua_fleet.scenarios"),
        faulted=lambda robot, faulted: hub().set_faulted(robot, faulted),
    )
    records = service.restore()
    view.restored(records, [hold for hold in service.holds if hold.robot in service.robots])
    activities.restored(records, service.holds)
    view.show_settings(service.settings)
    log_of_runs = structlog.get_logger("ua_fleet.scenarios")
    carried = CarriedRuns(
        config,
        service,
        partial(
            SkillCommands,
            MemoryJournal(),
            send=ground.send,
            want=ground.subscriber.want_action,
            sooner=timer.sooner,
            wall_ticks=wall_ticks,
            must_be_verified=must_be_verified,
            clock=clock,
            log=log_of_runs,
            pace=JOURNALED_PACE,
        ),
        reserve=service.driven,
        sooner=timer.sooner,
        clock=clock,
        wall_s=service.wall_s,
        mistakes=ground.mistakes,
        log=log_of_runs,
    )
    background = Places()
    ScenarioMethods(server, parts, service, carried, background).build()
    DecisionMethods(server, parts, view, service, carried, background).build()
    CarriedMethods(server, parts, service, carried)
    RobotMethods(server, parts, service.holds)
    return service, carried, view
