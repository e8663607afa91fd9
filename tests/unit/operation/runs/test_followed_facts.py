# pyright: reportPrivateUsage=false
"""What the server's journal has of a carried run with many rounds."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.unit.operation.runs.test_carried import Bridges, Carried, answer
from ua_fleet.carrying import SegmentRound, parts_of, split
from ua_fleet.carrying.adoption import adopted_places, begun_slots, needed_places
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.operation.runs.carried_adoption import plan_view
from ua_fleet.operation.runs.followed_facts import FORGOTTEN_EACH, KEPT_FACTS, KEPT_TASKS, FollowedFacts
from ua_fleet.operation.runs.records import RunRecord, TaskRecord
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    Replaced,
    RobotReturned,
    RunEnded,
    RunOutcome,
    StepEnded,
    StepStarted,
    StepState,
    TaskAccepted,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
    encode_fact,
)
from ua_fleet.scenario.state import RunState
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.topics import Topic

ROUNDS = 5000
TEXT = f"""version: 1
name: made
steps:
  - repeat:
      - {{task: t0, skill: work, robot: r0}}
      - {{task: t1, skill: work, robot: r1}}
    times: {ROUNDS}
"""
OF_A_TASK = 4
"""Facts."""
KEYS = {0: "0.repeat.0", 1: "0.repeat.1"}
MOST_FACTS = (KEPT_TASKS + 4) * OF_A_TASK + KEPT_TASKS + 2 * FORGOTTEN_EACH + 50


def task(number: int, key: str, at: float, name: str = "t", robot: str = "r", results: float = 0.0) -> list[Fact]:
    """What happens at one task in a round."""
    step = f"{key}@{number}"
    return [
        StepStarted(at, step),
        TaskAssigned(at, step, name, 1, robot, f"{number:08x}{key}", "work"),
        TaskAccepted(at + 0.1, step, 1),
        TaskOver(at + 0.2, step, 1, TaskOutcome.DONE, Then.DONE, "well done", {"out": results}),
    ]


def of_bridge(which: int) -> list[Fact]:
    """All that a bridge tells of the run."""
    facts: list[Fact] = []
    for number in range(ROUNDS):
        at = 200.0 + number
        if which == 0:
            facts.append(IterationStarted(at, "0", number))
        facts += task(number, KEYS[which], at + 0.1 + which * 0.4, f"t{which}", f"r{which}", float(number))
    return [*facts, StepEnded(200.0 + ROUNDS, "0", StepState.DONE)] if which == 0 else facts


class ManyRounds(Bridges):
    """Bridges whose run is at some round, and that have the facts of the last 500 rounds alone, as real ones do."""

    def __init__(self) -> None:
        super().__init__()
        self.facts = {300: of_bridge(0), 301: of_bridge(1)}
        self.lines = {space: [encode_fact(fact) for fact in facts] for space, facts in self.facts.items()}
        self.at_round, self.is_over, self._after = 0, False, dict[int, int]()

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        super().request(topic, robot, skill, arguments, timeout_s, execution_id)
        if arguments["Word"] == Word.FETCH:
            self._after[topic.space] = decode_words(arguments["Content"])["after"]

    def outcome(self, space: int, word: Word) -> RequestOutcome | None:
        if word is not Word.FETCH:
            return super().outcome(space, word)
        each = OF_A_TASK + (space == 300)
        end = len(self.lines[space]) if self.is_over else self.at_round * each
        first = max(self._after[space], (self.at_round - 500) * each, 0)
        last = min(first + 150, end)
        words: dict[str, Any] = {"facts": self.lines[space][first:last], "last": last, "more": last < end}
        words |= {"told": last, "active": [], "holds": [], "waits": "", "decisions": []}
        words["closed"] = [200.0 + ROUNDS, "done", ""] if self.is_over else None
        return answer(zlib.compress(encode_words(**words)))


class World(Carried):
    """A server with these."""

    def __init__(self, folder: Path, bridges: ManyRounds) -> None:
        super().__init__(folder, 2)
        bridges.told = self.bridges.told
        self.bridges = bridges
        self.carried._commands = bridges  # type: ignore[assignment]

    def size(self) -> tuple[int, int, int]:
        """How many facts the journal has, of how many bytes, and how many pages its file."""
        database: Any = self.journal._database
        ((count, size),) = database.read("SELECT count(*), sum(length(line)) FROM facts")
        ((pages,),) = database.read("PRAGMA page_count")
        return count, size, pages

    def reach(self, number: int, *, each: int = 250) -> None:
        """Have the bridges go on to a round, and be followed."""
        bridges = self.bridges
        assert isinstance(bridges, ManyRounds)
        while bridges.at_round < number:
            bridges.at_round = min(number, bridges.at_round + each)
            self.now = max(self.now, 200.0 + bridges.at_round)
            self.go(7.0)
        assert not self.mistakes.count, self.mistakes.text()


def in_order(record: RunRecord) -> list[TaskRecord]:
    """The last tasks that are shown, but for the order in which the pages of bridges have come."""
    return sorted(record.rows(), key=lambda row: row.begun or 0.0)[-400:]


def test_the_record_of_a_run_with_many_rounds_is_bounded_and_a_restart_in_its_midst_is_right(tmp_path: Path) -> None:
    bridges = ManyRounds()
    world = World(tmp_path, bridges)
    checked, _ = world.carried.check(TEXT)
    run_id = world.carried.start(checked.scenario, (), (), "anna")
    world.reach(1000)
    sizes = [world.size()]
    world.reach(2500)
    sizes.append(world.size())
    before = RunRecord.of(run_id, world.service.facts_of(run_id)).rows()
    world.journal.close()

    again = World(tmp_path, bridges)
    assert RunRecord.of(run_id, again.service.facts_of(run_id)).rows() == before
    again.go(7.0)  # it fetches all once more that bridges have
    sizes.append(again.size())
    assert not [fact for fact in again.facts(TaskAssigned) if int(fact.step.partition("@")[2]) < 2500], "it is known"
    again.reach(ROUNDS)
    sizes.append(again.size())
    assert max(count for count, _, _ in sizes) <= MOST_FACTS, sizes
    assert max(size for _, size, _ in sizes) < 250 * MOST_FACTS, f"bytes of facts: {sizes}"
    assert sizes[-1][2] < 1.5 * sizes[0][2], f"what is free is used again: {sizes}"

    bridges.is_over = True
    again.go(12.0)
    assert [fact.outcome for fact in again.facts(RunEnded)] == [RunOutcome.DONE]
    full = RunRecord.of(run_id, sorted([*bridges.facts[300], *bridges.facts[301]], key=lambda fact: fact.at))
    shown = RunRecord.of(run_id, again.service.facts_of(run_id))
    assert len(shown.rows()) == 500
    assert in_order(shown) == in_order(full), "people see the same as if all were there"
    assert shown.state.results == full.state.results
    assert shown.state.outcome is RunOutcome.DONE


def test_what_a_server_knows_of_a_run_does_not_grow_with_the_rounds_whose_facts_come_late() -> None:
    """The bridge that decides tells of a round before the others have told of the one before it."""
    record, sizes = RunRecord("run"), list[int]()
    for number in range(2000):
        at = float(number)
        record.apply(IterationStarted(at, "0", number))
        for fact in task(number, KEYS[0], at) + (task(number - 1, KEYS[1], at) if number else []):
            record.apply(fact)
        state = record.state
        sizes.append(len(state.tasks) + len(state.ended) + len(state.started) + len(state.executions))
        sizes[-1] += len(record._messages) + len(record._times)
    assert max(sizes[1500:]) < 1.1 * max(sizes[:1500])
    assert max(sizes) < 10_000


def kept(facts: Iterable[Fact], kept_tasks: int = 20) -> list[Fact]:
    """What is left of facts that come one after the other."""
    known, there = FollowedFacts(kept_tasks=kept_tasks), dict[str, Fact]()
    for fact in facts:
        if known.take(fact):
            there[encode_fact(fact)] = fact
        for line in known.forget():
            del there[line]
    assert len(known) == len(there)
    return list(there.values())


def state_of(facts: Iterable[Fact]) -> RunState:
    state = RunState()
    for fact in facts:
        state.apply(fact)
    return state


def test_a_result_of_a_task_that_was_done_in_an_early_round_alone_is_kept() -> None:
    facts: list[Fact] = [*task(3, "0.repeat.1.then.0", 0.5, "rare", results=7.0)]
    for number in range(4, 1000):
        facts += [IterationStarted(number, "0", number), *task(number, KEYS[0], number, "often")]
    failing = "0.repeat.1.then.0@999"
    facts += [StepStarted(2000.0, failing), TaskAssigned(2000.0, failing, "rare", 1, "r", "ff", "work")]
    left = kept(facts)
    assert len(left) < 2 * FORGOTTEN_EACH + 100
    assert state_of(left).results["rare"] == {"out": 7.0}
    assert "0.repeat.1.then.0" in state_of(left).tasks_done


def stand_in(at: float, step: str) -> list[Fact]:
    return [Replaced(at, step, "r1", "r2", "auto")]


def returned(at: float, step: str) -> list[Fact]:
    return [*stand_in(at, step), RobotReturned(at, "r1")]


def itself_again(at: float, step: str) -> list[Fact]:
    return [*stand_in(at, step), Replaced(at, step, "r1", "r1", "auto")]


def returned_for_one(at: float, step: str) -> list[Fact]:
    return [Replaced(at, step, "r1", "r2", "auto", capacities=("a", "b")), RobotReturned(at, "r1", "a")]


def for_one_task(at: float, step: str) -> list[Fact]:
    return [Replaced(at, step, "r1", "r2", "auto", lasting=False)]


@pytest.mark.parametrize(
    ("change", "stands_in"),
    [(stand_in, True), (returned, False), (itself_again, False), (returned_for_one, True), (for_one_task, False)],
)
@pytest.mark.parametrize("rounds", [range(5), range(0, 1000, 7)], ids=["a few times", "over and over"])
def test_who_stands_in_for_whom_is_kept(
    change: Callable[[float, str], list[Fact]], stands_in: bool, rounds: Sequence[int]
) -> None:
    facts: list[Fact] = []
    for number in range(1000):
        facts += [IterationStarted(number, "0", number), *task(number, KEYS[0], number + 0.1)]
        if number in rounds:
            facts += change(number + 0.5, f"{KEYS[0]}@{number}")
    left = kept(facts)
    assert len(left) < 2 * FORGOTTEN_EACH + 200
    assert state_of(left).stand_ins == state_of(facts).stand_ins
    assert bool(state_of(left).stand_ins) == stands_in
    once_more = FollowedFacts(left, kept_tasks=20)
    assert not [fact for fact in facts[: len(facts) // 2] if once_more.take(fact)], "what was forgotten is not taken"


def test_an_adoption_is_told_the_same_of_the_rounds_that_are_not_over(tmp_path: Path) -> None:
    world = Carried(tmp_path, 2)
    checked, _ = world.carried.check(TEXT)
    plan, problems = split(checked.scenario, plan_view(world.carried._config, world.service))
    assert plan is not None, problems
    parts = parts_of(plan, "run", "made", {}, "anna", adopt_after_s=20.0)
    first, other = of_bridge(0)[: 5 * 1000], of_bridge(1)[: OF_A_TASK * 999 + 2]
    facts = sorted([*first, *other], key=lambda fact: fact.at)
    left = kept(facts)
    assert len(left) < 2 * FORGOTTEN_EACH + 200

    def told(known: list[Fact], gone: int, heir: int) -> dict[str, tuple[str, ...]]:
        places = {
            place: tuple([encode_fact(fact) for fact in adopted])
            for one in parts[gone].segments.values()
            for place, adopted in adopted_places(one, known, (), 9e3, "anna").items()
        }
        begun = begun_slots(list(parts[heir].segments.values()), known)
        return needed_places(parts[gone].segments, places, begun)

    for gone, heir in ((300, 301), (301, 300)):
        assert told(left, gone, heir) == told(facts, gone, heir)
        assert told(left, gone, heir)
        rounds = [number for place in told(left, gone, heir) for number in SegmentRound.parse(place).rounds]
        assert all(number > 990 for number in rounds), "of those before, the tokens of others prove that they are over"


def of_waits(first: int, rounds: int) -> Iterable[Fact]:
    """What a bridge tells of rounds in which it does no task: `repeat: [{wait: 0.05}]` with `while`."""
    for number in range(first, first + rounds):
        at, step = number * 0.05, f"0.repeat.0@{number}"
        yield IterationStarted(at, "0", number)
        yield StepStarted(at, step)
        yield StepEnded(at + 0.05, step, StepState.DONE)


@pytest.mark.parametrize("each", [0, 1000], ids=["without a task", "with a task now and then"])
def test_what_is_known_of_rounds_that_have_hardly_a_task_is_bounded(each: int) -> None:
    def happened(first: int, rounds: int) -> Iterable[Fact]:
        for number in range(first, first + rounds):
            yield from of_waits(number, 1)
            if each and number % each == 0:
                yield from task(number, KEYS[1], number * 0.05, "rare", results=float(number))

    known, most, there = FollowedFacts(), 0, dict[str, Fact]()
    for fact in happened(0, 6000):
        assert known.take(fact), "it is new"
        there[encode_fact(fact)] = fact
        for line in known.forget():
            del there[line]
        most = max(most, len(known))
    assert most <= KEPT_FACTS + FORGOTTEN_EACH + 100
    assert len(there) == len(known)
    state = state_of(there.values())
    assert state.iterations["0"] == 5999
    if each:
        assert [one.step for one in there.values() if isinstance(one, TaskAssigned)] == [
            f"{KEYS[1]}@{number}" for number in range(0, 6000, each)
        ], "the tasks that people see"
        assert state.results["rare"] == {"out": 5000.0}
    once_more = FollowedFacts(there.values())
    assert not [fact for fact in happened(0, 3000) if once_more.take(fact)], "what was forgotten is not taken"
    assert all(once_more.take(fact) for fact in of_waits(6000, 100))


def test_the_work_for_a_fact_does_not_grow_with_the_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted, as time depends on what else the machine does: the facts that are looked through each time."""
    looked: list[int] = []
    look_back = FollowedFacts._look_back

    def counted(known: FollowedFacts) -> None:
        looked.append(len(known))
        look_back(known)

    monkeypatch.setattr(FollowedFacts, "_look_back", counted)
    known = FollowedFacts()
    for fact in of_waits(0, 8000):
        known.take(fact)
        known.forget()
    assert len(looked) > 40
    assert max(looked) <= KEPT_FACTS + FORGOTTEN_EACH + 100
