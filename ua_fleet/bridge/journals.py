"""The executions of a bridge in two journals: what its own carried runs ask for stands in the file of these runs.

So one sync puts on the disk that a token came, what its first task is asked with, and that the robot is to begin it.
Who carries runs in the bridge brings that journal, at its start or with the first run.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ua_fleet.skill.executions import ExecutionReport
from ua_fleet.skill.journal import RecordedExecution, ResponderJournal

__all__ = ["ExecutionJournals"]


class ExecutionJournals:
    """A ResponderJournal of one bridge."""

    def __init__(self, space: int, common: ResponderJournal) -> None:
        """Record all in the common journal, until there is one for what the bridge's own space asks for."""
        self._space, self._common = space, common
        self._own: ResponderJournal | None = None
        self._in_own: set[bytes] = set()
        """Executions that stand in the bridge's own journal; older ones of it may stand in the common one."""
        self._is_owed = False
        """Whether the bridge's own journal was written since the last `settle`."""

    def record_own_in(self, journal: ResponderJournal) -> Collection[RecordedExecution]:
        """Record in it from now on what the bridge's own space asks for; what it has of a time before."""
        found = journal.executions()
        self._own, self._in_own = journal, {execution.execution_id for execution in found}
        return found

    def is_own(self, execution_id: bytes) -> bool:
        """Whether an execution stands in the bridge's own journal."""
        return execution_id in self._in_own

    def recorded(self, execution: RecordedExecution) -> None:
        """See ResponderJournal."""
        if self._own is None or execution.space != self._space:
            self._common.recorded(execution)
            return
        self._own.recorded(execution)
        self._in_own.add(execution.execution_id)
        self._is_owed = True

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        """See ResponderJournal."""
        if self._own is not None and execution_id in self._in_own:
            self._own.reported(execution_id, report)
            self._is_owed = True
        else:
            self._common.reported(execution_id, report)

    def executions(self) -> Collection[RecordedExecution]:
        """See ResponderJournal; those of the bridge's own space follow the others."""
        own = () if self._own is None else self._own.executions()
        return (*self._common.executions(), *own)

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        """See ResponderJournal; in each journal both or nothing, and what has a mark may still be remembered."""
        common = [each for each in execution_ids if each not in self._in_own]
        if common or self._own is None:
            self._common.forget_executions(common, forgotten)
        if self._own is not None and (own := self._in_own.intersection(execution_ids)):
            self._own.forget_executions(own, {self._space: forgotten[self._space]})
            self._in_own -= own
            self._is_owed = True

    def forgotten(self) -> Mapping[int, int]:
        """See ResponderJournal."""
        marks = dict(self._common.forgotten())
        for space, issued in () if self._own is None else self._own.forgotten().items():
            marks[space] = max(issued, marks.get(space, issued))
        return marks

    def settle(self, *, is_own: bool = False) -> None:
        """See ResponderJournal. The bridge's own journal keeps nothing back that does not concern it when it fails.

        Args:
            is_own: whether what follows is of the bridge's own runs, though nothing may have been written.
        """
        self._common.settle()
        if self._own is not None and (is_own or self._is_owed):
            self._is_owed = False
            self._own.settle()
