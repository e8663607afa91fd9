"""The bridge as a process: the event loop, one timer, the driver on one side and the transport on the other.

No task and no queue stands between them: a datagram goes from the socket to `driver.publish`, and a sample from the
inlet to the socket, within one callback. With message security one task beside them keeps the keys, and the bridge
enters its space once it has the key that it publishes with.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.bridge.actions import Actions
from ua_fleet.bridge.carry import CarryFactory, CarryGround
from ua_fleet.bridge.configured import every_data_set
from ua_fleet.bridge.core import BridgeCore, Rule
from ua_fleet.bridge.driver import (
    Driver,
    DriverEvent,
    Dropped,
    SampleRead,
    SourceFound,
)
from ua_fleet.bridge.execution_log import ExecutionLog
from ua_fleet.bridge.figures import BridgeFigures
from ua_fleet.bridge.inlet import BoundedInlet
from ua_fleet.bridge.lag import LagMeter
from ua_fleet.bridge.link_log import LinkLog
from ua_fleet.bridge.rival import Rival
from ua_fleet.bridge.status import STATUS_FIELDS, STATUS_INTERVAL_S, aside_text, status_topic, status_values
from ua_fleet.bridge.switching import BridgeSwitches
from ua_fleet.bridge.teleoperation import BridgeTeleoperation
from ua_fleet.bridge.told import ToldReasons
from ua_fleet.bridge.wanted import Wants
from ua_fleet.config.applications import bridge_application
from ua_fleet.config.nodes import mapped_sources, max_ages_of, writer_settings
from ua_fleet.config.registration import announced_robots
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import keys_needed, publisher_ids, weaknesses
from ua_fleet.config.teleoperation import setpoint_groups, teleoperations
from ua_fleet.config.transports import connections_of
from ua_fleet.counters import Counters
from ua_fleet.errors import DriverFailed, UaFleetError
from ua_fleet.fleet.wanted import wanted_topic
from ua_fleet.keys.keeper import KeysKept, keep_keys
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring import Mistakes, Monitor
from ua_fleet.pubsub.group_figures import LinkErrors, figures_of
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.skill.journal import MemoryJournal, ResponderJournal
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.storage.control import state_control
from ua_fleet.storage.journal import SqliteJournal
from ua_fleet.storage.lease_numbers import LeaseNumbers
from ua_fleet.storage.process_lock import process_lock
from ua_fleet.topics import Topic, loop_verdict
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.connections import Connections, Sender
from ua_fleet.transport.paced import PacedSender
from ua_fleet.transport.sealed import Sent
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec

__all__ = ["run_bridge"]

JOURNAL: Final = "executions.db"
"""In a bridge's state folder: what its robots were asked to do."""
PAUSE_S: Final = 1.0
"""What was due and has failed is tried again after so long."""


def _wall_ticks() -> int:
    return ticks_from_unix_ns(time.time_ns())


class _Shell:
    """What the event loop calls: one method for each cause of work."""

    def __init__(
        self,
        config: FleetConfig,
        bridge_name: str,
        driver: Driver,
        transports: Transport | Sequence[Transport],
        state_dir: Path,
        journal: ResponderJournal,
        rule: Rule,
        sent: Sent | None,
        mistakes: Mistakes,
        carry: CarryFactory | None,
    ) -> None:
        self.mistakes = mistakes
        self._loop = asyncio.get_running_loop()
        self._name, self._bridge = bridge_name, config.bridges[bridge_name]
        self._log: Any = structlog.get_logger("ua_fleet.bridge", bridge=bridge_name)
        self._driver = driver
        self._status_topic = status_topic(config, self._bridge)
        self.counters = Counters()
        timing, space = config.pubsub.timing(), self._bridge.space
        codec = Codec(packed_arrays=driver.takes_packed_arrays)
        self.connections = connections_of(config, space, self.counters, state_dir, transports)
        self.envelopes = self.connections.envelopes
        first, *further = self.connections.all
        self.keys = KeysKept()
        max_ages = max_ages_of(config)
        self._subscriber = Subscriber(
            space,
            timing,
            self.counters,
            codec,
            rule,
            envelope=first.envelope,
            barred=first.barred,
            relayed=first.relayed,
            takes_actions=first.takes_actions,
            max_ages=max_ages,
            mapped=mapped_sources(config),
            publisher_ids=publisher_ids(config),
            setpoint_groups=setpoint_groups(config),
        )
        for each in further:
            self._subscriber.add_connection(
                each.envelope, barred=each.barred, relayed=each.relayed, takes_actions=each.takes_actions
            )
        publisher = Publisher(
            space,
            timing,
            self.counters,
            codec,
            bridge_application(config, bridge_name),
            max_packed_bytes=self.envelopes.max_plain_bytes,
            settings=writer_settings(config),
        )
        self._publisher, self._links_seen = publisher, [LinkErrors() for _ in self.connections.all]
        self._rival = Rival()
        self.connections.speak_for(
            space,
            self.receive,
            publisher.names_of,
            taken_over=lambda: self._rival.heard(("the broker", 0), self._loop.time()),
        )
        lag = LagMeter()
        paced = [
            PacedSender(
                each.envelope,
                each.transport,
                self._loop.time,
                self._loop.call_at,
                self.counters,
                sent,
                arrived=lambda: self.inlet.arrived_at,
                gone=lag.observe,
            )
            for each in self.connections.all
        ]
        self._sender = Sender(self.connections, paced, self.counters)
        send = self._sender.send if carry is None else self._send_and_tell
        self._core = BridgeCore(
            space,
            publisher,
            self._subscriber,
            self.counters,
            send=send,
            publish=driver.publish,
            rule=rule,
            max_ages=max_ages,
        )
        self._core.caught, self._core.dropped = mistakes.caught, self._from_space
        if self._status_topic is not None:
            namespaces = {topic.id: topic.ns for _, _, topic, _ in every_data_set(config) if topic.space == space}
            self._core.wants = Wants(wanted_topic(self._status_topic), space, driver.want, namespaces)
        self._core.stale = driver.stale
        self._actions = self._core.actions = Actions(
            space,
            publisher,
            self.counters,
            driver=driver,
            journal=journal,
            requestors=self._bridge.requestors,
            must_be_verified=self.connections.must_be_verified,
            core=self._core,
            send=send,
            send_to=self._sender.send,
            wall_ticks=_wall_ticks,
            failed=self.failed,
            followed=ExecutionLog(self._log).take,
            rule=rule,
            definitions=announced_robots(config, bridge_name),
            answers=self.connections.answer_address,
            limits=limits_of(self.connections),
        )
        self._switches = self._core.switches = BridgeSwitches(
            bridge_name,
            space,
            config.fleet.namespace_index,
            publisher,
            self._subscriber,
            self.counters,
            requestors=self._bridge.requestors,
            must_be_verified=self.connections.must_be_verified,
            send=send,
            send_to=self._sender.send,
            wall_ticks=_wall_ticks,
            hear=self._core.hear,
            told=self._switched,
            failed=self.failed,
            caught=mistakes.caught,
            answers=self.connections.answer_address,
            limits=limits_of(self.connections),
        )
        self._actions.rival = self._not_now
        if carry is not None:
            self._core.carrying = carry(
                CarryGround(
                    publisher,
                    self._subscriber,
                    self._core,
                    self._actions,
                    self.counters,
                    mistakes,
                    self._loop,
                    send=self._sender.send,
                    send_to=self._sender.send,
                    wall_ticks=_wall_ticks,
                    sooner=self._arm,
                    must_be_verified=self.connections.must_be_verified,
                    answers=self.connections.answer_address,
                    limits=limits_of(self.connections),
                )
            )
        self.teleoperation = self._driven(config, state_dir, publisher)
        if self.connections.know_themselves:
            is_own = self.connections.is_own

            def impostor(sender: Address, now: float) -> bool:
                if is_own(sender):
                    return False
                self._rival.heard(sender, now)
                return True

            self._subscriber.impostor = impostor
        self._data_of: dict[str, set[Topic]] = {}
        """The data of each robot of `fleet.yaml`."""
        for robot, _, topic, _ in every_data_set(config):
            self._data_of.setdefault(robot, set()).add(topic)
        self.inlet = BoundedInlet(
            self._loop,
            config.pubsub.inlet_size,
            self._from_space,
            max_wait_s=config.pubsub.max_wait_s,
            max_ages=max_ages,
            lag=lag,
            sources_of=self._sources_of,
        )
        self.figures = BridgeFigures(self.counters, driver, self.connections, self.inlet, self.keys, lag, self._sender)
        self._timer: asyncio.TimerHandle | None = None
        self._status_at = self._not_before = 0.0
        self._told = ToldReasons()
        self._links = LinkLog(self._log)
        self.over: asyncio.Future[None] = self._loop.create_future()
        """Never done, unless the driver is over: then why."""
        for weakness in weaknesses(config):
            self._log.warning(weakness)

    def _driven(self, config: FleetConfig, state_dir: Path, publisher: Publisher) -> BridgeTeleoperation | None:
        """The robots that are driven by hand; None where there are none."""
        if not (models := teleoperations(config, self._name)):
            return None
        self._core.teleoperation = driven = BridgeTeleoperation(
            self._bridge.space,
            models,
            publisher,
            self.counters,
            driver=self._driver,
            core=self._core,
            next_number=LeaseNumbers(state_dir).next,
            requestors=self._bridge.requestors,
            must_be_verified=self.connections.must_be_verified,
            busy=self._actions.busy,
            send=self._sender.send,
            send_to=self._sender.send,
            wall_ticks=_wall_ticks,
            caught=self.mistakes.caught,
            told=lambda text, robot, detail: self._log.info(text, robot=robot, detail=detail),
            loop=self._loop,
            answers=self.connections.answer_address,
            limits=limits_of(self.connections),
        )
        self._actions.driven_by = driven.driven_by
        return driven

    async def wait_for_own_key(self) -> None:
        """Wait until there is something to publish with."""
        group_id = telemetry_group(self._bridge.space)
        self._log.info("waiting for keys", group=group_id)
        await self.keys.wait_for([group_id])

    def begin(self) -> None:
        """Begin to work; the driver and the transport have started."""
        now = self._loop.time()
        self._core.begin(now=now, wall_ticks=_wall_ticks())
        if self._status_topic is not None:
            source = SourceFound(self._status_topic, f"{self._name} status", STATUS_FIELDS)
            self._core.from_space(source, now=now, wall_ticks=_wall_ticks())
        self._status_at = now
        self._switches.begin(now)
        self._actions.begin(now)
        if self._core.carrying is not None:
            self._core.carrying.begin(now)
        if self.teleoperation is not None:
            self.teleoperation.begin(now)
        self.inlet.open()
        self._on_timer()

    def end(self) -> None:
        """Take nothing in any more, and say so."""
        self._core.end()
        self.inlet.close()
        self._sender.close()
        if self._timer is not None:
            self._timer.cancel()

    def receive(self, datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        """Take a datagram from a transport, or what its broker had kept."""
        try:
            now = self._loop.time()
            self._core.from_pubsub(datagram, now=now, sender=sender, is_fresh=is_fresh, connection=connection)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one datagram, others are behind it
            self.mistakes.caught("datagrams", error, client=f"{sender[0]}:{sender[1]}")
        if self._subscriber.is_nearer:
            self._arm()

    def _send_and_tell(self, datagram: bytes) -> None:
        """Send to all, and tell who carries runs here: nobody hears a bridge itself."""
        self._sender.send(datagram)
        if self._core.carrying is not None:
            self._core.carrying.own(datagram)

    def failed(self, text: str, error: BaseException | None) -> None:
        """Log what went wrong, with the traceback where there is an exception, which is a mistake then."""
        self._log.error(text, exc_info=error)
        if error is not None:
            self.mistakes.counted("commands", error)

    def _not_now(self, now: float) -> str:
        """Why nothing may be begun now; empty where it may."""
        return self._rival.problem(now) or self._switches.problem

    def _switched(self, component: str, is_enabled: bool) -> None:
        self._log.warning("PubSub was switched", component=component, state="enabled" if is_enabled else "disabled")

    def _sources_of(self, execution_id: bytes) -> Collection[Topic]:
        """The data of the robot that an execution belongs to."""
        return self._data_of.get(self._actions.robot_of(execution_id) or "", ())

    def _from_space(self, event: DriverEvent) -> None:
        try:
            now = self._loop.time()
            rest: DriverEvent | None = event
            if isinstance(event, SampleRead):
                rest = self._core.sample(event, now, self.inlet.arrived_at)
            if rest is not None:
                self._core.from_space(rest, now=now, wall_ticks=_wall_ticks())
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one event, facts are behind it
            self.mistakes.caught("space", error, what=type(event).__name__)
        if not isinstance(event, SampleRead):
            self._arm()
            if isinstance(event, Dropped) and event.detail:
                self._tell(event)
        elif self._core.freshness.is_nearer:
            self._core.freshness.is_nearer = False
            self._arm()

    def _tell(self, drop: Dropped) -> None:
        if self._told.is_due(drop.cause, drop.detail, self._loop.time()):
            self._log.warning("dropped", cause=drop.cause.value, detail=drop.detail)

    def _arm(self) -> None:
        """Set the one timer to the next deadline, unless it will ring before that."""
        deadline = self._core.next_deadline()
        at = self._status_at if deadline is None else max(min(deadline, self._status_at), self._not_before)
        if self._timer is not None:
            if self._timer.when() <= at:
                return
            self._timer.cancel()
        self._timer = self._loop.call_at(at, self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        now = self._loop.time()
        is_round = now >= self._status_at
        if is_round:  # first, since it makes the keep-alive that is due with it needless
            self._status_at = now + STATUS_INTERVAL_S
            with self.mistakes.guard("each second"):
                self._report(now)
        try:
            self._core.poll(now, _wall_ticks(), is_round=is_round)
        except Exception as error:  # noqa: BLE001 - what is due stays due: it is tried again, and not all the time
            self.mistakes.caught("timer", error)
            self._not_before = now + PAUSE_S
        self._arm()

    def _report(self, now: float) -> None:
        """Log a change of the connection and what is malformed, publish the bridge's status; end with its driver."""
        status = self._driver.status()
        if status.is_over and not self.over.done():
            self.over.set_exception(DriverFailed(f"bridge {self._name}: {' '.join(status.detail.split())}"))
        if problem := self.envelopes.problem or self.keys.problem() or self._actions.problem:
            status = replace(status, detail=f"{status.detail}; {problem}")
        if self._core.carrying is not None and (waits := self._core.carrying.problem):
            status = replace(status, detail=f"{status.detail}; {waits}")
        if rival := self._rival.problem(now):
            status = replace(status, detail=f"{status.detail}; {rival}")
            if self._rival.is_due(now):
                self._log.error(rival)
        self._links.take(status)
        if status.aside:
            status = replace(status, detail=f"{status.detail}; {aside_text(status.aside)}")
        for complaint in self._subscriber.complaints(now):
            self._log.warning(complaint.what, cause=complaint.cause, count=complaint.count, detail=complaint.detail)
        self.connections.count_drops(self.counters)
        for link, problem in zip(self._links_seen, self.connections.problems, strict=True):
            link.look(problem)
        if self._status_topic is not None:
            lag_p99_s, oldest_s = self.figures.lags_s()
            values = status_values(
                self._name,
                self._bridge.kind,
                status,
                self.counters,
                lag_p99_s=lag_p99_s,
                oldest_s=oldest_s,
                figures=figures_of(self._publisher, self._sender.failed, self._sender.not_secured, self._links_seen),
            )
            self._core.tell(self._status_topic, values, _wall_ticks(), now=now)


def limits_of(connections: Connections) -> ResponderLimits:
    """A broker may hold a request back for as long as it likes, so that none is taken after its TimeoutHint."""
    return ResponderLimits(late_tolerance_s=0.0) if connections.are_brokered else ResponderLimits()


async def run_bridge(
    config: FleetConfig,
    bridge_name: str,
    driver: Driver,
    transport: Transport | Sequence[Transport],
    *,
    state_dir: Path,
    keys: KeySource | None = None,
    journal: ResponderJournal | None = None,
    ready: Callable[[], None] | None = None,
    rule: Rule = loop_verdict,
    sent: Sent | None = None,
    monitor: Monitor | None = None,
    carry: CarryFactory | None = None,
) -> None:
    """Run a bridge until cancelled; then the driver has left its space and the transport is closed.

    Args:
        config: the fleet.
        bridge_name: which of its bridges this is.
        driver: the bridge's driver, not started.
        transport: the PubSub side, not started; of a bridge on several connections one for each, in their order.
        state_dir: where the bridge remembers what must survive a restart; used only with message security or skills.
        keys: where the keys of message security come from; not needed where it is `none`.
        journal: of executions; the one in `state_dir` if left out. Without skills there is nothing to remember.
        ready: called once both sides work.
        rule: the loop rule; only a test puts another one in its place.
        sent: told of each message that is sent, with its bytes on the wire.
        monitor: tells of the bridge.
        carry: makes who carries runs in it; without, it takes no part of any.

    Raises:
        ConfigError: no key source is configured, or what stands in `state_dir` cannot be used.
        BridgeUnavailable: a library that the driver needs is missing.
        DriverFailed: a mistake of the driver has ended it; a bridge that is started anew goes on where it stopped.
        StorageUnavailable: the journal of executions cannot be used, or this bridge runs already.
        TransportError: the PubSub side cannot be opened; with the remedy.
    """
    keys = keys_needed(config, config.bridges[bridge_name].space, keys)
    async with AsyncExitStack() as cleanup:
        cleanup.enter_context(process_lock(state_dir / f"{bridge_name}.lock", f"bridge {bridge_name}"))
        if journal is None and driver.has_skills:
            journal = cleanup.enter_context(SqliteJournal(state_dir / JOURNAL))
        await cleanup.enter_async_context(state_control(state_dir, bridge_name))
        mistakes = monitor.mistakes if monitor is not None else Mistakes()
        shell = _Shell(
            config, bridge_name, driver, transport, state_dir, journal or MemoryJournal(), rule, sent, mistakes, carry
        )
        cleanup.push_async_callback(shell.connections.close)
        cleanup.push_async_callback(driver.stop)
        cleanup.callback(shell.end)
        if shell.teleoperation is not None:
            cleanup.push_async_callback(shell.teleoperation.stop)
        try:
            async with asyncio.TaskGroup() as tasks:
                if keys is not None:
                    count = config.pubsub.keys.future_keys + 1
                    keeping = partial(keep_keys, shell.envelopes, keys, shell.keys, count=count, mistakes=mistakes)
                    tasks.create_task(mistakes.keep("keys", keeping))
                    if monitor is not None:
                        monitor.ready_when(
                            lambda: f"it waits for its keys: {shell.keys.problem() or 'they were asked for'}"
                        )
                    await shell.wait_for_own_key()
                driver.remember_in(state_dir)
                await driver.start(shell.inlet)
                await shell.connections.start(shell.receive)
                shell.begin()
                if monitor is not None:
                    shell.figures.tell(monitor)
                if ready is not None:
                    ready()
                await shell.over
        except ExceptionGroup as failed:
            # Whatever failed while the rest was ended stands first; an error with a remedy was the cause.
            first, *others = sorted(failed.exceptions, key=lambda error: not isinstance(error, UaFleetError))
            for other in others:
                shell.failed("this failed, too, while the bridge ended", other)
            raise first from None
