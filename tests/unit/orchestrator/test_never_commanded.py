"""Whatever becomes known in whatever order, and however often the server is started anew: no execution reaches a robot
with a fault that keeps it from that task; nobody begins a task that another may still be at unless somebody consents;
no robot is asked for something while it may be at something else; no robot is silent for what it says it is at; no run
meets a mistake of ours, or goes on for ever without a robot at work.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from ua_fleet.errors import UaFleetError
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator import (
    DecisionChanged,
    Fault,
    FaultChanged,
    FaultFound,
    Halt,
    HaltChanged,
    OperatorAsked,
    Orchestrator,
    Output,
    ResilienceSettings,
    RunBroken,
    TaskCancelled,
    TasksAhead,
    TaskStarted,
)
from ua_fleet.resilience import Criterion, CriterionKind, DecisionMode, OnLimit, RankingChanged, ReplacementChosen
from ua_fleet.scenario import FleetView, RobotView, Scenario, Value, ValueUnknown, scenario_of
from ua_fleet.scenario.consequences import NOT_HALTED
from ua_fleet.scenario.facts import Fact, RunEnded, TaskOutcome, TaskOver, decode_fact, encode_fact
from ua_fleet.scenario.state import TaskPhase

ROBOTS = ("r1", "r2", "r3")
SOURCES = ("announced", "robot", "battery_low", "silent")
SKILLS = {"go": SkillModel(1, "go", ("mobile",)), "grab": SkillModel(2, "grab", ("grab",))}
FLEET = FleetView({name: RobotView(name, frozenset({"mobile", "grab"}), SKILLS) for name in ROBOTS})
CRITERIA = ((Criterion("availability", CriterionKind.BENEFIT, (0, 100)), TasksAhead()),)
NAMED = "{{task: {name}, robot: {robot}, skill: {skill}, retries: {retries}, timeout_s: 40, on_unknown: {policy}}}"
ANY = "{{task: {name}, capacity: {capacity}, skill: {skill}, retries: {retries}, timeout_s: 40, on_unknown: {policy}}}"

robots = st.sampled_from(ROBOTS)
tasks = st.tuples(
    st.sampled_from((NAMED, ANY)),
    robots,
    st.sampled_from(tuple(SKILLS)),
    st.integers(0, 2),
    st.sampled_from(("ask", "retry", "fail", "replace")),
)
lost: st.SearchStrategy[tuple[str, ...]] = st.sampled_from(((), ("mobile",), ("grab",), ("mobile", "grab")))
news = st.lists(st.tuples(robots, st.sampled_from(SOURCES), st.booleans(), lost), min_size=1, max_size=4)


@dataclass
class Request:
    """One execution, as the world really has it."""

    run_id: str
    step: str
    robot: str
    skill: str
    state: str = "on its way"
    """Then `at work`, `over`, or `withdrawn`: its bridge is asked on, and will never let it begin."""


class Fleet(RuleBasedStateMachine):
    """An orchestrator between people, time, and robots that do what they are told, or nothing."""

    @initialize(mode=st.sampled_from(DecisionMode), on_limit=st.sampled_from((OnLimit.BEST_IF_KNOWN, OnLimit.ABORT)))
    def begin(self, mode: DecisionMode, on_limit: OnLimit) -> None:
        self.settings = ResilienceSettings(CRITERIA, {}, mode=mode, limit_s=20, on_limit=on_limit)
        self.now = 0.0
        self.texts: dict[str, str] = {}
        self.journal: dict[str, list[str]] = {}
        self.faults: dict[str, Fault] = {}
        self.halts: dict[str, Halt] = {}
        self.requests: dict[str, Request] = {}
        self.consented: set[tuple[str, str]] = set()
        self.unknown: dict[str, DecisionChanged] = {}
        self.questions: set[str] = set()
        self.unsure: set[str] = set()
        """Executions of which their bridges cannot tell."""
        self.said: dict[str, frozenset[str]] = {}
        """What robots say they are at, whose SkillStatus is heard, though their values may be lost."""
        self.make = self._orchestrator()

    def _orchestrator(self) -> Orchestrator:
        return Orchestrator(self.settings, FLEET, self._lookup, self._write)

    def _lookup(self, name: str) -> Value:
        raise ValueUnknown(f"{name} is not known")

    def _write(self, run_id: str, fact: Fact) -> None:
        if isinstance(fact, TaskOver) and ("nothing is heard" in fact.message or "is silent" in fact.message):
            over = self.make.runs[run_id].state.tasks[fact.step]
            assert over.execution_id not in self.said.get(over.robot, ()), "it says that it is at it"
        self.journal.setdefault(run_id, []).append(encode_fact(fact))

    # What is carried out.

    def take(self, outputs: list[Output]) -> None:
        for output in outputs:
            if isinstance(output, FaultChanged):
                self.faults[output.fault.id] = output.fault
            elif isinstance(output, HaltChanged):
                self.halts.pop(output.halt.execution_id, None)
                if output.is_owed:
                    self.halts[output.halt.execution_id] = output.halt
            elif isinstance(output, TaskStarted):
                self._ask(output)
            elif isinstance(output, TaskCancelled):
                self._withdraw(output.execution_id)
            elif isinstance(output, OperatorAsked):
                self.questions.add(f"{output.run_id}.{output.step}")
            elif isinstance(output, DecisionChanged):
                self._decided(output)
            elif isinstance(output, RunBroken):
                raise output.error

    def _decided(self, changed: DecisionChanged) -> None:
        decision_id = changed.event.decision_id
        if isinstance(changed.event, RankingChanged):
            if "may still be at it" in changed.reason:
                self.unknown[decision_id] = changed
        else:
            asked = self.unknown.pop(decision_id, None)
            if asked is not None and isinstance(changed.event, ReplacementChosen):
                assert changed.event.by == "anna", "time alone consents to nothing that is not written"
                self.consented.add((changed.run_id, changed.step))

    def _is_kept(self, robot: str, skill: str) -> bool:
        """Whether a fault keeps a robot from a skill, by what was told of faults alone."""
        faults = [fault for fault in self.faults.values() if fault.robot == robot and fault.source != "silent"]
        needs = set(SKILLS[skill].capacities)
        return any(fault.active and (not fault.capacities or needs & set(fault.capacities)) for fault in faults)

    def _ask(self, task: TaskStarted) -> None:
        assert not self._is_kept(task.robot, task.skill), "a robot with a fault is asked"
        if task.execution_id in self.requests:
            return  # said again after a restart: the same request
        place = task.run_id, task.step
        beside = [
            one
            for one in self.requests.values()
            if (one.run_id, one.step) == place and one.state in ("on its way", "at work")
        ]
        is_written = "on_unknown: replace" in self.texts[task.run_id]
        assert not beside or place in self.consented or is_written, "nobody has consented to a second one"
        at_work = [one for _, one in self._in("at work") if one.robot == task.robot]
        assert not at_work, "it may be moving for another task"
        self.requests[task.execution_id] = Request(*place, task.robot, task.skill)

    def _withdraw(self, execution_id: str) -> None:
        request = self.requests.get(execution_id)
        if request is not None and request.state == "on its way":
            request.state = "withdrawn"

    def _in(self, *states: str) -> list[tuple[str, Request]]:
        return [(key, request) for key, request in self.requests.items() if request.state in states]

    # What happens.

    @rule(written=st.lists(tasks, min_size=1, max_size=3), is_parallel=st.booleans())
    def start(self, written: list[tuple[str, str, str, int, str]], *, is_parallel: bool) -> None:
        if len(self.texts) >= 4:
            return
        run_id = f"run{len(self.texts)}"
        steps = [
            form.format(
                name=f"t{number}",
                robot=robot,
                skill=skill,
                capacity=SKILLS[skill].capacities[0],
                retries=retries,
                policy=policy,
            )
            for number, (form, robot, skill, retries, policy) in enumerate(written)
        ]
        if is_parallel and len(steps) > 1:
            body = "  - parallel:\n" + "".join(f"      - {step}\n" for step in steps)
        else:
            body = "".join(f"  - {step}\n" for step in steps)
        self.texts[run_id] = f"version: 1\nname: s\nsteps:\n{body}"
        self.take(self.make.start(run_id, scenario_of(self.texts[run_id]), {}, by="anna", now=self.now))

    @rule(told=news)
    def become_known(self, told: list[tuple[str, str, bool, tuple[str, ...]]]) -> None:
        for robot, source, active, capacities in told:
            if source == "announced" and active:  # who says that it has a fault stands
                for _, request in self._in("at work"):
                    if request.robot == robot and (
                        not capacities or set(SKILLS[request.skill].capacities) & set(capacities)
                    ):
                        request.state = "over"
        found = [
            FaultFound(robot, source, active, f"{source} it is {lost}", () if source == "silent" else lost)
            for robot, source, active, lost in told
        ]
        self.take(self.make.told(found, self.now))

    @rule(data=st.data())
    def reach_a_robot(self, data: st.DataObject) -> None:
        waiting = self._in("on its way")
        if not waiting:
            return
        execution_id, request = data.draw(st.sampled_from(waiting))
        if self.make.is_silent(request.robot):
            return
        assert not self._is_kept(request.robot, request.skill), "a robot with a fault is told"
        request.state = "at work"
        self.take(self.make.accepted(execution_id, self.now))

    def _say(self, robot: str) -> None:
        at_work = [key for key, one in self._in("at work") if one.robot == robot and key not in self.unsure]
        self.said[robot] = frozenset(at_work)
        self.take(self.make.followed(robot, self.said[robot], self.now))

    @rule(robot=robots)
    def say_what_it_is_at(self, robot: str) -> None:
        self._say(robot)

    @rule(data=st.data())
    def lose_the_values_of_a_robot_at_work(self, data: st.DataObject) -> None:
        at_work = self._in("at work")
        if at_work:
            _, request = data.draw(st.sampled_from(at_work))
            self._say(request.robot)
            self.take(self.make.told([FaultFound(request.robot, "silent", True, "its values are lost")], self.now))

    @rule(robot=robots)
    def lose_what_it_says(self, robot: str) -> None:
        self.said.pop(robot, None)
        self.take(self.make.followed(robot, frozenset(), self.now))

    def _is_heard(self, robot: str) -> bool:
        return robot in self.said or not self.make.is_silent(robot)

    @rule(data=st.data())
    def answer_for_what_was_withdrawn(self, data: st.DataObject) -> None:
        waiting = self._in("withdrawn")
        if not waiting:
            return
        execution_id, request = data.draw(st.sampled_from(waiting))
        if self.make.is_silent(request.robot):
            return
        request.state = "over"
        self.take(self.make.ended(execution_id, TaskOutcome.TIMED_OUT, self.now, message="never begun"))

    @rule(
        data=st.data(),
        outcome=st.sampled_from((TaskOutcome.DONE, TaskOutcome.FAILED, TaskOutcome.STOPPED, TaskOutcome.UNKNOWN)),
    )
    def end(self, data: st.DataObject, outcome: TaskOutcome) -> None:
        waiting = self._in("at work")
        if not waiting:
            return
        execution_id, request = data.draw(st.sampled_from(waiting))
        if not self._is_heard(request.robot):
            return
        if outcome is not TaskOutcome.UNKNOWN:
            request.state = "over"
        else:
            self.unsure.add(execution_id)  # its SkillStatus says so from now on
        if request.robot in self.said:
            self._say(request.robot)
        self.take(self.make.ended(execution_id, outcome, self.now))

    @rule(seconds=st.sampled_from((0.5, 6.0, 15.0, 31.0, 60.0)))
    def pass_time(self, seconds: float) -> None:
        end = self.now + seconds
        while (due := self.make.next_deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            self.take(self.make.poll(self.now))
        self.now = end
        self.take(self.make.poll(self.now))

    @rule(data=st.data())
    def confirm(self, data: st.DataObject) -> None:
        decisions = sorted(self.make.decisions)
        if decisions:
            decision_id, robot = data.draw(st.sampled_from(decisions)), data.draw(robots)
            try:
                _, outputs = self.make.confirm(decision_id, robot, "anna", self.now)
            except UaFleetError:
                return
            self.take(outputs)

    @rule(data=st.data())
    def abort(self, data: st.DataObject) -> None:
        if self.make.runs:
            self.take(self.make.abort(data.draw(st.sampled_from(sorted(self.make.runs))), "enough", "anna", self.now))

    @rule(robot=robots)
    def say_that_it_stands(self, robot: str) -> None:
        """A person has looked at a robot that did not stop."""
        if any(fault.source == NOT_HALTED for fault in self.make.faults.active(robot)):
            self._now_stands(lambda one: one.robot == robot)
            self.take(self.make.fault_cleared(robot, NOT_HALTED, self.now))

    def _now_stands(self, which: Callable[[Request], bool]) -> None:
        for request in self.requests.values():
            if request.state in ("on its way", "at work") and which(request):
                request.state = "over"

    @rule(data=st.data(), answer=st.sampled_from(("done", "fail", "retry")))
    def answer(self, data: st.DataObject, answer: str) -> None:
        if self.questions:
            question = data.draw(st.sampled_from(sorted(self.questions)))
            self.questions.discard(question)
            run_id, _, step = question.partition(".")
            try:
                outputs = self.make.answer(run_id, step, answer, "anna", self.now)
            except UaFleetError:
                return
            self._now_stands(lambda one: (one.run_id, one.step) == (run_id, step))  # who answers has looked
            self.take(outputs)

    @rule()
    def restart(self) -> None:
        """Everything that was written down is there again, and nothing is heard of anybody yet."""
        self.make = self._orchestrator()
        self.said.clear()
        self.unknown.clear()
        for fault in list(self.faults.values()):
            self.take(self.make.fault_raised(fault.robot, fault.source, fault.reason, fault.since, fault.capacities))
            if not fault.active:
                self.take(self.make.fault_cleared(fault.robot, fault.source, self.now))
        self.take(self.make.not_heard(ROBOTS, self.now))
        stored: list[tuple[str, Scenario, list[Fact]]] = []
        for run_id, lines in self.journal.items():
            facts = [decode_fact(line) for line in lines]
            if not any(isinstance(fact, RunEnded) for fact in facts):
                stored.append((run_id, scenario_of(self.texts[run_id]), facts))
        self.take(self.make.restore_all(stored, self.now, list(self.halts.values())))
        for execution_id in self.make.must_not_begin():
            self._withdraw(execution_id)

    @rule()
    def hear_all(self) -> None:
        self.take(self.make.told([FaultFound(robot, "silent", False, "") for robot in ROBOTS], self.now))

    def teardown(self) -> None:
        """Nothing more is said, and nobody answers: limits end every run."""
        if not hasattr(self, "make"):
            return
        for _ in range(100):
            for execution_id, request in self._in("on its way"):
                request.state = "at work"  # nobody knows; the requestor says so in time
                self.take(self.make.ended(execution_id, TaskOutcome.UNKNOWN, self.now, message="no answer came"))
            if not self.make.runs:
                return
            self.pass_time(100.0)
        raise AssertionError("a run goes on for ever")

    @invariant()
    def nothing_is_on_its_way_to_a_robot_with_a_fault(self) -> None:
        for _, request in self._in("on its way"):
            assert not self._is_kept(request.robot, request.skill)


Fleet.TestCase.settings = settings(
    max_examples=150, stateful_step_count=50, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
test_a_fleet_of_three_robots = Fleet.TestCase


def test_a_lost_robot_that_says_that_it_is_at_its_task_is_not_given_up() -> None:
    """Nothing was heard of it for 30 s; its SkillStatus comes back before its values do."""
    fleet = Fleet()
    fleet.begin(mode=DecisionMode.OPERATOR, on_limit=OnLimit.BEST_IF_KNOWN)
    text = "{{task: {name}, robot: {robot}, skill: {skill}, retries: {retries}, on_unknown: {policy}}}"
    fleet.start([(text, "r2", "go", 0, "retry")], is_parallel=False)
    (execution_id,) = fleet.requests
    fleet.requests[execution_id].state = "at work"
    fleet.take(fleet.make.accepted(execution_id, fleet.now))
    fleet.take(fleet.make.told([FaultFound("r2", "silent", True, "its values are lost")], fleet.now))
    fleet.pass_time(31.0)
    state = fleet.make.runs["run0"].state
    assert state.phase("0") is TaskPhase.LOST
    fleet.say_what_it_is_at("r2")
    fleet.pass_time(60.0)
    assert state.in_phase(TaskPhase.ACCEPTED)
    assert fleet.questions == set()
    fleet.take(fleet.make.ended(execution_id, TaskOutcome.DONE, fleet.now))
    assert fleet.make.runs == {}
