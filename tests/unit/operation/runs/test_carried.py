"""The server's side of carried runs, with bridges that answer what a test says."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest
import structlog

from tests.unit.operation.runs.world import World
from ua_fleet.carrying.adoption import Adoption, decode_adoption
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ScenarioError
from ua_fleet.operation.runs.carried import OFFER_S, CarriedRuns
from ua_fleet.operation.runs.carried_adoption import RoundsUnknown
from ua_fleet.orchestrator import BridgesFollowed, RunChanged, TaskWaiting
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.run_data import RUN_DATA_FIELDS, RUN_DATA_ID, RUN_DATA_TYPES, run_data_topic
from ua_fleet.scenario.facts import (
    IterationStarted,
    RunAdopted,
    RunClosing,
    RunEnded,
    RunOutcome,
    StepEnded,
    StepState,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
    encode_fact,
)
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, pack
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData, FrameKind

AWAY_S = 20.0
NOBODY = RequestOutcome(OutcomeKind.UNKNOWN, ExecutionReport(ExecutionState.UNKNOWN))
REFUSED = RequestOutcome(
    OutcomeKind.REFUSED, ExecutionReport(ExecutionState.FAILED, StatusCode.BAD_INVALID_STATE, "it is over here")
)


def config(count: int) -> FleetConfig:
    """As many bridges with a robot each, which may all ask each other."""
    spaces = [0, *range(300, 300 + count)]
    return FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {
                f"c{number}": {
                    "kind": "virtual",
                    "space": 300 + number,
                    "status_id": 900 + number,
                    "requestors": spaces,
                }
                for number in range(count)
            },
            "robots": {
                f"r{number}": {
                    "bridge": f"c{number}",
                    "skill_status_id": 1200 + number,
                    "skills": {"work": {"id": 1100 + number}},
                }
                for number in range(count)
            },
            "scenarios": {"adopt_after_s": AWAY_S},
        }
    )


def answer(content: bytes = b"") -> RequestOutcome:
    report = ExecutionReport(ExecutionState.DONE, result=pack((int(BuiltinType.BYTE_STRING),), (content,)))
    return RequestOutcome(OutcomeKind.ACCEPTED, report)


def page(*facts: str, closed: str = "", holds: tuple[str, ...] = ()) -> RequestOutcome:
    """What a bridge says that has these facts, whose run has ended so, and that has tokens of these segments."""
    words: dict[str, Any] = {"facts": facts, "last": len(facts), "more": False, "told": len(facts)}
    words |= {"active": [], "holds": holds, "waits": "", "decisions": []}
    words["closed"] = [50.0, closed, ""] if closed else None
    return answer(zlib.compress(encode_words(**words)))


class Bridges:
    """In place of SkillCommands: each question is answered when it is polled, by what its bridge does."""

    def __init__(self) -> None:
        self.told: Callable[[bytes, RequestOutcome], None] = lambda _id, _outcome: None
        self.open: list[tuple[int, Word, bytes, bytes]] = []
        """Space, word, content and id of what was not answered yet."""
        self.asked: list[tuple[int, Word]] = []
        self.contents: list[tuple[int, Word, bytes]] = []
        self.does: dict[tuple[int, Word], RequestOutcome | None] = {}
        """What they do other than that they take it; None: the question stays open."""
        self.off: set[int] = set()

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        del robot, skill, timeout_s
        word, content = Word(arguments["Word"]), arguments["Content"]
        self.open.append((topic.space, word, content, execution_id))
        self.asked.append((topic.space, word))
        self.contents.append((topic.space, word, content))

    def receive(self, *_: object) -> None: ...

    def announced(self, *_: object) -> None: ...

    def next_deadline(self) -> float | None:
        return None

    def poll(self, now: float) -> None:
        """As `SkillCommands` tells what is due: one after the other, in one loop."""
        del now
        questions, self.open = self.open, []
        for question in questions:
            outcome = self.outcome(*question[:2])
            if outcome is None:
                self.open.append(question)
            else:
                self.told(question[3], outcome)

    def outcome(self, space: int, word: Word) -> RequestOutcome | None:
        if space in self.off:
            return NOBODY
        usual = page() if word is Word.FETCH else answer(encode_words(filled=[]) if word is Word.ADOPT else b"")
        return self.does.get((space, word), usual)


class Carried(World):
    """A server with bridges."""

    def __init__(self, folder: Path, count: int = 3) -> None:
        super().__init__(folder, heard=(), config=config(count))
        self.bridges, self.count = Bridges(), count
        self.carried = self.with_bridges(count)

    def with_bridges(self, count: int) -> CarriedRuns:
        """Who has so many bridges in the file."""

        def commands(*, told: Callable[[bytes, RequestOutcome], None], **_: object) -> Any:
            self.bridges.told = told
            return self.bridges

        return CarriedRuns(
            config(count),
            self.service,
            commands,
            reserve=lambda _robot, _why: None,
            sooner=lambda: None,
            clock=lambda: self.now,
            wall_s=lambda: self.now,
            mistakes=self.mistakes,
            log=structlog.get_logger(),
        )

    def offer(self) -> str:
        steps = "\n".join(f"  - {{task: t{number}, skill: work, robot: r{number}}}" for number in range(self.count))
        checked, _ = self.carried.check(f"version: 1\nname: made\nsteps:\n{steps}\n")
        assert not checked.problems
        return self.carried.start(checked.scenario, (), (), "anna")

    def begin(self) -> str:
        """A run that is under way."""
        run_id = self.offer()
        self.go(1.0)
        assert (300, Word.TOKEN) in self.bridges.asked
        return run_id

    def go(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.now += 0.1
            self.carried.poll(self.now)

    def asked(self, seconds: float) -> list[tuple[int, Word]]:
        """What bridges are asked in this time."""
        self.bridges.asked.clear()
        self.go(seconds)
        return list(self.bridges.asked)

    def facts(self, kind: type) -> list[Any]:
        return [one.fact for one in self.said if isinstance(one, RunChanged) and isinstance(one.fact, kind)]

    def reason(self) -> str:
        """Why the run waits, as it was shown last."""
        return [one.waits.reason for one in self.said if isinstance(one, TaskWaiting)][-1]

    def bridges_told(self) -> dict[str, tuple[str, bool]]:
        """How the bridges of the run were shown last: the state of each, and whether it has the token."""
        told = [one.bridges for one in self.said if isinstance(one, BridgesFollowed)][-1]
        return {f"c{space - 300}": (one.state, one.has_token) for space, one in told.items()}

    def tell_token(
        self, space: int, run_id: str, holds: tuple[int, ...], count: int = 0, ranked: tuple[str, ...] = ()
    ) -> None:
        """A bridge tells by its DataSet which segments it has the tokens of, how many facts, and a ranking."""
        values = (run_id, holds, (), (), (), (), "", ranked, (0.5,) * len(ranked), count, "")
        metadata = DataSetMetaData("Runs", RUN_DATA_FIELDS, ConfigurationVersion(1, 1))
        message = DataSetMessage(RUN_DATA_ID, FrameKind.KEY, types=RUN_DATA_TYPES, values=values, timestamp=1)
        self.carried.follow(DataReceived(run_data_topic(space, 2), message, metadata))


@pytest.fixture
def world(tmp_path: Path) -> Iterable[Carried]:
    made = Carried(tmp_path)
    yield made
    assert not made.mistakes.count, made.mistakes.text()


def test_an_answer_of_a_bridge_that_was_left_out_costs_no_other_answer(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.bridges.does |= {(space, Word.FETCH): None for space in (300, 301, 302)}
    world.bridges.off.clear()
    world.go(6.0)  # all three are asked, and have not answered
    assert {space for space, *_ in world.bridges.open} == {300, 301, 302}
    world.now += AWAY_S
    assert world.carried.adopt(run_id, "c1", (), "anna") == "c0"
    world.bridges.does.clear()
    world.bridges.off.add(301)
    world.go(1.0)
    assert not world.mistakes.count, world.mistakes.text()
    words = [(space, word) for space, word in world.bridges.asked if word is Word.ADOPT]
    assert words == [(302, Word.ADOPT), (300, Word.ADOPT)], "the heir is the last one"


def test_a_mistake_in_one_answer_costs_no_other_one(tmp_path: Path) -> None:
    world = Carried(tmp_path)
    world.begin()
    world.bridges.does[300, Word.FETCH] = answer(b"no page")
    asked = world.asked(12.0)
    assert world.mistakes.count
    for space in (300, 301, 302):
        assert asked.count((space, Word.FETCH)) >= 2, "it is asked on"


def test_a_bridge_whose_pages_are_of_another_version_is_named_and_the_run_can_be_aborted(world: Carried) -> None:
    run_id = world.begin()
    before: dict[str, Any] = {"facts": [], "count": 0, "active": [], "waits": "", "closed": None, "decisions": []}
    world.bridges.does[301, Word.FETCH] = answer(zlib.compress(encode_words(**before)))
    assert world.asked(12.0).count((301, Word.FETCH)) >= 2, "it may be updated meanwhile"
    assert world.reason() == "c1: it has another version of ua-fleet: update it, or abort the run"
    world.carried.abort(run_id, "", "anna")
    world.go(1.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_a_run_that_many_bridges_do_not_take_ends_with_a_reason_that_they_can_read(tmp_path: Path) -> None:
    world = Carried(tmp_path, 120)
    world.bridges.off = set(range(301, 420))
    world.offer()
    world.go(OFFER_S + 1)
    (closing,) = world.facts(RunClosing)
    assert closing.reason.endswith("c5: it does not answer; and 114 more")
    world.bridges.off.clear()
    world.go(2.0)
    ends = [decode_words(content) for _, word, content in world.bridges.contents if word is Word.END]
    assert {words["reason"] for words in ends} == {closing.reason}
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.FAILED]


def test_what_a_bridge_says_is_cut_off_in_the_reason_of_an_end(tmp_path: Path) -> None:
    world = Carried(tmp_path, 8)
    said = ExecutionReport(ExecutionState.FAILED, StatusCode.BAD_INVALID_STATE, "\x01" * 4000)
    for space in range(300, 308):
        world.bridges.does[space, Word.PART] = RequestOutcome(OutcomeKind.REFUSED, said)
    world.offer()
    world.go(2.0)
    ends = [content for _, word, content in world.bridges.contents if word is Word.END]
    assert ends
    assert all(len(content) < 4000 and decode_words(content)["outcome"] == "failed" for content in ends)


def test_a_run_that_a_bridge_has_ended_before_it_is_told_of_an_adoption_ends_as_it_has(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c1", (), "anna")
    world.bridges.does |= {
        (302, Word.ADOPT): REFUSED,
        (302, Word.FETCH): page(closed="done"),
        (300, Word.FETCH): page(closed="done"),
    }
    asked = world.asked(3.0)
    assert asked.count((302, Word.ADOPT)) == 1, "it is not asked on for what it has refused"
    assert (300, Word.ADOPT) not in asked
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]
    assert not world.carried.has(run_id)


def test_a_bridge_that_refuses_an_adoption_for_now_is_told_again(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c1", ("t1",), "anna")
    world.bridges.does[302, Word.ADOPT] = REFUSED
    asked = world.asked(15.0)
    assert [word for space, word in asked if space == 302][:4] == [Word.ADOPT, Word.FETCH] * 2
    assert (300, Word.ADOPT) not in asked
    assert "c0: it goes on once all others know which bridge is off" in world.reason()
    world.bridges.does.clear()
    asked = world.asked(6.0)
    assert asked.index((302, Word.ADOPT)) < asked.index((300, Word.ADOPT))
    (content,) = [content for space, word, content in world.bridges.contents if (space, word) == (300, Word.ADOPT)]
    assert str(SegmentRound(1)) in decode_adoption(content).facts
    assert (302, Word.FETCH) in world.asked(6.0), "the run is followed"


def adoptions(world: Carried, space: int) -> list[Adoption]:
    """What a bridge was told of others that are off."""
    told = [content for asked, word, content in world.bridges.contents if (asked, word) == (space, Word.ADOPT)]
    return [decode_adoption(content) for content in told]


def test_two_bridges_that_are_off_at_once_are_left_out_one_after_the_other(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off |= {300, 301}
    world.go(AWAY_S + 10)
    for name in ("c0", "c1"):
        assert f"ua-fleet scenario adopt {run_id} {name} --off" in world.reason()
    assert world.carried.adopt(run_id, "c1", ("t1",), "anna") == "c2", "c0 does not answer"
    world.go(3.0)
    assert not adoptions(world, 302), "c0 may know more, and does not answer"
    assert "the run goes on without c1 once c0 knows it: start c0, or abort it" in world.reason()
    assert f"if it is off for good too: ua-fleet scenario adopt {run_id} c0 --off" in world.reason()

    assert world.carried.adopt(run_id, "c0", ("t0",), "anna") == "c2"
    world.go(1.0)
    (told,) = adoptions(world, 302)
    assert (told.part.epoch, told.gone, set(told.part.segments)) == (3, (301, 300), {0, 1, 2})
    assert set(told.facts) == {"1"}, "what the person has said of both counts"
    assert sorted(slot.segment for slot in told.filled) == [0, 1], "the second one proves that the first one is over"
    assert [[*fact.also, fact.space] for fact in world.facts(RunAdopted)] == [[301], [301, 300]]
    assert (302, Word.FETCH) in world.asked(6.0), "the run goes on"
    world.bridges.does[302, Word.FETCH] = page(closed="done")
    world.go(6.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]


def test_an_heir_that_is_off_before_it_knows_is_left_out_as_well(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    assert world.carried.adopt(run_id, "c1", ("t1",), "anna") == "c0"
    world.bridges.off.add(300)
    world.go(AWAY_S + 10)
    assert [one.part.epoch for one in adoptions(world, 302)] == [2]
    with pytest.raises(ScenarioError, match="c2 knows that another one is off"):
        world.carried.adopt(run_id, "c2", (), "anna")
    assert world.carried.adopt(run_id, "c0", (), "anna") == "c2"
    world.go(1.0)
    last = adoptions(world, 302)[-1]
    assert (last.part.epoch, last.gone, set(last.part.segments)) == (3, (301, 300), {0, 1, 2})
    assert (302, Word.FETCH) in world.asked(6.0), "the run goes on"


def test_a_late_answer_to_the_adoption_before_does_not_count_for_the_next_one(tmp_path: Path) -> None:
    world = Carried(tmp_path, 4)
    run_id = world.begin()
    world.bridges.off |= {302, 303}
    world.go(AWAY_S + 10)
    world.bridges.does[301, Word.ADOPT] = None
    assert world.carried.adopt(run_id, "c3", (), "anna") == "c0"
    world.go(0.5)
    assert [space for space, word, *_ in world.bridges.open if word is Word.ADOPT] == [301]
    assert world.carried.adopt(run_id, "c2", (), "anna") == "c0"
    world.bridges.does.clear()
    world.go(0.1)  # only now it answers
    assert not world.mistakes.count
    world.go(1.0)
    assert [one.part.epoch for one in adoptions(world, 301)] == [2, 3], "it is told the next one as well"
    assert [one.part.epoch for one in adoptions(world, 300)] == [3]


def test_a_late_answer_to_an_adoption_is_none_to_the_end_of_an_aborted_run(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.bridges.does[302, Word.ADOPT] = None
    world.carried.adopt(run_id, "c1", (), "anna")
    world.go(0.5)
    assert [space for space, word, *_ in world.bridges.open if word is Word.ADOPT] == [302]
    world.carried.abort(run_id, "", "anna")
    world.go(0.5)
    world.bridges.does.clear()
    asked = world.asked(1.0)  # only now it answers
    assert (302, Word.END) in asked
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_a_bridge_that_does_not_answer_now_is_no_heir(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.bridges.off.add(300)
    world.go(6.0)
    assert world.carried.adopt(run_id, "c1", (), "anna") == "c2"


def test_no_bridge_that_answers_may_be_the_heir(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.bridges.off |= {300, 302}
    world.go(6.0)
    with pytest.raises(ScenarioError, match="c0 could take the place of c1, and does not answer now"):
        world.carried.adopt(run_id, "c1", (), "anna")


def test_a_run_that_nobody_can_go_on_with_ends_without_the_bridges_that_are_off(tmp_path: Path) -> None:
    world = Carried(tmp_path, 2)
    run_id = world.begin()
    world.bridges.off |= {300, 301}
    world.go(AWAY_S + 10)
    with pytest.raises(ScenarioError, match=f"abort it: ua-fleet scenario abort {run_id}"):
        world.carried.adopt(run_id, "c1", (), "anna")
    world.carried.abort(run_id, "", "anna")
    world.go(AWAY_S + 10)
    assert world.carried.has(run_id), "it waits for both"
    assert f"have the run end without it: ua-fleet scenario adopt {run_id} c0 --off" in world.reason()
    assert world.carried.adopt(run_id, "c0", (), "anna") == ""
    world.go(1.0)
    assert world.carried.has(run_id), "it waits for the other one"
    assert world.carried.adopt(run_id, "c1", (), "anna") == ""
    world.go(1.0)
    assert not world.carried.has(run_id)
    (ended,) = world.facts(RunEnded)
    assert ended.outcome is RunOutcome.ABORTED
    assert "c0 and c1 did not know it" in ended.reason
    assert world.asked(11.0).count((300, Word.END)) == 2, "each 5 s"
    world.bridges.off.discard(300)
    world.go(6.0)
    ends = [
        decode_words(content) for space, word, content in world.bridges.contents if (space, word) == (300, Word.END)
    ]
    assert ends[-1]["outcome"] == "aborted"
    asked = world.asked(11.0)
    assert (300, Word.END) not in asked, "it knows it now"
    assert (301, Word.END) in asked
    assert not world.mistakes.count, world.mistakes.text()


def test_a_server_that_is_started_again_tells_the_end_to_a_bridge_that_was_off(tmp_path: Path) -> None:
    world = Carried(tmp_path, 2)
    run_id = world.begin()
    world.bridges.off |= {301}
    world.carried.abort(run_id, "enough", "anna")
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c1", (), "anna")
    world.go(1.0)
    assert not world.carried.has(run_id)
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.go(6.0)
    (told,) = [content for space, word, content in again.bridges.contents if (space, word) == (301, Word.END)]
    assert decode_words(told) == {"run": run_id, "outcome": "aborted", "reason": "enough"}
    assert again.asked(11.0) == [], "it knows it now"


def test_a_run_ends_without_a_bridge_that_was_left_out_and_is_taken_out_of_the_file(tmp_path: Path) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.bridges.off |= {301, 302}
    world.carried.abort(run_id, "enough", "anna")
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c2", (), "anna")
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.go(1.0)
    assert not again.mistakes.count, again.mistakes.text()
    (ended,) = again.facts(RunEnded)
    assert ended.reason == "enough; space 302 did not know it: off, as people have said, and told when there"
    assert not again.facts(RunAdopted), "it is in the journal already"
    again.go(12.0)
    again.journal.close()
    last = Carried(tmp_path, 2)
    assert last.asked(12.0) == [], "nobody is asked for a bridge that is not there"
    assert last.carried.next_deadline(last.now) is None
    assert not last.mistakes.count, last.mistakes.text()


def test_what_nobody_has_said_of_a_bridge_is_not_said_with_what_people_have(tmp_path: Path) -> None:
    world = Carried(tmp_path, 4)
    run_id = world.begin()
    world.bridges.off |= {301}
    world.carried.abort(run_id, "enough", "anna")
    world.go(AWAY_S + 10)
    world.bridges.off |= {303}
    world.carried.adopt(run_id, "c1", (), "anna")
    world.journal.close()
    again = Carried(tmp_path, 3)
    again.go(1.0)
    (ended,) = again.facts(RunEnded)
    assert ended.reason == (
        "enough; c1 did not know it: off, as people have said, and told when there; space 303 did not know it: not in"
        " fleet.yaml any more, and told when it is again"
    )
    assert [(fact.space, fact.by) for fact in again.facts(RunAdopted)] == [(303, "the server")]


def test_a_run_that_was_under_way_is_followed_without_a_bridge_that_is_taken_out_of_the_file(tmp_path: Path) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.journal.close()
    again = Carried(tmp_path, 2)
    assert {(300, Word.FETCH), (301, Word.FETCH)} == set(again.asked(6.0))
    assert again.reason().startswith("space 302: it is not in fleet.yaml any more, and what it has of the run does not")
    assert f"or abort the run: ua-fleet scenario abort {run_id}" in again.reason()
    again.carried.abort(run_id, "", "anna")
    again.go(1.0)
    (ended,) = again.facts(RunEnded)
    assert ended.outcome is RunOutcome.ABORTED
    assert ended.reason.endswith("; space 302 did not know it: not in fleet.yaml any more, and told when it is again")
    assert not again.mistakes.count, again.mistakes.text()
    again.journal.close()
    back = Carried(tmp_path, 3)
    assert back.asked(12.0) == [(302, Word.END)], "it is told once it is there again"
    assert not back.mistakes.count, back.mistakes.text()


def test_an_adoption_in_whose_midst_the_bridge_leaves_the_file_can_be_aborted(tmp_path: Path) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.bridges.off |= {302}
    world.go(AWAY_S + 10)
    world.bridges.does |= {(space, Word.ADOPT): None for space in (300, 301)}
    world.carried.adopt(run_id, "c2", (), "anna")
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.go(1.0)
    again.carried.abort(run_id, "", "anna")
    again.go(1.0)
    assert [fact.outcome for fact in again.facts(RunEnded)] == [RunOutcome.ABORTED]
    assert not again.mistakes.count, again.mistakes.text()


def test_an_adoption_that_waits_for_a_bridge_says_so(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c1", (), "anna")
    world.bridges.off.add(302)
    world.go(AWAY_S + 1)
    assert (
        "c2: it does not answer, nor has it answered for 20 s; the run goes on without c1 once c2 knows it: start c2,"
        f" or abort it: ua-fleet scenario abort {run_id}; if it is off for good too:" in world.reason()
    )
    world.carried.abort(run_id, "", "anna")
    world.bridges.off.discard(302)
    world.go(2.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_a_bridge_says_whether_it_has_the_token_where_its_data_set_was_not_heard(world: Carried) -> None:
    run_id = world.begin()
    world.tell_token(300, run_id, (0,))
    world.bridges.does[301, Word.FETCH] = page(holds=("1",))  # it tells of another run by its DataSet
    world.go(32.0)
    waits = ("answers", False)
    assert world.bridges_told() == {"c0": waits, "c1": ("answers", True), "c2": waits}


def test_a_ranking_that_has_changed_is_fetched_soon_and_one_that_is_told_again_is_not(world: Carried) -> None:
    run_id = world.begin()
    world.tell_token(300, run_id, (0,))
    world.go(6.0)
    for ranked, is_fetched in ((("b",), True), (("b",), False), ((), False), (("b", "a"), True), (("b",), True)):
        world.tell_token(300, run_id, (0,), ranked=ranked)
        assert ((300, Word.FETCH) in world.asked(1.0)) is is_fetched, ranked


def test_where_the_token_is_and_which_bridge_can_be_left_out_is_shown(world: Carried) -> None:
    run_id = world.begin()
    waits, silent = ("answers", False), ("silent", True)
    assert world.bridges_told() == {"c0": waits, "c1": waits, "c2": waits}
    world.tell_token(300, run_id, (0,))
    assert world.bridges_told() == {"c0": ("answers", True), "c1": waits, "c2": waits}
    world.tell_token(300, run_id, ())
    world.tell_token(301, run_id, (1,))
    world.tell_token(302, "another run", (1,))
    assert world.bridges_told() == {"c0": waits, "c1": ("answers", True), "c2": waits}
    world.bridges.does[301, Word.FETCH] = page(holds=("1",))
    world.bridges.off.add(301)
    world.go(12.0)
    assert world.bridges_told()["c1"] == ("away", True)
    world.go(AWAY_S)
    assert world.bridges_told() == {"c0": waits, "c1": silent, "c2": waits}
    world.bridges.off.add(302)
    world.go(AWAY_S + 10)
    assert [state for state, _ in world.bridges_told().values()] == ["answers", "silent", "silent"], "one, then both"
    world.bridges.off.discard(302)
    world.go(6.0)
    assert world.bridges_told()["c1"] == silent
    world.carried.adopt(run_id, "c1", (), "anna")
    world.go(6.0)
    assert world.bridges_told() == {"c0": waits, "c2": waits}


ALONE = """version: 1
name: alone
parameters: {with_others: false}
steps:
  - {task: first, skill: work, robot: r0}
  - repeat:
      - {task: one, skill: work, robot: r1}
      - if: with_others
        then: [{task: two, skill: work, robot: r2}, {task: three, skill: work, robot: r0}]
    times: 10000
  - {task: last, skill: work, robot: r0}
"""


def begin_alone(world: Carried) -> str:
    """A run most of which c1 does alone; no other bridge knows how far it is."""
    checked, found = world.carried.check(ALONE)
    assert not checked.problems + found.problems
    run_id = world.carried.start(checked.scenario, (), (), "anna")
    world.go(1.0)
    return run_id


def done_alone(number: int) -> tuple[str, ...]:
    step, execution_id = f"1.repeat.0@{number}", f"{number:032x}"
    facts = (
        IterationStarted(10.0, "1", number),
        TaskAssigned(10.0, step, "one", 1, "r1", execution_id, "work"),
        TaskOver(10.0, step, 1, TaskOutcome.DONE, Then.DONE),
        StepEnded(10.0, step, StepState.DONE),
    )
    return tuple([encode_fact(fact) for fact in facts])


def adopted_by(world: Carried, space: int) -> Adoption:
    """What a bridge was told last."""
    told = [content for each, word, content in world.bridges.contents if (each, word) == (space, Word.ADOPT)]
    return decode_adoption(told[-1])


def test_the_heir_knows_that_rounds_are_over_which_nobody_has_fetched(world: Carried) -> None:
    """The server was away for most of them, and the bridge has forgotten all but the last ones since."""
    world.bridges.does[301, Word.FETCH] = page(*done_alone(0), *done_alone(1), *done_alone(4998), *done_alone(4999))
    run_id = begin_alone(world)
    world.go(10.0)
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    heir = world.carried.adopt(run_id, "c1", ("one@none",), "anna")
    world.go(5.0)
    told = adopted_by(world, {"c0": 300, "c2": 302}[heir])
    assert sorted(told.facts) == ["2@4999"], "what is sent of it is the last round alone"
    assert (2, (4999,)) in [(slot.segment, slot.rounds) for slot in told.filled]


def test_rounds_that_a_bridge_may_have_done_alone_have_to_be_named_by_a_person(tmp_path: Path) -> None:
    """The server has not heard the bridge since its own start."""
    world = Carried(tmp_path)
    world.bridges.does[301, Word.FETCH] = page(*done_alone(0), *done_alone(1))
    run_id = begin_alone(world)
    world.go(10.0)
    world.journal.close()
    again = Carried(tmp_path)
    again.bridges.off.add(301)
    again.go(AWAY_S + 10)
    for said in ((), ("one",)):
        with pytest.raises(ScenarioError, match="c1 may have done more rounds of one alone: round 1 was heard of last"):
            again.carried.adopt(run_id, "c1", said, "anna")
    with pytest.raises(RoundsUnknown, match=f"adopt {run_id} c1 --off --done one@ROUND") as refused:
        again.carried.adopt(run_id, "c1", (), "anna")
    assert refused.value.ua_status == StatusCode.BAD_INVALID_STATE
    assert not again.facts(RunAdopted)
    heir = again.carried.adopt(run_id, "c1", ("one@4711",), "anna")
    again.go(5.0)
    told = adopted_by(again, {"c0": 300, "c2": 302}[heir])
    assert sorted(told.facts) == ["2@4711"]
    assert not again.mistakes.count, again.mistakes.text()


def test_a_person_says_that_a_bridge_has_done_no_more_rounds_than_were_heard_of(world: Carried) -> None:
    world.bridges.does[301, Word.FETCH] = page(*done_alone(0), *done_alone(1))
    run_id = begin_alone(world)
    world.go(10.0)
    world.tell_token(301, run_id, (2,), count=12)
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    with pytest.raises(RoundsUnknown):
        world.carried.adopt(run_id, "c1", (), "anna")
    heir = world.carried.adopt(run_id, "c1", ("one@none",), "anna")
    world.go(5.0)
    assert sorted(adopted_by(world, {"c0": 300, "c2": 302}[heir]).facts) == ["2@1"]


def test_a_bridge_that_is_taken_out_of_the_file_is_adopted_as_one_that_is_off(tmp_path: Path) -> None:
    """The plan is known although the fleet has none of its robots any more."""
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.go(1.0)
    assert "have another bridge go on 20 s after the server began: ua-fleet scenario adopt" in again.reason()
    assert again.bridges_told()["c2"] == ("away", False)
    with pytest.raises(ScenarioError, match="any more, and can be left out 20 s after the server began"):
        again.carried.adopt(run_id, "space 302", (), "anna")
    again.go(AWAY_S)
    assert again.reason().endswith(f"have another bridge go on: ua-fleet scenario adopt {run_id} 'space 302' --off"), (
        again.reason()
    )
    assert again.bridges_told()["c2"] == ("silent", False)
    assert again.carried.adopt(run_id, "space 302", ("t2",), "anna") == "c0"
    again.go(3.0)
    told = adopted_by(again, 300)
    assert (told.part.epoch, told.gone, set(told.part.segments)) == (2, (302,), {0, 2})
    assert set(told.facts) == {"2"}
    assert again.reason() == ""
    assert "c2" not in again.bridges_told()
    again.bridges.does |= {(space, Word.FETCH): page(closed="done") for space in (300, 301)}
    again.go(7.0)
    (ended,) = again.facts(RunEnded)
    assert (ended.outcome, ended.reason) == (RunOutcome.DONE, "")
    assert not again.mistakes.count, again.mistakes.text()


def test_two_bridges_that_are_taken_out_of_the_file_are_left_out_as_one(tmp_path: Path) -> None:
    world = Carried(tmp_path, 4)
    run_id = world.begin()
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.go(AWAY_S + 1)
    assert again.carried.adopt(run_id, "space 302", (), "anna") == "c0"
    again.go(3.0)
    assert (300, Word.ADOPT) not in [(space, word) for space, word, _ in again.bridges.contents], "303 does not know it"
    assert f"ua-fleet scenario adopt {run_id} 'space 303' --off" in again.reason()
    again.bridges.does[300, Word.ADOPT] = None
    assert again.carried.adopt(run_id, "space 303", (), "anna") == "c0"
    again.go(3.0)
    told = adopted_by(again, 300)
    assert (told.part.epoch, told.gone) == (3, (302, 303))
    assert {2, 3} <= set(told.part.segments)
    again.journal.close()
    last = Carried(tmp_path, 2)
    last.go(3.0)
    assert adopted_by(last, 300) == told, "a server that is started again meanwhile says the same"
    assert not last.mistakes.count, last.mistakes.text()


def test_a_run_none_of_whose_bridges_is_in_the_file_any_more_can_be_aborted_alone(tmp_path: Path) -> None:
    world = Carried(tmp_path, 2)
    run_id = world.begin()
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.carried = again.with_bridges(0)
    again.go(AWAY_S + 1)
    assert "ua-fleet scenario adopt" not in again.reason()
    with pytest.raises(ScenarioError, match="no other bridge of the run may take the place"):
        again.carried.adopt(run_id, "space 300", (), "anna")
    again.carried.abort(run_id, "", "anna")
    again.go(1.0)
    assert [fact.outcome for fact in again.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_a_fleet_that_has_changed_since_a_run_began_does_not_keep_it_from_being_adopted(tmp_path: Path) -> None:
    """Another one of its bridges has left; and the time after which one may be left out is another one."""
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.journal.close()
    again = Carried(tmp_path, 2)
    again.bridges.off.add(301)
    again.go(AWAY_S + 10)
    assert again.carried.adopt(run_id, "c1", (), "anna") == "c0"
    assert again.carried.adopt(run_id, "space 302", (), "anna") == "c0"
    again.go(3.0)
    assert adopted_by(again, 300).gone == (301, 302)
