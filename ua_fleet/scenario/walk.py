"""How a run goes through its steps: everything but tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ua_fleet.scenario.effects import Effect
from ua_fleet.scenario.expression import Expression, Lookup, ValueUnknown
from ua_fleet.scenario.facts import (
    BranchTaken,
    Fact,
    IterationStarted,
    RunClosing,
    RunOutcome,
    StepEnded,
    StepStarted,
    StepState,
)
from ua_fleet.scenario.model import (
    BranchPoint,
    Condition,
    End,
    EndOutcome,
    OnTimeout,
    Parallel,
    Repeat,
    Sequence,
    Step,
    Task,
    Wait,
)
from ua_fleet.scenario.state import RunState

__all__ = ["StepWalk", "WalkState"]

_Result = tuple[StepState | None, str]
"""How a step has ended, or None while it has not, and why."""
_GOING_ON: _Result = (None, "")
_DONE: _Result = (StepState.DONE, "")


@dataclass(slots=True)
class WalkState:
    """What one call of a run knows and collects."""

    now: float
    lookup: Lookup
    effects: list[Effect] = field(default_factory=list[Effect])
    deadlines: list[float] = field(default_factory=list[float])


class StepWalk:
    """Takes steps as far as they go now. A step within repetitions has their numbers at the end of its key."""

    def __init__(
        self,
        state: RunState,
        note: Callable[[Fact, WalkState], None],
        close: Callable[[RunClosing, WalkState], None],
        task: Callable[[Task, str, WalkState], StepState | None],
    ) -> None:
        """Make a walk.

        Args:
            state: of the run.
            note: journals and applies a fact.
            close: begins to end the run.
            task: takes a task, by its key, as far as it goes.
        """
        self._state, self._note, self._close, self._task = state, note, close, task

    def go(self, step: Step, moment: WalkState, scope: str = "") -> StepState | None:
        """Take a step as far as it goes; how it has ended, or None while it has not."""
        key = step.key + scope
        ended = self._state.ended.get(key)
        if ended is not None or self._state.closing is not None:
            return ended
        if isinstance(step, BranchPoint):
            return self._branch_point(step, key, moment)
        if key not in self._state.started:
            self._note(StepStarted(moment.now, key), moment)
        result, reason = self._take(step, key, scope, moment)
        if result is not None and key not in self._state.ended:
            self._note(StepEnded(moment.now, key, result, reason), moment)
        return result

    def _branch_point(self, step: BranchPoint, key: str, moment: WalkState) -> StepState | None:
        """Decide, and leave what follows to others: the step itself ends here only where nothing of it follows."""
        state, number = self._state, step.round
        if key in state.branches or (step.is_loop and state.iterations.get(key, -1) >= number):
            return StepState.DONE
        if not number and key not in state.started:
            self._note(StepStarted(moment.now, key), moment)
        decided: bool | str | None = step.times is None or number < step.times
        if decided is True and step.condition is not None:
            known_as = f"{key}@{number - 1}" if step.is_loop else key
            decided = self._decide(step.condition, known_as, step.timeout_s, moment)
        if decided is None:
            return None
        if isinstance(decided, str):
            self._note(StepEnded(moment.now, key, StepState.FAILED, decided), moment)
        elif not step.is_loop:
            self._note(BranchTaken(moment.now, key, decided), moment)
        elif decided:
            self._note(IterationStarted(moment.now, key, number), moment)
        else:
            self._note(StepEnded(moment.now, key, StepState.DONE), moment)
        return state.ended.get(key, StepState.DONE)

    def _take(self, step: Step, key: str, scope: str, moment: WalkState) -> _Result:
        match step:
            case BranchPoint():
                raise AssertionError("it is taken by itself")
            case Task():
                return self._task(step, key, moment), ""
            case Sequence(steps=steps):
                return self._sequence(steps, scope, moment)
            case Parallel(branches=branches):
                results = [self.go(branch, moment, scope) for branch in branches]
                if None in results:
                    return _GOING_ON
                return (StepState.FAILED if StepState.FAILED in results else StepState.DONE), ""
            case Condition():
                return self._condition(step, key, scope, moment)
            case Repeat():
                return self._repeat(step, key, scope, moment)
            case Wait():
                return self._wait(step, key, moment)
            case End(outcome=outcome, reason=reason):
                ended = RunOutcome.DONE if outcome is EndOutcome.DONE else RunOutcome.FAILED
                self._close(RunClosing(moment.now, ended, reason or "the scenario ends here"), moment)
                return _GOING_ON

    def _sequence(self, steps: tuple[Step, ...], scope: str, moment: WalkState) -> _Result:
        for step in steps:
            result = self.go(step, moment, scope)
            if result is not StepState.DONE:
                return result, ""
        return _DONE

    def _condition(self, step: Condition, key: str, scope: str, moment: WalkState) -> _Result:
        then = self._state.branches.get(key)
        if then is None:
            decided = self._decide(step.when, key, step.timeout_s, moment)
            if isinstance(decided, str):
                return StepState.FAILED, decided
            if decided is None:
                return _GOING_ON
            self._note(BranchTaken(moment.now, key, decided), moment)
            then = decided
        return self.go(step.then if then else step.otherwise, moment, scope), ""

    def _repeat(self, step: Repeat, key: str, scope: str, moment: WalkState) -> _Result:
        while True:
            number = self._state.iterations.get(key, -1)
            if number >= 0:
                result = self.go(step.body, moment, f"{scope}@{number}")
                if result is not StepState.DONE:
                    return result, ""
            if step.times is not None and number + 1 >= step.times:
                return _DONE
            if step.while_ is not None:
                decided = self._decide(step.while_, f"{key}@{number}", step.timeout_s, moment)
                if isinstance(decided, str):
                    return StepState.FAILED, decided
                if decided is None:
                    return _GOING_ON
                if not decided:
                    return _DONE
            self._note(IterationStarted(moment.now, key, number + 1), moment)

    def _decide(self, when: Expression, key: str, timeout_s: float, moment: WalkState) -> bool | str | None:
        """Whether a condition holds; None while its values are waited for; a text when they do not come."""
        undecided = self._state.undecided
        try:
            holds = when.holds(moment.lookup)
        except ValueUnknown as error:
            give_up_at = undecided.setdefault(key, moment.now) + timeout_s
            if moment.now >= give_up_at:
                return f"{when.text!r} cannot be decided: {error}"
            moment.deadlines.append(give_up_at)
            return None
        undecided.pop(key, None)
        return holds

    def _wait(self, step: Wait, key: str, moment: WalkState) -> _Result:
        since = self._state.started[key]
        if step.for_s is not None:
            if moment.now >= since + step.for_s:
                return _DONE
            moment.deadlines.append(since + step.for_s)
            return _GOING_ON
        if self._has_come(step, key, moment):
            return _DONE
        if step.timeout_s is None:
            return _GOING_ON
        if moment.now < since + step.timeout_s:
            moment.deadlines.append(since + step.timeout_s)
            return _GOING_ON
        if step.on_timeout is OnTimeout.CONTINUE:
            return StepState.DONE, "waited in vain"
        what = step.event if step.until is None else step.until.text
        return StepState.FAILED, f"{what!r} did not come in {step.timeout_s:g} s"

    def _has_come(self, step: Wait, key: str, moment: WalkState) -> bool:
        if step.until is None:
            if key in self._state.events_seen:
                return True
            self._state.waiting_for_events[key] = step.event or ""
            return False
        try:
            return step.until.holds(moment.lookup)
        except ValueUnknown:
            return False  # it is waited for, like the condition itself
