"""What the file of a bridge has of a run with many rounds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from tests.unit.carrier.test_side import Bridge
from tests.unit.carrying.test_rounds import LOOP, MINE, round_token
from ua_fleet.carrier.pages import FactPages
from ua_fleet.carrier.side import COMPACTED_EACH, KEPT_SEGMENTS
from ua_fleet.carrying import Holder, SegmentRound, SendToken, encode_part, parts_of, segment_run
from ua_fleet.carrying.held import HeldRun
from ua_fleet.scenario.facts import RunCreated, RunEnded, RunOutcome, StepEnded, StepState, decode_fact
from ua_fleet.storage.carried_records import CARRIED_FILE, CarriedRecords

PART = encode_part(parts_of(LOOP, "run", "made", {}, "anna")[301])
TEXT = "x" * 500
"""Of a segment, as long as a small one is."""


@pytest.fixture
def records(tmp_path: Path) -> Iterator[CarriedRecords]:
    with CarriedRecords(tmp_path) as opened:
        yield opened


def do_round(bridge: Bridge, records: CarriedRecords, number: int) -> None:
    """One round of the bridge of space 301, whose engine writes what it does in it."""
    holder: Holder = cast("Any", bridge.side)._holder
    place = SegmentRound(MINE, (number,))
    holder.take_token(round_token(number), 300, float(number))
    segment = segment_run("run", place)
    step = StepEnded(float(number), f"1.repeat.1@{number}", StepState.DONE)
    ended = RunEnded(float(number), RunOutcome.DONE, "")
    records.runs.write([(segment, fact) for fact in (RunCreated(0.0, segment, TEXT, {}, "anna"), step, ended)])
    holder.segment_ended("run", place, float(number))
    for sent in list(holder.to_send()):
        assert isinstance(sent, SendToken)
        holder.handed_over(sent, float(number))


def known(held: HeldRun) -> tuple[object, ...]:
    return held.tokens, held.begun, held.over, held.handed, held.rounds, held.passed, held.part, held.heard


def rows(records: CarriedRecords) -> dict[str, int]:
    database = cast("Any", records)._database
    return {name: database.read(f"SELECT count(*) FROM {name}")[0][0] for name in ("carried", "facts", "runs")}


def test_the_file_does_not_grow_with_the_rounds_and_a_restart_knows_the_same(
    tmp_path: Path, records: CarriedRecords
) -> None:
    hall = Bridge("hall", tmp_path, records)
    holder: Holder = cast("Any", hall.side)._holder
    holder.take_part(PART, 0.0)
    sizes: list[int] = []
    for number in range(4 * KEPT_SEGMENTS):
        do_round(hall, records, number)
        hall.loop.run_ready()
        assert not hall.mistakes.count, hall.mistakes.text()
        if number % KEPT_SEGMENTS == KEPT_SEGMENTS - 1:
            sizes.append((tmp_path / CARRIED_FILE).stat().st_size)
            again = Holder(301, lambda _fact: None, records.facts())
            assert known(again.runs["run"]) == known(holder.runs["run"])
    assert sizes[-1] < 1.2 * sizes[1], f"what is free is used again: {sizes}"
    there = rows(records)
    assert there["carried"] <= COMPACTED_EACH + 10
    assert there["runs"] <= KEPT_SEGMENTS + COMPACTED_EACH
    assert there["facts"] <= 3 * there["runs"]

    pages, last, fetched = FactPages(lambda: records), 0, list[str]()
    while not (page := pages.after("run", last)).is_last:
        last, fetched = page.last, fetched + page.lines
    facts = [decode_fact(line) for line in [*fetched, *page.lines]]
    steps = [fact.step for fact in facts if isinstance(fact, StepEnded)]
    rounds = range(4 * KEPT_SEGMENTS - KEPT_SEGMENTS, 4 * KEPT_SEGMENTS)
    assert steps[-KEPT_SEGMENTS:] == [f"1.repeat.1@{number}" for number in rounds], "all that the server shows"


def test_a_server_goes_on_fetching_where_it_was_though_what_is_before_was_forgotten(
    tmp_path: Path, records: CarriedRecords
) -> None:
    hall = Bridge("hall", tmp_path, records)
    holder: Holder = cast("Any", hall.side)._holder
    holder.take_part(PART, 0.0)
    for number in range(10):
        do_round(hall, records, number)
    pages = FactPages(lambda: records)
    first = pages.after("run", 0)
    do_round(hall, records, 10)
    assert records.compact(holder.runs["run"], kept=0) > 0
    steps = [decode_fact(line) for line in pages.after("run", first.last).lines]
    assert [fact.step for fact in steps if isinstance(fact, StepEnded)] == ["1.repeat.1@10"]
    assert records.compact(holder.runs["run"], kept=0) == 0, "there is no more"


def test_what_was_forgotten_counts_after_a_restart_in_what_is_told_of_facts(
    tmp_path: Path, records: CarriedRecords
) -> None:
    assert records.last_number() == 0
    hall = Bridge("hall", tmp_path, records)
    holder: Holder = cast("Any", hall.side)._holder
    holder.take_part(PART, 0.0)
    written = 0
    for number in range(10):
        do_round(hall, records, number)
        written += 3
    assert records.compact(holder.runs["run"], kept=0) > 0
    assert rows(records)["facts"] < written
    holder.take_end("run", "aborted", "", 0, 11.0)  # no engine reads the text of these segments
    again = Bridge("hall", tmp_path, records)
    assert cast("Any", again.side)._watch.facts_of("run") >= written, "else the server takes news for what it has"
