"""When a bridge forgets runs that are over: not before the server has fetched them."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from tests.unit.carrier.test_side import Bridge
from tests.unit.carrying.test_plan import plan, task
from ua_fleet.carrier.engine import SegmentEnd, SegmentEngine
from ua_fleet.carrier.side import RunUnknown
from ua_fleet.carrying import Holder, RunRefused, SendEnd, Token, encode_part, encode_token, parts_of
from ua_fleet.carrying.holder import MOST_KEPT, MOST_UNFETCHED
from ua_fleet.carrying.part import Part
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import RunCreated
from ua_fleet.skill.executions import unpack
from ua_fleet.storage.carried_records import CarriedRecords

PLAN = plan(task("one", "a"), task("two", "b"))
"""Of two bridges: `hall` has the last segment and tells `cell` the end."""


@pytest.fixture
def records(tmp_path: Path) -> Iterator[CarriedRecords]:
    with CarriedRecords(tmp_path) as opened:
        yield opened


@pytest.fixture(autouse=True)
def without_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    def begin(*_: object) -> None: ...

    monkeypatch.setattr(SegmentEngine, "begin_segment", begin)


class Carrier:
    """A bridge, the words of the server to it, and acknowledgements of another bridge."""

    def __init__(self, name: str, folder: Path, records: CarriedRecords) -> None:
        self.bridge, self._records = Bridge(name, folder, records), records
        self._side = cast("Any", self.bridge.side)

    @property
    def holder(self) -> Holder:
        return cast("Holder", self._side._holder)

    def said(self, word: Word, content: bytes, sender: int = 0) -> bytes:
        self._side._actions.asked_by = sender
        answer = self._side._asked(0, [word, content], self.bridge.now)
        self.bridge.go_on(0.1)
        return bytes(unpack(answer)[0].value or b"")

    def take(self, part: Part, segment: int, sender: int = 0) -> None:
        """Get a part and its token."""
        self.said(Word.PART, encode_part(part))
        token = encode_token(Token(part.run_id, part.plan_hash, 1, segment, 0), ())
        self.said(Word.TOKEN, token, sender)

    def end(self, run_id: str, segment: int) -> None:
        """The last segment ends, and all others acknowledge that the run is over."""
        self._side._segment_ended(SegmentEnd(f"{run_id}.{segment}", "", {}, "", ""))
        for sent in list(self.holder.to_send()):
            assert isinstance(sent, SendEnd)

            def told(holder: Holder, now: float, sent: SendEnd = sent) -> None:
                holder.end_told(sent, now)

            self._side._told(told)
        self.bridge.go_on(0.1)

    def fetch(self, run_id: str) -> dict[str, Any]:
        answer = self.said(Word.FETCH, encode_words(run=run_id, after=0))
        return decode_words(zlib.decompress(answer), most=1_000_000)

    def rows(self) -> int:
        """Runs that the file has something of."""
        database = cast("Any", self._records)._database
        return int(database.read("SELECT count(DISTINCT run_id) FROM carried")[0][0])


def part_of(run_id: str) -> Part:
    return parts_of(PLAN, run_id, "made", {}, "eva")[301]


def test_a_long_run_is_known_until_the_server_has_fetched_its_end(tmp_path: Path, records: CarriedRecords) -> None:
    hall = Carrier("hall", tmp_path, records)
    hall.take(part_of("long"), 1, 300)
    for number in range(MOST_KEPT):
        run_id = f"short{number}"
        hall.take(part_of(run_id), 1, 300)
        hall.end(run_id, 1)
        assert hall.fetch(run_id)["closed"][1] == "done"
    hall.end("long", 1)
    assert hall.fetch("long")["closed"][1] == "done"
    assert hall.fetch("long")["closed"][1] == "done", "the first answer may be lost"
    with pytest.raises(RunUnknown):
        hall.fetch("short0")
    assert (len(hall.holder.runs), hall.rows()) == (MOST_KEPT, MOST_KEPT)


def test_all_runs_that_have_ended_while_the_server_was_away_are_there_when_it_is_back(
    tmp_path: Path, records: CarriedRecords
) -> None:
    hall = Carrier("hall", tmp_path, records)
    runs = [f"run{number}" for number in range(100)]
    for run_id in runs:
        hall.take(part_of(run_id), 1, 300)
    for run_id in runs:
        hall.end(run_id, 1)
    assert [run_id for run_id in runs if hall.fetch(run_id)["closed"] is None] == []
    assert list(hall.holder.runs) == runs[-MOST_KEPT:]


def test_it_is_said_that_runs_are_forgotten_which_no_server_has_fetched(
    tmp_path: Path, records: CarriedRecords
) -> None:
    hall = Carrier("hall", tmp_path, records)
    with capture_logs() as logs:
        for number in range(MOST_UNFETCHED + 2):
            hall.take(part_of(f"run{number}"), 1, 300)
            hall.end(f"run{number}", 1)
    said = [(one["oldest"], one["since_the_start"]) for one in logs if "has not fetched" in one["event"]]
    assert said == [("run0", 1), ("run1", 2)]
    assert (len(hall.holder.runs), hall.rows()) == (MOST_UNFETCHED, MOST_UNFETCHED)


def test_a_bridge_that_has_nothing_to_tell_others_forgets_runs_too(tmp_path: Path, records: CarriedRecords) -> None:
    cell = Carrier("cell", tmp_path, records)
    alone = plan(task("one", "a"))
    for number in range(MOST_UNFETCHED + 5):
        run_id = f"run{number}"
        cell.take(parts_of(alone, run_id, "made", {}, "eva")[300], 0)
        cell.end(run_id, 0)
    assert (len(cell.holder.runs), cell.rows()) == (MOST_UNFETCHED, MOST_UNFETCHED)
    for run_id in list(cell.holder.runs):
        cell.fetch(run_id)
    assert (len(cell.holder.runs), cell.rows()) == (MOST_KEPT, MOST_KEPT)


def test_a_bridge_that_the_server_alone_tells_of_ends_forgets_runs_too(tmp_path: Path, records: CarriedRecords) -> None:
    hall = Carrier("hall", tmp_path, records)
    for number in range(MOST_KEPT + 5):
        hall.said(Word.PART, encode_part(part_of(f"run{number}")))
        hall.said(Word.END, encode_words(run=f"run{number}", outcome="aborted", reason="enough"))
    assert (len(hall.holder.runs), hall.rows()) == (MOST_KEPT, MOST_KEPT)


def test_what_a_file_has_of_runs_that_are_over_goes_at_a_start(tmp_path: Path, records: CarriedRecords) -> None:
    holder = Holder(301, records.note)
    with records.one_sync():
        for number in range(MOST_UNFETCHED + 5):
            run_id = f"run{number}"
            holder.take_part(encode_part(part_of(run_id)), 1.0)
            records.runs.write([(f"{run_id}.1", RunCreated(1.0, f"{run_id}.1", "{}", {}, "eva"))])
            holder.take_end(run_id, "failed", "", 300, 2.0 + number)
    hall = Carrier("hall", tmp_path, records)
    assert (len(hall.holder.runs), hall.rows()) == (MOST_UNFETCHED, MOST_UNFETCHED)
    assert [run_id for run_id in ("run0", "run5") if records.segments_of(run_id)] == ["run5"]


def test_ends_of_runs_whose_part_never_came_go_from_the_file_too(tmp_path: Path, records: CarriedRecords) -> None:
    hall = Carrier("hall", tmp_path, records)
    ended = [f"run{number}" for number in range(MOST_KEPT + 5)]
    for run_id in ended:
        hall.said(Word.END, encode_words(run=run_id, outcome="aborted", reason="enough"))
        assert hall.rows() <= MOST_KEPT
    again = Carrier("hall", tmp_path, records)
    assert again.rows() == MOST_KEPT
    with pytest.raises(RunRefused, match="is over here: aborted, enough"):
        again.said(Word.PART, encode_part(part_of(ended[-MOST_KEPT])))
    again.said(Word.PART, encode_part(part_of(ended[0])))
    assert list(again.holder.runs) == ended[:1]
