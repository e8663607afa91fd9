"""What the contract suite asks of each driver's surroundings, and what it uses to watch a driver."""

from __future__ import annotations

import json
import socket
import subprocess
import threading
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

import pytest

from tests.forking import ForkedProcess, command_of
from ua_fleet.bridge import Driver, DriverEvent, Dropped, SampleRead, SourceFound, SourceLost
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

__all__ = [
    "FAULT_ID",
    "NUMBER",
    "TEXT",
    "TWIST",
    "UNKNOWN",
    "WORK",
    "WORK_ID",
    "DrivenSpace",
    "Kind",
    "MappedRobot",
    "MappedSpace",
    "Recorder",
    "Robot",
    "RobotProcess",
    "Rubbish",
    "SkillCase",
    "SkillSpace",
    "Space",
    "driven_fleet",
    "message_of",
]

WAIT_S: Final = 60.0
WORK_ID: Final = 1900
FAULT_ID: Final = 1903
"""Of the fault topic of a SkilledSpace's robot, where its driver has one."""
WORK: Final = {
    "id": WORK_ID,
    "arguments": {"work": {"type": "String"}, "seconds": {"type": "Double"}},
    "results": {"done": {"type": "String"}, "seconds": {"type": "Double"}},
}
"""The skill of a SkilledSpace, as `fleet.yaml` has it."""


@dataclass(frozen=True)
class Kind:
    """A type of message, with its flat fields."""

    ros_type: str
    fields: tuple[tuple[str, BuiltinType], ...]

    def metadata(self, name: str) -> DataSetMetaData:
        """Metadata as it comes from another space."""
        fields = tuple(
            make_field(field, builtin, properties={} if index else {"RosType": self.ros_type})
            for index, (field, builtin) in enumerate(self.fields)
        )
        return DataSetMetaData(name, fields, ConfigurationVersion(1, 1))

    def values(self, *values: Any) -> dict[str, Any]:
        """Values by field name."""
        return dict(zip((name for name, _ in self.fields), values, strict=True))


NUMBER: Final = Kind("std_msgs/Float64", (("data", BuiltinType.DOUBLE),))
TEXT: Final = Kind("std_msgs/String", (("data", BuiltinType.STRING),))
TWIST: Final = Kind(
    "geometry_msgs/Twist",
    tuple((f"{part}.{axis}", BuiltinType.DOUBLE) for part in ("linear", "angular") for axis in "xyz"),
)
UNKNOWN: Final = Kind("no_such_msgs/Thing", (("data", BuiltinType.DOUBLE),))


def message_of(topic: Topic, *values: Any, kind: Kind = NUMBER) -> DataSetMessage:
    """A message of another space, as a subscriber hands it on."""
    return DataSetMessage(
        topic.id,
        types=tuple(int(builtin) for _, builtin in kind.fields),
        values=values,
        timestamp=ticks_from_unix_ns(time.time_ns()),
        status=0,
        major_version=1,
        minor_version=1,
    )


class Robot(Protocol):
    """A robot in the space, independent of the driver. Names are those of topics, without a slash before them."""

    def advertise(self, name: str, kind: Kind) -> None:
        """Begin to publish on a topic."""
        ...

    def publish(self, name: str, values: Mapping[str, Any]) -> None:
        """Publish a message on an advertised topic; returns when it is handed to the robot's own library."""
        ...

    def withdraw(self, name: str) -> None:
        """Cease to publish on a topic."""
        ...

    def subscribe(self, name: str, kind: Kind) -> None:
        """Begin to hear a topic."""
        ...

    def heard(self, name: str) -> list[dict[str, Any]]:
        """The messages heard so far, in order."""
        ...

    def misbehave(self, name: str) -> None:
        """Say once on an advertised topic what is no message of its type."""
        ...


class Space(Protocol):
    """A space with its robots' side, up or not."""

    number: int
    can_be_absent: bool
    """Whether the robots' side has something that must be up (a ROS master)."""
    own_work: str
    """Where the driver does its own work again and again: the full name of a method, which a test breaks."""

    @property
    def robot(self) -> Robot:
        """The robot; there once the space has appeared."""
        ...

    def make_driver(self) -> Driver:
        """A new driver for this space, not started."""
        ...

    def appear(self) -> None:
        """Bring the robots' side up."""
        ...


class MappedRobot(Protocol):
    """A robot without topics: it has values, and takes values, that `fleet.yaml` names."""

    def show(self, topic: Topic, values: Sequence[Any]) -> None:
        """Have other values, in the order of the source's fields.

        Returns once the driver can have seen them: what a driver has to ask for is there until it has asked.
        """
        ...

    def taken(self, topic: Topic) -> list[tuple[Any, ...]]:
        """What came in for a sink, in the order of its fields and of its coming."""
        ...

    def leave(self) -> None:
        """Be gone, with all its sources."""
        ...

    def come_back(self) -> None:
        """Be there again."""
        ...

    def misbehave(self) -> None:
        """Say what no robot should, until `behave`."""
        ...

    def behave(self) -> None:
        """Be as before."""
        ...


class MappedSpace(Protocol):
    """A space without UA topics: what is read and written stands in the driver's configuration."""

    number: int
    sources: Mapping[Topic, Kind]
    """What is read from the robot: first a NUMBER; a TEXT and a TWIST where it has such a thing."""
    sinks: Mapping[Topic, Kind]
    """What other spaces' data is written to the robot: a NUMBER, and a TWIST where it can take one."""
    is_sampled: bool
    """Whether the driver looks at what the robot has now: a value that is replaced before the next look is not seen."""
    own_work: str
    """See Space."""

    @property
    def robot(self) -> MappedRobot:
        """The robot; there once the space has appeared."""
        ...

    def make_driver(self) -> Driver:
        """A new driver for this space, not started."""
        ...

    def appear(self) -> None:
        """Bring the robot up."""
        ...


@dataclass(frozen=True)
class SkillCase:
    """A skill of a robot, and arguments with which it does what a test needs."""

    topic: Topic
    target_id: int
    succeeds: tuple[Any, ...]
    """At once."""
    lasts: tuple[Any, ...]
    """Succeeds too, after half a second or more."""
    fails: tuple[Any, ...]
    """It is begun, and fails."""
    refused: tuple[Any, ...]
    """It is not begun."""


@runtime_checkable
class SkillSpace(Space, Protocol):
    """A space whose robots can be commanded."""

    skill_case: SkillCase

    def begun(self, execution_id: bytes) -> int:
        """How often a robot was told to begin an execution, over all drivers."""
        ...


class SkilledSpace(Protocol):
    """A space with a robot that is up and has a skill `work`.

    It takes a String `work` and a Double `seconds`, goes on for so long, and its results are the Strings `done` and the
    Double `seconds`. It refuses the work `refuse`, fails at `fail`, and never ends with `never ends`.
    """

    remembers: bool
    """Whether the robot can tell a later driver what became of an execution."""

    def make_driver(self) -> Driver:
        """A new driver for this space, not started."""
        ...

    def told(self) -> list[str]:
        """The work that the robot was told to do, twice where it was told twice."""
        ...

    def freeze(self) -> None:
        """The robot heeds no halt from now on, and says nothing more of it; its link stays."""
        ...

    def cut(self) -> None:
        """The link to the robot breaks."""
        ...


class DrivenSpace(Protocol):
    """A space with a robot that is up and takes setpoints of two axes, `linear` and `angular`, once it listens."""

    topic: Topic
    """The data that takes them."""

    def make_driver(self) -> Driver:
        """A new driver for this space, not started."""
        ...

    def listen(self) -> None:
        """The robot begins to listen."""
        ...

    def heard(self) -> list[tuple[float, float]]:
        """What reached the robot, in order."""
        ...


_DRIVEN: Final[dict[str, Any]] = {
    "data": {
        "cmd_vel": {
            "id": 1905,
            "origin": "server",
            "fields": {
                "linear": {"type": "Double", "path": "linear.x"},
                "angular": {"type": "Double", "path": "angular.z"},
            },
            "sink": {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"},
        }
    },
    "teleoperation": {
        "id": 1906,
        "acquire_id": 1907,
        "renew_id": 1908,
        "release_id": 1909,
        "data": "cmd_vel",
        "axes": {
            "linear": {"speed": 1000.0, "acceleration": 1000.0, "jerk": 1000.0},
            "angular": {"speed": 1000.0, "acceleration": 1000.0, "jerk": 1000.0},
        },
        "robot_timeout_ms": 500,
    },
}


def driven_fleet(bridge_name: str, bridge: Mapping[str, Any]) -> FleetConfig:
    """The fleet of a DrivenSpace in ROS."""
    fleet = {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {bridge_name: {**bridge, "status_id": 1904}},
        "robots": {"carrier": {"bridge": bridge_name, **_DRIVEN}},
    }
    return load_content(json.dumps(fleet).encode(), "fleet.json", {})


@dataclass
class Recorder:
    """An inlet that keeps all it gets."""

    events: list[DriverEvent] = field(default_factory=list[DriverEvent])

    def put(self, event: DriverEvent) -> None:
        """Appending to a list is safe from any thread."""
        self.events.append(event)

    def of(self, topic: Topic) -> list[DriverEvent]:
        """Everything about a source, in order."""
        facts = (SampleRead, SourceFound, SourceLost)
        return [event for event in list(self.events) if isinstance(event, facts) and event.topic == topic]

    def samples(self, topic: Topic) -> list[SampleRead]:
        """The samples of a source."""
        return [event for event in self.of(topic) if isinstance(event, SampleRead)]

    def found(self, topic: Topic) -> list[SourceFound]:
        """How often and with what a source was found."""
        return [event for event in self.of(topic) if isinstance(event, SourceFound)]

    def lost(self, topic: Topic) -> int:
        """How often a source was lost."""
        return sum(isinstance(event, SourceLost) for event in self.of(topic))

    def dropped(self, cause: Drop) -> int:
        """How many messages were dropped for a reason."""
        return sum(e.count for e in list(self.events) if isinstance(e, Dropped) and e.cause is cause)


@contextmanager
def broken(method: str) -> Generator[None]:
    """Have a method of a driver fail as no driver foresees."""

    def fail(*_: object) -> None:
        raise KeyError("a mistake of the bridge")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method, fail)
        yield


class RobotProcess:
    """A robot in another process. One JSON object for each line, and for each command the answer `{"done": true}`.

    {"do": "advertise", "name": .., "type": "pkg/Name"}     {"do": "withdraw", "name": ..}
    {"do": "publish", "name": .., "values": {"linear.x": 1.0}}
    {"do": "subscribe", "name": .., "type": .., "fields": ["linear.x"]}
    and at any time, from the robot:  {"heard": name, "values": {..}}
    """

    def __init__(self, command: Sequence[str | Path], env: Mapping[str, str]) -> None:
        self._heard: dict[str, list[dict[str, Any]]] = {}
        self._done = threading.Semaphore(0)
        self._other: list[str] = []
        found = command_of(command)
        assert found is not None, command
        self._process = ForkedProcess(found, env, reads=True)
        self._reader = threading.Thread(target=self._read, name="robot-reader", daemon=True)
        self._reader.start()
        self._wait("the robot's start")

    def _read(self) -> None:
        for line in self._process.stdout:
            if not line.startswith("{"):
                self._other.append(line)
                continue
            said: dict[str, Any] = json.loads(line)
            if "heard" in said:
                self._heard.setdefault(said["heard"], []).append(said["values"])
            else:
                self._done.release()

    def _wait(self, what: str) -> None:
        if not self._done.acquire(timeout=WAIT_S):
            raise AssertionError(f"{what} took more than {WAIT_S:g} s:\n{''.join(self._other)}")

    def _do(self, command: str, name: str, **rest: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": command, "name": name, **rest}) + "\n")
        self._process.stdin.flush()
        self._wait(f"the robot's {command}")

    def advertise(self, name: str, kind: Kind) -> None:
        """See Robot."""
        self._do("advertise", name, type=kind.ros_type)

    def publish(self, name: str, values: Mapping[str, Any]) -> None:
        """See Robot."""
        self._do("publish", name, values=dict(values))

    def withdraw(self, name: str) -> None:
        """See Robot."""
        self._do("withdraw", name)

    def subscribe(self, name: str, kind: Kind) -> None:
        """See Robot."""
        self._do("subscribe", name, type=kind.ros_type, fields=[field for field, _ in kind.fields])

    def heard(self, name: str) -> list[dict[str, Any]]:
        """See Robot."""
        return list(self._heard.get(name, []))

    def misbehave(self, name: str) -> None:
        """See Robot."""
        self._do("misbehave", name)

    def end(self) -> None:
        """End the process, which its end of input asks for."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(5)
        self._process.stdout.close()


class Rubbish:
    """In the place of a robot's server: whoever connects gets bytes without a sense, and without end."""

    def __init__(self, host: str, port: int, content: bytes) -> None:
        self._content = content * (1 + 65_536 // len(content))
        self._links: list[socket.socket] = []
        self._listener = socket.create_server((host, port))
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                self._links.append(self._listener.accept()[0])
                threading.Thread(target=self._say, args=(self._links[-1],), daemon=True).start()

    def _say(self, link: socket.socket) -> None:
        with suppress(OSError), link:
            while True:
                link.sendall(self._content)

    def end(self) -> None:
        """Be gone."""
        for each in (self._listener, *self._links):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        self._listener.close()
