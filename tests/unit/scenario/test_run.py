"""Runs: what robots are asked in which order, and how faults, time and people change it."""

from __future__ import annotations

import pytest

from tests.unit.scenario.owner import Owner, Skill
from ua_fleet.errors import ScenarioError
from ua_fleet.scenario.effects import Effect, Happened, WantRobot
from ua_fleet.scenario.facts import (
    Replaced,
    RobotReturned,
    RunOutcome,
    StepEnded,
    StepState,
    TaskOutcome,
    TaskOver,
)

NOBODY_KNOWS = "task a: pick on ned: unknown; it is unknown whether it is done, so no other robot may begin it"
BEFORE = "r1: pick on r1: failed; r2: pick on r2: failed"
HEAD = "version: 1\nname: s\nsteps:\n"


def owner(steps: str, **given: object) -> Owner:
    return Owner(HEAD + steps)


def test_tasks_in_sequence() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n  - {task: b, robot: ned, skill: place}\n")
    world.go()
    assert world.log == ["0 ned pick", "1 ned place", "2 done"]


def test_tasks_side_by_side() -> None:
    world = owner(
        "  - parallel:\n"
        "      - {task: a, robot: ned, skill: pick}\n"
        "      - - {task: b, robot: drone, skill: up}\n"
        "        - {task: c, robot: drone, skill: down}\n"
        "  - {task: d, robot: ned, skill: place}\n"
    )
    world.go()
    assert world.log == ["0 ned pick", "0 drone up", "1 drone down", "2 ned place", "3 done"]


def test_after_waits_for_a_task_of_another_branch() -> None:
    world = owner(
        "  - parallel:\n"
        "      - {task: a, robot: ned, skill: pick, after: [b]}\n"
        "      - {task: b, robot: drone, skill: up}\n"
    )
    world.go()
    assert world.log == ["0 drone up", "1 ned pick", "2 done"]


@pytest.mark.parametrize(("temperature", "angle"), [(21, 20), (20, -20), (-3, -20)])
def test_a_condition_on_a_value(temperature: float, angle: int) -> None:
    world = owner(
        "  - if: temperature > 20\n"
        "    then: {task: a, robot: ur3, skill: turn, arguments: {angle: 20}}\n"
        "    else: {task: b, robot: ur3, skill: turn, arguments: {angle: -20}}\n"
    )
    world.values["temperature"] = temperature
    world.go()
    assert world.log == [f"0 ur3 turn(angle={angle})", "1 done"]


def test_a_condition_on_a_result_and_a_parameter() -> None:
    world = Owner(
        "version: 1\nname: s\nparameters: {limit: {default: 5, range: [0, 9]}}\nsteps:\n"
        "  - {task: weigh, robot: scale, skill: weigh}\n"
        "  - if: weigh.kg > limit\n"
        "    then: {task: heavy, robot: ned, skill: pick, arguments: {force: =weigh.kg * 2}}\n",
        {"limit": 3},
    )
    world.skills["scale", "weigh"] = Skill(results={"kg": 4.0})
    world.go()
    assert world.log == ["0 scale weigh", "1 ned pick(force=8.0)", "2 done"]


def test_a_value_that_is_not_known_is_waited_for() -> None:
    steps = "  - {if: temperature > 20, then: {task: a, robot: ned, skill: pick}, timeout_s: 5}\n"
    world = owner(steps)
    world.at(3, lambda: world.values.update(temperature=30) or [])
    world.go()
    assert world.log == ["3 ned pick", "4 done"]
    world = owner(steps)
    world.go()
    assert world.log == ["5 failed 'temperature > 20' cannot be decided: temperature is not known"]


def test_repetitions() -> None:
    world = owner("  - {repeat: {task: a, robot: ned, skill: pick}, times: 3}\n")
    world.go()
    assert world.log == ["0 ned pick", "1 ned pick", "2 ned pick", "3 done"]


def test_repetition_while_a_condition_holds() -> None:
    world = owner("  - {repeat: {task: a, robot: ned, skill: pick}, while: box.full == false}\n")
    world.values["box.full"] = False
    world.at(1.5, lambda: world.values.update({"box.full": True}) or [])
    world.go()
    assert world.log == ["0 ned pick", "1 ned pick", "2 done"]


def test_repetitions_within_repetitions() -> None:
    world = owner(
        "  - repeat:\n"
        "      - {repeat: {task: a, robot: ned, skill: pick}, times: 2}\n"
        "      - {task: b, robot: ned, skill: place}\n"
        "    times: 2\n"
    )
    world.go()
    assert [line.split()[2] for line in world.log[:-1]] == ["pick", "pick", "place"] * 2


def test_waiting() -> None:
    world = owner(
        "  - wait: 2\n"
        "  - {wait: , until: gate.open}\n"
        "  - {wait: , event: BoxArrived}\n"
        "  - {wait: , event: Never, timeout_s: 3, on_timeout: continue}\n"
        "  - {wait: , until: gate.open == false, timeout_s: 4}\n"
    )
    world.at(1, lambda: world.run.event("BoxArrived", 1))  # too early: nobody waits for it
    world.at(5, lambda: world.values.update({"gate.open": True}) or [])
    world.at(7, lambda: world.run.event("BoxArrived", 7))
    world.go()
    assert world.log == ["14 failed 'gate.open == false' did not come in 4 s"]
    ends = {fact.step: fact.at for fact in world.facts(StepEnded) if isinstance(fact, StepEnded)}
    assert [ends[str(number)] for number in range(5)] == [2, 5, 7, 10, 14]


def test_an_end_step_ends_the_run_and_halts_what_is_under_way() -> None:
    world = owner(
        "  - parallel:\n"
        "      - {task: a, robot: ned, skill: pick}\n"
        "      - - wait: 0.5\n"
        "        - {end: failed, reason: no boxes}\n"
    )
    world.skills["ned", "pick"] = Skill(takes_s=100)
    world.go()
    assert world.log == ["0 ned pick", "0.5 ned halted", "1 failed no boxes"]


def test_retries_then_a_replacement() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick, retries: 2}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.FAILED)
    world.stand_in = lambda decision: "ur3"
    world.go()
    assert world.log == ["0 ned pick", "1 ned pick", "2 ned pick", "3 ur3 pick", "4 done"]
    (decision,) = world.decisions
    assert (decision.robot, decision.task, decision.reason) == ("ned", "a", "pick on ned: failed")


def test_replacements_may_fail_again_and_again_until_none_is_left() -> None:
    world = owner("  - {task: a, robot: r1, skill: pick}\n")
    for robot in ("r1", "r2", "r3"):
        world.skills[robot, "pick"] = Skill(outcome=TaskOutcome.FAILED)
    world.stand_in = lambda decision: {"r1": "r2", "r2": "r3"}.get(decision.robot)
    world.go()
    assert world.log == [
        "0 r1 pick",
        "1 r2 pick",
        "2 r3 pick",
        f"3 failed task a: pick on r3: failed; no robot is left that can take over ({BEFORE})",
    ]


def test_a_stand_in_keeps_later_tasks_until_the_robot_is_back() -> None:
    world = owner("".join(f"  - {{task: t{n}, robot: ridgeback, skill: go}}\n" for n in range(4)))
    world.stand_in = lambda decision: "pioneer"
    world.at(1.5, lambda: world.fault("ridgeback", "motor is hot"))
    world.at(3, lambda: world.repaired("ridgeback"))
    world.go()
    assert world.log == [
        *("0 ridgeback go", "1 ridgeback go", "1.5 ridgeback halted", "2 pioneer go"),
        *("3 ridgeback go", "4 ridgeback go", "5 done"),
    ]
    assert len(world.decisions) == 1
    assert len(world.facts(Replaced)) == len(world.facts(RobotReturned)) == 1


def test_a_robot_that_is_back_is_not_asked_for_what_it_has_refused() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.REFUSED)
    world.go(1)
    world.tell(world.fault("ned", "hot"))
    effects = world.run.replaced(world.decisions[0].step, "ur3", "anna", 1)
    assert [effect.robot for effect in effects if isinstance(effect, WantRobot)] == ["ur3"]
    world.now = 2
    effects = world.repaired("ned")  # while the task waits for ur3
    assert [type(effect) for effect in effects] == [Happened]
    world.restart()
    world.go()
    assert world.log == ["2 ur3 pick", "3 done"]


def test_a_robot_that_is_broken_before_its_task_is_replaced_at_once() -> None:
    world = owner("  - wait: 1\n  - {task: a, robot: ned, skill: pick}\n")
    world.stand_in = lambda decision: "ur3"
    world.at(0.5, lambda: world.fault("ned", "emergency stop"))
    world.go()
    assert world.log == ["1 ur3 pick", "2 done"]
    assert world.decisions[0].reason == "emergency stop"


def test_an_operator_decides_later() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.REFUSED)
    world.go(50)
    (decision,) = world.decisions
    world.now = 60
    world.tell(world.run.replaced(decision.step, "ur3", "anna", 60))
    world.tell(world.run.replaced(decision.step, "drone", "bert", 60))  # the first has decided
    world.go()
    assert world.log == ["60 ur3 pick", "61 done"]


def test_a_robot_that_is_at_something_else_is_asked_again() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n")
    busy, free = Skill(outcome=TaskOutcome.BUSY), Skill()
    world.skills["ned", "pick"] = busy

    def done() -> list[Effect]:
        world.skills["ned", "pick"] = free
        return []

    world.at(3.2, done)
    world.go()
    assert world.log == ["3.5 ned pick", "4.5 done"]
    assert not world.decisions


def test_a_robot_that_stays_at_something_else_has_refused_and_no_retry_is_lost_to_that() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick, retries: 1}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.BUSY)
    world.restart()
    world.stand_in = lambda decision: "ur3"
    world.go()
    assert world.log == ["10 ur3 pick", "11 done"]
    (decision,) = world.decisions
    assert decision.robot == "ned"
    (task_run,) = world.run.state.tasks.values()
    assert task_run.excluded == {"ned": "was at something else"}


def test_each_robot_that_is_at_something_else_is_asked_again_for_its_own_while() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n")
    busy, free = Skill(outcome=TaskOutcome.BUSY), Skill()
    world.skills["ned", "pick"] = world.skills["ur3", "pick"] = busy
    world.stand_in = lambda decision: "ur3" if decision.robot == "ned" else None

    def done() -> list[Effect]:
        world.skills["ur3", "pick"] = free
        return []

    world.at(12.2, done)
    world.go()
    assert world.log == ["12.5 ur3 pick", "13.5 done"]


def test_a_task_for_whoever_has_the_capacity() -> None:
    world = owner("  - {task: a, capacities: [fly, camera], skill: look}\n")
    world.any_robot["fly camera"] = "drone"
    world.go()
    assert world.log == ["0 drone look", "1 done"]


def test_without_any_robot_a_replacement_is_asked_for() -> None:
    world = owner("  - {task: a, capacity: fly, skill: look}\n")
    world.stand_in = lambda decision: None
    world.go()
    assert world.log == ["0 failed task a was not begun: no robot has fly; no robot is left that can take over"]
    assert world.decisions[0].reason == "no robot has fly"


def test_a_task_that_takes_too_long_is_halted_and_tried_again() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick, timeout_s: 3, retries: 1}\n")
    world.skills["ned", "pick"] = Skill(takes_s=100)
    world.stand_in = lambda decision: None
    world.go()
    assert world.log == [
        *("0 ned pick", "3 ned halted", "3.5 ned pick", "6.5 ned halted"),
        "7 failed task a: ned: not done in 3 s; it was halted: failed; no robot is left that can take over",
    ]
    over = [fact.outcome for fact in world.facts(TaskOver) if isinstance(fact, TaskOver)]
    assert over == [TaskOutcome.TIMED_OUT, TaskOutcome.TIMED_OUT]


def test_that_it_was_halted_is_said_once() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick, timeout_s: 3}\n")
    world.skills["ned", "pick"] = Skill(takes_s=100)
    world.says = "it was halted (BadRequestCancelledByClient)"
    world.stand_in = lambda decision: None
    world.go()
    why = "not done in 3 s; it was halted (BadRequestCancelledByClient); no robot is left that can take over"
    assert world.log[-1] == f"3.5 failed task a: ned: {why}"


@pytest.mark.parametrize(
    ("answer", "log"),
    [
        ("done", ["0 ned pick", "10 ned halted", "10 done"]),
        ("retry", ["0 ned pick", "10 ned halted", "10 ned pick", "11 done"]),
        ("replace", ["0 ned pick", "10 ned halted", "10 ur3 pick", "11 done"]),
        ("fail", ["0 ned pick", "10 ned halted", "10 failed pick on ned: unknown"]),
    ],
)
def test_an_unknown_end_is_asked_about(answer: str, log: list[str]) -> None:
    world = owner("  - {task: a, robot: ned, skill: pick, retries: 5}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.UNKNOWN)
    world.stand_in = lambda decision: "ur3"
    world.go(5)
    (question,) = world.questions
    assert question.question == (
        "was a (pick on ned) done? pick on ned: unknown; ned may still be at it, "
        "and a second robot would do it beside it, or twice"
    )
    world.skills["ned", "pick"] = Skill()
    world.now = 10
    with pytest.raises(ScenarioError, match="known answers: done, retry, fail, replace"):
        world.run.answered(question.step, "perhaps", "anna", 10)
    world.tell(world.run.answered(question.step, answer, "anna", 10))
    with pytest.raises(ScenarioError, match="asks no question"):
        world.run.answered(question.step, answer, "bert", 10)
    world.go()
    assert world.log == log


@pytest.mark.parametrize(
    ("on_unknown", "log"),
    [
        ("retry", []),  # it may be at it: somebody is asked
        ("fail", ["1 ned halted", f"1 failed {NOBODY_KNOWS}"]),
        ("replace", ["1 ned halted", "1 ur3 pick", "2 done"]),
    ],
)
def test_an_unknown_end_by_configuration(on_unknown: str, log: list[str]) -> None:
    world = owner(f"  - {{task: a, robot: ned, skill: pick, on_unknown: {on_unknown}}}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.UNKNOWN)
    world.stand_in = lambda decision: "ur3"
    world.at(0.5, lambda: world.skills.update({("ned", "pick"): Skill()}) or [])
    world.go()
    assert world.log == ["0 ned pick", *log]


def test_a_pause_lets_robots_finish_and_starts_nothing() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n  - {task: b, robot: ned, skill: place}\n")
    world.at(0.5, lambda: world.run.pause("anna", 0.5))
    world.at(8, lambda: world.run.resume("anna", 8))
    world.go()
    assert world.log == ["0 ned pick", "8 ned place", "9 done"]


def test_an_abort_halts_robots_and_ends_when_they_have_stopped() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n  - {task: b, robot: ned, skill: place}\n")
    world.skills["ned", "pick"] = Skill(takes_s=100)
    world.at(2, lambda: world.run.abort("lunch", "anna", 2))
    world.go()
    assert world.log == ["0 ned pick", "2 ned halted", "2.5 aborted lunch"]
    assert world.run.state.outcome is RunOutcome.ABORTED


def test_a_robot_that_does_not_say_that_it_stopped_does_not_hold_the_end_up_for_ever() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n")
    world.skills["ned", "pick"] = Skill(takes_s=100)
    world.go(1)
    effects = world.run.abort("lunch", "anna", 1)
    assert world.run.next_deadline() == 11
    assert world.run.poll(world.lookup, 11) != []
    assert effects
    assert world.run.state.reason == "lunch; ned did not confirm that it has stopped"


def test_ends_that_come_twice_late_or_for_another_execution_change_nothing() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n  - {task: b, robot: ned, skill: place}\n")
    world.go(0.5)
    (execution_id,) = world.run.state.executions
    assert world.run.ended("ff" * 16, TaskOutcome.FAILED, 0.6) == []
    assert world.run.accepted("ff" * 16, 0.6) == []
    world.tell(world.run.ended(execution_id, TaskOutcome.DONE, 0.7))
    before = len(world.journal)
    assert world.run.ended(execution_id, TaskOutcome.FAILED, 0.8) == []
    assert world.run.accepted(execution_id, 0.8) == []
    assert len(world.journal) == before
    assert world.run.state.ended["0"] is StepState.DONE


def test_nothing_changes_a_run_that_has_ended() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n")
    world.go()
    before = len(world.journal)
    for effects in (
        world.run.abort("x", "anna", 9),
        world.run.pause("anna", 9),
        world.fault("ned", "x"),
        world.run.event("E", 9),
        world.run.again(world.lookup, 9),
        world.run.poll(world.lookup, 9),
    ):
        assert effects == []
    assert len(world.journal) == before
    assert world.run.next_deadline() is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "'speed' is missing"),
        ({"speed": 2, "x": 1}, "no parameter 'x'"),
        ({"speed": 2, "angle": 91}, "'angle' is 91; legal is -90 to 90"),
        ({"speed": 2, "angle": "much"}, "of another kind"),
        ({"speed": 2, "angle": True}, "'angle' is True, and its default 0 is of another kind"),
        ({"speed": 2, "force": True}, "'force' is True; legal is 0 to 9"),
        ({"speed": 2, "gently": 1}, "'gently' is 1, and its default False is of another kind"),
    ],
)
def test_parameters_are_checked(given: dict[str, int | str], said: str) -> None:
    text = (
        "version: 1\nname: s\nparameters:\n"
        "  {angle: {default: 0, range: [-90, 90]}, force: {range: [0, 9]}, gently: false, speed: }\n"
        "steps: {task: a, robot: r, skill: k}\n"
    )
    with pytest.raises(ScenarioError, match=said):
        Owner(text, given)


def test_a_task_whose_argument_has_no_value_fails_with_the_reason() -> None:
    world = owner("  - {task: a, robot: ned, skill: pick, arguments: {x: =nowhere.there + 1}}\n")
    world.go()
    assert world.log == ["0 a waits: nowhere.there is not known", "10 failed task a: nowhere.there is not known"]


@pytest.mark.parametrize(
    ("outcome", "log"),
    [
        (TaskOutcome.DONE, ["0 ned pick", "10 done"]),
        (TaskOutcome.FAILED, ["0 ned pick", "10 ur3 pick", "11 done"]),
        (TaskOutcome.REFUSED, ["0 ned pick", "10 ur3 pick", "11 done"]),
    ],
)
@pytest.mark.parametrize("killed", [False, True])
def test_a_robot_that_can_tell_later_answers_the_question(
    outcome: TaskOutcome, log: list[str], *, killed: bool
) -> None:
    world = owner("  - {task: a, robot: ned, skill: pick}\n  - {if: a.weight > 1, then: [{wait: 0.1}]}\n")
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.UNKNOWN)
    world.skills["ur3", "pick"] = Skill(results={"weight": 0.5})
    world.stand_in = lambda decision: "ur3"
    world.go(5)
    if killed:
        world.restart()
    question = world.questions[-1]
    assert (question.skill, len(question.execution_id)) == ("pick", 32)
    world.now = 10
    assert not world.run.ended(question.execution_id, TaskOutcome.UNKNOWN, 10)
    world.tell(world.run.ended(question.execution_id, outcome, 10, results={"weight": 0.5}))
    over = [fact for fact in world.facts(TaskOver) if isinstance(fact, TaskOver)]
    assert over[1].message == f"ned reported late: {outcome.value}; the question is closed"
    with pytest.raises(ScenarioError, match="asks no question"):
        world.run.answered(question.step, "retry", "anna", 10)
    world.go()
    assert world.log == log


def test_a_run_that_repeats_for_long_stays_small() -> None:
    """What is within a past iteration is forgotten, but for the last tasks; a restart goes on where it was."""
    world = owner(
        "  - {repeat: [{task: a, robot: ned, skill: pick}, {wait: 1}, {if: 1 > 0, then: [{wait: 1}]}], times: 1100}\n"
    )
    world.go(2500)
    state = world.run.state
    assert len(state.started) < 1100
    assert len(state.tasks) <= 1001
    before = state.iterations
    world.restart()
    assert world.run.state.iterations == before
    assert len(world.run.state.started) < 1100
    world.go(9000)
    assert world.log[-1].endswith(" done")
    assert len(world.done_by) == 1100


def test_what_is_over_in_one_repetition_stays_while_another_turns() -> None:
    steps = """
  - parallel:
      - [{repeat: [{task: a, robot: ned, skill: pick}], times: 1200}]
      - [{repeat: [{task: b, robot: ur3, skill: pick}, {wait: 2000}], times: 2}]
"""
    world = owner(steps)
    world.go(9000)
    assert world.begun["b"] == 2
    assert world.begun["a"] == 1200
