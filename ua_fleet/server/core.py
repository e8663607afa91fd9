"""The server without I/O: what comes by PubSub, from clients and with time becomes nodes, runs and messages.

    datagram -> subscriber -> state -> coalescer -> nodes
                           -> tracker, runs, teleoperation, registry
    a client's write -> commands -> publisher -> send
    a skill that is asked for -> requestor -> send; the responses come back as datagrams

Time is an argument: `now` is seconds of any monotonic clock, `wall` ticks of the wall clock. What is to be sent and
shown goes through callables, since effects as objects would cost more than the work itself. A value is shown within the
call that brings it, unless its node had one a moment ago: then the last one waits in the coalescer, which `poll` asks.

What fails costs one item: a datagram, an event, a change, or the turn of one part; see `monitoring.mistakes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError
from ua_fleet.fleet.changes import CapacitiesChanged, Change, Noticed, RobotRemoved, SourceRemoved, ValueChanged
from ua_fleet.fleet.coalesce import Coalescer
from ua_fleet.fleet.commands import Publication, metadata_of
from ua_fleet.fleet.model import RobotModel, RobotState
from ua_fleet.operation.skills.tracker import SkillChange
from ua_fleet.pubsub.events import (
    ActionReceived,
    AnnouncementReceived,
    DataReceived,
    EventReceived,
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
from ua_fleet.server.attached import Clocked, Ground, NoHistory, NoNamespace, Parts
from ua_fleet.server.timetable import Timetable
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.status import ROBOT_PROPERTY
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.messages import FieldMetaData

Address = tuple[str, int]

__all__ = ["ServerCore"]

TICK_S: Final = 1.0
"""Period of what the server says of robots, bridges and its own traffic."""
MOST_VALUES: Final = 100
"""Values of nodes that are shown before others have their turn: each may be watched by as many items as a user may
have on a node, and is queued for all of them."""
BURST: Final = 20
"""DataSets that are announced at once at the start, so that receivers' buffers hold them."""
BURST_PAUSE_S: Final = 0.005

_EXCHANGED: Final = (SourceUnknown, ProbeDue, ProbeReceived, ActionReceived, AnnouncementReceived, EventReceived)
"""Events that are no news of a source's data."""
_LIVES: Final = (DataReceived, SourceSilent, SourceStale, SourceReturned, SourceRefused)
"""Events that say how a source is."""


class ServerCore:
    """One server."""

    def __init__(
        self,
        ground: Ground,
        parts: Parts,
        *,
        analog_rate_hz: float,
        tick_s: float = TICK_S,
        each_second: Callable[[float], None] = lambda _now: None,
        events: tuple[str, Topic, tuple[FieldMetaData, ...]] | None = None,
    ) -> None:
        """Connect the parts; it begins with `begin`.

        Args:
            ground: PubSub and what is known of the fleet.
            parts: who hears of it.
            analog_rate_hz: how often each node's analog value is shown at most.
            tick_s: period in which robots, bridges and the server are looked at; infinite where nobody looks.
            each_second: does before that what the shell has to do in that period.
            events: name, topic and fields of the events that are published; None where none are.
        """
        self._publisher, self._subscriber = ground.publisher, ground.subscriber
        self._commands, self._state, self._skills = ground.commands, ground.state, ground.skills
        self._tracker, self._mistakes, self._log, self._send = ground.tracker, ground.mistakes, ground.log, ground.send
        self._nodes, self._runs, self._teleoperation = parts.nodes, parts.runs, parts.teleoperation
        self._registry, self._wanted, self._model = parts.registry, parts.wanted, parts.model
        self._namespace = parts.namespace
        self._history, self._carried, self._alarms = parts.history, parts.carried, parts.alarms
        self._watched = parts.alarms.watched
        self._told: list[Callable[[ValueChanged], None]] = []
        """What is told of each value; a part that is not there costs nothing."""
        if type(parts.namespace) is not NoNamespace:
            self._told.append(parts.namespace.value_changed)
        if type(parts.history) is not NoHistory:
            self._told.append(parts.history.record)
        self._coalescer = Coalescer(analog_rate_hz)
        self._tick_s, self._each_second, self._events = tick_s, each_second, events
        self._counters = ground.counters
        self._next_tick = 0.0
        self.refused = 0
        """Publications that could not be encoded."""
        self._now, self._wall = 0.0, 0
        """The clocks of this `poll`."""
        self._has_more = False
        self._bursts: Iterator[None] = iter(())
        """What is yet to be announced at the start."""
        self._burst_at: float | None = None
        wanted = Clocked(self._wanted)
        self._timetable = Timetable(
            self._mistakes,
            [
                ("nodes", self._nodes.poll, self._nodes.next_deadline),
                ("subscriber", self._poll_subscriber, lambda _: self._subscriber.next_deadline()),
                ("publisher", self._poll_publisher, lambda _: self._publisher.next_deadline()),
                ("actions", self._skills.poll, lambda _: self._skills.next_deadline()),
                ("values", self._poll_values, lambda _: self._coalescer.next_deadline()),
                ("each second", self._poll_tick, lambda _: self._next_tick),
                ("announcements", self._poll_bursts, lambda _: self._burst_at),
                ("scenarios", lambda _: self._runs.poll(), lambda _: self._runs.next_deadline()),
                ("teleoperation", self._teleoperation.poll, lambda _: self._teleoperation.next_deadline()),
                ("WantedData", wanted.poll, wanted.next_deadline),
                ("PubSub model", self._model.poll, self._model.next_deadline),
                ("carried runs", self._carried.poll, self._carried.next_deadline),
                ("alarms", self._alarms.poll, self._alarms.next_deadline),
                ("history", self._history.poll, self._history.next_deadline),
                *[(name, part.poll, part.next_deadline) for name, part in parts.timed.items()],
            ],
        )

    # The beginning and the end.

    def begin(self, *, now: float, wall: int) -> None:
        """Go on where the last server ended, and begin to announce what originates here."""
        guard = self._mistakes.guard
        withdrawn: Iterable[bytes] = ()
        with guard("scenarios"):
            withdrawn = self._runs.must_not_begin()
        with guard("actions"):
            self._skills.resume(now, tuple(withdrawn))
        for action in self._tracker.actions():
            with guard("actions", topic=action.name):
                self._want(action)
        with guard("teleoperation"):
            self._teleoperation.begin()
        with guard("scenarios"):
            self._runs.go_on()
        with guard("announcements"):
            self._send_all(self._publisher.begin(now=now, wall_ticks=wall))
            self._now, self._wall = now, wall
            self._bursts, self._burst_at = self._announcements(), now
            self._poll_bursts(now)

    def _announcements(self) -> Iterator[None]:
        """Announce and publish what originates here, in bursts; the time is that of the turn."""
        guard = self._mistakes.guard
        for number, (data_set, fields) in enumerate(list(self._commands.sources()), start=1):
            with guard("announcements", topic=data_set.topic.name):
                self._announce(data_set.topic, data_set.name, fields, self._now, self._wall)
            if number % BURST == 0:
                yield
        events = () if self._events is None else (self._events,)
        for name, topic, fields in (*events, *self._wanted.sources()):
            self._announce(topic, name, fields, self._now, self._wall)
        self._wanted.begin()
        for number, publication in enumerate(self._commands.initial(self._wall), start=1):
            with guard("announcements", topic=publication.topic.name):
                self.publish(publication, now=self._now)
            if number % BURST == 0:
                yield

    def _announce(self, topic: Topic, name: str, fields: tuple[FieldMetaData, ...], now: float, wall: int) -> None:
        self._send_all(self._publisher.announce(topic, name, fields, now=now, wall_ticks=wall))

    def end(self) -> None:
        """Say on PubSub that this server ends."""
        self._send_all(self._publisher.end())

    # Time.

    def poll(self, *, now: float, wall: int) -> bool:
        """Do what is due; whether there are more values to show, which is to be done once others had their turn."""
        self._now, self._wall, self._has_more = now, wall, False
        self._nodes.begin_turn()
        self._timetable.poll(now)
        return self._has_more

    def next_deadline(self, now: float) -> float:
        """When `poll` is to be called next; infinity where nothing is due."""
        return self._timetable.next_deadline(now)

    def _poll_subscriber(self, now: float) -> None:
        if events := self._subscriber.poll(now):
            self.hear(events, now=now, wall=self._wall)

    def _poll_publisher(self, now: float) -> None:
        self._send_all(self._publisher.poll(now, self._wall))

    def _poll_values(self, now: float) -> None:
        for change in self._coalescer.poll(now, MOST_VALUES):
            self._nodes.write(change)
        due = self._coalescer.next_deadline()
        self._has_more = due is not None and due <= now

    def _poll_bursts(self, now: float) -> None:
        if self._burst_at is None or now < self._burst_at:
            return
        self._burst_at = None
        for _ in self._bursts:
            self._burst_at = now + BURST_PAUSE_S
            break

    def _poll_tick(self, now: float) -> None:
        if now < self._next_tick:
            return
        self._next_tick = now + self._tick_s
        guard = self._mistakes.guard
        with guard("each second"):
            self._each_second(now)
            self._take(self._state.tick(self._wall), now)
        with guard("announced robots"):
            self._registry.tick()
        with guard("each second"):
            for complaint in self._subscriber.complaints(now):
                self._log.warning(complaint.what, cause=complaint.cause, count=complaint.count, detail=complaint.detail)

    # What comes by PubSub.

    def receive(
        self,
        datagram: bytes,
        sender: Address,
        *,
        now: float,
        wall: int,
        is_fresh: bool = True,
        connection: int = 0,
    ) -> None:
        """Take a datagram, and where it came from; `is_fresh` as in `Subscriber.receive`."""
        self._nodes.begin_turn()
        try:
            events = self._subscriber.receive(datagram, now, sender, is_fresh=is_fresh, connection=connection)
        except Exception as error:  # noqa: BLE001 - what a peer sends is refused without one: this is ours
            self._mistakes.caught("datagrams", error, client=f"{sender[0]}:{sender[1]}")
            return
        if events:
            self.hear(events, now=now, wall=wall)

    def hear(self, events: Iterable[SubscriberEvent], *, now: float, wall: int) -> None:
        """Take a batch of events: of a datagram, of time, or of a robot whose skills clients do."""
        for event in events:
            try:
                if type(event) is not DataReceived:  # most are, and cost the least so
                    if isinstance(event, _EXCHANGED):
                        self._exchange(event, now)
                        if not isinstance(event, SourceUnknown):
                            continue
                    elif isinstance(event, MetaDataReceived):
                        self._look_for_robot(event)
                for value in self._values(self._state.apply(event, wall), now):
                    self._nodes.write(value)
                self._follow(event, now, wall)
            except Exception as error:  # noqa: BLE001 - the events behind it have nothing to do with it
                self._mistakes.caught("messages", error, what=type(event).__name__)
        try:
            self._runs.end_batch()
        except Exception as error:  # noqa: BLE001 - what comes next has nothing to do with it
            self._mistakes.caught("scenarios", error)

    def _exchange(self, event: SubscriberEvent, now: float) -> None:
        """Take what is no news of data: questions, answers, and what can be asked for."""
        if isinstance(event, SourceUnknown | ProbeDue):
            if event.datagram is not None:
                self._send(event.datagram)
        elif isinstance(event, ProbeReceived):
            self._send_all(self._publisher.answer(event.probe, now))
        elif isinstance(event, EventReceived):
            self._counters.drop(Drop.UNSUPPORTED)  # a node shows what is, and an event is over
        elif isinstance(event, ActionReceived):
            self._skills.receive(event, now)
            self._teleoperation.receive(event, now)
            self._model.receive(event, now)
            self._carried.receive(event, now)
        elif isinstance(event, AnnouncementReceived):
            if isinstance(event.announcement, ActionMetaDataAnnouncement):
                self._skills.announced(event.announcement)
                self._teleoperation.announced(event.announcement)
                self._carried.announced(event.announcement)
            self._model.follow(event)

    def _look_for_robot(self, event: MetaDataReceived) -> None:
        """A robot's SkillStatus may say what the robot is."""
        text = first_property(event.metadata, ROBOT_PROPERTY)
        if isinstance(text, str):
            with self._mistakes.guard("announced robots", topic=event.topic.name):
                self._registry.announced(event.topic, text)

    def _follow(self, event: SubscriberEvent, now: float, wall: int) -> None:
        """Tell skills, runs and those who drive by hand what robots say, and when nothing says so any more."""
        if isinstance(event, _LIVES):
            if self._tracker.knows(event.topic):
                with self._mistakes.guard("outcomes", topic=event.topic.name):
                    self.show_skills(self._tracker.apply(event, wall), now=now, wall=wall)
            try:
                if isinstance(event, DataReceived):
                    self._runs.heard(event)
                elif isinstance(event, SourceReturned):
                    self._runs.source_returned(event.topic)
                else:
                    self._runs.source_lost(event.topic)
            except Exception as error:  # noqa: BLE001 - who drives by hand is told all the same
                self._mistakes.caught("scenarios", error, topic=event.topic.name)
        self._teleoperation.follow(event)
        self._carried.follow(event)

    def _take(self, changes: Iterable[Change], now: float) -> None:
        for value in self._values(changes, now):
            self._nodes.write(value)

    def _values(self, changes: Iterable[Change], now: float) -> Iterator[ValueChanged]:
        """The values of changes that are to be shown now. All other changes are shown here, in their order."""
        for change in changes:
            try:
                if type(change) is ValueChanged:
                    if (ready := self._coalescer.offer(change, now)) is not None:
                        yield ready
                    for told in self._told:
                        told(change)
                    if self._watched and (alarm := self._watched.get(change.key)) is not None:
                        self._alarms.look(alarm, change)
                    self._runs.value_changed(change)  # last: who does not understand a value keeps it from no node
                elif isinstance(change, Noticed):
                    (self._log.warning if change.is_problem else self._log.info)(change.text, **change.ids)
                else:
                    self._change_nodes(change)
            except Exception as error:  # noqa: BLE001 - the other changes are as true as before
                self._mistakes.caught("changes", error, what=type(change).__name__)

    def _change_nodes(self, change: Change) -> None:
        gone = [change.data_set] if isinstance(change, SourceRemoved) else []
        if isinstance(change, RobotRemoved):
            gone += change.robot.all_data_sets()
        for data_set in gone:
            keys = [field.key for field in data_set.fields]
            self._coalescer.forget(keys)
            self._history.forget(keys)
        self._nodes.put(change)
        self._namespace.changed(change)
        if isinstance(change, CapacitiesChanged):
            self._runs.fleet_changed()

    # Skills.

    def concluded(self, execution_id: bytes, outcome: RequestOutcome, *, now: float, wall: int) -> None:
        """The outcome of a request is known, or known better."""
        named = execution_id.hex()
        with self._mistakes.guard("outcomes", execution_id=named):
            self.show_skills(self._tracker.concluded(execution_id, outcome, wall), now=now, wall=wall)
        with self._mistakes.guard("scenarios", execution_id=named):
            self._runs.concluded(execution_id, outcome)

    def show_skills(self, changes: Iterable[SkillChange], *, now: float, wall: int) -> None:
        """Show what has become of executions, in the order in which it happened."""
        for change in changes:
            self._nodes.put(change)
        for topic, skills in self._tracker.take_busy_changes():
            self._take(self._state.set_busy(topic, skills, wall), now)

    def _want(self, action: Topic) -> None:
        """See to it that a bridge announces an Action; nobody announces what clients do."""
        if action.space != SERVER_SPACE:
            self._skills.want(action)

    # What clients write.

    def publish(self, publication: Publication, *, now: float) -> None:
        """Send a DataSet of space 0."""
        topic, types, values, timestamp = publication
        try:
            datagrams = self._publisher.publish(topic, values, timestamp=timestamp, now=now, types=types)
        except LocalWireError as error:
            self.refused += 1
            self._publisher.count_failed(topic)
            self._log.error("not published", topic=topic.name, reason=str(error))
            return
        self._state.delivered(topic, timestamp)
        self._runs.published(topic, types, values)
        self._namespace.written(publication)
        self._send_all(datagrams)

    def publish_event(self, publication: Publication, *, now: float) -> None:
        """Send an event. Before all is announced nobody could read it; then only clients are told."""
        topic, types, values, timestamp = publication
        if self._publisher.metadata(topic) is None:
            return
        try:
            told = self._publisher.publish(topic, values, timestamp=timestamp, now=now, types=types)
        except LocalWireError as error:
            self.refused += 1
            self._log.error("not published", topic=topic.name, reason=str(error))
            return
        self._send_all(told)

    def flush(self, *, now: float) -> None:
        """Publish what clients have written."""
        for publication in self._commands.flush():
            with self._mistakes.guard("writes", topic=publication.topic.name):
                self.publish(publication, now=now)

    # Robots that come, go, have faults or are driven.

    def add_robot(self, robot: RobotModel, *, now: float, wall: int) -> None:
        """Know a robot from now on, with what was heard of it before."""
        self._take(self._state.add_robot(robot), now)
        self._tracker.add(robot)
        initial = self._commands.add(robot, wall)
        self._runs.add_robot(robot, is_heard=self._state.robot_states[robot.name] is not RobotState.OFFLINE)
        for data_set in robot.data_sets:
            if data_set.writable:
                self._announce(data_set.topic, data_set.name, metadata_of(data_set), now, wall)
        for publication in initial:
            self.publish(publication, now=now)
        for data_set in robot.all_data_sets():
            self.hear(self._subscriber.known(data_set.topic), now=now, wall=wall)
        for action in robot.actions():
            self._want(action)

    def remove_robot(self, robot: RobotModel, *, now: float, is_replaced: bool = False) -> None:
        """Forget a robot that does nothing; `is_replaced`: it comes again at once, with another definition."""
        self._runs.remove_robot(robot.name, is_replaced=is_replaced)
        self._commands.remove(robot)
        self._tracker.remove(robot)
        for action in robot.actions():
            self._subscriber.unwant_action(action.space, action.id)
        for data_set in robot.data_sets:
            if data_set.writable:
                self._publisher.retire(data_set.topic)
        self._take(self._state.remove_robot(robot.name), now)

    def set_faulted(self, robot: str, faulted: bool, *, now: float, wall: int) -> None:
        """A robot has a fault that is more than its silence, or none."""
        self._take(self._state.set_faulted(robot, faulted, wall), now)

    def set_driven(self, robot: str, by: str, *, now: float, wall: int) -> None:
        """Somebody drives a robot by hand, in words; empty: nobody."""
        self._take(self._state.set_driven(robot, by, wall), now)

    def _send_all(self, datagrams: Iterable[bytes]) -> None:
        for datagram in datagrams:
            self._send(datagram)
