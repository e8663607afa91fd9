"""The processes of the benchmark `availability`.

    python -m benchmarks._availability passive FLEET          a bridge; its robot prints a string, or gives it back
    python -m benchmarks._availability node FLEET SPACE       asks it again and again, one string after the other
    python -m benchmarks._availability main FLEET             asks as it is told, our robot or an echo

All answer lines on their standard input with lines of JSON:

    passive   executed      the ids that the robot was told since it was last asked; one told twice is there twice
    node      go, rest      rest: what it has asked since it was told to go
    main      open CHARACTERS PERIOD_MS COUNT, respond CHARACTERS COUNT         our robot
              echo-open BYTES PERIOD_MS COUNT PORT, echo-respond BYTES COUNT PORT
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import secrets
import socket
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from struct import Struct
from typing import Any

from benchmarks._actions import quiet_logs
from ua_fleet.bridge import Driver, DriverStatus, Execution, ExecutionEnded, Inlet, Skill, SkillTarget
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import file_keys_of
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

SPACE = 300
PRINT, ECHO, STATUS = Topic(SPACE, 2, 1900), Topic(SPACE, 2, 1901), Topic(SPACE, 2, 1902)
TARGET = 1
TIMEOUT_S = 5.0
ECHO_TIMEOUT_S = 1.0
_NUMBER = Struct("<I")
NODE_CHARACTERS, NODE_PAUSE_S = 1000, (0.001, 0.020)
"""What a further node asks with, and how long it waits before it asks again (Tamashiro et al., section 3)."""
MOST_LATE_S = 0.1
"""A request that could not be made until so long after its slot is not made."""
LEAST_PAUSE_S = 0.005
"""Between two requests whose response time is measured."""


class Printer(Driver):
    """A driver whose robot prints a string, or gives it back."""

    def __init__(self) -> None:
        from tests.contract.virtual import Bus, VirtualDriver

        self._base = VirtualDriver(SPACE, Bus())
        self._inlet: Inlet | None = None
        self._printed = open(os.devnull, "w")  # noqa: SIM115 - as long as the process
        self.told: list[str] = []

    async def start(self, inlet: Inlet) -> None:
        self._inlet = inlet
        await self._base.start(inlet)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        return self._base.publish(topic, metadata, message)

    def status(self) -> DriverStatus:
        return self._base.status()

    async def stop(self) -> None:
        await self._base.stop()

    def skills(self) -> Sequence[Skill]:
        target, text = (SkillTarget(TARGET, "robot", STATUS),), (make_field("text", BuiltinType.STRING),)
        limits = SkillLimits(requests_at_once=64)
        return (
            Skill(PRINT, "print", target, text, limits=limits),
            Skill(ECHO, "echo", target, text, text, is_immediate=True, limits=limits),
        )

    def execute(self, execution: Execution) -> None:
        assert self._inlet is not None
        self.told.append(execution.execution_id.hex())
        print(execution.values[0], file=self._printed)
        results = execution.values if execution.topic == ECHO else ()
        self._inlet.put(ExecutionEnded(execution.execution_id, 0, results))

    def query(self, execution: Execution) -> None: ...


@dataclass
class Asked:
    """What became of requests."""

    slots: int = 0
    missed: int = 0
    """Slots whose request would have been too late."""
    outcomes: Counter[str] = field(default_factory=Counter[str])
    """Outcomes of the others, by their kind."""
    accepted: list[str] = field(default_factory=list[str])
    """Ids of those that the robot was told, as the requestor knows it."""
    ids: list[str] = field(default_factory=list[str])
    ages_us: list[float] = field(default_factory=list[float])
    """From the slot's time to the outcome of what was accepted."""

    @property
    def refused(self) -> int:
        """By the robot's side; or never begun, because of a timeout or a slot that was missed."""
        return self.missed + self.outcomes["refused"] + self.outcomes["timed_out"]

    def line(self) -> str:
        """As a line of JSON."""
        return json.dumps(self.__dict__)

    @classmethod
    def read(cls, line: str) -> Asked:
        """What a line says."""
        fields: dict[str, Any] = json.loads(line)
        fields["outcomes"] = Counter[str](fields["outcomes"])
        return cls(**fields)


async def open_loop(period_s: float, count: int, ask: Callable[[float], Awaitable[None]]) -> int:
    """Ask once for each slot, whatever became of the requests before; the number of slots that were missed.

    One that is late is asked for all the same, up to MOST_LATE_S; its time goes on from the slot.
    """
    loop = asyncio.get_running_loop()
    start, slot, missed = loop.time() + period_s, 0, 0
    asking: list[asyncio.Future[None]] = []
    while slot < count:
        due = start + slot * period_s
        await asyncio.sleep(max(0.0, due - loop.time()))
        if loop.time() - due > MOST_LATE_S:
            missed += 1
        else:
            asking.append(asyncio.ensure_future(ask(due)))
        slot += 1
    await asyncio.gather(*asking)
    return missed


class Asking:
    """One requestor that asks the robot."""

    def __init__(self, requestor: Any, random: Random) -> None:
        self._requestor, self._random = requestor, random
        self._now = asyncio.get_running_loop().time

    async def ask(self, asked: Asked, topic: Topic, characters: int, since: float | None = None) -> None:
        execution_id = secrets.token_bytes(16)
        text = chr(self._random.randint(97, 122)) * characters
        since = self._now() if since is None else since
        asked.ids.append(execution_id.hex())
        outcome = await self._requestor.invoke(topic, (text,), TIMEOUT_S, execution_id)
        asked.outcomes[outcome.kind.value] += 1
        if outcome.kind == "accepted":
            asked.accepted.append(execution_id.hex())
            asked.ages_us.append(round((self._now() - since) * 1e6, 1))

    async def open(self, characters: int, period_s: float, count: int) -> Asked:
        asked = Asked(count)
        asked.missed = await open_loop(period_s, count, lambda due: self.ask(asked, PRINT, characters, due))
        return asked

    async def respond(self, characters: int, count: int) -> Asked:
        asked = Asked(count)
        for _ in range(count):
            await asyncio.sleep(LEAST_PAUSE_S)
            await self.ask(asked, ECHO, characters)
        return asked


class Echoing:
    """Asks an echo; any number of datagrams may be under way, and what is lost is not sent again."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[bytes, asyncio.Future[None]] = {}
        self._numbers = itertools.count()
        self._loop.add_reader(self._socket.fileno(), self._drain)

    def _drain(self) -> None:
        while True:
            try:
                datagram, _ = self._socket.recvfrom(65_536)
            except BlockingIOError:
                return
            waiting = self._waiting.pop(datagram[: _NUMBER.size], None)
            if waiting is not None:
                waiting.set_result(None)

    async def ask(self, asked: Asked, size: int, port: int, since: float | None = None) -> None:
        since = self._loop.time() if since is None else since
        number = _NUMBER.pack(next(self._numbers))
        waiting = self._waiting[number] = self._loop.create_future()
        self._socket.sendto(number + bytes(size - len(number)), ("127.0.0.1", port))
        done, _ = await asyncio.wait([waiting], timeout=ECHO_TIMEOUT_S)
        if not done:
            del self._waiting[number]
            asked.outcomes["lost"] += 1
            return
        asked.outcomes["accepted"] += 1
        asked.ages_us.append(round((self._loop.time() - since) * 1e6, 1))

    async def open(self, size: int, period_s: float, count: int, port: int) -> Asked:
        asked = Asked(count)
        asked.missed = await open_loop(period_s, count, lambda due: self.ask(asked, size, port, due))
        return asked

    async def respond(self, size: int, count: int, port: int) -> Asked:
        asked = Asked(count)
        for _ in range(count):
            await asyncio.sleep(LEAST_PAUSE_S)
            await self.ask(asked, size, port)
        return asked


async def lines() -> asyncio.StreamReader:
    """The standard input, line by line."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    return reader


async def passive(config: FleetConfig, folder: Path) -> None:
    robot, reader = Printer(), await lines()
    running = asyncio.ensure_future(
        run_bridge(
            config,
            "cell",
            robot,
            UdpTransport(config.pubsub.url, "lo"),
            state_dir=folder / config.state_dir_of("cell"),
            keys=file_keys_of(config, SPACE, folder),
            ready=lambda: print("ready", flush=True),
        )
    )
    while await reader.readline():
        told, robot.told = robot.told, []
        print(json.dumps(told), flush=True)
    running.cancel()
    await asyncio.wait([running])


async def node(config: FleetConfig, folder: Path, space: int) -> None:
    from tests.integration.actions.requesting import requesting

    reader, random = await lines(), Random(space)
    folder = folder / f"node-{space}"
    folder.mkdir()
    async with requesting(config, folder, space=space) as requestor:
        asking = Asking(requestor, random)
        await asking.ask(Asked(), PRINT, NODE_CHARACTERS)
        print("ready", flush=True)
        while await reader.readline():  # go
            asked, resting = Asked(), asyncio.ensure_future(reader.readline())
            while not resting.done():
                await asyncio.sleep(random.uniform(*NODE_PAUSE_S))
                asked.slots += 1
                await asking.ask(asked, PRINT, NODE_CHARACTERS)
            print(asked.line(), flush=True)


async def main_node(config: FleetConfig, folder: Path) -> None:
    from tests.integration.actions.requesting import requesting

    reader = await lines()
    folder = folder / "main"
    folder.mkdir()
    async with requesting(config, folder) as requestor:
        ours, echo = Asking(requestor, Random(0)), Echoing()
        await ours.ask(Asked(), PRINT, 10)
        await ours.ask(Asked(), ECHO, 10)
        print("ready", flush=True)
        while line := (await reader.readline()).decode().split():
            what, numbers = line[0], line[1:]
            if what == "open":
                asked = await ours.open(int(numbers[0]), float(numbers[1]) / 1000, int(numbers[2]))
            elif what == "respond":
                asked = await ours.respond(int(numbers[0]), int(numbers[1]))
            elif what == "echo-open":
                asked = await echo.open(int(numbers[0]), float(numbers[1]) / 1000, int(numbers[2]), int(numbers[3]))
            else:
                asked = await echo.respond(int(numbers[0]), int(numbers[1]), int(numbers[2]))
            print(asked.line(), flush=True)


def main() -> None:
    quiet_logs()
    role, fleet = sys.argv[1], Path(sys.argv[2])
    config, folder = FleetConfig.model_validate_json(fleet.read_text()), fleet.parent
    if role == "passive":
        asyncio.run(passive(config, folder))
    elif role == "node":
        asyncio.run(node(config, folder, int(sys.argv[3])))
    else:
        asyncio.run(main_node(config, folder))


if __name__ == "__main__":
    main()
