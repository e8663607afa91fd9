"""The base class of drivers: the part of a bridge that talks the robots' own language.

A driver tells what it hears through the `Inlet` (from any thread) as facts (`ua_fleet.bridge.facts`), and is told what
to publish into its space through `publish`. It knows nothing of datagrams, sequence numbers or the loop rule. Four
methods are its own to write; it overrides others where its robots can do more.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Protocol

from ua_fleet.bridge.facts import (
    DriverEvent,
    Dropped,
    ExecutionEnded,
    ExecutionFact,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
    SampleRead,
    SourceForgotten,
    SourceFound,
    SourceLost,
    SourceRead,
)
from ua_fleet.errors import SkillRejected
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldMetaData

__all__ = [
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
    "Inlet",
    "SampleRead",
    "Skill",
    "SkillTarget",
    "SourceForgotten",
    "SourceFound",
    "SourceLost",
    "SourceRead",
]

_CANNOT: Final = "the robot has no way to do that"
_TOGETHER: Final = (("skills", "execute", "query"), ("suspend", "resume"), ("setpoint_problem", "write_setpoint"))
"""Methods of which a driver overrides all or none."""


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
    """Whether robots can stand in the middle of it and go on, where the driver can have them do so (`suspend`)."""
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


class Driver(ABC):
    """What every bridge has; all but the inlet's `put` runs in the bridge's event loop and must not block it.

    `start`, `publish`, `status` and `stop` have no default. The others have: a driver that overrides none of them has
    robots that cannot be commanded, are not driven by hand, and keep no files. What is overridden is what the bridge
    offers, so nothing else has to be declared.
    """

    takes_packed_arrays: ClassVar[bool] = False
    """Whether it takes long arrays as views: see `ua_fleet.wire.packed`."""

    @abstractmethod
    async def start(self, inlet: Inlet) -> None:
        """Begin to watch the space. Returns once the driver works by itself, connected or not.

        A space that is absent (a ROS master that is not up) is not an error: the driver keeps trying and says so in
        `status`.

        Raises:
            BridgeUnavailable: a library that the driver needs is missing.
        """

    @abstractmethod
    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """Publish another space's message into this space; False, after an inlet Dropped, when that is not possible.

        Raises:
            FieldMissing: the message lacks a field that `fleet.yaml` gives its DataSet; the bridge counts it. See
                `ConfiguredData.order`, by which all drivers match fields.
        """

    @abstractmethod
    def status(self) -> DriverStatus:
        """The state of the link now."""

    @abstractmethod
    async def stop(self) -> None:
        """Leave the space and release everything. Safe to call twice."""

    # What it is told. The default does nothing with it, on purpose.

    def remember_in(self, folder: Path) -> None:  # noqa: B027 - see above
        """Where it keeps files: certificates, or what must survive a restart.

        Told the bridge's `state_dir` before `start`. The folder need not exist.
        """

    def want(self, wanted: frozenset[Topic]) -> None:  # noqa: B027 - see above
        """The sources that somebody follows from now on; the others are to rest.

        For a driver that reads some of its data only while somebody follows it. Called after `start`, when it changes;
        with none when the server is not heard any more.
        """

    def stale(self, topic: Topic, is_stale: bool) -> None:  # noqa: B027 - see above
        """The value that was published last is not of now (its source is Bad, or silent), or is so again.

        For a driver whose robots ask for values of other spaces, which must be of now then. What is published is of
        now, and is not told here.
        """

    # Skills. The bridge has recorded an execution before it calls `execute`, and calls that once for each id, whatever
    # is repeated on the network.

    @property
    def has_skills(self) -> bool:
        """Whether robots of its space can be commanded: it has `skills`, `execute` and `query` of its own."""
        return type(self).execute is not Driver.execute

    def skills(self) -> Sequence[Skill]:
        """What there is to command. Asked after `start`, and each second from then on."""
        return ()

    def execute(self, execution: Execution) -> None:
        """Begin an execution. ExecutionEnded follows through the inlet in any case, also where the robot refuses.

        Raises:
            SkillError: nothing was begun, and nothing will be; the requestor is told the StatusCode and the text.
                RobotBusy where the robot is at something else: it is asked again.
        """
        raise SkillRejected(_CANNOT)

    def query(self, execution: Execution) -> None:
        """Find out what became of an execution that a bridge before us may have begun.

        One of the facts about it follows through the inlet, as soon as the robot can be asked: it goes on, it has
        ended, the robot cannot tell, or it was never begun.
        """
        raise SkillRejected(_CANNOT)

    @property
    def can_halt(self) -> bool:
        """Whether robots can be stopped in what they do: it has `halt` of its own."""
        return type(self).halt is not Driver.halt

    def halt(self, execution: Execution) -> None:
        """Have a robot stop an execution that was begun and has not ended, as far as the bridge knows.

        ExecutionEnded follows through the inlet once somebody has seen that it stands, Bad_RequestCancelledByClient is
        its usual status; ExecutionForgotten where nobody has. What ends by itself meanwhile ends as ever.

        Raises:
            SkillError: it cannot be stopped, and goes on; the requestor is told the StatusCode and the text.
        """
        raise SkillRejected(_CANNOT)

    @property
    def can_suspend(self) -> bool:
        """Whether robots can stand in the middle of what they do, and go on: it has `suspend` and `resume`.

        Both are asked for by people, and may be asked for again before the robot has done them.
        """
        return type(self).suspend is not Driver.suspend

    def suspend(self, execution: Execution) -> None:
        """Have a robot stand in the middle of an execution that has not ended, as far as the bridge knows.

        ExecutionSuspended follows through the inlet once it stands. It may be halted then, and its time goes on.

        Raises:
            SkillError: it cannot stand there, and goes on; the requestor is told the StatusCode and the text.
        """
        raise SkillRejected(_CANNOT)

    def resume(self, execution: Execution) -> None:
        """Have a robot go on; ExecutionResumed follows through the inlet once it does.

        Raises:
            SkillError: it cannot go on, and stands; the requestor is told the StatusCode and the text.
        """
        raise SkillRejected(_CANNOT)

    # Driving by hand (docs/teleoperation.md). `topic` is the data that takes the setpoints.

    def setpoint_problem(self, topic: Topic) -> str:
        """Why nothing that is written now reaches the robot, in a line for people; empty where it does.

        Asked before a lease is granted, and each 50 ms while one is held: the lease ends with a problem.
        """
        return "its driver has no way to write setpoints"

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        """Write a setpoint to the robot now, or not at all: none may wait for anything. `values` are by field.

        Called each period while the robot is driven, and until it stands.
        """
        raise NotImplementedError

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a driver that does a thing by halves.

        Raises:
            TypeError: of methods that belong together, it has only some.
        """
        super().__init_subclass__(**kwargs)
        for together in _TOGETHER:
            missing = [name for name in together if getattr(cls, name) is getattr(Driver, name)]
            if missing and len(missing) < len(together):
                raise TypeError(f"{cls.__name__} has no {' and no '.join(missing)}; write all of {', '.join(together)}")
