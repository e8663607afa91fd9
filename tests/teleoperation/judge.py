"""Whether a robot that was driven by hand was stopped in time, by its own record. Pure; all times are of one clock.

The record is the speed of one axis each time that it was set; between two entries the robot keeps it. A motion has to
be explained by a wish that its operator sent under a lease, and by nothing else:

    fresh     a wish explains a motion until `deadman_s` after its echo was published, and one period, and the slack
    sent      not before it could arrive: what was sent into a link that is cut explains nothing, and what was sent into
              one that stands nothing before it goes on
    held      no longer than until the next lease was granted
    frozen    while the bridge stands still the robot goes on, but only until its own watch stops it
    waited    longer by what the bridge or the robot waited for a core after that, as the kernel itself has recorded:
              no program acts while a machine that is too busy does not run it

A lease is one motion: it rises, holds, falls, and ends at zero. Once it falls it goes to zero within `stop_s`, and only
a newer lease explains what comes after that. So wishes that follow an old one after a stop, and two who command at
once, are no explanation. The runs keep to that: whoever has let go of the stick does not press it again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

__all__ = ["Blocked", "Entry", "Facts", "Frozen", "Grant", "Rules", "Stop", "Verdict", "Waited", "Wish", "judge"]


class Entry(NamedTuple):
    """The robot's speed from a time on."""

    at: float
    speed: float


class Wish(NamedTuple):
    """A setpoint, as the device of its operator sent it."""

    sent: float
    published: float
    """When the bridge published the counter that it echoes."""
    lease: int
    speed: float


class Grant(NamedTuple):
    """A lease."""

    lease: int
    asked: float
    granted: float
    """When the answer was there; the bridge granted it somewhere between the two."""


class Blocked(NamedTuple):
    """When wishes did not get through."""

    since: float
    until: float
    is_lost: bool
    """Whether they never arrive, in place of arriving when it is over."""
    lease: int = 0
    """Of whose wishes this is said; 0: of all."""


class Frozen(NamedTuple):
    """When the bridge stood still."""

    since: float
    until: float


class Waited(NamedTuple):
    """How long the threads of a process had waited for a core by a time, each since it began."""

    at: float
    total_s: Mapping[str, float]


class Rules(NamedTuple):
    """What the robot was promised."""

    deadman_s: float
    period_s: float
    robot_timeout_s: float
    stop_s: float
    """From the beginning of a stop to zero; see `AxisLimits.stop_s`."""
    rise_s: float
    """For so long of that a speed that rises may go on doing so: acceleration / jerk."""
    slack_s: float
    """For a busy machine: it delays the robot's own record too."""


@dataclass
class Facts:
    """What happened to one robot in one run."""

    entries: Sequence[Entry]
    until: float
    """When it was looked at last."""
    grants: Sequence[Grant]
    wishes: Sequence[Wish]
    blocked: Sequence[Blocked] = ()
    frozen: Sequence[Frozen] = ()
    waited: Sequence[Sequence[Waited]] = ()
    """Of each process that has a part in the stop, in the order of time."""
    takes_last: Sequence[Waited] = ()
    """Of a robot that takes the last alone of the speeds that came while it waited for a core."""


class Stop(NamedTuple):
    """One that the robot made."""

    lease: int
    began: float
    unexplained_s: float
    """How long after the last wish that explains the motion had ceased to be fresh; negative: so long before that."""
    took_s: float


@dataclass
class Verdict:
    """What is wrong, and what was seen."""

    problems: list[str] = field(default_factory=list[str])
    stops: list[Stop] = field(default_factory=list[Stop])


def judge(facts: Facts, rules: Rules) -> Verdict:
    """Judge one run."""
    return _Judge(facts, rules).judged()


def _most_waited_s(process: Sequence[Waited], since: float, at: float) -> float:
    """The most that one of its threads waited between the records that enclose a time."""
    before = [one for one in process if one.at <= since]
    after = [one for one in process if one.at >= at]
    if not before or not (after or process[-1].at > since):
        return 0.0
    first, last = before[-1].total_s, (after[0] if after else process[-1]).total_s
    return max((total_s - first.get(thread, total_s) for thread, total_s in last.items()), default=0.0)


class _Judge:
    def __init__(self, facts: Facts, rules: Rules) -> None:
        self._facts, self._rules = facts, rules
        self._verdict = Verdict()
        self._wishes = [(wish, self._explains_from(wish), self._explains_until(wish)) for wish in facts.wishes]
        self._began: float | None = None
        """When the speed began to fall; None while it does not."""
        self._is_rising = False
        self._lease = 0
        """Whose motion it is."""
        self._over = 0
        """The newest lease whose motion has fallen: it explains none any more."""

    def judged(self) -> Verdict:
        before = Entry(-math.inf, 0.0)
        for entry in self._facts.entries:
            self._step(before, entry)
            before = entry
        if before.speed:
            self._wrong(self._facts.until, f"it still moves with {before.speed:g} at the end")
        return self._verdict

    def _step(self, before: Entry, entry: Entry) -> None:
        at, speed = entry
        if self._has_missed_zero(before, entry):
            self._step(before, Entry(at, 0.0))
            before = Entry(at, 0.0)
        if speed * before.speed < 0:
            self._wrong(at, f"it goes from {before.speed:g} to {speed:g} without standing between: two command")
        if before.speed and abs(speed) < abs(before.speed):
            if self._began is None:
                self._falls(at, before.speed)
            if not speed:
                self._stands(at)
            return
        if not speed:
            return
        if self._began is not None:
            self._wrong(at, f"it rises from {before.speed:g} to {speed:g} while it is stopped")
            self._began = None
        self._is_rising = abs(speed) > abs(before.speed)
        extra_s = self._rules.rise_s if self._is_rising and before.speed else 0.0
        self._moves(at, speed, extra_s)

    def _has_missed_zero(self, before: Entry, entry: Entry) -> bool:
        """Whether the robot may have stood in between, and was busy for so long that it has not taken the zero."""
        is_falling = abs(entry.speed) < abs(before.speed) and entry.speed * before.speed > 0
        if self._began is None or not entry.speed or is_falling:
            return False
        return _most_waited_s(self._facts.takes_last, before.at, entry.at) >= self._rules.period_s

    def _moves(self, at: float, speed: float, extra_s: float) -> None:
        """A motion that rises or holds."""
        explaining = [wish.lease for wish in self._explaining(at, speed, extra_s)]
        if not explaining:
            self._wrong(at, f"nobody wishes a speed of {speed:g}{self._latest(at)}")
            return
        self._lease = max(explaining)

    def _falls(self, at: float, held: float) -> None:
        """It begins to fall, and was held until then."""
        extra_s = self._rules.rise_s if self._is_rising else 0.0
        if not self._explaining(at, held, extra_s):
            self._wrong(at, f"a stop from {held:g} begins too late{self._latest(at)}")
        self._began, self._over, self._is_rising = at, max(self._over, self._lease), False

    def _stands(self, at: float) -> None:
        assert self._began is not None
        rules, took_s = self._rules, at - self._began
        fresh = [until for wish, since, until in self._wishes if wish.lease == self._lease and since <= self._began]
        late_s = self._began - (max(fresh) - rules.slack_s - rules.period_s) if fresh else math.nan
        self._verdict.stops.append(Stop(self._lease, self._began, late_s, took_s))
        most_s = rules.stop_s + 3 * rules.period_s + rules.slack_s + self._stood_s(self._began, at)
        if took_s > most_s:
            self._wrong(at, f"a stop takes {took_s:.3f} s, at most {most_s:.3f} s are legal")
        self._began = None

    def _explaining(self, at: float, speed: float, extra_s: float) -> list[Wish]:
        explaining = [
            (wish, until + extra_s)
            for wish, since, until in self._wishes
            if since <= at
            and wish.lease > self._over
            and wish.speed * speed > 0
            and abs(speed) <= abs(wish.speed) + 1e-6
        ]
        # What was waited for a core counts from the time on at which the stop was due by all of them.
        last = max((until for _, until in explaining), default=-math.inf)
        if at > last >= at - self._waited_s(last - extra_s - self._rules.period_s - self._rules.slack_s, at):
            return [wish for wish, until in explaining if until == last]
        return [wish for wish, until in explaining if at <= until]

    def _explains_from(self, wish: Wish) -> float:
        since = wish.sent
        for blocked in sorted(self._facts.blocked):
            if blocked.since <= since < blocked.until and blocked.lease in (0, wish.lease):
                since = math.inf if blocked.is_lost else blocked.until
        return since

    def _explains_until(self, wish: Wish) -> float:
        rules = self._rules
        grace_s = rules.period_s + rules.slack_s
        until = wish.published + rules.deadman_s + grace_s
        for grant in self._facts.grants:
            if grant.lease > wish.lease:
                until = min(until, grant.granted + grace_s)
        for frozen in self._facts.frozen:
            if wish.sent <= frozen.since <= until:
                until = max(until, min(frozen.since + rules.robot_timeout_s + rules.slack_s, frozen.until + grace_s))
        return until

    def _waited_s(self, since: float, at: float) -> float:
        """What was waited for a core meanwhile: one process after the other, the longest of each one's threads."""
        return sum(min(at - since, _most_waited_s(process, since, at)) for process in self._facts.waited)

    def _stood_s(self, began: float, at: float) -> float:
        """For so much of a stop the bridge stood, and the robot kept its speed until its own watch acted."""
        return sum(
            min(at - began, frozen.until - frozen.since, self._rules.robot_timeout_s)
            for frozen in self._facts.frozen
            if began <= frozen.until and frozen.since <= at
        )

    def _latest(self, at: float) -> str:
        """How old the newest wishes are, for people."""
        before = [wish for wish in self._facts.wishes if wish.sent <= at]
        if not before:
            return ": nobody has wished anything yet"
        newest = max(before)
        echo_s = at - max(wish.published for wish in before)
        said = f"; the newest wish is {newest.speed:g} under lease {newest.lease}, sent {at - newest.sent:.3f} s ago"
        return f"{said}, the newest echo was published {echo_s:.3f} s ago"

    def _wrong(self, at: float, what: str) -> None:
        self._verdict.problems.append(f"{at:.3f}: {what}")
