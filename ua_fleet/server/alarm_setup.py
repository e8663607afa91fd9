"""Alarms of values put together with what clients see of them."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Iterable, Iterator
from typing import Final

import structlog

from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.certificates import CertificateInfo
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.stack import ObjectIds
from ua_fleet.fleet.model import FleetModel
from ua_fleet.nodes.alarm_nodes import AlarmNodes
from ua_fleet.nodes.condition_methods import ConditionMethods
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.alarms.configured import alarm_definitions
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind, WatchedCertificate
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.clock import steady
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.server.timer import Timer
from ua_fleet.storage.alarm_states import AlarmStates
from ua_fleet.validity import WARN_DAYS
from ua_fleet.values import NodeId

__all__ = ["certificate_alarms", "make_alarms"]

_SERVER: Final = NodeId(0, int(ObjectIds.Server))
_DAY_S: Final = 24 * 3600.0


def certificate_alarms(found: Iterable[tuple[CertificateInfo, str]]) -> Iterator[AlarmDefinition]:
    """The alarms of certificates, with what is to be said of each."""
    for info, notice in found:
        try:
            der = info.path.read_bytes()
        except OSError:  # it has gone since it was listed
            continue
        name = f"{info.state.value}.{info.path.stem}"
        certificate = WatchedCertificate(
            der, info.validity.end.timestamp(), WARN_DAYS * _DAY_S, f"{notice}; {info.renewal}" if notice else ""
        )
        yield AlarmDefinition(
            id=f"certificates.{name}",
            kind=AlarmKind.CERTIFICATE,
            source=_SERVER,
            source_name=f"certificate {name}",
            watched=None,
            certificate=certificate,
        )


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
    server.context.housekeeping.append(nodes.tell)
    alarms = AlarmService(
        alarm_definitions(config, model),
        states,
        notify=nodes.notify,
        found=scenarios.news.alarms_found,
        make_event_id=lambda: secrets.token_bytes(16),
        wall_s=steady(asyncio.get_running_loop().time, time.time),
        sooner=timer.sooner,
        log=structlog.get_logger("ua_fleet.alarms"),
    )
    for condition in alarms:
        nodes.add(condition)
    alarms.added = nodes.add
    scenarios.news.alarms_restored(alarms.faults())
    ConditionMethods(server, view, scenarios, nodes, alarms, carried).build()
    view.show_questions()
    return alarms
