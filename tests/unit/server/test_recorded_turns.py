"""The core with runs and a requestor that record in the server's file: each turn is synced once, before it sends."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from pathlib import Path

import pytest
import structlog

from tests.kill_points import Syncs, counted_syncs
from tests.unit.operation.runs.recorded_world import RecordedWorld
from tests.unit.operation.runs.test_recorded_requests import CHAIN, TASKS
from tests.unit.operation.runs.world import CONFIG, STATUS
from tests.unit.server.core_bench import RATE_HZ, SENDER, TIMING
from ua_fleet.config.nodes import fleet_model
from ua_fleet.counters import Counters
from ua_fleet.fleet.commands import Commands
from ua_fleet.fleet.state import FleetState
from ua_fleet.operation.skills.tracker import SkillTracker
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.server.attached import Ground, Parts
from ua_fleet.server.core import ServerCore
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus
from ua_fleet.topics import Topic
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage, encode_action


class CoreWorld(RecordedWorld):
    """All that robots say comes as datagrams, each of which is a turn."""

    def __init__(self, folder: Path, syncs: Syncs) -> None:
        super().__init__(folder)
        self._syncs = syncs
        self.unsynced: list[int] = []
        """Turns at whose end something was not synced."""
        self.turns = 0
        model, counters = fleet_model(CONFIG), Counters()
        self.core = ServerCore(
            Ground(
                publisher=Publisher(0, TIMING, counters, Codec()),
                subscriber=Subscriber(0, TIMING, counters, Codec()),
                counters=counters,
                commands=Commands(model),
                state=FleetState(model, counters),
                skills=self.commands,
                tracker=SkillTracker(model),
                mistakes=self.mistakes,
                log=structlog.get_logger(),
                send=lambda _: None,
            ),
            Parts(runs=self.service),
            analog_rate_hz=RATE_HZ,
        )
        self.bridge = Publisher(2, TIMING, Counters(), Codec())
        for topic in STATUS.values():
            announced = self.bridge.announce(
                topic, topic.name, SKILL_STATUS_FIELDS, now=self.now, wall_ticks=self.wall()
            )
            self.take(announced)

    def wall(self) -> int:
        return ticks_from_unix_ns(round(self.now * 1e9))

    def take(self, datagrams: Iterable[bytes]) -> None:
        for datagram in datagrams:
            self.now += 0.1
            self.core.receive(datagram, SENDER, now=self.now, wall=self.wall())
            self.turns += 1
            if self._syncs.is_pending:
                self.unsynced.append(self.turns)

    def poll(self, seconds: int) -> None:
        for _ in range(seconds):
            self.now += 1.0
            self.core.poll(now=self.now, wall=self.wall())

    def receive(self, response: ActionMessage) -> None:
        self.take([encode_action(response)])

    def hear(self, status_id: int, *executions: ExecutionStatus, status: int = 0) -> None:
        shown = SkillStatus()
        for execution in executions:
            shown.show(execution)
        types, values = shown.fields()
        topic = Topic(2, 2, status_id)
        self.take(self.bridge.publish(topic, values, timestamp=self.wall(), status=status, now=self.now, types=types))

    def _concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self.core.concluded(execution_id, outcome, now=self.now, wall=self.wall())


def test_a_turn_is_synced_once_and_before_it_sends(tmp_path: Path) -> None:
    pending: list[bool] = []
    with counted_syncs() as syncs:
        world = CoreWorld(tmp_path, syncs)
        world.before_send = lambda: pending.append(syncs.is_pending)
        syncs.take()
        world.start(CHAIN)
        costs = [syncs.take()]
        for number in range(TASKS):
            world.respond(world.asked()[number])
            costs.append(syncs.take())
            world.end()
            costs.append(syncs.take())
        world.close()
    assert world.ended() == ["done"]
    assert costs == [1, *[1, 1] * TASKS], "each is accepted, and ends where the next one begins"
    assert len(pending) == 2 * TASKS, "a request, and Idle after its response"
    assert not any(pending)
    assert world.unsynced == [], "clients are told in a later turn"
    assert not world.mistakes.count


def test_after_a_sync_that_failed_no_turn_sends_anything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with counted_syncs() as syncs:
        world = CoreWorld(tmp_path, syncs)
        world.start(CHAIN)
        [first] = world.asked()
        with monkeypatch.context() as patch:
            patch.setattr(os, "fdatasync", broken)
            world.respond(first)
        world.end()
        world.poll(30)
        assert world.sent == [first]
        assert "the disk could not be synced (Input/output error)" in world.service.problem
        assert not world.mistakes.count
        world.close()
