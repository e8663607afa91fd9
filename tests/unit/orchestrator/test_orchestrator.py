"""Runs side by side, faults, decisions: what is asked of robots and told to people."""

from __future__ import annotations

import pytest

from tests.unit.orchestrator.world import BATTERY, FLEET, FREE, World, settings
from ua_fleet.errors import JudgementsInvalid, NoCandidate, ScenarioError
from ua_fleet.orchestrator import (
    FaultChange,
    FaultChanged,
    OperatorAsked,
    ResilienceSettings,
    TasksAhead,
    ValueOf,
)
from ua_fleet.resilience import (
    Aborted,
    Confirmation,
    DecisionMode,
    OnLimit,
    RankingChanged,
    ReplacementChosen,
)
from ua_fleet.scenario import scenario_of
from ua_fleet.scenario.facts import TaskOutcome, decode_fact


def test_two_runs_that_want_one_robot_are_served_in_order() -> None:
    world = World()
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n  - {task: t2, robot: ridgeback, skill: go}\n")
    world.start("b", "  - {task: t1, robot: ridgeback, skill: grab}\n")
    world.go()
    assert world.log == [
        *("0 a ridgeback go", "1 b ridgeback grab", "2 b done"),
        *("2 a ridgeback go", "3 a done"),
    ]


def test_runs_with_robots_of_their_own_go_side_by_side() -> None:
    world = World()
    world.start("a", "  - {task: t1, robot: pioneer_1, skill: go}\n")
    world.start("b", "  - {task: t1, robot: pioneer_2, skill: go}\n")
    world.go()
    assert world.log == ["0 a pioneer_1 go", "0 b pioneer_2 go", "1 a done", "1 b done"]


def test_a_fault_in_the_middle_of_a_task_brings_the_best_replacement() -> None:
    world = World()
    world.values["pioneer_2.battery"] = 90.0
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n  - {task: t2, robot: ridgeback, skill: go}\n")
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "robot", "motor is hot", 0.5))
    world.at(1.2, lambda: world.make.fault_cleared("ridgeback", "robot", 1.2))
    world.go()
    assert world.log == [
        *("0 a ridgeback go", "0.5 ridgeback halted", "0.5 a pioneer_2 go", "1.5 a ridgeback go", "2.5 a done"),
    ]
    first, second = world.decisions()
    assert isinstance(first.event, RankingChanged)
    ranking = first.event.ranking
    assert [place.robot for place in ranking.ranked] == ["pioneer_2", "pioneer_1"]
    assert {left.robot: left.reason for left in ranking.excluded} == {
        "ridgeback": "has a fault: motor is hot",
        "ur3": "lacks the capacity mobile",
    }
    assert isinstance(second.event, ReplacementChosen)
    reason = "motor is hot; it was halted: stopped"
    assert (second.failed, second.reason, second.event.by) == ("ridgeback", reason, "automatic")
    changes = [
        (change.fault.id, change.change) for change in world.heard(FaultChanged) if isinstance(change, FaultChanged)
    ]
    assert changes == [("ridgeback.robot", FaultChange.RAISED), ("ridgeback.robot", FaultChange.CLEARED)]


def test_a_task_that_another_robot_has_then_done_is_a_fault_until_it_is_acknowledged() -> None:
    world = World()
    world.outcome["ridgeback", "go"] = TaskOutcome.FAILED
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n  - {task: t2, robot: ridgeback, skill: grab}\n")
    world.go(1.5)
    assert list(world.make.faults) == [], "nobody knows yet whether the robot or the task is to blame"
    world.go()
    assert [line.split()[2] for line in world.log[:3]] == ["ridgeback", "pioneer_1", "ridgeback"]
    (fault,) = world.make.faults
    assert (fault.robot, fault.active, fault.acknowledged) == ("ridgeback", True, False)
    assert fault.capacities == ("mobile",), "it takes away what the skill needs, and Ridgeback still grabs"
    assert fault.reason == "go failed (go on ridgeback: failed), and pioneer_1 has done it"
    world.take(world.make.acknowledge(fault.id, "anna", 9))
    assert list(world.make.faults) == []
    with pytest.raises(ScenarioError, match="no fault"):
        world.make.acknowledge(fault.id, "bert", 9)


def test_a_robot_that_says_that_it_stands_in_an_error_has_a_fault_at_once() -> None:
    world = World()
    world.outcome["ridgeback", "go"] = TaskOutcome.STOPPED
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go, retries: 3}\n")
    world.go(1.5)
    assert [(fault.robot, fault.source) for fault in world.make.faults] == [("ridgeback", "skill")]
    world.go()
    assert world.log == ["0 a ridgeback go", "1 a pioneer_1 go", "2 a done"]


def test_replacements_fail_until_none_is_left_and_the_run_ends_clearly() -> None:
    world = World()
    for robot in FLEET.robots:
        world.outcome[robot, "go"] = TaskOutcome.FAILED
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.go()
    assert [line.split()[2] for line in world.log[:3]] == ["ridgeback", "pioneer_1", "pioneer_2"]
    said = "ridgeback: go on ridgeback: failed; pioneer_1: go on pioneer_1: failed"
    assert world.log[3] == f"3 a failed task t1: go on pioneer_2: failed; no robot is left that can take over ({said})"
    assert list(world.make.faults) == [], "one bad task leaves the fleet as it was"
    world.outcome.clear()
    world.start(
        "b", "".join(f"  - {{task: {robot}, robot: {robot}, skill: go}}\n" for robot in ("ridgeback", "pioneer_1"))
    )
    world.go(900)
    assert world.log[-1].endswith("b done")
    assert isinstance(world.decisions()[-1].event, Aborted)
    assert world.make.next_deadline() is None
    assert world.make.runs == {}


def test_an_operator_confirms_and_of_two_the_first_decides() -> None:
    world = World(DecisionMode.OPERATOR)
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    ((decision_id, decision),) = world.make.decisions.items()
    assert decision.ranking.best == "pioneer_1"
    with pytest.raises(NoCandidate, match="ur3 cannot take over: lacks the capacity mobile"):
        world.make.confirm(decision_id, "ur3", "anna", 1.0)
    confirmation, outputs = world.make.confirm(decision_id, "pioneer_2", "anna", 1.0)
    assert confirmation is Confirmation.TAKEN
    world.now = 1.0
    world.take(outputs)
    with pytest.raises(ScenarioError, match="no decision"):
        world.make.confirm(decision_id, "pioneer_1", "bert", 1.0)
    world.go()
    assert world.log[-2:] == ["1 a pioneer_2 go", "2 a done"]


def test_a_changed_value_and_a_changed_judgement_rank_an_open_decision_again() -> None:
    world = World(DecisionMode.OPERATOR)
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    before = len(world.decisions())
    world.take(world.make.poll(1.0))
    assert len(world.decisions()) == before
    world.values["pioneer_2.battery"] = 100.0
    world.take(world.make.poll(2.0))
    changed = world.decisions()[-1].event
    assert isinstance(changed, RankingChanged)
    assert changed.ranking.best == "pioneer_2"
    other = {("battery", "distance"): 1 / 9, ("battery", "availability"): 1 / 9, ("distance", "availability"): 1.0}
    world.take(world.make.set_settings(ResilienceSettings(settings().criteria, other, mode=DecisionMode.OPERATOR), 3.0))
    changed = world.decisions()[-1].event
    assert isinstance(changed, RankingChanged)
    assert changed.ranking.best == "pioneer_1"


@pytest.mark.parametrize(
    ("on_limit", "last"),
    [
        (OnLimit.BEST, "31 a done"),
        (OnLimit.ABORT, "30 a failed task t1: ridgeback: stuck; it was halted: stopped; no operator chose in time"),
    ],
)
def test_the_limit_of_an_operator(on_limit: OnLimit, last: str) -> None:
    world = World(DecisionMode.OPERATOR, on_limit)
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    world.go()
    assert world.log[-1] == last


def test_what_if_says_who_would_take_over_without_effect() -> None:
    world = World()
    world.start(
        "a",
        "  - {task: t1, robot: ridgeback, skill: go}\n"
        "  - {task: t2, robot: ridgeback, skill: grab}\n"
        "  - {task: t3, robot: ur3, skill: grab}\n",
    )
    journal, said = list(world.journal), len(world.said)
    forecasts = list(world.make.what_if("ridgeback")[1])
    assert [(forecast.task, forecast.ranking.best) for forecast in forecasts] == [("t1", "pioneer_1"), ("t2", "ur3")]
    assert (world.journal, len(world.said)) == (journal, said)
    assert world.make.decisions == {}
    assert [forecast.task for forecast in world.make.what_if("ur3")[1]] == ["t3"]


def test_what_if_in_a_repetition() -> None:
    world = World()
    world.start("a", "  - {repeat: [{task: t, robot: ridgeback, skill: go}], times: 3}\n")
    world.go(1.5)
    assert [(forecast.task, forecast.ranking.best) for forecast in world.make.what_if("ridgeback")[1]] == [
        ("t", "pioneer_1")
    ]
    world.go(3.5)
    assert list(world.make.what_if("ridgeback")[1]) == []


def test_a_robot_that_is_back_takes_a_task_that_waits_for_who_stands_in() -> None:
    world = World()
    world.values["pioneer_2.battery"] = 1.0
    world.start("b", "  - {task: t, robot: pioneer_1, skill: go}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    world.start("a", "  - {task: t, robot: ridgeback, skill: go}\n")
    world.start("c", "  - {task: t, robot: pioneer_1, skill: go}\n")
    world.at(0.3, lambda: world.make.fault_cleared("ridgeback", "robot", 0.3))
    world.go()
    assert world.log == [
        *("0 b pioneer_1 go", "0.3 a ridgeback go", "1 b done"),
        *("1 c pioneer_1 go", "1.3 a done", "2 c done"),
    ]


def test_availability_falls_with_the_tasks_that_a_robot_has_ahead() -> None:
    world = World(DecisionMode.OPERATOR)
    world.values.update({"pioneer_1.x": 5.0, "pioneer_2.x": 5.0})
    world.start("busy", "".join(f"  - {{task: t{n}, robot: pioneer_1, skill: go}}\n" for n in range(4)))
    world.start("a", "  - {task: t, robot: ridgeback, skill: go}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    (decision,) = world.make.decisions.values()
    raw = {place.robot: place.raw[2] for place in decision.ranking.ranked}
    assert raw == {"pioneer_1": 20.0, "pioneer_2": 100.0}
    assert decision.ranking.best == "pioneer_2"


def test_a_task_for_a_capacity_goes_to_the_best_that_is_fit() -> None:
    world = World()
    world.values["pioneer_2.battery"] = 99.0
    world.start("a", "  - {task: t1, capacity: mobile, skill: go}\n")
    world.go()
    assert world.log[0] == "0 a pioneer_2 go"
    world = World()
    world.values.clear()  # nothing is known of anybody: the work goes on all the same
    world.start("a", "  - {task: t1, capacity: mobile, skill: go}\n")
    world.go()
    assert world.log[0] == "0 a pioneer_1 go"


def test_without_any_fit_robot_the_reason_is_said() -> None:
    world = World(DecisionMode.ABORT)
    world.take(world.make.fault_raised("ur3", "silent", "nothing heard for 3 s", -50.0))
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    world.start("a", "  - {task: t1, capacity: grab, skill: grab}\n")
    decision = world.decisions()[0]
    assert "ur3 is silent" in decision.reason
    (line,) = world.log
    assert line.startswith("0 a failed task t1 was not begun: no robot can do grab: ")
    assert line.endswith("; the mode is Abort")


def test_an_unknown_end_is_asked_about() -> None:
    world = World()
    world.outcome["ridgeback", "go"] = TaskOutcome.UNKNOWN
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.go(5)
    (asked,) = world.heard(OperatorAsked)
    assert isinstance(asked, OperatorAsked)
    world.take(world.make.answer("a", asked.step, "done", "anna", 5.0))
    assert world.log[-1] == "5 a done"
    with pytest.raises(ScenarioError, match="no run 'a'"):
        world.make.answer("a", asked.step, "done", "anna", 5.0)


def test_a_restart_goes_on_with_faults_and_decisions() -> None:
    world = World(DecisionMode.OPERATOR)
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n  - {task: t2, robot: ur3, skill: grab}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    assert len(world.make.decisions) == 1
    again = World(DecisionMode.OPERATOR)
    again.take(again.make.fault_raised("ridgeback", "robot", "stuck", 10.0))
    scenario = scenario_of(world.make.runs["a"].state.run_id and _text_of(world))
    facts = [decode_fact(line) for _, line in world.journal]
    again.now = 10.0
    again.take(again.make.restore("a", scenario, facts, 10.0))
    ((decision_id, _),) = again.make.decisions.items()
    again.take(again.make.confirm(decision_id, "pioneer_1", "anna", 10.0)[1])
    again.go()
    assert again.log == ["10 a pioneer_1 go", "11 a ur3 grab", "12 a done"]


def _text_of(world: World) -> str:
    first = decode_fact(world.journal[0][1])
    return str(getattr(first, "text"))  # noqa: B009 - a fact of any kind for the type checker


def test_a_run_id_is_used_once_at_a_time_and_unknown_ones_are_refused() -> None:
    world = World()
    steps = "  - {task: t1, robot: ridgeback, skill: go}\n"
    world.start("a", steps)
    with pytest.raises(ScenarioError, match="there is a run 'a' already"):
        world.start("a", steps)
    for call in (world.make.pause, world.make.resume):
        with pytest.raises(ScenarioError, match="no run 'b'"):
            call("b", "anna", 0.0)
    with pytest.raises(ScenarioError, match="no run 'b'"):
        world.make.abort("b", "x", "anna", 0.0)
    assert world.make.ended("ff", TaskOutcome.DONE, 0.0) == []


def test_an_abort_frees_the_robots() -> None:
    world = World()
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.start("b", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.unstoppable.add("ridgeback")
    world.at(0.5, lambda: world.make.abort("a", "lunch", "anna", 0.5))
    world.go()
    assert world.log == [
        "0 a ridgeback go",
        "0.5 ridgeback halted",
        "1 a aborted lunch",
        "1 b ridgeback go",
        "2 b done",
    ]


def test_settings_that_cannot_be_weighed_are_refused() -> None:
    with pytest.raises(JudgementsInvalid):
        ResilienceSettings(((BATTERY, ValueOf("battery")), (FREE, TasksAhead())), {})


def test_after_a_restart_a_robot_stays_with_what_it_is_at() -> None:
    world = World()
    world.start("b", "  - {task: other, robot: ur3, skill: grab}\n")
    world.start("a", "  - {task: waiting, robot: ur3, skill: grab}\n")
    again = World()
    stored = [
        (
            run_id,
            scenario_of("version: 1\nname: s\nsteps:\n  - {task: " + task + ", robot: ur3, skill: grab}\n"),
            [decode_fact(line) for owner, line in world.journal if owner == run_id],
        )
        for run_id, task in (("a", "waiting"), ("b", "other"))
    ]
    again.take(again.make.restore_all(stored, 0.0))
    again.go()
    assert again.log == ["0 b ur3 grab", "1 b done", "1 a ur3 grab", "2 a done"]


def test_the_distance_is_to_the_place_that_the_task_names() -> None:
    """Its own place, given as it stands or computed, and at each further replacement; not where a robot failed."""
    world = World(DecisionMode.OPERATOR)
    world.values |= {"pioneer_1.x": 40.0, "pioneer_2.x": 1.0, "ridgeback.x": 45.0}
    text = "version: 1\nname: s\nparameters: {place: {default: dock}}\nsteps:\n"
    text += "  - {task: t, robot: ridgeback, skill: go, arguments: {to: =place}}\n"
    world.take(world.make.start("a", scenario_of(text), {}, by="anna", now=0))
    assert [place.robot for place in next(world.make.what_if("ridgeback")[1]).ranking.ranked] == [
        "pioneer_2",
        "pioneer_1",
    ]
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.5))

    def ranked() -> dict[str, float]:
        (decision,) = world.make.decisions.values()
        column = decision.ranking.weights.names.index("distance")
        return {place.robot: place.raw[column] for place in decision.ranking.ranked}

    assert ranked() == {"pioneer_2": 1.0, "pioneer_1": 40.0}
    world.take(world.make.confirm("a.0", "pioneer_2", "anna", 0.6)[1])
    world.take(world.make.fault_raised("pioneer_2", "robot", "stuck", 0.7))
    assert ranked() == {"pioneer_1": 40.0}


def test_where_nobody_knows_where_the_task_is_the_distance_does_not_count() -> None:
    """A robot that is silent does not say where it is; that must not leave nobody to take over."""
    world = World()
    del world.values["ridgeback.x"]
    world.take(world.make.fault_raised("ridgeback", "silent", "it is silent", 0.0))
    world.start("a", "  - {task: t, robot: ridgeback, skill: go}\n")
    world.go()
    assert world.log == ["30 a pioneer_1 go", "31 a done"]
    chosen = [change.event for change in world.decisions() if isinstance(change.event, ReplacementChosen)]
    assert "distance" not in chosen[0].ranking.weights.names


def test_robots_that_refuse_a_task_are_not_asked_again_and_there_is_an_end() -> None:
    world = World()
    world.outcome = {(robot, "go"): TaskOutcome.REFUSED for robot in FLEET.robots}
    world.start("a", "  - {task: t, robot: ridgeback, skill: go}\n")
    world.start("b", "  - {task: t, capacity: mobile, skill: go}\n")
    world.go()
    asked = [line.split()[1:3] for line in world.log if line.endswith(" go")]
    mobile = ["pioneer_1", "pioneer_2", "ridgeback"]
    assert sorted(asked) == [["a", robot] for robot in mobile] + [["b", robot] for robot in mobile]
    assert [line for line in world.log if "failed" in line] == [
        f"3 {run} failed task t: go on {last}: refused; no robot is left that can take over ({before})"
        for run, last, before in (
            ("a", "pioneer_2", "ridgeback: go on ridgeback: refused; pioneer_1: go on pioneer_1: refused"),
            ("b", "ridgeback", "pioneer_1: go on pioneer_1: refused; pioneer_2: go on pioneer_2: refused"),
        )
    ]
    last = [change.event for change in world.decisions() if isinstance(change.event, RankingChanged)][-1]
    reasons = {left.robot: left.reason for left in last.ranking.excluded}
    assert [reasons[robot] for robot in mobile] == ["has refused it"] * 3
    assert not world.make.faults.active("ridgeback"), "who refuses is not broken"


def test_a_robot_that_is_repaired_while_somebody_decides_may_have_its_task_back() -> None:
    world = World(DecisionMode.OPERATOR)
    world.start("a", "  - {task: t, robot: ur3, skill: grab}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.1))
    world.take(world.make.fault_raised("ur3", "robot", "stuck", 0.2))
    (decision,) = world.make.decisions.values()
    assert not decision.ranking.ranked
    world.take(world.make.fault_cleared("ur3", "robot", 0.3))
    world.take(world.make.poll(0.4))
    assert [place.robot for place in decision.ranking.ranked] == ["ur3"]
    world.take(world.make.confirm(decision.id, "ur3", "anna", 0.5)[1])
    world.go()
    assert world.log[-2:] == ["0 a ur3 grab", "1 a done"]
    assert not [change for change in world.decisions() if isinstance(change.event, Aborted)]


OTHERWISE = {("battery", "distance"): 1 / 9, ("battery", "availability"): 1 / 9, ("distance", "availability"): 1.0}


def deciding() -> tuple[World, str]:
    """An open decision, in which pioneer_2 has the battery and pioneer_1 is nearer."""
    world = World(DecisionMode.OPERATOR)
    world.values["pioneer_2.battery"] = 100.0
    world.start("a", "  - {task: t1, robot: ridgeback, skill: go}\n")
    world.take(world.make.fault_raised("ridgeback", "robot", "stuck", 0.0))
    ((decision_id, decision),) = world.make.decisions.items()
    assert decision.ranking.best == "pioneer_2"
    return world, decision_id


def test_a_preview_is_the_ranking_that_would_be_and_changes_nothing() -> None:
    world, decision_id = deciding()
    before, said = world.make.decisions[decision_id].ranking, len(world.said)
    assert world.make.preview(decision_id, None) == before
    previewed = world.make.preview(decision_id, OTHERWISE)
    assert previewed.best == "pioneer_1"
    assert (world.make.decisions[decision_id].ranking, world.make.poll(1.0)) == (before, [])
    assert len(world.said) == said
    with pytest.raises(JudgementsInvalid, match="consisten"):
        world.make.preview(decision_id, {**OTHERWISE, ("distance", "availability"): 9.0})
    with pytest.raises(ScenarioError, match="there is no decision 'b'"):
        world.make.preview("b", None)
    world.take(
        world.make.set_settings(ResilienceSettings(settings().criteria, OTHERWISE, mode=DecisionMode.OPERATOR), 3.0)
    )
    assert world.make.decisions[decision_id].ranking == previewed


def test_judgements_of_one_decision_rank_that_one_alone() -> None:
    world, decision_id = deciding()
    world.start("b", "  - {task: t1, robot: ridgeback, skill: go}\n")
    (other,) = world.make.decisions.keys() - {decision_id}
    world.take(world.make.judge(decision_id, OTHERWISE, 1.0))
    best = {one: decision.ranking.best for one, decision in world.make.decisions.items()}
    assert best == {decision_id: "pioneer_1", other: "pioneer_2"}
    world.values["pioneer_1.y"] = 0.1
    world.take(world.make.poll(2.0))
    assert world.make.decisions[decision_id].ranking.best == "pioneer_1", "also when values change"
    with pytest.raises(JudgementsInvalid):
        world.make.judge(decision_id, {("battery", "distance"): 2.0}, 3.0)
    world.take(world.make.judge(decision_id, None, 3.0))
    assert world.make.decisions[decision_id].ranking.best == "pioneer_2"


def test_who_is_chosen_at_the_limit_is_the_best_by_the_judgements_of_the_decision() -> None:
    world, decision_id = deciding()
    world.take(world.make.judge(decision_id, OTHERWISE, 1.0))
    world.go(60)
    assert "30 a pioneer_1 go" in world.log
