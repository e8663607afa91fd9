"""What the server tells of itself: figures for Prometheus, and whether it is ready. It looks when it is asked."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from typing import Any, Final

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.subscriptions import ClientSubscription
from ua_fleet.fleet.model import RobotState
from ua_fleet.fleet.source import Source
from ua_fleet.monitoring import Monitor, metrics
from ua_fleet.monitoring.counted import counted, keys_left, transported
from ua_fleet.monitoring.metrics import MOST_ROBOTS, Family
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.scenario.facts import RunOutcome
from ua_fleet.server.attached import Ground
from ua_fleet.server.hub import Hub
from ua_fleet.server.run_log import RunLog
from ua_fleet.server.skill_ends import SkillEnds
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire.security import SecurityMode

__all__ = ["ServerFigures", "source_state"]

_SOURCE_STATES: Final = ("heard", "silent", "waiting", "refused")


def source_state(source: Source) -> str:
    """How a data source is, in one word."""
    if source.alive:
        return "heard"
    if source.is_refused:
        return "refused"
    return "silent" if source.newest >= 0 or source.lost else "waiting"


class ServerFigures:
    """Looks at the parts of a running server when it is asked."""

    def __init__(
        self,
        hub: Hub,
        ground: Ground,
        server: HardenedServer,
        scenarios: ScenarioService,
        runs: RunLog,
        ends: SkillEnds,
    ) -> None:
        self._hub, self._state, self._tracker, self._server = hub, ground.state, ground.tracker, server
        self._scenarios, self._runs, self._ends = scenarios, runs, ends

    def tell(self, monitor: Monitor) -> None:
        """Tell of the server from now on: it serves."""
        monitor.add(self.collect)
        monitor.ready_when(self.problem, self.text)

    def problem(self) -> str:
        """Why the server cannot do its work; empty while it can. That a bridge is away is said in `text`."""
        return self._hub.transport.stats.problem or self._hub.envelope.problem or self._scenarios.problem

    def text(self) -> str:
        """Where it serves, and which bridges are not heard."""
        heard = self._state.bridges_heard
        away = [name for name, is_heard in heard.items() if not is_heard]
        text = f"{self._server.endpoint.geturl()}, {len(heard) - len(away)} of {len(heard)} bridges heard"
        return f"{text}; not heard: {', '.join(away)}" if away else text

    def collect(self) -> Iterator[Family]:
        """All figures now."""
        hub = self._hub
        yield from counted(hub.counters, has_space=False)
        yield from transported(hub.transport.stats)
        if hub.envelope.mode is not SecurityMode.NONE:
            now = asyncio.get_running_loop().time()
            yield from keys_left(hub.envelope.keys_last_s(now), hub.keys_kept.source_problem)
        yield from self._fleet()
        yield from self._work()
        yield from self._clients()

    def _fleet(self) -> Iterator[Family]:
        state = self._state
        robots = state.robot_states
        yield metrics.ROBOT_UP.many(
            ((name,), shown is not RobotState.OFFLINE) for name, shown in islice(robots.items(), MOST_ROBOTS)
        )
        counts = Counter(robots.values())
        yield metrics.ROBOTS.many(((shown.name.lower(),), counts[shown]) for shown in RobotState)
        yield metrics.LEFT_OUT.many(
            [(("robot",), max(0, len(robots) - MOST_ROBOTS)), (("skill",), self._ends.names_left_out)]
        )
        yield metrics.BRIDGE_UP.many(((name,), is_heard) for name, is_heard in state.bridges_heard.items())
        sources: Counter[str] = Counter()
        severities: Counter[int] = Counter()
        for source in state.all_sources:
            sources[source_state(source)] += 1
            severities.update([field.shown >> 30 for field in source.fields])
        values: Counter[Quality] = Counter()
        for severity, count in severities.items():
            values[quality_of(severity << 30)] += count
        yield metrics.SOURCES.many(((name,), sources[name]) for name in _SOURCE_STATES)
        yield metrics.VALUES.many(((quality.name.lower(),), values[quality]) for quality in Quality)

    def _work(self) -> Iterator[Family]:
        yield metrics.EXECUTIONS.many(self._ends.by_robot.items())
        yield metrics.UNDER_WAY.one(self._tracker.all_under_way)
        service = self._scenarios
        yield metrics.RUNS.one(len(service.run_ids))
        yield metrics.RUNS_ENDED.many(((outcome.value,), self._runs.ended[outcome]) for outcome in RunOutcome)
        faults = service.faults
        active = sum(fault.active for fault in faults)
        unseen = sum(not fault.acknowledged for fault in faults)
        yield metrics.FAULTS.many([(("active",), active), (("unacknowledged",), unseen)])
        yield metrics.DECISIONS.one(service.open_decisions)

    def _clients(self) -> Iterator[Family]:
        statistics = self._server.statistics
        registry: dict[int, Any] = self._server.iserver.subscription_service.subscriptions
        subscriptions = [each for each in registry.values() if isinstance(each, ClientSubscription)]
        yield metrics.SESSIONS.one(self._server.sessions)
        yield metrics.SUBSCRIPTIONS.one(len(subscriptions))
        yield metrics.ITEMS.one(sum(len(each.items) for each in subscriptions))
        queues = self._server.queues
        yield metrics.QUEUED_BYTES.one(queues.held_bytes)
        yield metrics.NOTIFICATIONS_LOST.one(queues.lost)
        yield metrics.CONNECTIONS.one(statistics.connections)
        yield metrics.REQUESTS.one(statistics.requests)
        yield metrics.REFUSED.many(
            [
                (("connection",), statistics.connections_refused + statistics.connections_evicted),
                (("computing_time",), statistics.strangers_refused),
                (("handshake",), statistics.handshake_timeouts),
                (("frame",), statistics.frames_refused),
                (("certificate",), statistics.certificates_rejected),
                (("request",), statistics.requests_refused),
                (("session",), statistics.sessions_refused + statistics.sessions_evicted),
            ]
        )
        logins = self._server.context.gateway_logins.outcomes
        yield metrics.GATEWAY_LOGINS.many(
            ((gateway, outcome.value), count) for (gateway, outcome), count in logins.items()
        )
        audit = self._server.context.audit
        yield metrics.AUDIT_LINES.many(
            [
                (("written",), audit.lines),
                (("summed_up",), audit.omitted),
                (("lost",), audit.lost),
                (("undelivered",), audit.undelivered),
            ]
        )
