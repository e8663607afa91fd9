"""What has happened is written down, and then carried out.

What follows from one input is written down as one, before any of it is carried out or shown. Where that fails it is
tried again until it is written: nothing is carried out meanwhile, and nothing is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any, Final

import structlog

from ua_fleet.errors import StorageUnavailable
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.orchestrator import Fault, FaultChanged, HaltChanged, HoldChanged, Output, TaskCancelled, TaskStarted
from ua_fleet.scenario.facts import Fact
from ua_fleet.storage.run_journal import RunJournal

__all__ = ["OutputCarrier"]

RETRY_S: Final = 1.0
"""After a journal that could not be written it is tried again after so long."""

_log: Any = structlog.get_logger("ua_fleet.scenarios")


class OutputCarrier:
    """The outputs of the orchestrator that wait, and the facts that are not written."""

    def __init__(
        self,
        journal: RunJournal,
        carry_out: Callable[[Output, Collection[str]], None],
        failed: Callable[[str, Exception], None],
        *,
        mistakes: Mistakes,
        clock: Callable[[], float],
        sooner: Callable[[], None],
    ) -> None:
        """Begin with nothing.

        Args:
            journal: of runs, faults, halts and holds.
            carry_out: carries one output out; told of the executions that an output behind it takes back.
            failed: told of an execution whose robot could not be asked, for a mistake of ours.
            mistakes: counts what has cost an output.
            clock: monotonic seconds.
            sooner: called when something was done, so that deadlines may have come nearer.
        """
        self._journal, self._carry_out, self._failed = journal, carry_out, failed
        self._mistakes, self._clock, self._sooner = mistakes, clock, sooner
        self._unwritten: list[tuple[str, Fact]] = []
        self._held: list[Output] = []
        """Outputs that are carried out once their facts are written."""
        self._changed_faults: dict[str, Fault] = {}
        self._changed_halts: dict[str, HaltChanged] = {}
        self._changed_holds: dict[str, HoldChanged] = {}
        self._is_carrying_out = False
        self.retry_at: float | None = None
        """When to try again, by the monotonic clock."""
        self.problem = ""
        """Why nothing is carried out; empty while it is."""

    @property
    def is_behind(self) -> bool:
        """Whether something waits to be carried out."""
        return bool(self._held)

    def note(self, run_id: str, fact: Fact) -> None:
        """A fact of a run is to be written down."""
        self._unwritten.append((run_id, fact))

    def hold(self, outputs: Iterable[Output]) -> None:
        """Outputs wait for the next `do`."""
        self._held += outputs

    def first_unwritten(self, run_id: str) -> Fact | None:
        """The first fact of a run that is not written; None where all are."""
        return next((fact for owner, fact in self._unwritten if owner == run_id), None)

    def drop(self, run_id: str) -> None:
        """Have nothing happen of a run of which nothing is written."""
        self._unwritten = [(owner, fact) for owner, fact in self._unwritten if owner != run_id]
        self._held = [output for output in self._held if getattr(output, "run_id", "") != run_id]

    def poll(self, now: float) -> None:
        """Try again, where it is time to."""
        if self.retry_at is not None and now >= self.retry_at:
            self.retry_at = None
            self.do([])

    def do(self, outputs: Iterable[Output], *, must_be_written: bool = False) -> None:
        """Write down what has happened, then carry it out, and what follows from that.

        Raises:
            StorageUnavailable: it cannot be written, and somebody must know.
        """
        self._held += outputs
        if self._is_carrying_out:
            return  # whoever carries out takes this as well
        self._is_carrying_out = True
        try:
            while self._held or self._unwritten:
                self._write()
                if self._held:
                    self._carry_out_one(self._held.pop(0))
        except StorageUnavailable as error:
            if self.retry_at is None:
                _log.error("runs cannot be written down, and stand still", reason=str(error))
            self.problem = f"runs cannot be written down, and stand still: {error}"
            self.retry_at = self._clock() + RETRY_S
            if must_be_written:
                raise
        finally:
            self._is_carrying_out = False
        self._sooner()

    def _carry_out_one(self, output: Output) -> None:
        taken_back: list[str] = []
        if isinstance(output, TaskStarted):
            taken_back = [later.execution_id for later in self._held if isinstance(later, TaskCancelled)]
        try:
            self._carry_out(output, taken_back)
        except StorageUnavailable:
            raise
        except Exception as error:  # noqa: BLE001 - the outputs behind it are other runs' too
            self._mistakes.caught("outputs of runs", error, what=type(output).__name__)
            if isinstance(output, TaskStarted):
                self._failed(output.execution_id, error)

    def _write(self) -> None:
        for output in self._held:
            if isinstance(output, FaultChanged):
                self._changed_faults[output.fault.id] = output.fault
            elif isinstance(output, HaltChanged):
                self._changed_halts[output.halt.execution_id] = output
            elif isinstance(output, HoldChanged):
                self._changed_holds[output.hold.robot] = output
        faults, halts, holds = self._changed_faults, self._changed_halts, self._changed_holds
        if not (self._unwritten or faults or halts or holds):
            return
        self._journal.write(self._unwritten, faults.values(), halts.values(), holds.values())
        if self.problem:
            self.problem = ""
            _log.info("runs are written down again, and go on")
        self._unwritten.clear()
        faults.clear()
        halts.clear()
        holds.clear()
