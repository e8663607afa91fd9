"""What the server's core hands its facts to: parts that hear what comes by PubSub, or have to be called in time.

Each part has a type of its own here, whose methods do nothing: that is the part of a server without it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from ua_fleet.counters import Counters
from ua_fleet.fleet.changes import Change, ValueChanged
from ua_fleet.fleet.commands import Commands, Publication
from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.state import FleetState
from ua_fleet.operation.alarms.condition import Condition
from ua_fleet.operation.log import Log, MistakeLog
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.operation.skills.tracker import SkillTracker, SkillTransitioned
from ua_fleet.pubsub.events import ActionReceived, DataReceived, SubscriberEvent
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.messages import FieldMetaData

__all__ = [
    "AlarmsPart",
    "CarriedPart",
    "Clock",
    "Clocked",
    "Ground",
    "HistoryPart",
    "ModelPart",
    "NamespacePart",
    "NoAlarms",
    "NoCarried",
    "NoHistory",
    "NoModel",
    "NoNamespace",
    "NoNodes",
    "NoRegistry",
    "NoRuns",
    "NoTeleoperation",
    "NoWantedData",
    "Parts",
    "RegistryPart",
    "RunsPart",
    "ShownNodes",
    "TeleoperationPart",
    "TimedPart",
    "WantedPart",
]


class TimedPart(Protocol):
    """What has to be called in time, by the clock of the core."""

    def poll(self, now: float) -> None:
        """Do what is due."""
        return

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        return None


class ShownNodes(TimedPart, Protocol):
    """Where clients see what the core knows: see `nodes.projection`."""

    def begin_turn(self) -> None:
        """The core begins with something else, a datagram for example."""
        return

    def write(self, change: ValueChanged) -> None:
        """Show a value."""
        return

    def put(self, change: Change | SkillTransitioned) -> None:
        """Show any change."""
        return


class RunsPart(Protocol):
    """Runs of scenarios: see `operation.runs.service`."""

    def must_not_begin(self) -> Collection[bytes]:
        """Executions that were asked for before a restart and must not begin any more."""
        return ()

    def go_on(self) -> None:
        """Go on where the last server ended."""
        return

    def heard(self, event: DataReceived) -> None:
        """Take data, of which a robot's SkillStatus matters."""
        return

    def source_lost(self, topic: Topic) -> None:
        """A source is not heard any more, or its last value may not be of now."""
        return

    def source_returned(self, topic: Topic) -> None:
        """The last value of a source is of now again."""
        return

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request is known."""
        return

    def value_changed(self, change: ValueChanged) -> None:
        """A node of the fleet has another value or status."""
        return

    def published(self, topic: Topic, types: Sequence[int], values: Sequence[object]) -> None:
        """Data of the server itself, which clients write, has been sent to robots."""
        return

    def fleet_changed(self) -> None:
        """Robots, skills or capacities have come or gone."""
        return

    def end_batch(self) -> None:
        """A batch of news is complete: what follows from it may be decided."""
        return

    def add_robot(self, robot: RobotModel, *, is_heard: bool) -> None:
        """A robot has come."""
        return

    def remove_robot(self, name: str, *, is_replaced: bool = False) -> None:
        """A robot that no run uses is gone; or it comes again at once, with another definition."""
        return

    def poll(self) -> None:
        """Do what is due."""
        return

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return None


class TeleoperationPart(Protocol):
    """Robots that are driven by hand: see `server.teleoperation.service`."""

    def begin(self) -> None:
        """Ask for the Actions that are not announced yet."""
        return

    def follow(self, event: SubscriberEvent) -> None:
        """Take what bridges say of them."""
        return

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        return

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action."""
        return

    def poll(self, now: float) -> None:
        """Do what is due."""
        return

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return None


class RegistryPart(Protocol):
    """Who is told of robots that bridges announce: see `operation.robots.roster`."""

    def announced(self, topic: Topic, text: str) -> None:
        """A bridge says in the metadata of a robot's SkillStatus what the robot is."""
        return

    def tick(self) -> None:
        """A second has passed."""
        return


class Clock(Protocol):
    """What has to be called in time, by a clock of its own."""

    def poll(self) -> None:
        """Do what is due."""
        return

    def due_in_s(self) -> float | None:
        """After how many seconds `poll` is to be called next, or None."""
        return None


class Clocked:
    """Such a part as one that goes by the clock of the core."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def poll(self, now: float) -> None:
        """Do what is due."""
        del now
        self._clock.poll()

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next, or None."""
        due_in_s = self._clock.due_in_s()
        return None if due_in_s is None else now + due_in_s


class WantedPart(Clock, Protocol):
    """What bridges are told of the data that is wanted: see `nodes.wanted_data`."""

    def sources(self) -> Iterable[tuple[str, Topic, tuple[FieldMetaData, ...]]]:
        """What is to be announced: name, topic and fields."""
        return ()

    def begin(self) -> None:
        """The sources are announced: tell of them from now on."""
        return


class ModelPart(TimedPart, Protocol):
    """The information model of PubSub: see `server.pubsub_model`."""

    def follow(self, event: SubscriberEvent) -> None:
        """Take what bridges announce."""
        return

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        return


class NamespacePart(Protocol):
    """The Unified Namespace: see `server.unified_namespace`. A mistake in it costs it alone."""

    def value_changed(self, change: ValueChanged) -> None:
        """A node of the fleet has another value or status."""
        return

    def changed(self, change: Change) -> None:
        """A robot, or something else, has come or gone."""
        return

    def written(self, publication: Publication) -> None:
        """Data that clients write has been sent to robots."""
        return


class HistoryPart(TimedPart, Protocol):
    """What is kept of values: see `server.history`."""

    def record(self, change: ValueChanged) -> None:
        """A node of the fleet has another value or status."""
        return

    def forget(self, keys: Iterable[NodeId]) -> None:
        """These nodes are gone."""
        return


class AlarmsPart(TimedPart, Protocol):
    """Alarms of values: see `operation.alarms.service`."""

    @property
    def watched(self) -> Mapping[NodeId, Condition]:
        """Those that watch a node, by it; it changes with them."""
        return {}

    def look(self, condition: Condition, change: ValueChanged) -> None:
        """The node that an alarm watches has another value or status."""
        return


class CarriedPart(TimedPart, Protocol):
    """Runs that bridges carry: see `operation.runs.carried`."""

    def follow(self, event: SubscriberEvent) -> None:
        """Take what robots say."""
        return

    def announced(self, announcement: ActionMetaDataAnnouncement) -> None:
        """Learn of an Action."""
        return

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take responses."""
        return


class NoAlarms(AlarmsPart):
    """Nothing is watched."""


class NoCarried(CarriedPart):
    """No bridge carries runs."""


class NoHistory(HistoryPart):
    """Nothing is kept."""


class NoModel(ModelPart):
    """Nobody looks at PubSub itself."""


class NoNamespace(NamespacePart):
    """Nobody is told over MQTT."""


class NoNodes(ShownNodes):
    """Nobody looks."""


class NoRuns(RunsPart):
    """There are no scenarios."""


class NoTeleoperation(TeleoperationPart):
    """Nobody drives a robot by hand."""


class NoRegistry(RegistryPart):
    """Robots are those of the model."""


class NoWantedData(WantedPart):
    """No bridge reads on demand."""


@dataclass(frozen=True, slots=True)
class Ground:
    """What the core and its parts have in common, made before them."""

    publisher: Publisher
    subscriber: Subscriber
    counters: Counters
    commands: Commands
    """The data that clients write."""
    state: FleetState
    skills: SkillCommands
    """Its outcomes are to come to `ServerCore.concluded`."""
    tracker: SkillTracker
    """What is known of executions."""
    mistakes: MistakeLog
    log: Log
    send: Callable[[bytes], None]
    """Sends a plain message to all, at once."""


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of one server."""

    nodes: ShownNodes = field(default_factory=NoNodes)
    runs: RunsPart = field(default_factory=NoRuns)
    teleoperation: TeleoperationPart = field(default_factory=NoTeleoperation)
    registry: RegistryPart = field(default_factory=NoRegistry)
    wanted: WantedPart = field(default_factory=NoWantedData)
    model: ModelPart = field(default_factory=NoModel)
    namespace: NamespacePart = field(default_factory=NoNamespace)
    history: HistoryPart = field(default_factory=NoHistory)
    carried: CarriedPart = field(default_factory=NoCarried)
    alarms: AlarmsPart = field(default_factory=NoAlarms)
    timed: Mapping[str, TimedPart] = field(default_factory=dict[str, TimedPart])
    """Others, by the names under which their mistakes are counted."""
