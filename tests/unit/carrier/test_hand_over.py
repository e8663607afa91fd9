"""From the end of a step to the call of the robot in the next bridge: what is synced to the disk, and when.

Two bridges with their Actions, holders, engines and journals, on a network that nobody waits for; the disk is real.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import pytest
from ua_demo.simulators.fleet.memory import VirtualLoop

from tests.kill_points import counted_syncs, kill_points
from tests.unit.carrying.test_plan import plan, task
from ua_fleet.bridge.actions import Actions
from ua_fleet.bridge.carry import CarryGround
from ua_fleet.bridge.core import BridgeCore, CarrySide
from ua_fleet.bridge.driver import (
    Driver,
    DriverStatus,
    Execution,
    ExecutionEnded,
    ExecutionNotBegun,
    ExecutionProgressed,
    Inlet,
    Skill,
    SkillTarget,
    SourceFound,
)
from ua_fleet.bridge.journals import ExecutionJournals
from ua_fleet.bridge.status import STATUS_FIELDS, status_topic, status_values
from ua_fleet.carrier import carrier_of
from ua_fleet.carrying import Holder, Token, encode_part, encode_token, parts_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.monitoring import Mistakes
from ua_fleet.pubsub.carry_action import CARRY_ID
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.storage.carried_records import CarriedRecords
from ua_fleet.storage.journal import SqliteJournal
from ua_fleet.topics import Topic
from ua_fleet.values import UNIX_EPOCH_TICKS
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

SKILL_IDS, STATUS_IDS = {300: 920, 301: 921}, {300: 910, 301: 911}
BRIDGES = {"cell": 300, "hall": 301}
ROBOTS = {"cell": "a", "hall": "b"}
CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {
            name: {"kind": "virtual", "space": space, "status_id": 600 + space, "requestors": [0, *BRIDGES.values()]}
            for name, space in BRIDGES.items()
        },
        "robots": {
            ROBOTS[name]: {
                "bridge": name,
                "skill_status_id": STATUS_IDS[space],
                "skills": {"work": {"id": SKILL_IDS[space]}},
            }
            for name, space in BRIDGES.items()
        },
    }
)
PARTS = parts_of(plan(task("one", "a"), task("two", "b")), "run", "made", {}, "eva", adopt_after_s=3600.0)
STEP_S = 0.05
MOST_STEPS = 200
RESTARTED_AT = 8.0


class Robot(Driver):
    """A robot that remembers what it has begun, whatever becomes of its bridge."""

    def __init__(self, space: int, robot: str, begun: Sequence[bytes], noted: Callable[[str], None]) -> None:
        self._noted, self.begun = noted, list(begun)
        self.told: list[ExecutionNotBegun | ExecutionProgressed] = []
        ns = CONFIG.fleet.namespace_index
        target = SkillTarget(1, robot, Topic(space, ns, STATUS_IDS[space]))
        self._skills = (Skill(Topic(space, ns, SKILL_IDS[space]), "work", (target,)),)

    async def start(self, inlet: Inlet) -> None: ...

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        return True

    def status(self) -> DriverStatus:
        return DriverStatus(connected=True, detail="a robot")

    async def stop(self) -> None: ...

    def skills(self) -> Sequence[Skill]:
        return self._skills

    def execute(self, execution: Execution) -> None:
        self.begun.append(execution.execution_id)
        self._noted("robot called")

    def query(self, execution: Execution) -> None:
        known = execution.execution_id in self.begun
        kind = ExecutionProgressed(execution.execution_id, 0.5) if known else ExecutionNotBegun(execution.execution_id)
        self.told.append(kind)


class Sent(NamedTuple):
    space: int
    datagram: bytes


class Bridge:
    """One bridge; what it sends stands in `sent`."""

    def __init__(
        self,
        name: str,
        folder: Path,
        begun: Sequence[bytes],
        clock: Callable[[], float],
        noted: Callable[[str], None],
    ) -> None:
        self.space, self.sent, self._clock, self._noted = BRIDGES[name], list[Sent](), clock, noted
        self.robot = Robot(self.space, ROBOTS[name], begun, noted)
        self.loop, self.mistakes = VirtualLoop(clock), Mistakes()
        self.journal = SqliteJournal(folder / "executions.db")
        self.records: CarriedRecords | None = None
        timing, counters = PubSubTiming(), Counters()
        publisher = Publisher(self.space, timing, counters, Codec())
        subscriber = Subscriber(self.space, timing, counters, Codec())
        self.core = BridgeCore(
            self.space, publisher, subscriber, counters, send=self._send_and_tell, publish=self.robot.publish
        )
        self.actions = self.core.actions = Actions(
            self.space,
            publisher,
            counters,
            driver=self.robot,
            journal=self.journal,
            requestors=[0, *BRIDGES.values()],
            must_be_verified=False,
            core=self.core,
            send=self._send_and_tell,
            send_to=lambda datagram, _address: self._send(datagram),
            wall_ticks=self.wall_ticks,
            failed=lambda text, error: pytest.fail(f"{text}: {error}"),
            answers=lambda _address, sender: sender,
            skills_period_s=math.inf,
        )
        ground = CarryGround(
            publisher,
            subscriber,
            self.core,
            self.actions,
            counters,
            self.mistakes,
            self.loop,
            send=self._send,
            send_to=lambda datagram, _address: self._send(datagram),
            wall_ticks=self.wall_ticks,
            sooner=lambda: None,
            must_be_verified=False,
            answers=lambda _address, sender: sender,
            limits=ResponderLimits(),
        )
        self.core.carrying = carrier_of(CONFIG, name, folder, lambda: self._open(folder))(ground)
        self._begin(name, self.core.carrying, counters)

    def _begin(self, name: str, carrying: CarrySide, counters: Counters) -> None:
        topic = status_topic(CONFIG, CONFIG.bridges[name])
        assert topic is not None
        self.core.begin(now=self._clock(), wall_ticks=self.wall_ticks())
        source = SourceFound(topic, f"{name} status", STATUS_FIELDS)
        self.core.from_space(source, now=self._clock(), wall_ticks=self.wall_ticks())
        values = status_values(name, "virtual", self.robot.status(), counters)
        self.core.tell(topic, values, self.wall_ticks(), now=self._clock())
        self.actions.begin(self._clock())
        carrying.begin(self._clock())

    def wall_ticks(self) -> int:
        return UNIX_EPOCH_TICKS + round((self._clock() + 1e9) * 10_000_000)

    def _open(self, folder: Path) -> CarriedRecords:
        self.records = CarriedRecords(folder)
        return self.records

    def _send(self, datagram: bytes) -> None:
        message = Codec().decode(datagram)
        if isinstance(message, ActionMessage) and message.data_set_writer_id == CARRY_ID:
            self._noted("token sent" if message.is_request else "token acknowledged")
        else:
            self._noted("sent")
        self.sent.append(Sent(self.space, datagram))

    def _send_and_tell(self, datagram: bytes) -> None:
        self._send(datagram)
        if self.core.carrying is not None:
            self.core.carrying.own(datagram)

    def take(self, sent: Sent) -> None:
        self.core.from_pubsub(sent.datagram, now=self._clock(), sender=("127.0.0.1", sent.space))
        self.go_on()

    def tell_end(self) -> None:
        """Its robot is done; what follows from it is the loop's."""
        ended = ExecutionEnded(self.robot.begun[-1])
        self.core.from_space(ended, now=self._clock(), wall_ticks=self.wall_ticks())

    def end_task(self) -> None:
        """Its robot is done."""
        self.tell_end()
        self.go_on()

    def poll(self) -> None:
        told, self.robot.told = self.robot.told, []
        for fact in told:
            self.core.from_space(fact, now=self._clock(), wall_ticks=self.wall_ticks())
        self.core.poll(self._clock(), self.wall_ticks())
        self.go_on()

    def go_on(self) -> None:
        self.loop.run_ready()
        assert not self.mistakes.count, self.mistakes.text()

    def close(self) -> None:
        self.journal.close()
        if self.records is not None:
            self.records.close()


class World:
    """Both bridges; the run has begun, and its token is with the first one."""

    def __init__(self, folder: Path, now: float, begun: Mapping[str, Sequence[bytes]]) -> None:
        self.now, self.noted = now, list[str]()
        self.looked: Callable[[str], None] = self.noted.append
        for name, space in BRIDGES.items():
            if not (folder / name).exists():
                (folder / name).mkdir()
                with CarriedRecords(folder / name) as records:
                    holder = Holder(space, records.note)
                    holder.take_part(encode_part(PARTS[space]), 1e9)
                    if space == BRIDGES["cell"]:
                        token = Token("run", PARTS[space].plan_hash, 1, 0, 0)
                        holder.take_token(encode_token(token, ()), 0, 1e9)
        self.bridges = {
            name: Bridge(name, folder / name, begun.get(name, ()), lambda: self.now, partial(self._note, name))
            for name in BRIDGES
        }
        self.cell, self.hall = self.bridges.values()

    def _note(self, bridge: str, what: str) -> None:
        self.looked(f"{bridge}: {what}")

    def begun(self) -> dict[str, list[bytes]]:
        """What the robots have begun, by their bridges."""
        return {name: list(bridge.robot.begun) for name, bridge in self.bridges.items()}

    def until(self, is_so: Callable[[], object]) -> None:
        """Have the network and the time go on until something is so."""
        for _ in range(MOST_STEPS):
            while any(bridge.sent for bridge in self.bridges.values()):
                for bridge in self.bridges.values():
                    sent, bridge.sent = bridge.sent, []
                    for other in self.bridges.values():
                        for one in sent if other is not bridge else ():
                            other.take(one)
            if is_so():
                return
            self.now += STEP_S
            for bridge in self.bridges.values():
                bridge.poll()
        pytest.fail(f"it does not come to that: {self.noted[-20:]}")

    def close(self) -> None:
        for bridge in self.bridges.values():
            bridge.close()


@contextmanager
def world_in(
    folder: Path, now: float = 5.0, begun: Mapping[str, Sequence[bytes]] = MappingProxyType({})
) -> Generator[World]:
    world = World(folder, now, begun)
    try:
        yield world
    finally:
        world.close()


def syncs_of_a_hand_over(folder: Path) -> tuple[dict[str, int], set[str]]:
    """The syncs until each thing is said or done first, and what is, while something is not on the disk."""
    at: dict[str, int] = {}
    early: set[str] = set()
    with counted_syncs() as syncs, world_in(folder) as world:
        world.until(lambda: world.cell.robot.begun)
        syncs.take()
        total = [0]

        def looked(what: str) -> None:
            total.append(total[-1] + syncs.take())
            at.setdefault(what, total[-1])
            if syncs.is_pending:
                early.add(what)

        world.looked = looked
        world.cell.end_task()
        world.until(lambda: world.hall.robot.begun and "hall: token acknowledged" in at)
    return at, early


def test_a_hand_over_costs_three_syncs_and_nothing_leaves_before_its_own(tmp_path: Path) -> None:
    at, early = syncs_of_a_hand_over(tmp_path)
    assert at["cell: token sent"] == 2, "that the robot is done; the end of the step and of its segment"
    assert at["hall: robot called"] == 3, "the token, the step, its request and its execution are on the disk at once"
    assert early == set()


def test_a_token_leaves_in_the_turn_that_has_synced_it(tmp_path: Path) -> None:
    with world_in(tmp_path) as world:
        world.until(lambda: world.cell.robot.begun)
        world.cell.tell_end()
        world.cell.loop.call_soon(world.noted.append, "what the loop does next")
        world.cell.go_on()
        assert world.noted.index("cell: token sent") < world.noted.index("what the loop does next")


def test_a_robot_that_is_called_before_the_sync_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unsettled(_journals: ExecutionJournals, *, is_own: bool) -> None: ...

    monkeypatch.setattr(ExecutionJournals, "settle", unsettled)
    assert "hall: robot called" in syncs_of_a_hand_over(tmp_path)[1]


def test_what_own_runs_ask_for_stands_with_them(tmp_path: Path) -> None:
    with world_in(tmp_path) as world:
        world.until(lambda: world.cell.robot.begun)
        assert [*world.cell.journal.executions()] == []
        assert world.cell.records is not None
        (execution,) = world.cell.records.executions.executions()
        assert (execution.execution_id, execution.space) == (world.cell.robot.begun[0], 300)


def begun_after_kills(tmp_path: Path) -> Iterator[list[bytes]]:
    """Of a hand-over that is killed at each write in turn, and goes on: what the robots have begun."""
    folder, copies = tmp_path / "disk", tmp_path / "copies"
    folder.mkdir()
    copies.mkdir()
    with kill_points(folder, copies) as points, world_in(folder) as world:
        points.state = world.begun
        world.until(lambda: world.cell.robot.begun)
        first = len(points.made)
        world.cell.end_task()
        world.until(lambda: world.hall.robot.begun)
        points.copy()
    assert len(points.made) - first > 5
    for killed, begun in points.made[first:]:
        with world_in(killed, RESTARTED_AT, begun) as again:
            yield begun_after_a_restart(again)


def begun_after_a_restart(world: World) -> list[bytes]:
    """What the robots have begun once the run has gone on for a while."""
    world.until(lambda: world.hall.robot.begun or world.now > RESTARTED_AT + 2.0)
    if not world.hall.robot.begun:  # killed before it was written that the first robot is done
        world.cell.end_task()
    world.until(lambda: world.hall.robot.begun and world.now > RESTARTED_AT + 4.0)
    return [*world.cell.robot.begun, *world.hall.robot.begun]


def test_a_kill_at_any_write_of_a_hand_over_begins_each_task_once(tmp_path: Path) -> None:
    for begun in begun_after_kills(tmp_path):
        assert len(begun) == len(set(begun)) == 2


def test_an_execution_that_is_not_written_down_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = ExecutionJournals.recorded

    def forgetful(journals: ExecutionJournals, execution: RecordedExecution) -> None:
        if execution.space != BRIDGES["hall"]:
            recorded(journals, execution)

    monkeypatch.setattr(ExecutionJournals, "recorded", forgetful)
    assert any(len(begun) > len(BRIDGES) for begun in begun_after_kills(tmp_path))
