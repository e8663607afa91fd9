"""What a bridge does with runs of its journal that it cannot read, and with tokens while its disk fails."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from structlog.testing import capture_logs
from ua_demo.simulators.fleet.memory import VirtualLoop

from tests.unit.carrying.test_plan import plan, task
from ua_fleet.bridge.carry import CarryGround
from ua_fleet.bridge.immediate import ImmediateActions
from ua_fleet.carrier import carrier_of
from ua_fleet.carrier.engine import SegmentEnd, SegmentEngine
from ua_fleet.carrying import Holder, RunRefused, SegmentRound, Token, encode_part, encode_token, parts_of, segment_run
from ua_fleet.carrying.facts import PartTaken, PauseTold, SegmentBegun
from ua_fleet.carrying.held import LOST, HeldRun
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.errors import LocalWireError, StorageUnavailable
from ua_fleet.monitoring import Mistakes
from ua_fleet.pubsub.carry_action import CARRY_ID
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.scenario.facts import RunClosing, RunCreated, RunEnded
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.storage.carried_records import CarriedRecords
from ua_fleet.values import UNIX_EPOCH_TICKS
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage

CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {
            "cell": {"kind": "ros1", "space": 300, "requestors": [0, 301]},
            "hall": {"kind": "ros1", "space": 301, "requestors": [0, 300]},
        },
    }
)
PARTS = parts_of(plan(task("one", "a"), task("two", "b")), "run", "made", {}, "eva")


def _hears_nothing(_events: object, _now: float) -> None: ...


def _record_nothing(_journal: object, _now: float) -> None: ...


class Bridge:
    """Who carries runs in a bridge, on a loop that nobody waits for; its disk is real."""

    def __init__(self, name: str, folder: Path, records: CarriedRecords, config: FleetConfig = CONFIG) -> None:
        self.now = 5.0
        self.ahead_s = 0.0
        """Of the wall clock, which somebody has set."""
        self.sent: list[bytes] = []
        self.loop, self.mistakes = VirtualLoop(lambda: self.now), Mistakes()
        space, timing = config.bridges[name].space, PubSubTiming()
        self.subscriber = Subscriber(space, timing, Counters(), Codec())
        self.publisher = Publisher(space, timing, Counters(), Codec())
        ground = CarryGround(
            self.publisher,
            self.subscriber,
            cast("Any", SimpleNamespace(hear=_hears_nothing)),
            cast("Any", SimpleNamespace(record_own_in=_record_nothing)),
            Counters(),
            self.mistakes,
            self.loop,
            send=self.sent.append,
            send_to=lambda datagram, _address: self.sent.append(datagram),
            wall_ticks=lambda: UNIX_EPOCH_TICKS + round((self.now + self.ahead_s) * 10_000_000),
            sooner=lambda: None,
            must_be_verified=False,
            answers=lambda _address, sender: sender,
            limits=ResponderLimits(),
        )
        self.side = carrier_of(config, name, folder, lambda: records)(ground)
        self.side.begin(self.now)
        self.go_on(0.0)

    def hear(self, other: Bridge) -> None:
        for datagram in other.sent:
            for event in self.subscriber.receive(datagram, self.now, ("", 0)):
                self.side.hear(event, self.now)

    def go_on(self, after_s: float) -> None:
        self.now += after_s
        self.loop.run_ready()
        with suppress(StorageUnavailable):  # as the shell of a bridge does
            self.side.poll(self.now)
        self.loop.run_ready()
        assert not self.mistakes.count, self.mistakes.text()

    def requests(self) -> int:
        """How often it has asked another bridge to take something."""
        decoded = [Codec().decode(datagram) for datagram in self.sent]
        return sum(isinstance(one, ActionMessage) and one.data_set_writer_id == CARRY_ID for one in decoded)


@pytest.fixture
def records(tmp_path: Path) -> Iterator[CarriedRecords]:
    with CarriedRecords(tmp_path) as opened:
        yield opened


def with_a_token(records: CarriedRecords) -> None:
    """The journal of the first bridge, which has ended its segment and not handed over its token."""
    holder = Holder(300, records.note)
    holder.take_part(encode_part(PARTS[300]), 1.0)
    holder.take_token(encode_token(Token("run", PARTS[300].plan_hash, 1, 0, 0), ()), 0, 1.0)
    holder.segment_ended("run", SegmentRound(0), 2.0, results={"one.out": 1.0})


@pytest.mark.parametrize("fails", [False, True])
def test_no_token_leaves_a_bridge_whose_disk_could_not_be_synced(
    tmp_path: Path, records: CarriedRecords, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    with_a_token(records)
    cell = Bridge("cell", tmp_path, records)
    (tmp_path / "hall").mkdir()
    with CarriedRecords(tmp_path / "hall") as others:
        hall = Bridge("hall", tmp_path / "hall", others)
    if fails:
        with monkeypatch.context() as patched:
            patched.setattr(os, "fdatasync", _no_sync)
            with pytest.raises(StorageUnavailable), records.one_sync():
                records.note(PauseTold(5.0, "run", False, "eva"))
    cell.sent.clear()
    cell.hear(hall)
    for _ in range(3):
        cast("Any", cell.side)._segment_ended(SegmentEnd("run.0", "", {}, "", ""))  # as at the end of a turn
        cell.go_on(0.5)
    assert (cell.requests() > 0) != fails
    assert ("could not be synced" in cell.side.problem) == fails
    due = cell.side.next_deadline()
    assert due is None or due > cell.now, "it waits before it tries again"


def _no_sync(_file: int) -> None:
    raise OSError(5, "Input/output error")


def test_a_run_of_another_version_is_left_out_and_the_bridge_begins(tmp_path: Path, records: CarriedRecords) -> None:
    with_a_token(records)
    records.note(PartTaken(1.0, "old", b"a part of another version".hex()))
    records.note(SegmentBegun(1.0, "old", 0))
    segment = segment_run("old", SegmentRound(0))
    records.runs.write([(segment, RunCreated(1.0, segment, "{}", {}, "eva"))])
    for _ in range(2):
        with capture_logs() as logs:
            bridge = Bridge("cell", tmp_path, records)
        (said,) = [one for one in logs if "left out" in one["event"]]
        assert said["run_id"] == "old"
        assert "cannot be read" in said["reason"]
        assert "the bridge of space 301 is not heard" in bridge.side.problem, "the other run goes on"
        kinds = [type(fact) for fact in records.runs.facts(segment)]
        assert kinds == [RunCreated, RunClosing, RunEnded], "the engine goes on with nothing of it"
    assert [fact.run_id for fact in records.facts()].count("old") == 2, "what was recorded stays"


def test_own_executions_are_known_where_no_runs_can_be_carried(
    tmp_path: Path, records: CarriedRecords, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[object] = []

    def record_own_in(journal: object, _now: float) -> None:
        found.append(journal)

    def refused(*_: object) -> None:
        raise LocalWireError("the announcement is too long")

    monkeypatch.setattr(sys.modules[__name__], "_record_nothing", record_own_in)
    monkeypatch.setattr(ImmediateActions, "offer", refused)
    with capture_logs() as logs:
        Bridge("cell", tmp_path, records)
    assert [one["event"] for one in logs] == ["this bridge carries no runs"]
    assert found == [records.executions]


def test_a_part_of_a_run_that_is_left_out_is_refused() -> None:
    holder = Holder(300, lambda _fact: None, [PartTaken(1.0, "run", "00")])
    assert holder.runs == {}
    with pytest.raises(RunRefused, match="by another version"):
        holder.take_part(encode_part(PARTS[300]), 2.0)


def test_a_segment_that_the_engine_could_not_write_down_begins_later(
    tmp_path: Path, records: CarriedRecords, monkeypatch: pytest.MonkeyPatch
) -> None:
    Holder(300, records.note).take_part(encode_part(PARTS[300]), 1.0)
    begun: list[str] = []

    def begin(_engine: SegmentEngine, run_id: str, *_: Any) -> None:
        begun.append(run_id)
        if len(begun) == 1:
            raise StorageUnavailable("the disk is full")

    monkeypatch.setattr(SegmentEngine, "begin_segment", begin)
    cell = Bridge("cell", tmp_path, records)
    side = cast("Any", cell.side)
    token = encode_token(Token("run", PARTS[300].plan_hash, 1, 0, 0), ())
    side._do(side._holder.take_token(token, 0, cell.now))
    assert "the disk is full" in cell.side.problem
    cell.go_on(0.5)
    assert begun == ["run.0"]
    cell.go_on(0.5)
    assert begun == ["run.0", "run.0"]
    assert cell.side.problem == ""
    cell.go_on(5.0)
    assert len(begun) == 2


def awaiting(tmp_path: Path, records: CarriedRecords) -> tuple[Bridge, HeldRun]:
    """The second bridge, which has its part, and waits for its token."""
    holder = Holder(301, records.note)
    holder.take_part(encode_part(PARTS[301]), 1.0)
    hall = Bridge("hall", tmp_path, records)
    return hall, cast("Any", hall.side)._holder.runs["run"]


@pytest.mark.parametrize("set_s", [-3600.0, 3600.0])
def test_what_could_not_be_written_is_tried_again_although_the_clock_was_set(
    tmp_path: Path, records: CarriedRecords, set_s: float
) -> None:
    hall, held = awaiting(tmp_path, records)
    cast("Any", hall.side)._holder.put_off("the disk is full", hall.now)
    hall.ahead_s = set_s
    hall.go_on(0.5)
    assert held.again_at is not None
    due = hall.side.next_deadline()
    assert due is not None
    assert due <= hall.now + 1.0
    hall.go_on(1.0)
    assert held.again_at is None


@pytest.mark.parametrize("set_s", [-1e6, 0.0, 1e6])
def test_a_run_is_lost_after_its_lease_although_the_clock_was_set(
    tmp_path: Path, records: CarriedRecords, set_s: float
) -> None:
    hall, held = awaiting(tmp_path, records)
    lease_s = held.part.lease_s
    hall.go_on(lease_s / 2)
    hall.ahead_s = set_s
    hall.go_on(lease_s / 2 - 10)
    outcomes = [held.closed]
    hall.go_on(10)
    outcomes.append(held.closed)
    assert [closed and closed.outcome for closed in outcomes] == [None, LOST]
    assert [closed.at for closed in outcomes if closed] == pytest.approx([hall.now + set_s]), "by the clock on the wall"
