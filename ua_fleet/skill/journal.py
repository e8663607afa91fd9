"""The journal: what of Actions must survive a restart, and the one that keeps it in memory.

Write-ahead: each method returns when the record is durable, and only then does a state machine give the effect that
depends on it. A request is journaled before it is sent, an intent before the robot is told, an outcome or end before
anybody hears of it. Where it cannot be written, the method raises StorageUnavailable, the state machine stays as it was
and gives no effect. What a method wrote is there after a crash at any moment after it returned; after a crash within
it, there or not, but never a part of it.

Records are NamedTuples of numbers, texts and bytes, so that a table with the same columns holds them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple, Protocol

from ua_fleet.skill.executions import ExecutionReport, RequestOutcome, Target

__all__ = [
    "MemoryJournal",
    "RecordedExecution",
    "RecordedRequest",
    "RequestorJournal",
    "ResponderJournal",
]


class RecordedRequest(NamedTuple):
    """A requestor's record of one execution."""

    execution_id: bytes
    target: Target
    content: bytes
    """The arguments, packed."""
    issued: int
    """Ticks; strictly increasing over all requests of a journal."""
    timeout_ms: int
    """0: it was withdrawn, and only asks."""
    outcome: RequestOutcome | None = None
    version: int = 0
    """Of the announcement by which the arguments were put in order; 0: it is not said."""


class RecordedExecution(NamedTuple):
    """A responder's record of one execution."""

    execution_id: bytes
    requestor_id: str
    space: int
    """The requestor's."""
    target: Target
    content: bytes
    issued: int
    timeout_ms: int
    report: ExecutionReport


class RequestorJournal(Protocol):
    """What a requestor writes down."""

    def requested(self, request: RecordedRequest) -> None:
        """A new request, before it is sent. Its id is not in the journal."""
        ...

    def withdrawn(self, execution_id: bytes) -> None:
        """A request must not be begun any more; its timeout is 0."""
        ...

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request, also one that corrects an earlier outcome."""
        ...

    def requests(self) -> Collection[RecordedRequest]:
        """All that are remembered, by their issue time."""
        ...

    def forget_requests(self, execution_ids: Collection[bytes]) -> None:
        """Forget requests that have an outcome, or were never sent; never the sent one with the greatest issue time."""
        ...

    def one_sync(self) -> AbstractContextManager[None]:
        """Have what is recorded within synced once: at the first `settle` after it, and at the end."""
        ...

    def settle(self) -> None:
        """What was recorded is on the disk when this returns, and may have effects outside."""
        ...


class ResponderJournal(Protocol):
    """What a responder writes down."""

    def recorded(self, execution: RecordedExecution) -> None:
        """A new execution: an intent (RUNNING), or that it will never begin. Its id is not in the journal."""
        ...

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        """A new state of an execution."""
        ...

    def executions(self) -> Collection[RecordedExecution]:
        """All that are remembered, in the order in which they were recorded."""
        ...

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        """Forget executions and set for some spaces the newest issue time that was forgotten: both or nothing."""
        ...

    def forgotten(self) -> Mapping[int, int]:
        """For each space the newest issue time of an execution that was forgotten."""
        ...

    def settle(self) -> None:
        """What was recorded is on the disk when this returns, and may have effects outside."""
        ...


class MemoryJournal:
    """Both journals in memory: it outlives state machines, but not its process."""

    def __init__(self) -> None:
        self._requests: dict[bytes, RecordedRequest] = {}
        self._executions: dict[bytes, RecordedExecution] = {}
        self._forgotten: dict[int, int] = {}

    def requested(self, request: RecordedRequest) -> None:
        """See RequestorJournal."""
        self._requests[request.execution_id] = request

    def withdrawn(self, execution_id: bytes) -> None:
        """See RequestorJournal."""
        self._requests[execution_id] = self._requests[execution_id]._replace(timeout_ms=0)

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """See RequestorJournal."""
        self._requests[execution_id] = self._requests[execution_id]._replace(outcome=outcome)

    def requests(self) -> Collection[RecordedRequest]:
        """See RequestorJournal."""
        return tuple(self._requests.values())

    def forget_requests(self, execution_ids: Collection[bytes]) -> None:
        """See RequestorJournal."""
        for execution_id in execution_ids:
            del self._requests[execution_id]

    def one_sync(self) -> AbstractContextManager[None]:
        """See RequestorJournal."""
        return nullcontext()

    def settle(self) -> None:
        """See RequestorJournal and ResponderJournal."""

    def recorded(self, execution: RecordedExecution) -> None:
        """See ResponderJournal."""
        self._executions[execution.execution_id] = execution

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        """See ResponderJournal."""
        self._executions[execution_id] = self._executions[execution_id]._replace(report=report)

    def executions(self) -> Collection[RecordedExecution]:
        """See ResponderJournal."""
        return tuple(self._executions.values())

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        """See ResponderJournal."""
        for execution_id in execution_ids:
            del self._executions[execution_id]
        self._forgotten.update(forgotten)

    def forgotten(self) -> Mapping[int, int]:
        """See ResponderJournal."""
        return dict(self._forgotten)
