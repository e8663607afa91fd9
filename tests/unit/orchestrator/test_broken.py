"""A run that meets a mistake of ours ends, and no other run with it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator import (
    DecisionChanged,
    FaultFound,
    HaltChanged,
    Orchestrator,
    Output,
    ResilienceSettings,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TasksAhead,
    TaskStarted,
)
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.resilience import Criterion, CriterionKind, DecisionMode
from ua_fleet.scenario import FleetView, Lookup, RobotView, Run, Value, scenario_of
from ua_fleet.scenario.effects import Effect
from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    RunEnded,
    RunOutcome,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
)
from ua_fleet.scenario.model import Task

SETTINGS = ResilienceSettings(((Criterion("availability", CriterionKind.BENEFIT, (0, 100)), TasksAhead()),), {})
GO = SkillModel(1, "go", ("mobile",))
FLEET = FleetView({name: RobotView(name, frozenset({"mobile"}), {"go": GO}) for name in ("ned", "ted")})
HEAD = "version: 1\nname: s\nsteps:\n"
WORKING = scenario_of(
    f"{HEAD}  - parallel:\n      - {{task: t, robot: ned, skill: go}}\n      - {{wait: , until: bad > 1}}\n"
)
OTHER = scenario_of(f"{HEAD}  - {{task: u, robot: ted, skill: go}}\n")


class Broken(Exception):
    """A mistake that nobody has thought of."""


def ended(outputs: list[Output]) -> dict[str, RunEnded]:
    return {
        each.run_id: each.fact for each in outputs if isinstance(each, RunChanged) and isinstance(each.fact, RunEnded)
    }


@pytest.fixture
def journal() -> list[tuple[str, Fact]]:
    return []


def make(journal: list[tuple[str, Fact]]) -> tuple[Orchestrator, dict[str, Value]]:
    values: dict[str, Value] = {"bad": 0}

    def look_up(name: str) -> Value:
        if values[name] == "broken":
            raise Broken(name)
        return values[name]

    return Orchestrator(SETTINGS, FLEET, look_up, lambda run_id, fact: journal.append((run_id, fact))), values


def test_it_ends_failed_and_cancels_what_its_robots_are_at(journal: list[tuple[str, Fact]]) -> None:
    orchestrator, values = make(journal)
    orchestrator.start("a", WORKING, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    values["bad"] = "broken"
    outputs = orchestrator.poll(1.0)
    end = ended(outputs)["a"]
    assert (end.outcome, "Broken: bad" in end.reason) == (RunOutcome.FAILED, True)
    assert [each.robot for each in outputs if isinstance(each, TaskCancelled)] == ["ned"]
    assert [type(each.error) for each in outputs if isinstance(each, RunBroken)] == [Broken]
    assert list(orchestrator.runs) == ["b"]
    assert orchestrator.poll(2.0) == []


def test_it_does_not_stop_a_restart(journal: list[tuple[str, Fact]]) -> None:
    orchestrator, _ = make(journal)
    orchestrator.start("a", WORKING, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    again, values = make([])
    values["bad"] = "broken"
    stored = [
        (name, scenario, [fact for run_id, fact in journal if run_id == name])
        for name, scenario in (("a", WORKING), ("b", OTHER))
    ]
    assert ended(again.restore_all(stored, 1.0)).keys() == {"a"}
    assert list(again.runs) == ["b"]


ONLY_NED = scenario_of(f"{HEAD}  - {{task: t, robot: ned, skill: go}}\n")
BOTH = scenario_of(
    f"{HEAD}  - parallel:\n      - {{task: t, robot: ned, skill: go}}\n      - {{task: u, robot: ted, skill: go}}\n"
)
ANYBODY = scenario_of(f"{HEAD}  - {{task: t, capacity: mobile, skill: go}}\n")
OPERATED = replace(SETTINGS, mode=DecisionMode.OPERATOR, limit_s=60.0)


class BrokenRankings(Orchestrator):
    """A ranking meets a mistake of ours, as long as it is told to."""

    def __init__(self, settings: ResilienceSettings = OPERATED) -> None:
        self.values: dict[str, Value] = {"bad": 0}
        self.journal: list[tuple[str, Fact]] = []
        super().__init__(
            settings, FLEET, self.values.__getitem__, lambda run_id, fact: self.journal.append((run_id, fact))
        )
        self.broken_runs: set[str] = set()
        asked, wanted = self._choosing.asked, self._choosing.wanted

        def broken_asked(run_id: str, *rest: Any, **named: Any) -> Any:
            if run_id in self.broken_runs:
                raise Broken(run_id)
            return asked(run_id, *rest, **named)

        def broken_wanted(run_id: str, *rest: Any) -> Any:
            if run_id in self.broken_runs:
                raise Broken(run_id)
            return wanted(run_id, *rest)

        vars(self._choosing).update(asked=broken_asked, wanted=broken_wanted)


def mistakes(outputs: list[Output]) -> list[tuple[str, str]]:
    return [(each.run_id, str(each.error)) for each in outputs if isinstance(each, RunBroken)]


def asked_for(outputs: list[Output]) -> list[tuple[str, str]]:
    """What robots are to begin, and are not told to leave in the same breath."""
    stopped = {each.execution_id for each in outputs if isinstance(each, TaskCancelled)}
    begun = [each for each in outputs if isinstance(each, TaskStarted)]
    return [(each.run_id, each.robot) for each in begun if each.execution_id not in stopped]


def test_who_does_a_task_cannot_be_found_and_another_run_goes_on() -> None:
    orchestrator = BrokenRankings()
    orchestrator.broken_runs = {"a"}
    outputs = orchestrator.start("a", ANYBODY, {}, by="anna", now=0.0)
    assert mistakes(outputs) == [("a", "a")]
    assert (ended(outputs)["a"].outcome, asked_for(outputs)) == (RunOutcome.FAILED, [])
    assert "a mistake of ua_fleet (Broken: a)" in ended(outputs)["a"].reason
    assert asked_for(orchestrator.start("b", ANYBODY, {}, by="anna", now=0.0)) == [("b", "ned")]
    assert list(orchestrator.runs) == ["b"]


def test_a_search_that_goes_on_later_costs_its_own_run_alone() -> None:
    """Nobody is there yet for two tasks; when robots come, one of the two cannot be looked for."""
    orchestrator = BrokenRankings()
    orchestrator.not_heard(["ned", "ted"], 0.0)
    for run_id in ("a", "b"):
        orchestrator.start(run_id, ANYBODY, {}, by="anna", now=0.0)
    orchestrator.broken_runs = {"a"}
    outputs = orchestrator.told([FaultFound(robot, "silent", False, "") for robot in ("ned", "ted")], 1.0)
    assert (mistakes(outputs), list(ended(outputs)), asked_for(outputs)) == ([("a", "a")], ["a"], [("b", "ned")])


def test_a_decision_that_cannot_be_ranked_costs_its_own_run_alone() -> None:
    orchestrator = BrokenRankings()
    orchestrator.start("a", ONLY_NED, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    orchestrator.told([FaultFound(robot, "announced", True, "stuck") for robot in ("ned", "ted")], 1.0)
    orchestrator.poll(4.0)
    assert sorted(orchestrator.decisions) == ["a.0", "b.0"]
    orchestrator.broken_runs = {"a"}
    assert orchestrator.poll(5.0) == [], "nothing has changed that a ranking is made of"
    changed = orchestrator.told([FaultFound("ted", "announced", True, "stuck twice")], 5.0)
    outputs = [each for each in changed if getattr(each, "run_id", "") == "a"]
    assert (mistakes(outputs), list(ended(outputs))) == ([("a", "a")], ["a"])
    assert list(orchestrator.decisions) == ["b.0"]
    (given_up,) = [each.event.decision_id for each in outputs if isinstance(each, DecisionChanged)]
    assert given_up == "a.0"
    assert orchestrator.poll(6.0) == []
    confirmed = orchestrator.told([FaultFound("ted", "announced", False, "")], 7.0)
    assert mistakes(confirmed) == []


def test_what_follows_from_a_fact_costs_its_own_run_and_its_robots_are_told_to_stop() -> None:
    """A mistake while one effect of a run is carried out: nothing that comes behind it is begun."""
    orchestrator = BrokenRankings()
    orchestrator.start("a", BOTH, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    orchestrator.broken_runs = {"a"}
    ids = {one.robot: one.execution_id for one in orchestrator.runs["a"].state.tasks.values()}
    outputs = orchestrator.ended(ids["ned"], TaskOutcome.REFUSED, 1.0, message="no")
    assert (mistakes(outputs), list(ended(outputs))) == ([("a", "a")], ["a"])
    assert [each.robot for each in outputs if isinstance(each, TaskCancelled)] == ["ted"]
    assert asked_for(outputs) == [], "ted has not said that it stands"
    assert asked_for(orchestrator.ended(ids["ted"], TaskOutcome.FAILED, 2.0)) == [("b", "ted")]


def test_a_run_that_cannot_even_be_ended_keeps_its_robots_from_all_others(monkeypatch: pytest.MonkeyPatch) -> None:
    orchestrator = BrokenRankings()
    orchestrator.start("a", WORKING, {}, by="anna", now=0.0)

    def broken(_reason: str, _now: float) -> list[Effect]:
        raise Broken("again")

    monkeypatch.setattr(orchestrator.runs["a"], "broken", broken)
    del orchestrator.values["bad"]
    assert mistakes(orchestrator.poll(1.0)) == [("a", "'bad'"), ("a", "again")]
    assert orchestrator.runs == {}
    assert asked_for(orchestrator.start("c", ONLY_NED, {}, by="anna", now=2.0)) == []
    assert asked_for(orchestrator.start("d", OTHER, {}, by="anna", now=2.0)) == [("d", "ted")]


def test_a_run_whose_facts_cannot_be_taken_in_ends_and_its_robot_is_to_stop_first() -> None:
    first = BrokenRankings()
    first.start("a", ONLY_NED, {}, by="anna", now=0.0)
    first.start("b", OTHER, {}, by="anna", now=0.0)
    facts = {name: [fact for run_id, fact in first.journal if run_id == name] for name in ("a", "b")}
    facts["a"].append(IterationStarted(1.0, "0", "one"))  # type: ignore[arg-type]
    (assigned,) = [fact for fact in facts["a"] if isinstance(fact, TaskAssigned)]
    again = BrokenRankings()
    outputs = again.restore_all([("a", ONLY_NED, facts["a"]), ("b", OTHER, facts["b"])], 5.0)
    assert [run_id for run_id, _ in mistakes(outputs)] == ["a"]
    assert ended(outputs)["a"].outcome is RunOutcome.FAILED
    assert [(run_id, type(fact)) for run_id, fact in again.journal] == [("a", RunEnded)]
    assert list(again.runs) == ["b"]
    owed = [each.halt.execution_id for each in outputs if isinstance(each, HaltChanged)]
    told = [each.execution_id for each in outputs if isinstance(each, TaskCancelled)]
    assert (owed, told, again.must_not_begin()) == ([assigned.execution_id],) * 3
    assert asked_for(again.start("c", ONLY_NED, {}, by="anna", now=6.0)) == [], "ned may be at it"
    assert asked_for(again.ended(assigned.execution_id, TaskOutcome.FAILED, 7.0)) == [("c", "ned")]


def test_two_tasks_that_fail_in_one_breath_end_their_run_once() -> None:
    """The first failure had the run end while the second was still to be told."""
    orchestrator = BrokenRankings(SETTINGS)
    tasks = "".join(
        f"      - {{task: {name}, robot: {robot}, skill: go, on_unknown: {policy}}}\n"
        for name, robot, policy in (("t", "ned", "replace"), ("u", "ted", "fail"))
    )
    orchestrator.start("a", scenario_of(f"{HEAD}  - parallel:\n{tasks}"), {}, by="anna", now=0.0)
    orchestrator.not_heard(["ned", "ted"], 0.0)
    outputs = orchestrator.poll(31.0)
    assert mistakes(outputs) == []
    assert [each.fact.step for each in outputs if isinstance(each, RunChanged) and isinstance(each.fact, TaskOver)] == [
        "0.0.0",
        "0.1.0",
    ]


def test_what_cannot_be_looked_at_must_not_begin_after_a_restart(monkeypatch: pytest.MonkeyPatch) -> None:
    orchestrator = BrokenRankings()
    caught: list[str] = []
    orchestrator.tell_mistakes(lambda loop, error: caught.append(f"{loop}: {error}"))
    orchestrator.start("a", ONLY_NED, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    assert orchestrator.must_not_begin() == []
    needs = Knowledge.needs

    def broken(known: Knowledge, robot: str, task: Task) -> tuple[str, ...]:
        if robot == "ned":
            raise Broken(robot)
        return needs(known, robot, task)

    monkeypatch.setattr(Knowledge, "needs", broken)
    assert orchestrator.must_not_begin() == [orchestrator.runs["a"].state.tasks["0"].execution_id]
    assert caught == ["runs: ned"]


def test_a_run_that_ends_in_the_breath_of_a_mistake_is_told_to_have_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    orchestrator = BrokenRankings()
    orchestrator.start("a", scenario_of(f"{HEAD}  - {{wait: 5}}\n"), {}, by="anna", now=0.0)
    poll = orchestrator.runs["a"].poll

    def broken(_run: Run, lookup: Lookup, now: float) -> list[Effect]:
        poll(lookup, now)
        raise Broken("late")

    monkeypatch.setattr(Run, "poll", broken)
    outputs = orchestrator.poll(6.0)
    assert (mistakes(outputs), ended(outputs)["a"].outcome) == ([("a", "late")], RunOutcome.DONE)
    assert [type(fact) for _, fact in orchestrator.journal].count(RunEnded) == 1
    assert orchestrator.runs == {}
