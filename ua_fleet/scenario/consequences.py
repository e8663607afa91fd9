"""What follows from what: the one place that decides it. `docs/resilience.md` has the same as a table for people.

What is known of a robot, by the source of its fault:

    source        it gets tasks   what it is at
    announced     no              is over: who can say that stands; its last word on it is waited for, SETTLE_S at most
    robot, name   no              is halted; once it says that it has stopped, or was done: another robot
    skill         no              likewise
    not_halted    no              it was told to stop, and has not said that it has: a person is to look
    silent        waits           goes on; after `silence_s`, or the task's own time-out: unknown

How an attempt ended, and what follows:

    done          the task is done; robots that failed at it before have a fault
    failed,       once more while `retries` are left; then this robot is left out for this task, and others are ranked
    timed_out,
    refused
    stopped       the robot has a fault; another one at once
    fault         another robot at once
    halted        the task fails: who halts a robot may stand beside it, and nobody is to begin to move there
    busy          asked again for BUSY_S, then as refused
    unreached     asked again for `silence_s`, then as refused; also a request that came too late to be begun
    unknown       what `on_unknown` says: nobody else begins without somebody's consent
"""

from __future__ import annotations

from typing import Final, NamedTuple

from ua_fleet.scenario.facts import TaskOutcome, Then
from ua_fleet.scenario.model import OnUnknown, Task
from ua_fleet.scenario.state import TaskPhase, TaskRun

__all__ = [
    "ALARM",
    "ANNOUNCED",
    "BRIDGE_OFF",
    "HALT_S",
    "LEAST_SILENCE_S",
    "NOT_HALTED",
    "RAISED",
    "SETTLE_S",
    "SILENT",
    "SKILL",
    "TELL_S",
    "VALUE_S",
    "FaultMeaning",
    "after_end",
    "meaning_of",
]

ANNOUNCED: Final = "announced"
RAISED: Final = "robot"
SILENT: Final = "silent"
SKILL: Final = "skill"
NOT_HALTED: Final = "not_halted"
BRIDGE_OFF: Final = "bridge.off"
"""Sources of faults; the others have the names of conditions. Nobody can see whether the cause of `skill` is gone:
acknowledging it clears it. `not_halted` ends when the robot says what became of it, or a person calls ClearFault;
`bridge.off`, which a person has said and no condition can be named, when anything is heard of the bridge."""

ALARM: Final = "alarm."
"""Before the name of a value: the source of a fault that is an alarm of that value."""

BUSY_S: Final = 10.0
"""So long a robot that is at something else is asked again; then it has refused."""
HALT_S: Final = 10.0
"""So long a robot that was told to stop may take to say that it has; then nobody knows."""
SETTLE_S: Final = 2.0
"""A robot that announces a fault stands. So long its last word on what it was at is waited for: it may have done it."""
LEAST_SILENCE_S: Final = 5.0
"""A bridge that is started anew is heard within this: before, a task's own time-out says nothing of a silent robot."""
TELL_S: Final = 10.0
"""A robot that is heard again has told within this what became of an execution, or cannot."""

VALUE_S: Final = 10.0
"""So long a task waits for the value of an argument whose robot is heard: as long as `if` does by itself. The values of
a robot that is heard again come one by one."""


class FaultMeaning(NamedTuple):
    """What follows from a fault."""

    keeps_from_work: bool
    stands: bool


_OF_SOURCES: Final = {
    SILENT: FaultMeaning(keeps_from_work=False, stands=False),
    ANNOUNCED: FaultMeaning(keeps_from_work=True, stands=True),
}
_OF_OTHERS: Final = FaultMeaning(keeps_from_work=True, stands=False)
_NOT_NOW: Final = (TaskOutcome.BUSY, TaskOutcome.UNREACHED)


def meaning_of(source: str) -> FaultMeaning:
    """What follows from a fault, by what has found it."""
    return _OF_SOURCES.get(source, _OF_OTHERS)


def after_end(
    task: Task,
    attempt: TaskRun,
    outcome: TaskOutcome,
    now: float,
    *,
    is_silent: bool,
    silence_s: float,
    return_s: float,
    is_closing: bool,
) -> Then:
    """What follows from how an attempt has ended; a run that is closing begins nothing more.

    Args:
        task: as it is written.
        attempt: the attempt, as it stands before its end is taken in.
        outcome: how it ended.
        now: wall time in seconds.
        is_silent: whether nothing is heard of the robot: it may tell what became of it when it is.
        silence_s: so long a robot that is not reached is asked again.
        return_s: so long a silent robot is waited for that may be at it.
        is_closing: whether the run is to end.
    """
    if outcome is TaskOutcome.DONE:
        return Then.DONE
    if is_closing or outcome is TaskOutcome.HALTED:
        return Then.FAILED
    if outcome is TaskOutcome.UNKNOWN:
        return _after_unknown(task, attempt, now, return_s=return_s, is_silent=is_silent)
    if outcome in _NOT_NOW:
        since = attempt.assigned_at if attempt.busy_since is None else attempt.busy_since
        limit_s = BUSY_S if outcome is TaskOutcome.BUSY else silence_s
        return Then.RETRY if now < since + limit_s else Then.REPLACE
    if outcome in (TaskOutcome.FAULT, TaskOutcome.STOPPED):
        return Then.REPLACE
    retries = task.retries
    was_unknown = attempt.phase in (TaskPhase.ASKED, TaskPhase.LOST)
    if was_unknown and task.on_unknown is OnUnknown.RETRY:  # it is known now that the robot is not at it
        retries = max(1, retries)  # who writes `on_unknown: retry` means once at least
    return Then.RETRY if attempt.tries <= retries else Then.REPLACE


def _after_unknown(task: Task, attempt: TaskRun, now: float, *, return_s: float, is_silent: bool) -> Then:
    """Not even the same robot begins it again while it may be at it: what is not known, a person is asked."""
    lost_since = now if attempt.lost_since is None else attempt.lost_since
    may_tell = is_silent and now < lost_since + return_s
    if attempt.is_agreed and not is_silent:
        return Then.RETRY
    match task.on_unknown:
        case _ if attempt.is_agreed:
            return Then.AWAIT if may_tell else Then.ASK
        case OnUnknown.ASK:
            return Then.ASK
        case OnUnknown.FAIL:
            return Then.FAILED
        case OnUnknown.REPLACE:
            return Then.REPLACE
        case OnUnknown.RETRY:
            return Then.AWAIT if may_tell and attempt.tries <= max(1, task.retries) else Then.ASK
