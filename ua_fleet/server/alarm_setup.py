"""Alarms of values put together with what clients see of them."""

from __future__ import annotations

import asyncio
import secrets
import time

import structlog

from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.fleet.model import FleetModel
from ua_fleet.nodes.alarm_nodes import AlarmNodes
from ua_fleet.nodes.condition_methods import ConditionMethods
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.alarms.configured import alarm_definitions
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.clock import steady
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.server.timer import Timer
from ua_fleet.storage.alarm_states import AlarmStates

__all__ = ["make_alarms"]


def make_alarms(
    config: FleetConfig,
    model: FleetModel,
    server: HardenedServer,
    factory: NodeFactory,
    events: ServerEvents,
    projection: Projection,
    timer: Timer,
    states: AlarmStates,
    scenarios: ScenarioService,
    view: ScenarioView,
    carried: CarriedRuns,
) -> AlarmService:
    """Let a server have alarms; it is not started yet.

    Args:
        config: the fleet's.
        model: of its nodes, which are built.
        server: gets the nodes and Methods.
        factory: of nodes.
        events: makes events.
        projection: writes values to nodes.
        timer: is to call what is due.
        states: of alarms, as they are kept.
        scenarios: told of alarms that are faults.
        view: of faults and dialogs, which have the same Methods.
        carried: runs that bridges carry.

    Raises:
        StorageUnavailable: the states cannot be read.
    """
    nodes = AlarmNodes(factory, events, projection)
    nodes.build()
    alarms = AlarmService(
        alarm_definitions(config, model),
        states,
        notify=nodes.notify,
        found=scenarios.alarms_found,
        make_event_id=lambda: secrets.token_bytes(16),
        wall_s=steady(asyncio.get_running_loop().time, time.time),
        sooner=timer.sooner,
        log=structlog.get_logger("ua_fleet.alarms"),
    )
    for condition in alarms:
        nodes.add(condition)
    scenarios.alarms_restored(alarms.faults())
    ConditionMethods(server, view, scenarios, nodes, alarms, carried).build()
    return alarms
