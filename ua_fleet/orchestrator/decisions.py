"""The open decisions of all runs: who takes a task over, and what follows from what nobody knows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Final

from ua_fleet.errors import ScenarioError
from ua_fleet.orchestrator.candidates import ResilienceSettings
from ua_fleet.orchestrator.choosing import Choosing
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.orchestrator.outputs import DecisionChanged, Output
from ua_fleet.orchestrator.under_way import RunsUnderWay
from ua_fleet.orchestrator.watched_values import WatchedValues
from ua_fleet.resilience import Aborted, Confirmation, Decision, DecisionEvent, Judgements, Ranking, ReplacementChosen
from ua_fleet.scenario import Lookup, Run
from ua_fleet.scenario.consequences import LEAST_SILENCE_S
from ua_fleet.scenario.effects import DecisionNeeded
from ua_fleet.scenario.facts import TaskAnswered, TaskFound, TaskHalting, TaskOver

__all__ = ["Decisions", "OpenedDecision"]

TURN_S: Final = 0.1
"""The rankings that people see are made anew in turns, so often at most."""
PLACES: Final = 500
"""Robots that a turn ranks, about 5 ms of work; one ranking at least."""


@dataclass(slots=True)
class OpenedDecision:
    """A decision with what it is about."""

    run_id: str
    asked: DecisionNeeded
    decision: Decision
    is_unknown: bool
    """Whether it is about what nobody knows, and not about a robot that cannot."""
    since: float
    names: set[str]
    """The values that its ranking was made of."""
    moment: tuple[int, int]
    """See `Choosing.moment`, at its ranking."""
    ranked_at: float
    facts: int
    """See `Choosing.facts`, likewise."""
    has_other_values: bool = False
    """Whether values are not what they were at its ranking."""


class Decisions:
    """One for each task that somebody has to decide about."""

    def __init__(
        self, known: Knowledge, choosing: Choosing, runs: RunsUnderWay, outputs: list[Output], lookup: Lookup
    ) -> None:
        """Begin with none.

        Args:
            known: the robots.
            choosing: ranks them.
            runs: told of what was decided.
            outputs: where it is told.
            lookup: values of robots.
        """
        self._known, self._choosing, self._runs, self._outputs = known, choosing, runs, outputs
        self._values = WatchedValues(lookup)
        self._turn_at, self._places_left = -inf, 0
        """When the present turn began, and how many robots it may still rank."""
        self._open: dict[str, OpenedDecision] = {}
        self._judgements: dict[str, Judgements] = {}
        """Of decisions for which others count than for all."""

    def __iter__(self) -> Iterator[OpenedDecision]:
        return iter(list(self._open.values()))

    def next_deadline(self) -> float | None:
        """When one of them is due, or to be ranked again, or None."""
        deadlines = [opened.decision.next_deadline() for opened in self._open.values()]
        if any(self._is_stale(opened) for opened in self._open.values()):
            deadlines.append(self._turn_at + TURN_S)
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def open(self, run_id: str, asked: DecisionNeeded, now: float, *, is_unknown: bool) -> None:
        """Somebody has to decide."""
        decision_id = f"{run_id}.{asked.step}"
        todo = self._choosing.asked(run_id, asked, is_unknown=is_unknown)
        settings, names = self._known.settings, self._choosing.argument_names(run_id, asked.step)
        moment, facts = self._choosing.moment(run_id), self._choosing.facts
        decision = Decision(
            decision_id,
            settings.mode,
            self._choosing.ranked(todo, self._settings(decision_id), self._values.reader(names)),
            limit_s=settings.limit_s,
            on_limit=settings.on_limit,
            now=now,
            is_unknown=is_unknown,
            hope_until=self._known.hope_until(todo, now, now),
            not_before=now + LEAST_SILENCE_S if asked.may_be_done else None,
        )
        opened = self._open[decision_id] = OpenedDecision(
            run_id, asked, decision, is_unknown, now, names, moment, now, facts
        )
        self._decided(opened, decision.begin(), now)

    def confirm(self, decision_id: str, robot: str, by: str, now: float) -> Confirmation:
        """A person chooses; raises NoCandidate, or ScenarioError where there is no such decision."""
        opened = self._find(decision_id)
        self._rank_again(opened, now)
        confirmation, events = opened.decision.confirm(robot, by)
        self._decided(opened, events, now)
        return confirmation

    def preview(self, decision_id: str, judgements: Judgements | None) -> Ranking:
        """The ranking of an open decision with other judgements, which changes nothing; None: those that count.

        Raises:
            JudgementsInvalid: no weights can be made of them.
            ScenarioError: there is no such decision.
        """
        opened, settings = self._find(decision_id), self._settings(decision_id)
        if judgements is not None:
            settings = replace(settings, judgements=judgements)
        todo = self._choosing.asked(opened.run_id, opened.asked, is_unknown=opened.is_unknown)
        return self._choosing.ranked(todo, settings)

    def judge(self, decision_id: str, judgements: Judgements | None, now: float) -> None:
        """Rank an open decision with other judgements; None: with those of all. Raises as `preview` does."""
        opened = self._find(decision_id)
        if judgements is None:
            self._judgements.pop(decision_id, None)
        else:
            replace(self._known.settings, judgements=judgements)  # refuses what cannot be weighed
            self._judgements[decision_id] = judgements
        self._rank_again(opened, now)

    def restore_judgements(self, judgements: Mapping[str, Judgements]) -> None:
        """Judgements of single decisions that were set before a restart; before these are open again."""
        self._judgements.update(judgements)

    def _find(self, decision_id: str) -> OpenedDecision:
        opened = self._open.get(decision_id)
        if opened is None:
            raise ScenarioError(f"there is no decision {decision_id!r}")
        return opened

    def _settings(self, decision_id: str) -> ResilienceSettings:
        own = self._judgements.get(decision_id)
        return self._known.settings if own is None else replace(self._known.settings, judgements=own)

    def look_at_values(self) -> None:
        """Find out whose rankings may be others now by their values: one look at each of these."""
        if not self._open:
            self._values.clear()
            return
        changed = self._values.changed()
        for opened in self._open.values():
            opened.has_other_values = opened.has_other_values or not opened.names.isdisjoint(changed)

    def _is_stale(self, opened: OpenedDecision) -> bool:
        """Whether a ranking may be another one now, also by what was decided a moment ago."""
        is_same = opened.facts == self._choosing.facts and opened.moment == self._choosing.moment(opened.run_id)
        return opened.has_other_values or not is_same

    def look_again(self, opened: OpenedDecision, now: float) -> None:
        """Time has passed, or more is known of robots. Whatever is chosen is chosen by the ranking of now."""
        if self._is_stale(opened) and self._cannot_wait(opened, now):
            self._rank_again(opened, now)
        if self._is_back(opened):
            self._decided(opened, opened.decision.take_back(opened.asked.robot), now)
        self._decided(opened, opened.decision.poll(now), now)

    def _cannot_wait(self, opened: OpenedDecision, now: float) -> bool:
        """Whether something may follow from the ranking at once."""
        decision, moment = opened.decision, self._choosing.moment(opened.run_id)
        due = decision.next_deadline()
        if due is not None and now >= due:
            return True
        if decision.is_by_itself and (decision.ranking.best is None or opened.moment != moment):
            return True
        return self._may_be_back(opened)

    def rank_in_turn(self, now: float) -> None:
        """Rank some of the others again, those first that wait longest: a turn ranks so many robots, however many
        decisions are open.
        """
        if now >= self._turn_at + TURN_S:
            self._turn_at, self._places_left = now, PLACES
        stale = [opened for opened in self._open.values() if self._is_stale(opened)]
        for opened in sorted(stale, key=lambda opened: opened.ranked_at):
            if self._places_left <= 0:
                return
            if self._open.get(opened.decision.id) is opened:
                self._places_left -= max(1, len(self._known.fleet.robots))
                self._runs.guard(opened.run_id, now, self._rank_again, opened, now)

    def _may_be_back(self, opened: OpenedDecision) -> bool:
        """Whether nothing that is known of the robot that could not even begin keeps it from beginning now."""
        run, asked = self._runs.runs.get(opened.run_id), opened.asked
        if run is None or opened.is_unknown or not asked.robot or run.state.tasks[asked.step].attempt:
            return False
        return self._known.unfit(asked.robot, self._known.needs(asked.robot, run.task(asked.step))) is None

    def _is_back(self, opened: OpenedDecision) -> bool:
        """Whether the robot that could not even begin can do it now: it has its task back, and nobody need choose."""
        run, asked = self._runs.runs.get(opened.run_id), opened.asked
        if run is None or opened.is_unknown or not asked.robot or opened.decision.outcome is not None:
            return False
        task_run = run.state.tasks[asked.step]
        ranked = opened.decision.ranking.ranked
        return not task_run.attempt and any(place.robot == asked.robot for place in ranked)

    def close(self, run_id: str, fact: TaskOver | TaskAnswered | TaskFound | TaskHalting) -> None:
        """It is known what a robot was at, or somebody has said what follows: nobody has to choose any more."""
        opened = self._open.pop(f"{run_id}.{fact.step}", None)
        if opened is None:
            return
        if isinstance(fact, TaskAnswered):
            why = f"{fact.by} has answered: {fact.then.value}"
        elif isinstance(fact, TaskFound):
            why = f"{opened.asked.robot} has told: it is still at it"
        elif isinstance(fact, TaskHalting):
            why = f"{opened.asked.robot} stands: {fact.reason}"
        else:
            why = fact.message or fact.outcome.value
        self._say(opened, opened.decision.give_up(why))

    def end(self, run_id: str, now: float) -> None:
        """Nobody has to decide anything for a run that has ended."""
        for opened in self.forget(run_id):
            self._runs.guard(run_id, now, self._give_up, opened)

    def forget(self, run_id: str) -> list[OpenedDecision]:
        """Say nothing more of a run's decisions; those that were open."""
        gone = [opened for opened in self._open.values() if opened.run_id == run_id]
        for opened in gone:
            del self._open[opened.decision.id]
        return gone

    def _give_up(self, opened: OpenedDecision) -> None:
        self._say(opened, opened.decision.give_up("the run has ended"))

    def _rank_again(self, opened: OpenedDecision, now: float) -> None:
        todo = self._choosing.asked(opened.run_id, opened.asked, is_unknown=opened.is_unknown)
        opened.names = self._choosing.argument_names(opened.run_id, opened.asked.step)
        opened.moment, opened.facts = self._choosing.moment(opened.run_id), self._choosing.facts
        opened.ranked_at, opened.has_other_values = now, False
        reader = self._values.reader(opened.names)
        events = opened.decision.rank_again(
            self._choosing.ranked(todo, self._settings(opened.decision.id), reader),
            self._known.hope_until(todo, opened.since, now),
        )
        self._decided(opened, events, now)

    def _decided(self, opened: OpenedDecision, events: list[DecisionEvent], now: float) -> None:
        self._say(opened, events)
        step = opened.asked.step
        for event in events:
            if isinstance(event, ReplacementChosen):
                self._open.pop(event.decision_id, None)
                self._runs.tell(opened.run_id, now, Run.replaced, step, event.robot, event.by, now)
            elif isinstance(event, Aborted):
                self._open.pop(event.decision_id, None)
                self._runs.tell(opened.run_id, now, Run.not_replaced, step, event.reason, now)

    def _say(self, opened: OpenedDecision, events: list[DecisionEvent]) -> None:
        asked = opened.asked
        if opened.decision.outcome is not None:
            self._judgements.pop(opened.decision.id, None)
        self._outputs += [
            DecisionChanged(
                opened.run_id, asked.step, asked.task, asked.robot, asked.reason, event, opened.decision.next_deadline()
            )
            for event in events
        ]
