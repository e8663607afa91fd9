"""The driver protocol: the part of a bridge that talks the robots' own language.

A driver tells what it hears through the `Inlet` (from any thread) as the facts below, and is told what to publish
into its space through `publish`. It knows nothing of datagrams, sequence numbers or the loop rule. A driver whose
robots can be commanded keeps the `SkillDriver` protocol too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from ua_fleet.counters import Drop
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldMetaData

__all__ = [
    "AnsweringDriver",
    "Driver",
    "DriverEvent",
    "DriverStatus",
    "Dropped",
    "Execution",
    "ExecutionEnded",
    "ExecutionFact",
    "ExecutionForgotten",
    "ExecutionNotBegun",
    "ExecutionProgressed",
    "ExecutionResumed",
    "ExecutionSuspended",
    "HaltingDriver",
    "Inlet",
    "PackingDriver",
    "RememberingDriver",
    "SampleRead",
    "SetpointDriver",
    "Skill",
    "SkillDriver",
    "SkillTarget",
    "SourceForgotten",
    "SourceFound",
    "SourceLost",
    "SourceRead",
    "StreamingDriver",
    "SuspendingDriver",
    "halts_of",
    "skills_of",
    "suspends_of",
]


@dataclass(frozen=True, slots=True)
class SourceFound:
    """A data source of the own space is there (again) and alive; its fields are known.

    Precedes its samples. Said again when the fields change, and when a lost source comes back.
    """

    topic: Topic
    name: str
    """Name for people: the mapped robot's topic, or the UA topic itself."""
    fields: tuple[FieldMetaData, ...]
    """The first field carries the properties `RosType` and, from ROS 1, `RosDefinition`."""
    may_have_period: bool = False
    """Whether a maximum age is learned from the period of its messages, where none is configured: each of them says
    what is now, and no late subscriber gets the last one."""


@dataclass(frozen=True, slots=True)
class SourceLost:
    """The source's own publisher is gone: one Bad_NoCommunication frame follows, then silence."""

    topic: Topic


@dataclass(frozen=True, slots=True)
class SourceForgotten:
    """A source that was lost is not looked for any more, and nothing of it is kept. SourceFound makes it anew."""

    topic: Topic


class SampleRead(NamedTuple):
    """One message of a source. `values` are in the order of the fields of its SourceFound."""

    topic: Topic
    values: tuple[Any, ...]
    source_time_ns: int
    """The robot's time of the message, ns since 1970."""
    status: int = 0
    own_publication: bool = False
    """Whether this bridge itself had published it into the space."""
    waited_s: float = 0.0
    """How long it had waited for the driver's callback, where the driver can tell."""


@dataclass(frozen=True, slots=True)
class SourceRead:
    """A polled source was read, and says what its last SampleRead said: that value is of now.

    Only sources with a maximum age need it (`ConfiguredData.is_aging`).
    """

    topic: Topic
    source_time_ns: int
    """When it was read, ns since 1970."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """The driver could not hand on `count` messages."""

    cause: Drop
    count: int = 1
    detail: str = ""


class ExecutionProgressed(NamedTuple):
    """How far a robot is with an execution. Also the answer to `query` where it works on it."""

    execution_id: bytes
    progress: float = 0.0
    """0 to 1."""
    message: str = ""
    """One line for people."""


class ExecutionSuspended(NamedTuple):
    """A robot stands in the middle of an execution. Also the answer to `query` where it does."""

    execution_id: bytes
    message: str = ""
    """One line for people."""


class ExecutionResumed(NamedTuple):
    """A robot that stood goes on with an execution."""

    execution_id: bytes


class ExecutionEnded(NamedTuple):
    """An execution is over. Said once, by whatever means the robot tells; also the answer to `query` where it is."""

    execution_id: bytes
    status: int = 0
    """StatusCode; 0 where the robot did what was asked."""
    values: tuple[Any, ...] = ()
    """The response's fields; empty where the robot failed, or with an Uncertain status where they are not known."""
    message: str = ""
    """One line for people: why it failed."""


class ExecutionForgotten(NamedTuple):
    """The answer to `query` where the robot cannot tell what became of an execution."""

    execution_id: bytes
    message: str = ""
    """One line for people: why it cannot."""


class ExecutionNotBegun(NamedTuple):
    """The answer to `query` where the robot knows for sure that it never heard of an execution.

    It is begun then, if it is not too late. Only a robot that forgets nothing may be said to know that.
    """

    execution_id: bytes


ExecutionFact = (
    ExecutionProgressed
    | ExecutionSuspended
    | ExecutionResumed
    | ExecutionEnded
    | ExecutionForgotten
    | ExecutionNotBegun
)
DriverEvent = SourceFound | SourceLost | SourceForgotten | SampleRead | SourceRead | Dropped | ExecutionFact


@dataclass(frozen=True, slots=True)
class DriverStatus:
    """State of the driver's link to its space."""

    connected: bool
    detail: str
    """One line: what it is connected to, or why it is not and what to do."""
    devices: Mapping[str, str] = field(default_factory=dict[str, str])
    """Where several things stand behind the bridge, each by its name: why it is away, empty while it is there."""
    aside: Mapping[str, str] = field(default_factory=dict[str, str])
    """The sources that were put aside since they misbehave, each by its name: why (`offenders.Offenders.told`)."""
    is_over: bool = False
    """Whether a mistake of its own has ended the driver, so that nothing in this process makes it work again.

    The bridge ends then, with `detail` as the error, and whoever supervises it starts it anew.
    """


class Inlet(Protocol):
    """The one bounded queue between a driver's threads and the bridge's event loop."""

    def put(self, event: DriverEvent) -> None:
        """Hand over an event; callable from any thread, never blocks.

        Facts of executions go before everything else. When full, the oldest SampleRead is dropped and counted;
        ExecutionProgressed, Suspended and Resumed give way to newer ones of their execution, and what is said of a
        source that comes and goes faster than is heard to the latest; other facts are never dropped.
        """
        ...


class Driver(Protocol):
    """Four methods; all but the inlet's `put` run in the bridge's event loop and must not block it."""

    async def start(self, inlet: Inlet) -> None:
        """Begin to watch the space. Returns once the driver works by itself, connected or not.

        A space that is absent (a ROS master that is not up) is not an error: the driver keeps trying and says so in
        `status`.

        Raises:
            BridgeUnavailable: a library that the driver needs is missing.
        """
        ...

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """Publish another space's message into this space; False, after an inlet Dropped, when that is not possible.

        Raises:
            FieldMissing: the message lacks a field that `fleet.yaml` gives its DataSet; the bridge counts it. See
                `ConfiguredData.order`, by which all drivers match fields.
        """
        ...

    def status(self) -> DriverStatus:
        """The state of the link now."""
        ...

    async def stop(self) -> None:
        """Leave the space and release everything. Safe to call twice."""
        ...


@runtime_checkable
class StreamingDriver(Protocol):
    """What a driver has beside `Driver` where it reads some of its data only while somebody follows it."""

    def want(self, wanted: frozenset[Topic]) -> None:
        """The sources that somebody follows from now on; the others are to rest. Runs in the bridge's event loop.

        Called after `start`, when it changes; with none when the server is not heard any more.
        """
        ...


@runtime_checkable
class AnsweringDriver(Protocol):
    """What a driver has beside `Driver` where its robots ask for values of other spaces, which must be of now then."""

    def stale(self, topic: Topic, is_stale: bool) -> None:
        """The value that was published last is not of now (its source is Bad, or silent), or is so again.

        Runs in the bridge's event loop. What is published is of now, and is not told here.
        """
        ...


@runtime_checkable
class PackingDriver(Protocol):
    """What a driver has beside `Driver` where it can take long arrays as views: see `ua_fleet.wire.packed`."""

    takes_packed_arrays: bool
    """Whether it does."""


@runtime_checkable
class RememberingDriver(Protocol):
    """What a driver has beside `Driver` where it keeps files: certificates, or what must survive a restart."""

    def remember_in(self, folder: Path) -> None:
        """Told the bridge's `state_dir` before `start`. The folder need not exist."""
        ...


@runtime_checkable
class SetpointDriver(Protocol):
    """What a driver has beside `Driver` where robots of its space can be driven by hand (docs/teleoperation.md).

    Both run in the bridge's event loop and must not block it. `topic` is the data that takes the setpoints.
    """

    def setpoint_problem(self, topic: Topic) -> str:
        """Why nothing that is written now reaches the robot, in a line for people; empty where it does.

        Asked before a lease is granted, and each 50 ms while one is held: the lease ends with a problem.
        """
        ...

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        """Write a setpoint to the robot now, or not at all: none may wait for anything. `values` are by field.

        Called each period while the robot is driven, and until it stands.
        """
        ...


class SkillTarget(NamedTuple):
    """A robot that has a skill."""

    id: int
    """ActionTargetId, unique within the skill; below 8192, since the others are for what is under way."""
    name: str
    status: Topic
    """The robot's SkillStatus, one data source for all its skills; the bridge publishes it."""


@dataclass(frozen=True, slots=True)
class Skill:
    """One thing that robots of the space do: an Action with a target for each robot that does it."""

    topic: Topic
    """(space, WriterGroupId, DataSetWriterId) of the Action's messages. No data source has this id."""
    name: str
    targets: tuple[SkillTarget, ...]
    """Who can be asked."""
    request: tuple[FieldMetaData, ...] = ()
    """The arguments."""
    response: tuple[FieldMetaData, ...] = ()
    """The results."""
    is_immediate: bool = False
    """Whether the ActionResponse waits for the end, which comes within the request's TimeoutHint."""
    can_suspend: bool = True
    """Whether robots can stand in the middle of it and go on, where the driver is a SuspendingDriver."""
    limits: SkillLimits = field(default_factory=SkillLimits)
    """What each target takes at most; more is refused."""
    problem: Callable[[tuple[Any, ...]], str | None] | None = field(default=None, compare=False)
    """Why arguments of the right types are not legal, or None; what is not legal is refused."""


class Execution(NamedTuple):
    """One skill that a robot is to do, once."""

    execution_id: bytes
    """16 bytes, unique for ever. What the robot calls it (a goal id) is best made of it."""
    topic: Topic
    """Of the Skill."""
    action_target_id: int
    values: tuple[Any, ...]
    """The request's fields, checked against their types."""
    timeout_s: float | None = None
    """How long the requestor waits, where it says so."""


@runtime_checkable
class SkillDriver(Protocol):
    """What a driver has beside `Driver` where robots of its space can be commanded.

    All of it runs in the bridge's event loop and must not block it. The bridge has recorded an execution before it
    calls `execute`, and calls that once for each id, whatever is repeated on the network.
    """

    def skills(self) -> Sequence[Skill]:
        """What there is to command. Asked after `start`, and each second from then on."""
        ...

    def execute(self, execution: Execution) -> None:
        """Begin an execution. ExecutionEnded follows through the inlet in any case, also where the robot refuses.

        Raises:
            SkillError: nothing was begun, and nothing will be; the requestor is told the StatusCode and the text.
                RobotBusy where the robot is at something else: it is asked again.
        """
        ...

    def query(self, execution: Execution) -> None:
        """Find out what became of an execution that a bridge before us may have begun.

        One of the facts about it follows through the inlet, as soon as the robot can be asked: it goes on, it has
        ended, the robot cannot tell, or it was never begun.
        """
        ...


@runtime_checkable
class HaltingDriver(SkillDriver, Protocol):
    """A SkillDriver whose robots can be stopped in what they do."""

    def halt(self, execution: Execution) -> None:
        """Have a robot stop an execution that was begun and has not ended, as far as the bridge knows.

        ExecutionEnded follows through the inlet once somebody has seen that it stands, Bad_RequestCancelledByClient is
        its usual status; ExecutionForgotten where nobody has. What ends by itself meanwhile ends as ever.

        Raises:
            SkillError: it cannot be stopped, and goes on; the requestor is told the StatusCode and the text.
        """
        ...


@runtime_checkable
class SuspendingDriver(SkillDriver, Protocol):
    """A SkillDriver whose robots can stand in the middle of what they do, and go on.

    Both are asked for by people, and may be asked for again before the robot has done them.
    """

    def suspend(self, execution: Execution) -> None:
        """Have a robot stand in the middle of an execution that has not ended, as far as the bridge knows.

        ExecutionSuspended follows through the inlet once it stands. It may be halted then, and its time goes on.

        Raises:
            SkillError: it cannot stand there, and goes on; the requestor is told the StatusCode and the text.
        """
        ...

    def resume(self, execution: Execution) -> None:
        """Have a robot go on; ExecutionResumed follows through the inlet once it does.

        Raises:
            SkillError: it cannot go on, and stands; the requestor is told the StatusCode and the text.
        """
        ...


def suspends_of(driver: SkillDriver) -> SuspendingDriver | None:
    """The driver where its robots can stand and go on."""
    return driver if isinstance(driver, SuspendingDriver) else None


def halts_of(driver: SkillDriver) -> HaltingDriver | None:
    """The driver where its robots can be stopped."""
    return driver if isinstance(driver, HaltingDriver) else None


def skills_of(driver: object) -> SkillDriver | None:
    """The driver where its robots can be commanded."""
    return driver if isinstance(driver, SkillDriver) else None
