"""The processes of the benchmark `actions`.

    python -m benchmarks._actions echo RESPONSE_BYTES      prints its port; answers each datagram with so many bytes,
                                                           or with the same where it is 0
    python -m benchmarks._actions bridge FLEET JOURNAL     our bridge; JOURNAL is `disk` or `memory`
    python -m benchmarks._actions client FLEET JOURNAL     our requestor, and the one that asks the echo

The client answers a line `echo N BYTES PORT` or `ours N` on its standard input with the microseconds of N round trips.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import structlog

from ua_fleet.bridge import Driver, DriverStatus, Execution, ExecutionEnded, Inlet, Skill, SkillTarget
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.config.schema import FleetConfig, PubSubSecurity
from ua_fleet.config.security import file_keys_of
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.topics import Topic
from ua_fleet.transport.base import Address
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

SPACE = 300
ACTION, STATUS = Topic(SPACE, 2, 1900), Topic(SPACE, 2, 1901)
TARGET = 1
PAUSE_S = 0.005
"""Before each round trip of either kind: the bridge records the end of an execution after it has answered."""
VALUES = (1.5, -2.5, 90.0, "pallet")
FIELDS = (*(make_field(name, BuiltinType.DOUBLE) for name in "xya"), make_field("tool", BuiltinType.STRING))


class Idler(Driver):
    """A driver whose robot does all at once."""

    def __init__(self) -> None:
        from tests.contract.virtual import Bus, VirtualDriver

        self._bus = Bus()
        self._base = VirtualDriver(SPACE, self._bus)
        self._inlet: Inlet | None = None

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
        return (
            Skill(
                ACTION,
                "place",
                (SkillTarget(TARGET, "robot", STATUS),),
                FIELDS,
                limits=SkillLimits(requests_at_once=60),
            ),
        )

    def execute(self, execution: Execution) -> None:
        assert self._inlet is not None
        self._inlet.put(ExecutionEnded(execution.execution_id))

    def query(self, execution: Execution) -> None: ...


async def echo(size: int) -> None:
    """The least that answers a datagram in an event loop."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    receiver.setblocking(False)
    answer = bytes(size)

    def drain() -> None:
        while True:
            try:
                datagram, sender = receiver.recvfrom(65_536)
            except BlockingIOError:
                return
            receiver.sendto(answer or datagram, sender)

    asyncio.get_running_loop().add_reader(receiver.fileno(), drain)
    print("ready", receiver.getsockname()[1], flush=True)
    await asyncio.to_thread(sys.stdin.read)


async def bridge(config: FleetConfig, folder: Path, journal: str) -> None:
    is_secured = config.pubsub.security is not PubSubSecurity.NONE
    running = asyncio.ensure_future(
        run_bridge(
            config,
            "cell",
            Idler(),
            UdpTransport(config.pubsub.url, "lo"),
            state_dir=folder / config.state_dir_of("cell"),
            keys=file_keys_of(config, SPACE, folder) if is_secured else None,
            journal=MemoryJournal() if journal == "memory" else None,
            ready=lambda: print("ready", flush=True),
        )
    )
    await asyncio.to_thread(sys.stdin.read)
    running.cancel()
    await asyncio.wait([running])


class EchoClient:
    """Asks an echo, one datagram at a time, in an event loop."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Future[None] = self._loop.create_future()
        self._loop.add_reader(self._socket.fileno(), self._drain)

    def _drain(self) -> None:
        while True:
            try:
                self._socket.recvfrom(65_536)
            except BlockingIOError:
                return
            self._waiting.set_result(None)

    async def ask(self, datagram: bytes, port: int) -> None:
        self._waiting = self._loop.create_future()
        self._socket.sendto(datagram, ("127.0.0.1", port))
        await self._waiting


class Sizes(UdpTransport):
    """Notes how long requests and their responses are."""

    def __init__(self, url: str) -> None:
        super().__init__(url, "lo")
        self.request = self.response = 0
        self.is_measuring = False

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        if self.is_measuring:
            self.request = max(self.request, len(datagram))
        super().send(datagram, address)


async def client(config: FleetConfig, folder: Path, journal: str) -> None:
    from tests.integration.actions.requesting import requesting

    transport = Sizes(config.pubsub.url)
    folder = folder / "requestor"
    folder.mkdir()
    memory = MemoryJournal() if journal == "memory" else None
    async with requesting(config, folder, transport=transport, journal=memory) as requestor:
        receive, take = requestor.receive, requestor.commands.receive
        last: list[int] = [0]

        def note(datagram: bytes, sender: Address) -> None:
            last[0] = len(datagram)
            receive(datagram, sender)

        def note_response(event: ActionReceived, now: float) -> None:
            transport.response = max(transport.response, last[0])
            take(event, now)

        requestor.receive = note  # type: ignore[method-assign]  # to see how long a response is
        requestor.commands.receive = note_response  # type: ignore[method-assign]  # as above
        transport.is_measuring = True
        await requestor.invoke(ACTION, VALUES, 5.0)
        transport.is_measuring = False
        requestor.receive, requestor.commands.receive = receive, take  # type: ignore[method-assign]  # as above
        echoing = EchoClient()
        print("ready", json.dumps([transport.request, transport.response]), flush=True)
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := (await reader.readline()).decode().split():
            times: list[float] = []
            for _ in range(int(line[1])):
                await asyncio.sleep(PAUSE_S)
                started = time.perf_counter()
                if line[0] == "echo":
                    await echoing.ask(bytes(int(line[2])), int(line[3]))
                else:
                    outcome = await requestor.invoke(ACTION, VALUES, 5.0)
                    assert outcome.kind == "accepted", outcome
                times.append(time.perf_counter() - started)
            print(json.dumps([round(one * 1e6, 1) for one in times]), flush=True)


def quiet_logs() -> None:
    """Only what is wrong is said, on the standard error."""
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    structlog.configure(
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING),
    )


def main() -> None:
    quiet_logs()
    role, *rest = sys.argv[1:]
    if role == "echo":
        asyncio.run(echo(int(rest[0])))
        return
    fleet, journal = Path(rest[0]), rest[1]
    config = FleetConfig.model_validate_json(fleet.read_text())
    asyncio.run((bridge if role == "bridge" else client)(config, fleet.parent, journal))


if __name__ == "__main__":
    main()
