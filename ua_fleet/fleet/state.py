"""The state of the fleet: facts in, changes out, without I/O and without a clock.

    DataReceived       the nodes of the source change; a source nobody knows falls under the policy for unknown sources
    SourceSilent       its nodes become Bad_NoCommunication and keep their last values and times
    SourceRefused      as long as it is not heard, its nodes become Bad_SecurityChecksFailed, also if it never was
    SourceAppeared     it is there and has said nothing yet; values of it from before become as those of SourceStale
    SourceStale        it is there, and its last values become Uncertain_NoCommunicationLastUsableValue
    SourceReturned     they come back
    tick (each second) what the server says of robots, bridges and itself

(namespace index, id) is an address: the first source that has it keeps it, and what another space sends for it is a
conflict that is counted and never shown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.changes import (
    CapacitiesChanged,
    Change,
    Noticed,
    RobotAdded,
    RobotRemoved,
    SourceAdded,
    SourceRemoved,
)
from ua_fleet.fleet.discovery import Discovery
from ua_fleet.fleet.members import BridgeLiveness, RobotLiveness, ServerCounters
from ua_fleet.fleet.model import DataSetModel, FleetModel, RobotModel, RobotState, UnknownSources
from ua_fleet.fleet.moved import MovedRobots
from ua_fleet.fleet.source import Source
from ua_fleet.fleet.turnover import LinePerMinute
from ua_fleet.pubsub.events import (
    DataReceived,
    MetaDataReceived,
    SourceAppeared,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.run_data import RUN_DATA_ID
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMetaData

__all__ = ["FleetState"]

_ASKED_IN_VAIN: Final = 3
"""Probes after which a source that has not answered is taken for one that never does."""
_MOST_ASKED: Final = 1000
_MAX_CONFLICTS: Final = 1000
"""Conflicts that the log is told of."""


class FleetState:
    """What is known of each data source, robot and bridge. Times are ticks of the wall clock."""

    def __init__(
        self,
        model: FleetModel,
        counters: Counters,
        *,
        unknown_sources: UnknownSources = UnknownSources.QUARANTINE,
        max_discovered_sources: int = 1000,
    ) -> None:
        """Make the state of a fleet of which nothing has been heard.

        Args:
            model: the nodes that are configured.
            counters: the server's; drops are counted here.
            unknown_sources: what happens to sources that the model does not name.
            max_discovered_sources: most of those that are kept.
        """
        self._counters = counters
        self._discovery = Discovery(unknown_sources, max_discovered_sources, model.namespaces)
        self._sources: dict[Topic, Source] = {}
        self._claims: dict[tuple[int, int], Topic] = {}
        self._skills: set[Topic] = set()
        """The Actions of all robots: each has the node of its id, and is no source."""
        self._conflicts: set[Topic] = set()
        self._asked: dict[Topic, int] = {}
        """How often each source was asked for its metadata."""
        self._discovered: set[Topic] = set()
        self._silent_strangers: set[Topic] = set()
        self.moved = MovedRobots()
        """Robots of which something has changed that a list of robots shows, or that are gone."""
        self._silences, self._returns = LinePerMinute(), LinePerMinute()
        self.caught: Callable[[str, Exception], None] | None = None
        """Told of a mistake that cost one robot or bridge its second; without it, the mistake is raised."""
        self._bridges = [BridgeLiveness(bridge) for bridge in model.bridges]
        self._bridge_named = {bridge.model.name: bridge for bridge in self._bridges}
        self._robots: dict[str, RobotLiveness] = {}
        self._robot_of: dict[Topic, RobotLiveness] = {}
        """By the sources that a robot can be reached by."""
        self._robot_of_skills: dict[Topic, RobotLiveness] = {}
        self._bridge_of = {
            bridge.model.status.topic: bridge for bridge in self._bridges if bridge.model.status is not None
        }
        self._bridges_in: dict[int, list[BridgeLiveness]] = {}
        for bridge in self._bridges:
            self._bridges_in.setdefault(bridge.model.space, []).append(bridge)
        self._traffic = ServerCounters(model)
        self.capacities = Capacities(model.robots)
        """What each robot can do now."""
        for bridge_model in model.bridges:
            if bridge_model.status is not None:
                self._claim(bridge_model.status)
        for robot in model.robots:
            self._add(robot)

    @property
    def sources(self) -> int:
        """Number of sources that have nodes."""
        return len(self._sources)

    @property
    def all_sources(self) -> Iterable[Source]:
        """The sources that have nodes."""
        return self._sources.values()

    def source(self, topic: Topic) -> Source | None:
        """A source that has nodes."""
        return self._sources.get(topic)

    @property
    def robot_states(self) -> dict[str, RobotState]:
        """What each robot's node shows."""
        return {name: status.shown or RobotState.OFFLINE for name, status in self._robots.items()}

    @property
    def bridges_heard(self) -> dict[str, bool]:
        """Whether each bridge is heard."""
        return {bridge.model.name: bool(bridge.online) for bridge in self._bridges}

    @property
    def robots(self) -> list[RobotModel]:
        """All robots that are there."""
        return [status.model for status in self._robots.values()]

    def robot_status(self, name: str) -> RobotLiveness | None:
        """What is known of a robot; None where there is no such robot."""
        return self._robots.get(name)

    def quality(self, robot: RobotLiveness) -> int:
        """The worst status of a robot's values."""
        statuses = (status for topic in robot.sources for status in self._sources[topic].shown())
        return robot.quality_of_values(statuses)

    def apply(self, event: SubscriberEvent, wall_ticks: int) -> list[Change]:
        """What an event changes. Events that do not concern nodes change nothing."""
        if isinstance(event, DataReceived):
            return self._data(event, wall_ticks)
        if isinstance(event, MetaDataReceived):
            source, changes = self._find(event.topic, event.metadata, wall_ticks)
            if source is not None:
                changes += source.bind(event.metadata, self._counters, wall_ticks)
                self._look_at_quality(source)
            return changes
        if isinstance(event, SourceSilent):
            return self._silent(event.topic, wall_ticks)
        if isinstance(event, SourceReturned | SourceStale | SourceAppeared):
            return self._there(event, wall_ticks)
        if isinstance(event, SourceRefused):
            return self._refused(event)
        if isinstance(event, SourceUnknown):
            return self._unannounced(event.topic)
        return []

    def tick(self, wall_ticks: int) -> list[Change]:
        """What the server says by itself; to be called each second."""
        changes: list[Change] = []
        ticks = [each.tick for each in self._bridges] + [each.tick for each in self._robots.values()]
        for tick in ticks:
            try:
                changes += tick(wall_ticks)
            except Exception as error:  # counted; the other ticks have nothing to do with it
                if self.caught is None:
                    raise
                self.caught("each second", error)
        return changes + self._traffic.tick(self._counters, wall_ticks)

    def owner(self, ns: int, identifier: int) -> Topic | None:
        """The source that has this id."""
        return self._claims.get((ns, identifier))

    def is_alive(self, topic: Topic) -> bool:
        """Whether a source is heard."""
        source = self._sources.get(topic)
        return source is not None and source.alive

    def knows(self, topic: Topic) -> bool:
        """Whether a source, or an Action, belongs to a robot or a bridge, so that no policy decides on it."""
        return topic in self._skills or (topic in self._sources and topic not in self._discovered)

    def add_robot(self, robot: RobotModel) -> list[Change]:
        """Know a robot from now on. Sources of it that were discovered before are its own now."""
        changes: list[Change] = []
        for data_set in robot.all_data_sets():
            changes += self._discovery.forget(data_set.topic)
            self._discovered.discard(data_set.topic)
            self._silent_strangers.discard(data_set.topic)
        self._add(robot)
        return [*changes, RobotAdded(robot), *self._capacities_moved(self.capacities.add(robot))]

    def remove_robot(self, name: str) -> list[Change]:
        """Forget a robot."""
        status = self._robots.pop(name)
        self.moved.add(name)
        for data_set in status.model.all_data_sets():
            topic = data_set.topic
            del self._sources[topic], self._claims[topic.ns, topic.id]
            self._robot_of.pop(topic, None)
            self._robot_of_skills.pop(topic, None)
        for action in status.model.all_actions():
            self._skills.discard(action)
            self._claims.pop((action.ns, action.id), None)
        return [RobotRemoved(status.model), *self._capacities_moved(self.capacities.remove(status.model))]

    def set_faulted(self, robot: str, faulted: bool, wall_ticks: int) -> list[Change]:
        """A robot has a fault that is more than its silence, or none."""
        status = self._robots.get(robot)
        if status is None:
            return []
        status.faulted = faulted
        return status.state(wall_ticks)

    def set_busy(self, skill_status: Topic, skills: tuple[str, ...], wall_ticks: int) -> list[Change]:
        """The robot of this SkillStatus is at these skills, or at none."""
        robot = self._robot_of_skills.get(skill_status)
        if robot is None or robot.skills == skills:
            return []
        robot.skills = skills
        robot.has_moved()
        return robot.state(wall_ticks)

    def set_driven(self, robot: str, by: str, wall_ticks: int) -> list[Change]:
        """Somebody drives a robot by hand, in words; empty: nobody."""
        status = self._robots.get(robot)
        if status is None or status.driven_by == by:
            return []
        status.driven_by = by
        status.has_moved()
        return status.state(wall_ticks)

    def delivered(self, topic: Topic, timestamp: int) -> None:
        """A client's write has reached the nodes of a source of space 0 with this time."""
        source = self._sources.get(topic)
        if source is not None:
            source.remember(timestamp)

    def _add(self, robot: RobotModel) -> None:
        status = self._robots[robot.name] = RobotLiveness(robot, self._bridge_named.get(robot.bridge), self.moved)
        for data_set in robot.all_data_sets():
            self._claim(data_set)
        for topic in status.sources:
            self._robot_of[topic] = status
        for action in robot.all_actions():
            self._skills.add(action)
            self._claims[action.ns, action.id] = action
        if robot.skill_status is not None:
            self._robot_of_skills[robot.skill_status] = status

    def _claim(self, data_set: DataSetModel) -> None:
        topic = data_set.topic
        self._sources[topic] = Source(data_set)
        self._claims[topic.ns, topic.id] = topic

    def _data(self, event: DataReceived, wall_ticks: int) -> list[Change]:
        topic, message, metadata = event
        source = self._sources.get(topic)
        changes: list[Change] = []
        if source is None:
            if topic.id == RUN_DATA_ID:
                return []  # the run is shown as a whole, and not what each bridge says of it
            source, changes = self._find(topic, metadata, wall_ticks)
            if source is None:
                is_conflict = (topic.ns, topic.id) in self._claims
                self._counters.drop(Drop.CONFLICT if is_conflict else Drop.UNKNOWN_SOURCE)
                return changes
        if source.metadata is not metadata:
            changes += source.bind(metadata, self._counters, wall_ticks)
        was_alive = source.alive
        changes += source.take(message, self._counters, wall_ticks)
        for bridge in self._bridges_in.get(topic.space, ()):
            bridge.last_seen = wall_ticks
        robot = self._robot_of.get(topic)
        if robot is not None:
            if source.alive:  # else it has said that it is gone
                robot.last_update = wall_ticks
            if source.has_moved:
                self._look_at_quality(source)
        if source.alive != was_alive:
            changes += self._life_changed(source, wall_ticks)
        return changes

    def _silent(self, topic: Topic, wall_ticks: int) -> list[Change]:
        source = self._sources.get(topic)
        if source is None:
            return []
        changes = source.silence()
        self._look_at_quality(source)
        if source.alive:
            source.alive = False
            changes += self._life_changed(source, wall_ticks)
        return changes

    def _there(self, event: SourceReturned | SourceStale | SourceAppeared, wall_ticks: int) -> list[Change]:
        source = self._sources.get(event.topic)
        if source is None:
            return []
        changes = source.return_(is_followed=event.is_followed) if isinstance(event, SourceReturned) else source.age()
        self._look_at_quality(source)
        if not source.alive:
            source.alive = True
            changes += self._life_changed(source, wall_ticks)
        return changes

    def _unannounced(self, topic: Topic) -> list[Change]:
        """A source sends what nobody can read: it was asked for its metadata once more, and has not answered."""
        if len(self._asked) > _MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        asked = self._asked[topic] = self._asked.pop(topic, 0) + 1
        if asked != _ASKED_IN_VAIN:
            return []
        if self.knows(topic):
            text = f"{topic.name} sends data and announces no metadata: state its fields in `sources` of fleet.yaml"
            return [Noticed(True, text, topic)]
        return self._discovery.unannounced(topic)

    def _refused(self, event: SourceRefused) -> list[Change]:
        """A source that is not known stays unknown: nothing in a refused message is proved."""
        source = self._sources.get(event.topic)
        if source is None or source.alive:
            return []
        changes = source.refuse()
        self._look_at_quality(source)
        if changes:
            text = f"{self._name(source)}: messages in its name are refused ({event.drop.value})"
            changes.append(Noticed(True, f"{text}: its nodes are Bad_SecurityChecksFailed", event.topic))
        return changes

    def _life_changed(self, source: Source, wall_ticks: int) -> list[Change]:
        """Carry it to the robot or bridge that the source belongs to."""
        topic = source.model.topic
        changes: list[Change] = []
        if source.alive and source.is_refused:
            source.is_refused = False
            changes.append(Noticed(False, f"{self._name(source)}: its messages are taken again", topic))
        if source.model.gives:
            changes += self._capacities_moved(self.capacities.source_changed(topic, source.alive))
        robot = self._robot_of.get(topic)
        if robot is not None:
            return changes + robot.source_changed(source.model.name, source.alive, wall_ticks)
        bridge = self._bridge_of.get(topic)
        if bridge is not None:
            changes += bridge.set_online(source.alive, wall_ticks)
            for one in self._robots.values():
                if one.bridge is bridge:
                    changes += one.state(wall_ticks)
            return changes
        return changes + self._notice_life(source, wall_ticks)

    def _look_at_quality(self, source: Source) -> None:
        """Remember whose quality may be another one now."""
        if source.has_moved:
            source.has_moved = False
            if (robot := self._robot_of.get(source.model.topic)) is not None:
                robot.has_moved(quality=True)

    def _capacities_moved(self, changes: list[CapacitiesChanged]) -> list[CapacitiesChanged]:
        for change in changes:
            self.moved.add(change.robot.name)
        return changes

    def _notice_life(self, source: Source, wall_ticks: int) -> list[Change]:
        """Say that a source of no robot and no bridge has come or gone: anybody may send such sources."""
        topic = source.model.topic
        is_silent = not source.alive
        if is_silent:
            self._silent_strangers.add(topic)
        elif topic not in self._silent_strangers:
            return []
        else:
            self._silent_strangers.discard(topic)
        what = "is silent: its nodes are Bad_NoCommunication" if is_silent else "is there again"
        lines = self._silences if is_silent else self._returns
        text = lines.say(f"{self._name(source)} {what}", wall_ticks)
        return [Noticed(is_silent, text, topic)] if text else []

    def _name(self, source: Source) -> str:
        return f"{source.model.topic.name} ({source.model.name})"

    def _find(self, topic: Topic, metadata: DataSetMetaData, wall_ticks: int) -> tuple[Source | None, list[Change]]:
        """The source of a topic, made by the policy for unknown sources where there is none."""
        known = self._sources.get(topic)
        if known is not None and topic not in self._discovered:
            return known, []
        if topic.id == RUN_DATA_ID:
            return None, []
        owner = self._claims.get((topic.ns, topic.id))
        if owner is not None and (owner != topic or topic in self._skills):
            if topic in self._conflicts or len(self._conflicts) >= _MAX_CONFLICTS:
                return None, []
            self._conflicts.add(topic)
            whose = f"the skill {owner.name}" if owner in self._skills else owner.name
            text = f"{topic.name} claims the node of {whose}: give one of them another id"
            return None, [Noticed(True, text, topic)]
        data_set, changes = self._discovery.meet(topic, metadata, wall_ticks)
        for change in changes:
            if isinstance(change, SourceRemoved):
                self._discovered.discard(topic)
                self._silent_strangers.discard(topic)
                del self._sources[topic], self._claims[topic.ns, topic.id]
            elif isinstance(change, SourceAdded):
                self._discovered.add(topic)
                self._sources[topic] = Source(change.data_set)
                self._claims[topic.ns, topic.id] = topic
        return (self._sources.get(topic) if data_set is not None else None), changes
