"""Who stands in for a robot: what one segment of a run has chosen counts for the others at the same bridge."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from tests.unit.carrier.test_side import CONFIG, Bridge
from tests.unit.carrying.test_plan import plan, task
from ua_fleet.carrying import Begin, SegmentRound, encode_part, parts_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.scenario.facts import Fact, Replaced, ReplacementWanted, RobotReturned, StandInTold, TaskAssigned
from ua_fleet.storage.carried_records import CarriedRecords
from ua_fleet.topics import Topic
from ua_fleet.values import UNIX_EPOCH_TICKS, BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import FieldMetaData


def robot(bridge: str, number: int) -> dict[str, Any]:
    return {
        "bridge": bridge,
        "capacities": ["mobile"],
        "fault_id": 1000 + number,
        "data": {"level": {"id": 900 + number, "type": "Double"}},
        "skill_status_id": 1100 + number,
        "skills": {"work": {"id": 1200 + number, "needs": ["mobile"]}},
    }


MODEL = CONFIG.model_dump(mode="json", exclude_unset=True) | {
    "robots": {"a": robot("cell", 1), "b": robot("hall", 2), "c": robot("hall", 3)},
    "resilience": {"mode": "automatic"},
}
PLAN = plan(task("one", "a"), task("two", "b"), task("three", "a"))


class Cell(Bridge):
    """The bridge of `a`, which hears what robots say."""

    def say(self, publisher: Publisher, number: int, fault: str) -> None:
        topic, ticks = Topic(300 if number == 1 else 301, 2, 1000 + number), UNIX_EPOCH_TICKS + round(self.now * 1e7)
        fields = (FieldMetaData("Fault", BuiltinType.STRING),)
        datagrams = publisher.announce(topic, "fault", fields, now=self.now, wall_ticks=ticks)
        datagrams += publisher.publish(topic, (fault,), timestamp=ticks, now=self.now)
        for datagram in datagrams:
            if number == 1:
                self.side.own(datagram)
            for event in self.subscriber.receive(datagram, self.now, ("", 0)) if number > 1 else ():
                self.side.hear(event, self.now)

    def begin(self, number: int, stand_ins: dict[str, dict[str, str]] | None = None) -> None:
        side = cast("Any", self.side)
        segment = side._holder.runs["run"].part.segments[number]
        side._holder.runs["run"].begun[SegmentRound(number)] = self.now
        side._do([Begin("run", segment, (), {}, stand_ins=stand_ins or {})])
        self.go_on(0.1)


@pytest.fixture
def records(tmp_path: Path) -> Iterator[CarriedRecords]:
    with CarriedRecords(tmp_path) as opened:
        yield opened


def of(records: CarriedRecords, number: int) -> list[Fact]:
    return records.runs.facts(f"run.{number}")


@pytest.fixture
def cell(tmp_path: Path, records: CarriedRecords) -> Cell:
    """The bridge of `a` with its part; all robots are heard."""
    cell = Cell("cell", tmp_path, records, FleetConfig.model_validate(MODEL))
    cast("Any", cell.side)._take_part(encode_part(parts_of(PLAN, "run", "made", {}, "eva")[300]), cell.now)
    cell.go_on(0.1)
    hear_all(cell)
    return cell


def hear_all(cell: Cell, fault: str = "") -> None:
    hall = Publisher(301, PubSubTiming(), Counters(), Codec())
    cell.say(hall, 2, "")
    cell.say(hall, 3, "")
    fails(cell, fault)


def fails(cell: Cell, fault: str = "mobile: the drive does not turn") -> None:
    cell.say(cell.publisher, 1, fault)
    cell.go_on(0.1)


def stand_in_of(records: CarriedRecords, number: int) -> str:
    (stand_in,) = {fact.robot for fact in of(records, number) if isinstance(fact, Replaced)}
    return stand_in


def assert_goes_to(records: CarriedRecords, robot: str) -> None:
    """The last segment goes to that robot, as soon as it has no other task, and has ranked nobody."""
    facts = of(records, 2)
    assert ReplacementWanted not in [type(fact) for fact in facts]
    assert {fact.robot for fact in facts if isinstance(fact, TaskAssigned | StandInTold)} == {robot}


def test_a_later_segment_goes_to_who_stood_in_before(cell: Cell, records: CarriedRecords) -> None:
    fails(cell)
    cell.begin(0)
    cell.begin(2)
    assert_goes_to(records, stand_in_of(records, 0))


def test_a_segment_that_was_begun_before_the_fault_goes_to_who_stands_in(cell: Cell, records: CarriedRecords) -> None:
    engine = cast("Any", cell.side)._engine_now(cell.now)
    cast("Any", cell.side)._do([Begin("run", cast("Any", cell.side)._holder.runs["run"].part.segments[2], (), {})])
    engine.pause_segment("run.2", "eva", is_paused=True)
    for _ in range(6):
        cell.go_on(2.0)  # nobody announces its Action, so that it is to be tried again
        hear_all(cell)
    fails(cell)
    cell.begin(0)
    stand_in = stand_in_of(records, 0)
    assert [fact.robot for fact in of(records, 2) if isinstance(fact, StandInTold)] == [stand_in]
    engine.pause_segment("run.2", "eva", is_paused=False)
    cell.go_on(0.1)
    facts = of(records, 2)
    assert ReplacementWanted not in [type(fact) for fact in facts]
    assert [fact.robot for fact in facts if isinstance(fact, TaskAssigned)][:1] == ["a"]


def test_it_is_known_after_a_restart(cell: Cell, tmp_path: Path, records: CarriedRecords) -> None:
    fails(cell)
    cell.begin(0)
    again = Cell("cell", tmp_path, records, FleetConfig.model_validate(MODEL))
    hear_all(again, "mobile: the drive does not turn")
    again.begin(2)
    assert_goes_to(records, stand_in_of(records, 0))


def test_a_robot_that_is_back_has_its_later_segments_again(cell: Cell, records: CarriedRecords) -> None:
    fails(cell)
    cell.begin(0)
    fails(cell, "")
    cell.begin(2)
    assert RobotReturned in [type(fact) for fact in of(records, 0)]
    assert_goes_to(records, "a")


def test_an_heir_goes_by_who_stood_in_at_the_bridge_that_is_off(cell: Cell, records: CarriedRecords) -> None:
    fails(cell)
    cell.begin(2, {"a": {"mobile": "c"}})
    assert_goes_to(records, "c")
