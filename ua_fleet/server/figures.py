"""What the server tells of itself: figures for Prometheus, and whether it is ready. It looks when it is asked."""

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
from ua_fleet.nodes.namespace_nodes import NAMESPACE_DROPS
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.scenario.facts import RunOutcome
from ua_fleet.server.attached import Ground
from ua_fleet.server.history import HistoryService
from ua_fleet.server.hub import Hub
from ua_fleet.server.run_log import RunLog
from ua_fleet.server.skill_ends import SkillEnds
from ua_fleet.server.unified_namespace import NamespacePublisher
from ua_fleet.values import Quality, quality_of

__all__ = ["ServerFigures", "source_state"]

_SOURCE_STATES: Final = ("heard", "silent", "waiting", "refused")
_REQUEST_BUCKETS_S: Final = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)


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
        namespace: NamespacePublisher | None = None,
        history: HistoryService | None = None,
        alarms: AlarmService | None = None,
    ) -> None:
        self._hub, self._state, self._tracker, self._server = hub, ground.state, ground.tracker, server
        self._scenarios, self._runs, self._ends = scenarios, runs, ends
        self._namespace, self._history, self._alarms = namespace, history, alarms

    def tell(self, monitor: Monitor) -> None:
        """Tell of the server from now on: it serves."""
        metric = metrics.REQUEST_SECONDS
        times = monitor.histogram(metric.name, metric.help, _REQUEST_BUCKETS_S, metric.labels)
        self._server.statistics.answered = lambda service, seconds: times.labels(service).observe(seconds)
        monitor.add(self.collect)
        monitor.ready_when(self.problem, self.text)

    def problem(self) -> str:
        """Why the server cannot do its work; empty while it can. That a bridge is away is said in `text`."""
        return self._hub.connections.stats.problem or self._hub.envelopes.problem or self._scenarios.problem

    def text(self) -> str:
        """Where it serves, and which bridges are not heard."""
        heard = self._state.bridges_heard
        away = [name for name, is_heard in heard.items() if not is_heard]
        text = f"{self._server.endpoint.geturl()}, {len(heard) - len(away)} of {len(heard)} bridges heard"
        text = f"{text}; not heard: {', '.join(away)}" if away else text
        namespace = self._namespace
        lost = f"Unified Namespace: {namespace.problem}" if namespace is not None and namespace.problem else ""
        history = "" if self._history is None else self._history.problem
        alarms = f"alarms are not written down: {found}" if self._alarms and (found := self._alarms.problem) else ""
        return "; ".join(filter(None, (text, self._hub.connections.problem, lost, history, alarms)))

    def collect(self) -> Iterator[Family]:
        """All figures now."""
        hub = self._hub
        yield from counted(hub.counters, has_space=False)
        yield from transported(hub.connections.stats)
        if hub.envelopes.is_secured:
            now = asyncio.get_running_loop().time()
            yield from keys_left(hub.envelopes.keys_last_s(now), hub.keys_kept.source_problem)
        yield from _namespace(self._namespace)
        yield from self._fleet()
        yield from self._work()
        yield from self._clients()
        if (history := self._history) is not None:
            rows = [("stored", history.stored), ("left_out", self._server.events_left_out), *history.lost.items()]
            yield metrics.HISTORY_ROWS.many([((str(what),), count) for what, count in rows])
            yield metrics.HISTORY_WAITING.one(history.waiting)
            yield metrics.HISTORY_UP.one(history.is_stored)

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
        if (alarms := self._alarms) is not None:
            yield metrics.ALARMS.many(((state,), number) for state, number in alarms.counts().items())
            yield metrics.ALARM_EVENTS.one(alarms.told)

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


def _namespace(namespace: NamespacePublisher | None) -> Iterator[Family]:
    """The figures of the Unified Namespace; without values where there is none."""
    told = [] if namespace is None else [(namespace.figures, namespace.counters.drops)]
    yield metrics.NAMESPACE_UP.many(((), figures.connected) for figures, _ in told)
    yield metrics.NAMESPACE_TOPICS.many(((), figures.topics) for figures, _ in told)
    yield metrics.NAMESPACE_WAITING.many(((), figures.waiting) for figures, _ in told)
    yield metrics.NAMESPACE_PUBLISHED.many(((), figures.published) for figures, _ in told)
    yield metrics.NAMESPACE_DROPS.many(((cause.value,), drops[cause]) for _, drops in told for cause in NAMESPACE_DROPS)
