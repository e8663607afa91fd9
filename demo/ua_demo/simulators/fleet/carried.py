"""A run that the bridges carry, as the server has it: the parts of the real one, without disk and nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from ua_demo.simulators.fleet.memory import MemoryDatabase
from ua_demo.simulators.fleet.processes import Place, nothing, wall_ticks
from ua_demo.simulators.fleet.server import CHECK_S, OPERATOR, RUN_ID, Unread
from ua_fleet.bridge.carry import CarryFactory
from ua_fleet.carrier import carrier_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.fleet.model import FleetModel
from ua_fleet.operation.runs.carried import FOLLOW_S, CarriedRuns
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.skills.commands import JOURNALED_PACE, SkillCommands
from ua_fleet.orchestrator import Output, RunChanged
from ua_fleet.pubsub.carry_action import carry_topic
from ua_fleet.pubsub.events import ActionReceived, SubscriberEvent
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.scenario import Scenario
from ua_fleet.server.attached import CarriedPart, Ground, Parts
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.storage.carried_records import CARRIED_TABLES, CarriedRecords
from ua_fleet.storage.journal import EXECUTION_TABLES
from ua_fleet.storage.request_journal import REQUEST_TABLES
from ua_fleet.storage.run_journal import RUN_TABLES, RunJournal
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND, UNIX_EPOCH_TICKS
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["carried_parts", "carrier_in_memory"]

_NOWHERE: Final = Path("/nonexistent")
_BEGAN_S: Final = (wall_ticks(0.0) - UNIX_EPOCH_TICKS) / TICKS_PER_SECOND
"""The wall clock at time 0, in seconds since 1970."""


def carrier_in_memory(config: FleetConfig, name: str) -> CarryFactory:
    """What makes who carries runs in a bridge, with its records in memory."""
    return carrier_of(config, name, _NOWHERE, lambda: CarriedRecords(MemoryDatabase(CARRIED_TABLES)))


def carried_parts(
    config: FleetConfig,
    model: FleetModel,
    scenario: Scenario,
    place: Place,
    show: Callable[[Output], None],
    ground: Ground,
) -> Parts:
    """What has a fleet carry a scenario.

    Args:
        config: the fleet.
        model: its robots.
        scenario: what is run.
        place: where the server lives.
        show: told of everything that happens, in seconds of its clock.
        ground: of the server.
    """
    service = _service_of(config, model, place, show, ground)
    runs = _runs_of(config, service, place, ground)
    ns = config.fleet.namespace_index
    actions = [carry_topic(bridge.space, ns) for bridge in config.bridges.values()]
    return Parts(runs=service, carried=_OneRun(runs, scenario, actions, ground.skills, place.clock))


def _service_of(
    config: FleetConfig, model: FleetModel, place: Place, show: Callable[[Output], None], ground: Ground
) -> ScenarioService:
    """What shows runs, with its journal in memory."""

    def shown(output: Output) -> None:
        if isinstance(output, RunChanged):
            fact: Any = output.fact
            output = replace(output, fact=replace(fact, at=fact.at - _BEGAN_S))
        show(output)

    service = ScenarioService(
        config,
        model,
        RunJournal(MemoryDatabase((*RUN_TABLES, *REQUEST_TABLES, *EXECUTION_TABLES))),
        ground.skills,
        folder=_NOWHERE,
        show=shown,
        forgotten=lambda _run_id: None,
        requested=lambda _node, _execution_id: None,
        sooner=nothing,
        clock=place.clock,
        wall_s=lambda: _BEGAN_S + place.clock(),
        mistakes=ground.mistakes,
        log=Unread(),
    )
    service.restore()
    return service


def _runs_of(config: FleetConfig, service: ScenarioService, place: Place, ground: Ground) -> CarriedRuns:
    """What gives bridges their parts, and follows."""
    return CarriedRuns(
        config,
        service,
        partial(
            SkillCommands,
            MemoryJournal(),
            send=ground.send,
            want=ground.subscriber.want_action,
            sooner=nothing,
            wall_ticks=place.wall_ticks,
            must_be_verified=True,
            clock=place.clock,
            log=Unread(),
            pace=JOURNALED_PACE,
        ),
        reserve=service.driven,
        sooner=nothing,
        clock=place.clock,
        wall_s=lambda: _BEGAN_S + place.clock(),
        mistakes=ground.mistakes,
        log=Unread(),
        new_id=lambda _now: RUN_ID,
        follow_s=FOLLOW_S * place.timing.keep_alive_s / PubSubTiming().keep_alive_s,
    )


class _OneRun(CarriedPart):
    """One run, as soon as all bridges can be asked."""

    def __init__(
        self,
        runs: CarriedRuns,
        scenario: Scenario,
        actions: list[Topic],
        skills: SkillCommands,
        clock: Callable[[], float],
    ) -> None:
        self._runs, self._scenario, self._skills, self._clock = runs, scenario, skills, clock
        self._missing = actions
        self._begin_at: float | None = CHECK_S

    def follow(self, event: SubscriberEvent) -> None:
        """See CarriedPart."""
        self._runs.follow(event)

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """See CarriedPart."""
        self._runs.announced(announcement)

    def receive(self, event: ActionReceived, now: float) -> None:
        """See CarriedPart."""
        self._runs.receive(event, now)

    def poll(self, now: float) -> None:
        """See CarriedPart."""
        if self._begin_at is not None and now >= self._begin_at:
            self._begin_at = now + CHECK_S
            self._missing = [topic for topic in self._missing if self._skills.action(topic) is None]
            if not self._missing:
                self._begin_at = None
                self._runs.start(self._scenario, [], [], OPERATOR)
        self._runs.poll(now)

    def next_deadline(self, now: float) -> float | None:
        """See CarriedPart."""
        deadlines = self._runs.next_deadline(now), self._begin_at
        return min((deadline for deadline in deadlines if deadline is not None), default=None)
