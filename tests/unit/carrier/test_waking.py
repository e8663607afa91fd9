"""An engine hears nothing while there is no run: what it knows of its own robots when the next one begins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from tests.unit.carrier.test_side import CONFIG, PARTS, Bridge
from ua_fleet.carrying import encode_part
from ua_fleet.config.schema import FleetConfig
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.storage.carried_records import CarriedRecords
from ua_fleet.topics import Topic
from ua_fleet.values import UNIX_EPOCH_TICKS, BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import FieldMetaData, Probe, ProbeKind, PublisherIdType

ROVER = CONFIG.model_dump(mode="json", exclude_unset=True) | {
    "robots": {"rover": {"bridge": "cell", "capacities": ["mobile"], "fault_id": 1001}}
}
FAULT = Topic(300, 2, 1001)
ASKED = Probe(300, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA)
"""What a server asks that was started again."""


class Cell(Bridge):
    """The bridge of a rover; what it says goes to its engine and onto the wire, as a bridge's shell has it."""

    def announce(self) -> None:
        fields = (FieldMetaData("Fault", BuiltinType.STRING),)
        self.tell(self.publisher.announce(FAULT, "fault", fields, now=self.now, wall_ticks=self.ticks))

    @property
    def ticks(self) -> int:
        return UNIX_EPOCH_TICKS + round(self.now * 10_000_000)

    def tell(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            self.sent.append(datagram)
            self.side.own(datagram)

    def says(self, fault: str) -> None:
        self.tell(self.publisher.publish(FAULT, (fault,), timestamp=self.ticks, now=self.now))

    def take_part(self, run_id: str) -> None:
        """As it comes from the server."""
        side = cast("Any", self.side)
        side._take_part(encode_part(replace(PARTS[300], run_id=run_id)), self.now)

    def end(self, run_id: str) -> None:
        side = cast("Any", self.side)
        side._do(side._holder.take_end(run_id, "done", "", 0, self.now))

    def lacks(self) -> list[str]:
        """What the engine believes: the faults that are active."""
        engine = cast("Any", self.side)._engine
        return [fault.reason for fault in engine._service.faults if fault.active]


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    with CarriedRecords(tmp_path) as records:
        cell = Cell("cell", tmp_path, records, FleetConfig.model_validate(ROVER))
        cell.announce()
        cell.says("mobile: the drive does not turn")
        cell.take_part("one")
        cell.go_on(0.1)
        assert cell.lacks() == ["the drive does not turn"]
        cell.end("one")
        cell.go_on(1.0)
        yield cell


@pytest.mark.parametrize("is_asked", [False, True], ids=["quiet", "asked just before"])
def test_a_robot_that_was_repaired_between_two_runs_is_known_to_be(cell: Cell, *, is_asked: bool) -> None:
    cell.says("")
    cell.go_on(0.2)
    assert cell.lacks() == ["the drive does not turn"], "there is no run"
    if is_asked:
        cell.tell(cell.publisher.answer(ASKED, cell.now))
    cell.take_part("two")
    assert cell.lacks() == [], "before any token can come"
    cell.go_on(0.0)
    assert cell.lacks() == []


def test_a_robot_that_fails_between_two_runs_is_known_to_have(cell: Cell) -> None:
    cell.says("")
    cell.take_part("two")
    cell.go_on(0.1)
    cell.end("two")
    cell.go_on(5.0)
    cell.says("mobile: it is stuck")
    cell.tell(cell.publisher.answer(ASKED, cell.now))
    cell.take_part("three")
    assert cell.lacks() == ["it is stuck"]


def test_who_listens_on_the_wire_misses_nothing_of_it(cell: Cell) -> None:
    others = Subscriber(0, PubSubTiming(), cast("Any", cell.side)._ground.counters, Codec())
    cell.says("")
    cell.tell(cell.publisher.answer(ASKED, cell.now))
    cell.go_on(0.2)
    asked_again = cell.publisher.answer(ASKED, cell.now)
    assert asked_again == [], "it waits, since the one before was just now"
    cell.take_part("two")
    cell.go_on(1.0)
    cell.tell(cell.publisher.poll(cell.now))
    for datagram in cell.sent:
        others.receive(datagram, cell.now, ("", 0))
    writer = others.writers[FAULT]
    assert (writer.gaps, writer.restarts) == (0, 0)
    assert cell.publisher.writers[FAULT].next_number == writer.expected
    assert writer.received == 5, "its announcement, the fault, its end, and both answers"
