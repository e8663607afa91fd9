"""The runs that have not ended, and what each asks for. A mistake of ours costs the run in which it was made.

    told -> run -> effects --in their order--> carried out -> told ...
                   none left --> a robot that is free is granted -> effects ...

What follows from an effect waits behind the effects before it. Robots are granted when nothing is left to carry out:
else a run that gives a robot back, or asks for it twice, would give back what it was granted in between.

A run in which a mistake was made ends as failed: what it asked for and was not carried out is dropped, but for what
takes back, and all of its robots are told to stop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, TypeVarTuple

from ua_fleet.errors import UaFleetError
from ua_fleet.orchestrator.outputs import Output, RunBroken
from ua_fleet.scenario import Run
from ua_fleet.scenario.effects import CancelTask, Effect, Happened, ReleaseRobot
from ua_fleet.scenario.facts import RunEnded

__all__ = ["RunsUnderWay"]

_Told = TypeVarTuple("_Told")

_TAKES_BACK: Final = (Happened, CancelTask, ReleaseRobot)
"""What of a broken run is carried out still: it has robots do nothing."""


class RunsUnderWay:
    """Runs by their ids."""

    def __init__(
        self,
        outputs: list[Output],
        carry_out: Callable[[str, Effect, float], None],
        given_up: Callable[[str], None],
        grant_next: Callable[[float], bool],
    ) -> None:
        """Begin without runs.

        Args:
            outputs: where mistakes are told.
            carry_out: carries one effect of a run out.
            given_up: told of a run that cannot even be ended: it is forgotten, and nobody gets its robots.
            grant_next: tells one run of a robot that it has now; whether there was one.
        """
        self.runs: dict[str, Run] = {}
        self._outputs, self._carry_out_one, self._given_up = outputs, carry_out, given_up
        self._grant_next = grant_next
        self._effects: deque[tuple[str, Effect]] = deque()
        self._is_carrying_out = False

    def ask(self, run_id: str, now: float, what: Callable[[Run], list[Effect]]) -> None:
        """Tell a run something for a person: who is told why it does not take it; raises UaFleetError then."""
        try:
            effects = what(self.runs[run_id])
        except UaFleetError:
            raise
        except Exception as error:  # noqa: BLE001 - as in `tell`
            self.end_broken(run_id, error, now)
        else:
            self.carry_out(run_id, effects, now)

    def tell(self, run_id: str, now: float, what: Callable[[Run, *_Told], list[Effect]], *told: *_Told) -> None:
        """Tell a run something, where it has not ended, and carry out what follows."""
        run = self.runs.get(run_id)
        if run is None:
            return
        try:
            effects = what(run, *told)
        except Exception as error:  # noqa: BLE001 - the other runs, and the server, go on
            self.end_broken(run_id, error, now)
        else:
            self.carry_out(run_id, effects, now)

    def guard(self, run_id: str, now: float, what: Callable[[*_Told], None], *told: *_Told) -> None:
        """Do something for a run; a mistake costs that run."""
        try:
            what(*told)
        except Exception as error:  # noqa: BLE001 - as in `tell`
            self.end_broken(run_id, error, now)

    def carry_out(self, run_id: str, effects: list[Effect], now: float) -> None:
        """Carry out what a run asks for, behind all that was asked for before."""
        self._effects.extend((run_id, effect) for effect in effects)
        self.go_on(now)

    def go_on(self, now: float) -> None:
        """Carry out what is left, and grant robots that are free."""
        if self._is_carrying_out:
            return
        self._is_carrying_out = True
        try:
            while self._effects or self._grant_next(now):
                if self._effects:
                    owner, effect = self._effects.popleft()
                    self.guard(owner, now, self._carry_out_one, owner, effect, now)
        finally:
            self._is_carrying_out = False

    def end_broken(self, run_id: str, error: Exception, now: float) -> None:
        """End a run that has met a mistake of ours; one that has ended stays as it is."""
        self._outputs.append(RunBroken(run_id, error))
        run = self.runs.get(run_id)
        if run is None:
            return
        kept = [one for one in self._effects if one[0] != run_id or isinstance(one[1], _TAKES_BACK)]
        self._effects = deque(kept)
        try:
            effects = run.broken(f"a mistake of ua_fleet ({type(error).__name__}: {error}); report the log", now)
        except Exception as again:  # noqa: BLE001 - as in `tell`
            self._outputs.append(RunBroken(run_id, again))
            del self.runs[run_id]
            self._effects = deque(one for one in kept if one[0] != run_id or isinstance(one[1], CancelTask))
            self._given_up(run_id)
            return
        state = run.state
        if not effects and state.outcome is not None and not any(_is_end(*one, run_id) for one in kept):
            effects.append(Happened(RunEnded(now, state.outcome, state.reason)))  # it was lost by the mistake
        self.carry_out(run_id, effects, now)


def _is_end(owner: str, effect: Effect, run_id: str) -> bool:
    return owner == run_id and isinstance(effect, Happened) and isinstance(effect.fact, RunEnded)
