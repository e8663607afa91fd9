"""What the event loop calls in a bridge: one method for each cause of work, and one timer.

No task and no queue stands between them: a datagram goes from the socket to `driver.publish`, and a sample from the
inlet to the socket, within one callback.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import structlog

from ua_fleet.bridge.assembly import BridgeGiven, BridgeParts, wall_ticks
from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound
from ua_fleet.bridge.link_log import LinkLog
from ua_fleet.bridge.status import STATUS_FIELDS, STATUS_INTERVAL_S, aside_text, status_values
from ua_fleet.bridge.told import ToldReasons
from ua_fleet.config.security import weaknesses
from ua_fleet.errors import DriverFailed
from ua_fleet.one_timer import PAUSE_S, OneTimer
from ua_fleet.pubsub.group_figures import LinkErrors, figures_of
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.transport.base import Address

__all__ = ["BridgeShell"]


class BridgeShell:
    """One bridge in its event loop."""

    def __init__(self, given: BridgeGiven) -> None:
        """Make a bridge and its parts, in the running loop."""
        self._loop = asyncio.get_running_loop()
        bridge = given.config.bridges[given.name]
        self._name, self._kind, self._space = given.name, bridge.kind, bridge.space
        self._log: Any = structlog.get_logger("ua_fleet.bridge", bridge=given.name)
        self._driver, self._mistakes = given.driver, given.mistakes
        self.parts = parts = BridgeParts(given, self, self._loop, self._log)
        self._core, self._subscriber = parts.core, parts.subscriber
        self._actions, self._inlet = parts.actions, parts.inlet
        self._links_seen = [LinkErrors() for _ in parts.connections.all]
        self._timer = OneTimer(self._loop, self._on_timer)
        self._status_at = 0.0
        self._told = ToldReasons()
        self._links = LinkLog(self._log)
        self.over: asyncio.Future[None] = self._loop.create_future()
        """Never done, unless the driver is over: then why."""
        for weakness in weaknesses(given.config):
            self._log.warning(weakness)

    async def wait_for_own_key(self) -> None:
        """Wait until there is something to publish with."""
        group_id = telemetry_group(self._space)
        self._log.info("waiting for keys", group=group_id)
        await self.parts.keys.wait_for([group_id])

    def begin(self) -> None:
        """Begin to work; the driver and the transport have started."""
        now = self._loop.time()
        self._core.begin(now=now, wall_ticks=wall_ticks())
        if self.parts.status_topic is not None:
            source = SourceFound(self.parts.status_topic, f"{self._name} status", STATUS_FIELDS)
            self._core.from_space(source, now=now, wall_ticks=wall_ticks())
        self._status_at = now
        self.parts.switches.begin(now)
        self._actions.begin(now)
        if self._core.carrying is not None:
            self._core.carrying.begin(now)
        if self.parts.teleoperation is not None:
            self.parts.teleoperation.begin(now)
        self._inlet.open()
        self._on_timer()

    def end(self) -> None:
        """Take nothing in any more, and say so."""
        self._core.end()
        self._inlet.close()
        self.parts.sender.close()
        self._timer.end()

    def receive(self, datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        """Take a datagram from a transport, or what its broker had kept."""
        try:
            now = self._loop.time()
            self._core.from_pubsub(datagram, now=now, sender=sender, is_fresh=is_fresh, connection=connection)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one datagram, others are behind it
            self._mistakes.caught("datagrams", error, client=f"{sender[0]}:{sender[1]}")
        if self._subscriber.is_nearer:
            self.arm()

    def failed(self, text: str, error: BaseException | None) -> None:
        """Log what went wrong, with the traceback where there is an exception, which is a mistake then."""
        self._log.error(text, exc_info=error)
        if error is not None:
            self._mistakes.counted("commands", error)

    def from_space(self, event: DriverEvent) -> None:
        """Take what the driver says."""
        try:
            now = self._loop.time()
            rest: DriverEvent | None = event
            if isinstance(event, SampleRead):
                rest = self._core.sample(event, now, self._inlet.arrived_at)
            if rest is not None:
                self._core.from_space(rest, now=now, wall_ticks=wall_ticks())
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one event, facts are behind it
            self._mistakes.caught("space", error, what=type(event).__name__)
        if not isinstance(event, SampleRead):
            self.arm()
            if isinstance(event, Dropped) and event.detail:
                self._tell(event)
        elif self._core.freshness.is_nearer:
            self._core.freshness.is_nearer = False
            self.arm()

    def _tell(self, drop: Dropped) -> None:
        if self._told.is_due(drop.cause, drop.detail, self._loop.time()):
            self._log.warning("dropped", cause=drop.cause.value, detail=drop.detail)

    def arm(self) -> None:
        """Set the one timer to the next deadline, unless it will ring before that."""
        deadline = self._core.next_deadline()
        self._timer.set(self._status_at if deadline is None else min(deadline, self._status_at))

    def _on_timer(self) -> None:
        now = self._loop.time()
        is_round = now >= self._status_at
        if is_round:  # first, since it makes the keep-alive that is due with it needless
            self._status_at = now + STATUS_INTERVAL_S
            with self._mistakes.guard("each second"):
                self._report(now)
        try:
            self._core.poll(now, wall_ticks(), is_round=is_round)
        except Exception as error:  # noqa: BLE001 - what is due stays due: it is tried again, and not all the time
            self._mistakes.caught("timer", error)
            self._timer.pause(now + PAUSE_S)
        self.arm()

    def _report(self, now: float) -> None:
        """Log a change of the connection and what is malformed, publish the bridge's status; end with its driver."""
        status = self._driver.status()
        if status.is_over and not self.over.done():
            self.over.set_exception(DriverFailed(f"bridge {self._name}: {' '.join(status.detail.split())}"))
        if problem := self.parts.connections.envelopes.problem or self.parts.keys.problem() or self._actions.problem:
            status = replace(status, detail=f"{status.detail}; {problem}")
        if self._core.carrying is not None and (waits := self._core.carrying.problem):
            status = replace(status, detail=f"{status.detail}; {waits}")
        if rival := self.parts.rival.problem(now):
            status = replace(status, detail=f"{status.detail}; {rival}")
            if self.parts.rival.is_due(now):
                self._log.error(rival)
        self._links.take(status)
        if status.aside:
            status = replace(status, detail=f"{status.detail}; {aside_text(status.aside)}")
        for complaint in self._subscriber.complaints(now):
            self._log.warning(complaint.what, cause=complaint.cause, count=complaint.count, detail=complaint.detail)
        self.parts.connections.count_drops(self.parts.counters)
        for link, problem in zip(self._links_seen, self.parts.connections.problems, strict=True):
            link.look(problem)
        if self.parts.status_topic is not None:
            publisher, sender = self.parts.publisher, self.parts.sender
            lag_p99_s, oldest_s = self.parts.figures.lags_s()
            values = status_values(
                self._name,
                self._kind,
                status,
                self.parts.counters,
                lag_p99_s=lag_p99_s,
                oldest_s=oldest_s,
                figures=figures_of(publisher, sender.failed, sender.not_secured, self._links_seen),
            )
            self._core.tell(self.parts.status_topic, values, wall_ticks(), now=now)
