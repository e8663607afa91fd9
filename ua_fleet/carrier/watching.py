"""What a bridge tells of the runs that it carries, for whoever watches: one DataSet, with the server or without.

    facts of segments, decisions, what is held and handed over --FLUSH_S later--> one message for each run with news

What happens within FLUSH_S is one message, so that a step has two: it begins, and it has ended and its token is with
the next bridge. One that is not acknowledged within HAND_OVER_S is told to be on its way. One that has come and
begins no task within HAND_OVER_S, since its run is paused or in doubt, or its step waits, is told by itself; so is one
that is gone without the end of a task.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from ua_fleet.bridge.carry import CarryGround
from ua_fleet.carrying import Holder, SendToken
from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.pubsub.run_data import RUN_DATA_FIELDS, run_data_topic
from ua_fleet.resilience import Aborted
from ua_fleet.scenario.facts import Fact, StepEnded, TaskAssigned, TaskOver

__all__ = ["FLUSH_S", "RunWatch"]

FLUSH_S: Final = 0.02
HAND_OVER_S: Final = 0.5
"""So long a token may be on its way until it is told that it is: mostly it has arrived before."""
MOST_TASKS: Final = 8
"""Tasks that one message tells of: the last ones."""
MOST_TEXT: Final = 80
MOST_CANDIDATES: Final = 4


@dataclass(slots=True)
class _Watched:
    """A run, as it was told and as it is."""

    holds: tuple[int, ...] = ()
    hands_to: tuple[int, ...] = ()
    has_told: bool = False
    """Whether it has told last that it holds any."""
    other_since: float | None = None
    """Since when it is otherwise, by the clock of the loop."""
    outcome: str = ""
    tasks: dict[str, tuple[str, str]] = field(default_factory=dict[str, tuple[str, str]])
    """Name and robot of each task by its step, until the step has ended: rounds have steps of their own."""
    changed: list[tuple[str, str, str]] = field(default_factory=list[tuple[str, str, str]])
    """Task, robot and state of what has begun or ended since the last message."""
    message: str = ""
    ranking: tuple[tuple[str, float], ...] = ()
    facts: int = 0
    """It grows by one with each fact, and never falls: a restart goes on at the highest number of the file."""
    is_new: bool = False
    since: float = 0.0
    """Since when, by the clock of the loop."""

    def take(self, fact: Fact) -> None:
        """Count a fact, and know whose step it is."""
        self.facts += 1
        if isinstance(fact, TaskAssigned):
            self.tasks[fact.step] = fact.task, fact.robot
        elif isinstance(fact, StepEnded):
            self.tasks.pop(fact.step, None)


class RunWatch:
    """The DataSet of one bridge."""

    def __init__(self, space: int, ns: int, name: str, ground: CarryGround) -> None:
        """Begin with nothing."""
        self._space, self._topic, self._name, self._ground = space, run_data_topic(space, ns), name, ground
        self._runs: dict[str, _Watched] = {}
        self._is_announced = self._is_due = False

    def announce(self) -> None:
        """Announce the DataSet; without this it is when there is something to tell."""
        ground, now, wall = self._ground, self._ground.loop.time(), self._ground.wall_ticks()
        if self._is_announced:
            return
        for datagram in ground.publisher.announce(
            self._topic, f"{self._name} runs", RUN_DATA_FIELDS, now=now, wall_ticks=wall
        ):
            ground.send(datagram)
        self._is_announced = True

    def happened(self, run_id: str, fact: Fact) -> None:
        """A fact of a segment is written down."""
        watched = self._runs.setdefault(run_id, _Watched())
        watched.take(fact)
        if isinstance(fact, TaskAssigned):
            self._changed(watched, fact.step, "assigned", "")
        elif isinstance(fact, TaskOver):
            self._changed(watched, fact.step, fact.outcome.value, fact.message)

    def _changed(self, watched: _Watched, step: str, state: str, message: str) -> None:
        task, robot = watched.tasks.get(step, (step, ""))
        watched.changed = [*watched.changed[1 - MOST_TASKS :], (task, robot, state)]
        watched.message = message[:MOST_TEXT]
        self._soon(watched)

    def decided(self, run_id: str, changed: DecisionChanged) -> None:
        """Substitutes for a robot were ranked, or one was chosen."""
        watched = self._runs.setdefault(run_id, _Watched())
        if not isinstance(changed.event, Aborted):
            ranked = changed.event.ranking.ranked[:MOST_CANDIDATES]
            watched.ranking = tuple([(one.robot, one.score) for one in ranked])
        self._soon(watched)

    def look(self, holder: Holder) -> None:
        """See what is held now, and handed over: that a token has arrived which was told to be on its way is news.

        What begins or ends with a token is told with the step, where that is within HAND_OVER_S.
        """
        sending = [sent for sent in holder.to_send() if isinstance(sent, SendToken)]
        for run_id, held in holder.runs.items():
            watched = self._runs.setdefault(run_id, _Watched())
            closed, told = held.closed, watched.hands_to
            watched.holds = tuple([place.number for place in held.holds])
            watched.hands_to = tuple(sorted({sent.road.space for sent in sending if sent.run_id == run_id}))
            if closed is not None and not watched.outcome:
                watched.outcome = closed.outcome
                if closed.by == self._space:
                    watched.message = closed.reason[:MOST_TEXT]
                    self._soon(watched)
            elif told and not watched.hands_to and not watched.is_new:
                self._soon(watched)
            self._settle(watched)

    def _settle(self, watched: _Watched) -> None:
        """Have it told before long that it holds any now, or none, where no step tells so before."""
        if bool(watched.holds) is watched.has_told:
            watched.other_since = None
        elif watched.other_since is None:
            now = watched.other_since = self._ground.loop.time()
            self._ground.loop.call_later(HAND_OVER_S, self._settled, watched, now)

    def _settled(self, watched: _Watched, since: float) -> None:
        if watched.other_since == since:  # else it was told meanwhile
            self._soon(watched)

    def facts_of(self, run_id: str) -> int:
        """What is told of the facts of a run: more than before means that there are more of them."""
        watched = self._runs.get(run_id)
        return 0 if watched is None else watched.facts

    def forget(self, run_id: str) -> None:
        """A run is not known here any more."""
        self._runs.pop(run_id, None)

    def restored(self, run_id: str, facts: Iterable[Fact], last: int) -> None:
        """These facts were told before a restart, maybe with others that are forgotten.

        Args:
            run_id: the run.
            facts: of its segments, as far as they are there.
            last: the highest number that the file has given a fact, so that at most as many were counted.
        """
        watched = self._runs.setdefault(run_id, _Watched())
        for fact in facts:
            watched.take(fact)
        watched.facts = last

    def _soon(self, watched: _Watched) -> None:
        if not watched.is_new:
            watched.is_new, watched.since = True, self._ground.loop.time()
        self._arm()

    def _arm(self) -> None:
        if not self._is_due:
            self._is_due = True
            self._ground.loop.call_later(FLUSH_S, self._flush)

    def _flush(self) -> None:
        self._is_due = False
        waits_until = self._ground.loop.time() - HAND_OVER_S
        with self._ground.mistakes.guard("carried runs"):
            for run_id, watched in self._runs.items():
                if watched.is_new and watched.hands_to and watched.since > waits_until:
                    self._arm()
                elif watched.is_new:
                    watched.is_new = False
                    self._tell(run_id, watched)
        self._ground.sooner()

    def _tell(self, run_id: str, watched: _Watched) -> None:
        ground, now, wall = self._ground, self._ground.loop.time(), self._ground.wall_ticks()
        columns: list[Any] = [list(column) for column in zip(*watched.changed, strict=True)] or [[], [], []]
        robots, scores = [robot for robot, _ in watched.ranking], [score for _, score in watched.ranking]
        values = (
            run_id,
            list(watched.holds),
            list(watched.hands_to),
            *columns,
            watched.message,
            robots,
            scores,
            watched.facts,
            watched.outcome,
        )
        watched.changed, watched.ranking, watched.has_told = [], (), bool(watched.holds)
        self._settle(watched)
        try:
            self.announce()
            for datagram in ground.publisher.publish(self._topic, values, timestamp=wall, now=now):
                ground.send(datagram)
        except LocalWireError:
            ground.counters.drop(Drop.CONVERSION)
