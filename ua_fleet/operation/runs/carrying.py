"""What has happened is written down, and then carried out.

    outputs -> unwritten --one transaction--> written --one by one, in their order--> carried out

To show a fact takes longer than to ask a robot, and no robot is asked otherwise for it: so what robots bring has the
next ones asked before anything of it is shown. What a command brings is shown in its turn, since whoever gave the
command looks for it in nodes as soon as the answer is there, and the disk may take its time.

A task that its robot can be asked for at once is written down with the request for it, in the same transaction. What
follows from one input is written down as one, before any of it is carried out or shown; so is all that follows from
carrying that out, once it is done. Where writing fails it is tried again until it is written: nothing is carried out
meanwhile, and nothing is lost. A thousand robots that fall silent at once are one transaction; what cannot be carried
out in `TURN_S` waits for the next turn of the event loop, with all that comes behind it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable
from typing import Final, Protocol

from ua_fleet.errors import StorageUnavailable
from ua_fleet.operation.log import Log, MistakeLog
from ua_fleet.orchestrator import (
    Fault,
    FaultChanged,
    HaltChanged,
    HoldChanged,
    OperatorAsked,
    Output,
    TaskCancelled,
    TaskFollowed,
    TaskStarted,
)
from ua_fleet.scenario.facts import Fact
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest
from ua_fleet.storage.run_journal import RunJournal

__all__ = ["OutputCarrier", "TaskOutput"]

TaskOutput = TaskStarted | TaskCancelled | TaskFollowed | OperatorAsked
"""What robots are asked, or listened to, for."""

RETRY_S: Final = 1.0
"""After a journal that could not be written it is tried again after so long."""
TURN_S: Final = 0.03
"""So long robots are asked, and so long outputs are carried out, before others get their turn in the event loop."""


class TaskRecords(Protocol):
    """Requests for tasks; see `TaskRequests`."""

    def prepare(self, tasks: Iterable[TaskStarted]) -> list[RecordedRequest | RecordedExecution]:
        """The records of those that can be made at once."""
        ...

    @property
    def left(self) -> tuple[bytes, ...]:
        """Those that were written down and not sent, and are to be deleted."""
        ...

    def recorded(self, records: Iterable[RecordedRequest | RecordedExecution], left_out: Iterable[bytes]) -> None:
        """These were written down, and these were deleted."""
        ...


class OutputCarrier:
    """The outputs of the orchestrator that wait, and the facts that are not written."""

    def __init__(
        self,
        journal: RunJournal,
        requests: TaskRecords,
        ask: Callable[[TaskOutput, Collection[str]], None],
        carry_out: Callable[[Output], None],
        failed: Callable[[str, Exception], None],
        *,
        mistakes: MistakeLog,
        log: Log,
        clock: Callable[[], float],
        sooner: Callable[[], None],
    ) -> None:
        """Begin with nothing.

        Args:
            journal: of runs, faults, halts, holds and the requests for tasks.
            requests: are made when tasks are carried out, and may be recorded before.
            ask: asks robots what an output is about; told of the executions that an output behind it takes back.
            carry_out: does all else that an output brings, after `ask`.
            failed: told of an execution whose robot could not be asked, for a mistake of ours.
            mistakes: counts what has cost an output.
            log: is told when nothing can be written.
            clock: monotonic seconds.
            sooner: called when something was done, so that deadlines may have come nearer.
        """
        self._journal, self._requests, self._failed = journal, requests, failed
        self._ask, self._carry_out = ask, carry_out
        self._mistakes, self._log, self._clock, self._sooner = mistakes, log, clock, sooner
        self._unwritten_facts: list[tuple[str, Fact]] = []
        self._to_ask: deque[TaskOutput] = deque()
        """Of `_written`, those that robots are to be asked for yet."""
        self._written: deque[Output] = deque()
        """Outputs that may be carried out: their facts are written."""
        self._unwritten: list[Output] = []
        """Those behind them, which are to be written first."""
        self._taken_back: Counter[str] = Counter()
        """The executions that are taken back by outputs that wait."""
        self._changed_faults: dict[str, Fault] = {}
        self._changed_halts: dict[str, HaltChanged] = {}
        self._changed_holds: dict[str, HoldChanged] = {}
        self._is_carrying_out = False
        self._goes_on_at: float | None = None
        """When what a turn has left is carried out, by the monotonic clock."""
        self._retry_at: float | None = None
        """When to try again to write, by the monotonic clock."""
        self.problem = ""
        """Why nothing is carried out; empty while it is."""

    @property
    def is_behind(self) -> bool:
        """Whether something waits to be carried out."""
        return bool(self._written or self._unwritten)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, by the monotonic clock, or None."""
        return self._retry_at if self._retry_at is not None else self._goes_on_at

    def note(self, run_id: str, fact: Fact) -> None:
        """A fact of a run is to be written down."""
        self._unwritten_facts.append((run_id, fact))

    def hold(self, outputs: Iterable[Output]) -> None:
        """Outputs wait for the next `do`."""
        for output in outputs:
            self._unwritten.append(output)
            if isinstance(output, FaultChanged):
                self._changed_faults[output.fault.id] = output.fault
            elif isinstance(output, HaltChanged):
                self._changed_halts[output.halt.execution_id] = output
            elif isinstance(output, HoldChanged):
                self._changed_holds[output.hold.robot] = output
            elif isinstance(output, TaskCancelled):
                self._taken_back[output.execution_id] += 1

    def first_unwritten(self, run_id: str) -> Fact | None:
        """The first fact of a run that is not written; None where all are."""
        return next((fact for owner, fact in self._unwritten_facts if owner == run_id), None)

    def drop(self, run_id: str) -> None:
        """Have nothing happen of a run of which nothing is written."""
        self._unwritten_facts = [(owner, fact) for owner, fact in self._unwritten_facts if owner != run_id]
        self._unwritten = [output for output in self._unwritten if getattr(output, "run_id", "") != run_id]

    def take_back(self, facts: Collection[Fact]) -> bool:
        """Have nothing happen of these facts where they are not written; whether that is so of any."""
        gone = {id(fact) for fact in facts}
        left = [(owner, fact) for owner, fact in self._unwritten_facts if id(fact) not in gone]
        is_unwritten = len(left) < len(self._unwritten_facts)
        self._unwritten_facts = left
        self._unwritten = [one for one in self._unwritten if id(getattr(one, "fact", None)) not in gone]
        return is_unwritten

    def poll(self, now: float) -> None:
        """Go on, or try again, where it is time to."""
        due = self.next_deadline()
        if due is not None and now >= due:
            self._retry_at = self._goes_on_at = None
            self.do([])

    def do(self, outputs: Iterable[Output], *, must_be_written: bool = False) -> None:
        """Write down what has happened, then carry it out, and what follows from that, as far as this turn goes.

        Raises:
            StorageUnavailable: it cannot be written, and somebody must know.
        """
        self.hold(outputs)
        if self._is_carrying_out:
            return  # whoever carries out takes this as well
        if self._goes_on_at is not None and not must_be_written:
            return  # the next turn takes it, in one transaction with all else that comes until then
        self._is_carrying_out = True
        try:
            with self._journal.one_sync():
                self._write()
                self._carry_out_written(asks_first=not must_be_written)
        except StorageUnavailable as error:
            if self._retry_at is None:
                self._log.error("runs cannot be recorded and are suspended", reason=str(error))
            self.problem = f"runs cannot be recorded and are suspended: {error}"
            self._retry_at = self._clock() + RETRY_S
            if must_be_written:
                raise
        finally:
            self._is_carrying_out = False
        self._sooner()

    def _carry_out_written(self, *, asks_first: bool) -> None:
        if self._goes_on_at is not None:
            return  # it is written, and has its place behind what waits
        until, has_asked = self._clock() + TURN_S, not asks_first
        while self._written or self._unwritten or self._unwritten_facts:
            if not self._written:
                self._write()
            elif self._clock() > until:
                self._goes_on_at = self._clock()
                return
            elif self._to_ask and (asks_first or self._to_ask[0] is self._written[0]):
                self._ask_one(self._to_ask.popleft())
                if not has_asked and not self._to_ask:
                    # A slow disk keeps back requests, and nothing that is shown. Once: an answer may bring a request.
                    until, has_asked = self._clock() + TURN_S, True
            else:
                self._carry_out_one(self._written.popleft())

    def _ask_one(self, output: TaskOutput) -> None:
        if isinstance(output, TaskCancelled):
            self._taken_back[output.execution_id] -= 1
            if not self._taken_back[output.execution_id]:
                del self._taken_back[output.execution_id]
        try:
            self._ask(output, self._taken_back.keys())
        except StorageUnavailable:
            raise
        except Exception as error:  # noqa: BLE001 - the outputs behind it are other runs' too
            self._mistakes.caught("outputs of runs", error, what=type(output).__name__)
            if isinstance(output, TaskStarted):
                self._failed(output.execution_id, error)

    def _carry_out_one(self, output: Output) -> None:
        try:
            self._carry_out(output)
        except StorageUnavailable:
            raise
        except Exception as error:  # noqa: BLE001 - the outputs behind it are other runs' too
            self._mistakes.caught("outputs of runs", error, what=type(output).__name__)

    def _write(self) -> None:
        facts, faults, halts, holds = (
            self._unwritten_facts,
            self._changed_faults,
            self._changed_halts,
            self._changed_holds,
        )
        begun = [one for one in self._unwritten if isinstance(one, TaskStarted)]
        requests = self._requests.prepare(one for one in begun if one.execution_id not in self._taken_back)
        left = self._requests.left
        if facts or faults or halts or holds or requests or left:
            self._journal.write(facts, faults.values(), halts.values(), holds.values(), requests, left)
            self._requests.recorded(requests, left)
            if self.problem:
                self.problem = ""
                self._log.info("runs are recorded again and go on")
            for written in (facts, faults, halts, holds):
                written.clear()
        self._to_ask += [one for one in self._unwritten if isinstance(one, TaskOutput)]
        self._written += self._unwritten
        self._unwritten.clear()
