"""The nine tasks carried by real bridges, over and over, while the server is killed: who watches the wire is the judge.

    python -m tests.carried.killed --runs 100 --seed 7

Everything is started once, as `ua-fleet demo talkrobots --mode carried` does. In each run the server is killed by
SIGKILL at a random moment after it has begun. In every second run it stays dead until the run is over: bridges tell
the end. In the others it is started again after a random while, and has to show the run with all that it has missed.
The seed decides all moments.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncGenerator, Sequence
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from random import Random
from typing import Final

from ua_demo.launch import Launch
from ua_demo.lines import read_line
from ua_demo.processes import Processes
from ua_demo.site import choose_site
from ua_demo.talkrobots.setting import ACTORS, DOMAINS, SCENARIO, Setting, make_setting

from tests.system import free_multicast_url, free_tcp_port, ros_domain
from ua_fleet.client import ScenarioClient
from ua_fleet.config.load import load
from ua_fleet.errors import RemoteWireError, UaFleetError
from ua_fleet.pubsub.run_data import RUN_DATA_ID
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, read_status
from ua_fleet.transport.base import Address
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import NetworkMessage

__all__ = ["AS_IT_SHOULD_BE", "FOR_GOOD", "Judged", "judge", "runs_with_kills"]

SPEED: Final = 20.0
"""The most that the demonstration offers: a dozen processes compute all the while, whether anything is done or not."""
RUN_S: Final = 120.0 / SPEED
"""What one run takes, more or less."""
LONGEST_S: Final = 60.0
FOR_GOOD: Final = "for good"
AS_IT_SHOULD_BE: Final = "nine tasks, each done once"
MENDED_S: Final = 60.0 / SPEED + 1.5
"""So long after a run the drive that has failed turns again, as its robot has told all bridges."""
SKILLS: Final = Counter(
    {"fetch": 1, "transport": 1, "grasp": 1, "go": 2, "take_off": 1, "pick": 1, "land": 1, "load": 1}
)
"""What the nine tasks ask of robots; the drive that fails is one `go` more, which has failed."""


@dataclass(slots=True)
class Heard:
    """What the bridges have told on the wire, whether a server was there or not."""

    executions: dict[bytes, ExecutionStatus] = field(default_factory=dict[bytes, ExecutionStatus])
    """By their ids, as SkillStatus has told of them last."""
    outcomes: dict[str, str] = field(default_factory=dict[str, str])
    """Of runs, by their ids."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of one run."""

    run_id: str
    killed_after_s: float
    is_for_good: bool
    problems: tuple[str, ...]


def judge(before: set[bytes], heard: Heard) -> list[str]:
    """What is wrong with a run, of which these executions are new: nine tasks, each done once."""
    new = [status for key, status in heard.executions.items() if key not in before]
    done = Counter(status.skill for status in new if status.state is ExecutionState.DONE)
    failed = Counter(status.skill for status in new if status.state is ExecutionState.FAILED)
    others = [status for status in new if status.state not in (ExecutionState.DONE, ExecutionState.FAILED)]
    problems = [
        f"{skill} was done {done[skill]} times, not {SKILLS[skill]}" for skill in SKILLS if done[skill] != SKILLS[skill]
    ]
    if failed != Counter({"go": 1}):
        problems.append(f"these have failed, and not one `go`: {dict(failed)}")
    return problems + [f"{status.skill} is {status.state.name}" for status in others]


class _Fleet:
    """The processes, and who listens to them."""

    def __init__(self, setting: Setting, processes: Processes) -> None:
        self.processes, self.launch = processes, Launch(setting.site, processes)
        self._setting, self.config = setting, load(setting.site.config_file)
        self.heard, self._codec = Heard(), Codec()
        ns = self.config.fleet.namespace_index
        self._statuses = {
            (self.config.bridges[robot.bridge].space, ns, int(robot.skill_status_id))
            for robot in self.config.robots.values()
            if robot.skill_status_id is not None
        }
        self._ready: set[str] = set()
        self._changed = asyncio.Event()
        self._mended_at = 0.0

    async def start(self) -> None:
        """Start everything, and wait until it works."""
        setting = self._setting
        await self.launch.prepare()
        if setting.has_ros1:
            await self.launch.master()
        await self.launch.server()
        for actor in ACTORS:
            await self.launch.bridge(actor.bridge, setting.bridge_ros(actor))
        for actor in ACTORS:
            command, environment = setting.command(actor), setting.environment(actor)
            await self.processes.start(actor.name, command, environment, partial(self._says, actor.name))
        await self.launch.ready("server", *(actor.bridge for actor in ACTORS))
        names = {actor.name for actor in ACTORS}
        await self.processes.until(lambda: names <= self._ready, self._changed, LONGEST_S, "the robots")

    def _says(self, name: str, line: str) -> None:
        event = read_line(line)
        if line.partition(":")[0] == "ready" or (event is not None and event.what == "is ready"):
            self._ready.add(name)
        self._changed.set()

    def receive(self, datagram: bytes, _sender: Address) -> None:
        """Take what is on the wire."""
        try:
            message = self._codec.decode(datagram)
        except RemoteWireError:
            return
        if not isinstance(message, NetworkMessage):
            return
        for part in message.messages:
            key = (message.publisher_id, message.writer_group_id, part.data_set_writer_id)
            if part.data_set_writer_id == RUN_DATA_ID and part.values and part.values[-1]:
                self.heard.outcomes[part.values[0]] = part.values[-1]
            elif key in self._statuses and part.values:
                for status in read_status(SKILL_STATUS_FIELDS, part.values):
                    self.heard.executions[status.execution_id] = status

    async def run(self, random: Random, *, is_for_good: bool) -> Judged:
        """One run, with the server killed in it."""
        before = set(self.heard.executions)
        run_id = await self._start_run()
        try:
            await _until(lambda: bool(set(self.heard.executions) - before), "the first task")
        except AssertionError as error:
            raise AssertionError(f"{error}: {'; '.join(await self._shown(run_id, 1.0))}") from error
        killed_after_s = random.uniform(0.0, 0.8 * RUN_S)
        await asyncio.sleep(killed_after_s)
        await self.processes.kill("server")
        if not is_for_good:
            await asyncio.sleep(random.uniform(0.0, 0.3 * RUN_S))
            await self._server_again()
        await _until(lambda: run_id in self.heard.outcomes, f"the end of {run_id}")
        self._mended_at, outcome = time.monotonic() + MENDED_S, self.heard.outcomes[run_id]
        await asyncio.sleep(0.5)  # whatever would be done twice would be by now
        problems = judge(before, self.heard) + ([] if outcome == "done" else [f"bridges say that it is {outcome}"])
        if is_for_good:
            await self._server_again()
        problems += await self._shown(run_id)
        return Judged(run_id, killed_after_s, is_for_good, tuple(problems))

    async def _server_again(self) -> None:
        await self.launch.server()
        await self.launch.ready("server")

    async def _start_run(self) -> str:
        """Start a run as soon as the server hears all bridges, and the drive of the run before turns again."""
        await asyncio.sleep(self._mended_at - time.monotonic())
        deadline = time.monotonic() + LONGEST_S
        while True:
            try:
                async with self.launch.connect() as client:
                    if not any(fault.active for fault in await ScenarioClient(client).faults()):
                        return await ScenarioClient(client).run(SCENARIO, carried=True)
            except UaFleetError:
                if time.monotonic() > deadline:
                    raise
            if time.monotonic() > deadline:
                raise AssertionError("a robot has a fault still")
            await asyncio.sleep(0.3)

    async def _shown(self, run_id: str, most_s: float = LONGEST_S) -> list[str]:
        """What is wrong with the run as the server that came back shows it."""
        deadline = time.monotonic() + most_s
        async with self.launch.connect() as client:
            while not (info := await ScenarioClient(client).run_info(run_id)).is_over and time.monotonic() < deadline:
                await asyncio.sleep(0.2)
        states = Counter(info.states)
        is_right = info.state == "done" and states == Counter({"done": 9})
        return [] if is_right else [f"the server shows {info.state} with {dict(states)}: {info.reason}"]


async def _until(condition: object, what: str) -> None:
    assert callable(condition)
    deadline = time.monotonic() + LONGEST_S
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} was waited for, {LONGEST_S:g} s long")
        await asyncio.sleep(0.05)


@asynccontextmanager
async def _started(folder: Path, domains: Sequence[int]) -> AsyncGenerator[_Fleet]:
    site = choose_site(
        folder,
        port=free_tcp_port(),
        master_port=free_tcp_port(),
        pubsub_urls=[free_multicast_url()],
        without_ros1=False,
        secure=False,
        console_port=None,
        say=lambda _line: None,
    )
    setting = make_setting(
        site, domains=domains, speed=SPEED, mode="automatic", limit_s=60.0, is_carried=True, say=lambda _line: None
    )
    async with Processes(folder / "log") as processes:
        fleet = _Fleet(setting, processes)
        transport = UdpTransport(site.pubsub_urls[0], "lo")
        await transport.start(fleet.receive)
        try:
            await fleet.start()
            yield fleet
        finally:
            await transport.close()


async def runs_with_kills(folder: Path, domains: Sequence[int], count: int, seed: int) -> AsyncGenerator[Judged]:
    """So many runs, each as soon as it is over."""
    random = Random(seed)
    async with _started(folder, domains) as fleet:
        for number in range(count):
            yield await fleet.run(random, is_for_good=number % 2 == 1)


async def _main(count: int, seed: int) -> int:
    wrong = 0
    with ExitStack() as held, tempfile.TemporaryDirectory() as folder:
        domains = [held.enter_context(ros_domain()) for _ in range(DOMAINS)]
        async for judged in runs_with_kills(Path(folder), domains, count, seed):
            how = FOR_GOOD if judged.is_for_good else "started again"
            what = "; ".join(judged.problems) or AS_IT_SHOULD_BE
            sys.stdout.write(f"{judged.run_id}  killed after {judged.killed_after_s:5.2f} s, {how:13}  {what}\n")
            sys.stdout.flush()
            wrong += bool(judged.problems)
    sys.stdout.write(f"{count} runs, seed {seed}: {wrong} were wrong\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The nine tasks, carried, while the server is killed.")
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    sys.exit(asyncio.run(_main(given.runs, given.seed)))
