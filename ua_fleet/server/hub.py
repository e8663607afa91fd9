"""PubSub and nodes together: the only place of the server that runs tasks.

transport -> subscriber -> state -> coalescer -> projection -> nodes and their subscriptions
a client's write -> commands -> publisher -> transport
skills.invoke -> requestor -> transport; the responses come back through the subscriber
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Final

import structlog

from ua_fleet.config.applications import server_application
from ua_fleet.config.nodes import mapped_sources, max_ages_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import envelope_of, keys_needed, weaknesses
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError
from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.changes import CapacitiesChanged, Change, Noticed, RobotRemoved, SourceRemoved, ValueChanged
from ua_fleet.fleet.coalesce import Coalescer
from ua_fleet.fleet.commands import Commands, Publication, metadata_of
from ua_fleet.fleet.model import FleetModel, RobotModel, RobotState
from ua_fleet.fleet.state import FleetState
from ua_fleet.keys.keeper import KeysKept, keep_keys
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.wanted_data import WantedData
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.operation.skills.tracker import SkillChange, SkillTracker
from ua_fleet.pubsub.events import (
    ActionReceived,
    AnnouncementReceived,
    DataReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.metadata import first_property
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.recent import RecentMessages
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.pubsub.subscriber import LoopRule, Subscriber
from ua_fleet.server.attached import Announced, Clock, TeleoperationPart, TimedPart
from ua_fleet.server.message_tap import MessageTap
from ua_fleet.server.timetable import Timetable
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import RequestorJournal
from ua_fleet.skill.status import ROBOT_PROPERTY
from ua_fleet.topics import SERVER_SPACE, Topic, loop_verdict
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.sealed import SealedSender, Sent
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, EndpointDescription
from ua_fleet.wire.security import SecurityMode

__all__ = ["Hub", "wall_ticks"]

TICK_S = 1.0
"""Period of what the server says of robots, bridges and its own traffic."""
SHORTEST_WAIT_S = 0.005
"""Deadlines that lie closer together are served together."""
BURST = 20
"""DataSets that are announced at once at the start, so that receivers' buffers hold them."""
BURST_PAUSE_S = 0.005

LEAST_WRITERS: Final = 50_000
"""DataSetWriters that a server can know at least; a fleet with many sources knows twice as many as there may be."""

_log = structlog.get_logger("ua_fleet.server")


def wall_ticks() -> int:
    """The time of the wall clock."""
    return ticks_from_unix_ns(time.time_ns())


def _sources(model: FleetModel) -> int:
    """Data sources that are configured."""
    return len(model.bridges) + sum(1 for robot in model.robots for _ in robot.all_data_sets())


class Hub:
    """Carries data between a transport and the nodes until it is cancelled."""

    def __init__(
        self,
        config: FleetConfig,
        model: FleetModel,
        transport: Transport,
        projection: Projection,
        *,
        state_dir: Path,
        journal: RequestorJournal,
        keys: KeySource | None = None,
        rule: LoopRule = loop_verdict,
        sent: Sent | None = None,
        mistakes: Mistakes | None = None,
    ) -> None:
        """Make a hub.

        Args:
            config: periods, rates and the policy for unknown sources.
            model: the nodes that are configured.
            transport: not started yet; `start` does.
            projection: onto the nodes of the model.
            state_dir: where the server remembers which nonces it has used; touched only with message security.
            journal: what robots were asked to do, through restarts.
            keys: where the keys of message security come from; not needed where it is `none`.
            rule: the loop rule.
            sent: told of each message that is sent.
            mistakes: counts what has cost an item; its own without.

        Raises:
            ConfigError: no key source is configured, or what stands in `state_dir` cannot be used.
        """
        pubsub = config.pubsub
        timing, codec = pubsub.timing(), Codec()
        self.counters = Counters()
        self.mistakes = mistakes or Mistakes()
        self.commands = Commands(model)
        self.transport = transport
        self._projection = projection
        self.envelope = envelope_of(config, SERVER_SPACE, self.counters, state_dir)
        sender = SealedSender(self.envelope, transport, lambda: asyncio.get_running_loop().time(), sent)
        self._send, self._send_all = sender.send, sender.send_all
        self.send: Callable[[bytes], None] = sender.send
        """Sends a plain message to all, at once."""
        self._keys, self.keys_kept = keys_needed(config, keys), KeysKept()
        self._keys_ahead = pubsub.keys.future_keys
        self._subscriber = Subscriber(
            SERVER_SPACE,
            timing,
            self.counters,
            codec,
            rule,
            envelope=self.envelope,
            max_writers=max(LEAST_WRITERS, 2 * (_sources(model) + config.server.max_discovered_sources)),
            max_ages=max_ages_of(config),
            mapped=mapped_sources(config),
        )
        self.recent = RecentMessages()
        """The last messages, while somebody looks at them."""
        self._tap = MessageTap(self.recent, self._subscriber, sender, self.counters, wall_ticks)
        self._config = config
        self._publisher = Publisher(
            SERVER_SPACE,
            timing,
            self.counters,
            codec,
            server_application(config),
            max_packed_bytes=self.envelope.max_plain_bytes,
        )
        self.state = FleetState(
            model,
            self.counters,
            unknown_sources=config.server.unknown_sources,
            max_discovered_sources=config.server.max_discovered_sources,
        )
        self._subscriber.caught = self.state.caught = self.mistakes.caught
        self._coalescer = Coalescer(config.server.analog_rate_hz)
        self.skills = SkillCommands(
            journal,
            send=self._send,
            want=self._subscriber.want_action,
            sooner=self.check_deadline,
            wall_ticks=wall_ticks,
            must_be_verified=self.envelope.mode is not SecurityMode.NONE,
            told=self.concluded,
            clock=lambda: asyncio.get_running_loop().time(),
            log=_log,
        )
        self.tracker = SkillTracker(model)
        """What is known of executions."""
        self.want_action = self._subscriber.want_action
        """Asks for an Action until it is announced."""
        self._scenarios: ScenarioService | None = None
        self._teleoperation: TeleoperationPart | None = None
        self._roster: Announced | None = None
        self._wanted: WantedData | None = None
        self._sooner = asyncio.Event()
        self._wake_at = 0.0
        self._next_tick = 0.0
        self._flush_is_due = False
        self._refused = 0
        """Publications that could not be encoded."""
        self._timetable = Timetable(self.mistakes)
        self._timetable.add("subscriber", self._poll_subscriber, lambda _: self._subscriber.next_deadline())
        self._timetable.add("publisher", self._poll_publisher, lambda _: self._publisher.next_deadline())
        self._timetable.add("actions", self.skills.poll, lambda _: self.skills.next_deadline())
        self._timetable.add("values", self._poll_values, lambda _: self._coalescer.next_deadline())
        self._timetable.add("each second", self._poll_tick, lambda _: self._next_tick)
        for weakness in weaknesses(config):
            _log.warning(weakness)

    def add_scenarios(self, service: ScenarioService) -> None:
        """Run scenarios too; before `start`."""
        self._scenarios = service
        self._timetable.add("scenarios", lambda _: service.poll(), lambda _: service.next_deadline())

    def add_teleoperation(self, service: TeleoperationPart) -> None:
        """Let robots be driven by hand too; before `start`."""
        self._teleoperation = service
        self._timetable.add("teleoperation", service.poll, lambda _: service.next_deadline())

    def add_clock(self, clock: Clock) -> None:
        """Call something in time; before `start`."""

        def due_at(now: float) -> float | None:
            due_in_s = clock.due_in_s()
            return None if due_in_s is None else now + due_in_s

        self._timetable.add(type(clock).__name__, lambda _: clock.poll(), due_at)

    def add_part(self, name: str, part: TimedPart) -> None:
        """Call something in time, counting its mistakes by this name; before `start`."""
        self._timetable.add(name, part.poll, part.next_deadline)

    def add_wanted(self, wanted: WantedData) -> None:
        """Tell bridges which data is wanted; before `start`."""
        self._wanted = wanted
        self.add_clock(wanted)

    @property
    def capacities(self) -> Capacities:
        """What each robot can do now."""
        return self.state.capacities

    @property
    def robots(self) -> list[RobotModel]:
        """All robots that are there."""
        return self.state.robots

    def add_roster(self, roster: Announced) -> None:
        """Tell of robots that bridges announce; before `start`."""
        self._roster = roster

    async def start(self) -> None:
        """Open the transport; data reaches the nodes once `run` runs.

        Raises:
            TransportError: it cannot be opened.
        """
        await self.transport.start(self._receive)

    async def run(self) -> None:
        """Announce what originates here, then carry data until cancelled. Nothing but that ends it."""
        keep, guard = self.mistakes.keep, self.mistakes.guard
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(keep("projection", self._projection.run))
            tasks.create_task(keep("timer", self._keep_time))
            if self._keys is not None:
                tasks.create_task(keep("keys", partial(self._keep_keys, self._keys)))
                await self.keys_kept.wait_for([telemetry_group(SERVER_SPACE)])
            withdrawn: Collection[bytes] = ()
            if self._scenarios is not None:
                with guard("scenarios"):
                    withdrawn = self._scenarios.must_not_begin()
            with guard("actions"):
                self.skills.resume(asyncio.get_running_loop().time(), withdrawn)
            for action in self.tracker.actions():
                with guard("actions", topic=action.name):
                    self._want(action)
            if self._teleoperation is not None:
                with guard("teleoperation"):
                    self._teleoperation.begin()
            if self._scenarios is not None:
                with guard("scenarios"):
                    self._scenarios.go_on()
            with guard("announcements"):
                await self._announce()

    async def _keep_keys(self, keys: KeySource) -> None:
        count = self._keys_ahead + 1
        await keep_keys(self.envelope, keys, self.keys_kept, count=count, mistakes=self.mistakes)

    def add_robot(self, robot: RobotModel) -> None:
        """Know a robot from now on, with what was heard of it before; its nodes follow in order with all else."""
        now, wall = asyncio.get_running_loop().time(), wall_ticks()
        self._take(self.state.add_robot(robot), now)
        self.tracker.add(robot)
        initial = self.commands.add(robot, wall)
        if self._scenarios is not None:
            is_heard = self.state.robot_states[robot.name] is not RobotState.OFFLINE
            self._scenarios.add_robot(robot, is_heard=is_heard)
        for data_set in robot.data_sets:
            if data_set.writable:
                topic, name, fields = data_set.topic, data_set.name, metadata_of(data_set)
                self._send_all(self._publisher.announce(topic, name, fields, now=now, wall_ticks=wall))
        for publication in initial:
            self.publish(publication)
        for data_set in robot.all_data_sets():
            self._handle(self._subscriber.known(data_set.topic), now)
        for action in robot.actions():
            self._want(action)
        self.check_deadline()

    def remove_robot(self, robot: RobotModel) -> None:
        """Forget a robot that does nothing."""
        if self._scenarios is not None:
            self._scenarios.remove_robot(robot.name)
        self.commands.remove(robot)
        self.tracker.remove(robot)
        for data_set in robot.data_sets:
            if data_set.writable:
                self._publisher.retire(data_set.topic)
        self._take(self.state.remove_robot(robot.name), asyncio.get_running_loop().time())

    def stranger(self, ns: int, identifier: int) -> Topic | None:
        """The source that has an id and belongs to no robot or bridge."""
        owner = self.state.owner(ns, identifier)
        return None if owner is None or self.state.knows(owner) else owner

    def is_alive(self, topic: Topic) -> bool:
        """Whether a source is heard."""
        return self.state.is_alive(topic)

    def set_faulted(self, robot: str, faulted: bool) -> None:
        """A robot has a fault that is more than its silence, or none."""
        changes = self.state.set_faulted(robot, faulted, wall_ticks())
        self._take(changes, asyncio.get_running_loop().time())

    def set_driven(self, robot: str, by: str) -> None:
        """Somebody drives a robot by hand, in words; empty: nobody."""
        self._take(self.state.set_driven(robot, by, wall_ticks()), asyncio.get_running_loop().time())

    def describe(self, endpoints: tuple[EndpointDescription, ...]) -> None:
        """Tell the server's Endpoints to who asks for them on PubSub."""
        self._publisher.describe(server_application(self._config, endpoints))

    async def close(self) -> None:
        """Say that this ends, and release the transport."""
        self._send_all(self._publisher.end())
        await self.transport.close()

    def publish(self, publication: Publication) -> None:
        """Send a DataSet of space 0."""
        topic, types, values, timestamp = publication
        now = asyncio.get_running_loop().time()
        try:
            datagrams = self._publisher.publish(topic, values, timestamp=timestamp, now=now, types=types)
        except LocalWireError as error:
            self._refused += 1
            _log.error("not published", topic=topic.name, reason=str(error))
            return
        self.state.delivered(topic, timestamp)
        if self._scenarios is not None:
            self._scenarios.published(topic, types, values)
        self._send_all(datagrams)
        self.check_deadline()

    def flush_soon(self) -> None:
        """Publish what clients have written, when the request that is being served is done."""
        if not self._flush_is_due:
            self._flush_is_due = True
            asyncio.get_running_loop().call_soon(self._flush)

    def _flush(self) -> None:
        self._flush_is_due = False
        for publication in self.commands.flush():
            with self.mistakes.guard("writes", topic=publication.topic.name):
                self.publish(publication)

    async def _announce(self) -> None:
        now = asyncio.get_running_loop().time()
        self._send_all(self._publisher.begin(now=now, wall_ticks=wall_ticks()))
        for number, (data_set, fields) in enumerate(self.commands.sources(), start=1):
            with self.mistakes.guard("announcements", topic=data_set.topic.name):
                told = self._publisher.announce(data_set.topic, data_set.name, fields, now=now, wall_ticks=wall_ticks())
                self._send_all(told)
            if number % BURST == 0:
                await asyncio.sleep(BURST_PAUSE_S)
        if self._wanted is not None:
            for name, topic, fields in self._wanted.sources():
                self._send_all(self._publisher.announce(topic, name, fields, now=now, wall_ticks=wall_ticks()))
            self._wanted.begin()
        for number, publication in enumerate(self.commands.initial(wall_ticks()), start=1):
            with self.mistakes.guard("announcements", topic=publication.topic.name):
                self.publish(publication)
            if number % BURST == 0:
                await asyncio.sleep(BURST_PAUSE_S)
        self.check_deadline()

    def _receive(self, datagram: bytes, sender: Address) -> None:
        if not self.recent.is_wanted:
            self._take_datagram(datagram, sender)
            return
        with self.mistakes.guard("recent messages"):
            self._tap.received(datagram, sender, self._take_datagram)

    def _take_datagram(self, datagram: bytes, sender: Address) -> None:
        now = asyncio.get_running_loop().time()
        try:
            events = self._subscriber.receive(datagram, now, sender)
        except Exception as error:  # noqa: BLE001 - what a peer sends is refused without one: this is ours
            self.mistakes.caught("datagrams", error, client=f"{sender[0]}:{sender[1]}")
            return
        if events:
            self._handle(events, now)
        self.check_deadline()

    def _handle(self, events: Iterable[SubscriberEvent], now: float) -> None:
        wall = wall_ticks()
        for event in events:
            try:
                self._handle_one(event, now, wall)
            except Exception as error:  # noqa: BLE001 - the events behind it have nothing to do with it
                self.mistakes.caught("messages", error, what=type(event).__name__)
        if self._scenarios is not None:
            with self.mistakes.guard("scenarios"):
                self._scenarios.end_batch()

    def _handle_one(self, event: SubscriberEvent, now: float, wall: int) -> None:
        if isinstance(event, SourceUnknown | ProbeDue):
            if event.datagram is not None:
                self._send(event.datagram)
            if isinstance(event, SourceUnknown):
                self._take(self.state.apply(event, wall), now)
        elif isinstance(event, ProbeReceived):
            self._send_all(self._publisher.answer(event.probe, now))
        elif isinstance(event, ActionReceived):
            self.skills.receive(event, now)
            if self._teleoperation is not None:
                self._teleoperation.receive(event, now)
        elif isinstance(event, AnnouncementReceived):
            if isinstance(event.announcement, ActionMetaDataAnnouncement):
                self.skills.announced(event.announcement)
                if self._teleoperation is not None:
                    self._teleoperation.announced(event.announcement)
        else:
            if isinstance(event, MetaDataReceived):
                self._look_for_robot(event)
            self._take(self.state.apply(event, wall), now)
            self._follow_skills(event, wall)
            self._follow_executions(event)
            if self._teleoperation is not None:
                self._teleoperation.follow(event)

    def _want(self, action: Topic) -> None:
        """See to it that a bridge announces an Action; nobody announces what clients do."""
        if action.space != SERVER_SPACE:
            self.skills.want(action)

    def _look_for_robot(self, event: MetaDataReceived) -> None:
        """A robot's SkillStatus may say what the robot is."""
        text = first_property(event.metadata, ROBOT_PROPERTY)
        if self._roster is not None and isinstance(text, str):
            with self.mistakes.guard("announced robots", topic=event.topic.name):
                self._roster.announced(event.topic, text)

    def hear(self, event: SubscriberEvent) -> None:
        """Take what would have come by PubSub from a robot whose skills clients do."""
        self._handle([event], asyncio.get_running_loop().time())
        self.check_deadline()

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request is known, or known better."""
        named = execution_id.hex()
        with self.mistakes.guard("outcomes", execution_id=named):
            self.show_skills(self.tracker.concluded(execution_id, outcome, wall_ticks()))
        if self._scenarios is not None:
            with self.mistakes.guard("scenarios", execution_id=named):
                self._scenarios.concluded(execution_id, outcome)

    def _follow_skills(self, event: SubscriberEvent, wall: int) -> None:
        """Take a robot's SkillStatus."""
        if not isinstance(event, DataReceived | SourceSilent | SourceStale | SourceReturned | SourceRefused):
            return
        if self.tracker.knows(event.topic):
            with self.mistakes.guard("outcomes", topic=event.topic.name):
                self.show_skills(self.tracker.apply(event, wall))

    def _follow_executions(self, event: SubscriberEvent) -> None:
        """Tell runs what robots say they are at, and when nothing says so any more."""
        if self._scenarios is None:
            return
        if isinstance(event, DataReceived):
            with self.mistakes.guard("scenarios", topic=event.topic.name):
                self._scenarios.heard(event)
        elif isinstance(event, SourceSilent | SourceStale | SourceRefused):
            with self.mistakes.guard("scenarios", topic=event.topic.name):
                self._scenarios.source_lost(event.topic)
        elif isinstance(event, SourceReturned):
            with self.mistakes.guard("scenarios", topic=event.topic.name):
                self._scenarios.source_returned(event.topic)

    def show_skills(self, changes: Iterable[SkillChange]) -> None:
        """Show what has become of executions, in the order in which it happened."""
        for change in changes:
            self._projection.put(change)
        for topic, skills in self.tracker.take_busy_changes():
            self._take(self.state.set_busy(topic, skills, wall_ticks()), asyncio.get_running_loop().time())

    def _take(self, changes: Iterable[Change], now: float) -> None:
        for change in changes:
            try:
                self._take_one(change, now)
            except Exception as error:  # noqa: BLE001 - the other changes are as true as before
                self.mistakes.caught("changes", error, what=type(change).__name__)

    def _take_one(self, change: Change, now: float) -> None:
        if isinstance(change, ValueChanged):
            if (ready := self._coalescer.offer(change, now)) is not None:
                self._projection.put(ready)
            if self._scenarios is not None:  # last: who does not understand a value must not keep it from its node
                self._scenarios.value_changed(change)
        elif isinstance(change, Noticed):
            (_log.warning if change.is_problem else _log.info)(change.text, **change.ids)
        elif isinstance(change, CapacitiesChanged):
            self._projection.put(change)
            if self._scenarios is not None:
                self._scenarios.fleet_changed()
        else:
            gone = [change.data_set] if isinstance(change, SourceRemoved) else []
            if isinstance(change, RobotRemoved):
                gone += change.robot.all_data_sets()
            for data_set in gone:
                self._coalescer.forget(field.key for field in data_set.fields)
            self._projection.put(change)

    async def _keep_time(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._wake_at = max(self._deadline(), loop.time() + SHORTEST_WAIT_S)
            try:
                async with asyncio.timeout_at(self._wake_at):
                    await self._sooner.wait()
            except TimeoutError:
                pass
            self._sooner.clear()
            self._timetable.poll(loop.time())

    def _deadline(self) -> float:
        return self._timetable.next_deadline(asyncio.get_running_loop().time())

    def check_deadline(self) -> None:
        """Wake the timer where something has to be done before it would wake by itself."""
        if self._deadline() < self._wake_at - SHORTEST_WAIT_S:
            self._sooner.set()

    def _poll_subscriber(self, now: float) -> None:
        self._handle(self._subscriber.poll(now), now)

    def _poll_publisher(self, now: float) -> None:
        self._send_all(self._publisher.poll(now, wall_ticks()))

    def _poll_values(self, now: float) -> None:
        for change in self._coalescer.poll(now):
            self._projection.put(change)

    def _poll_tick(self, now: float) -> None:
        if now < self._next_tick:
            return
        self._next_tick = now + TICK_S
        guard = self.mistakes.guard
        with guard("each second"):
            self.transport.stats.count_drops(self.counters)
            self.counters.drops[Drop.SEND_FAILED] += self._refused
            self.counters.drops[Drop.UNTOLD] = self._projection.untold
            self._take(self.state.tick(wall_ticks()), now)
            self.recent.poll(now)
        if self._roster is not None:
            with guard("announced robots"):
                self._roster.tick()
        with guard("each second"):
            for complaint in self._subscriber.complaints(now):
                _log.warning(complaint.what, cause=complaint.cause, count=complaint.count, detail=complaint.detail)
