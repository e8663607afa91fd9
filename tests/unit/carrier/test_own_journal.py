"""The executions of a bridge in two journals: its own runs' and all others."""

from __future__ import annotations

from pathlib import Path

from tests.unit.carrier.test_hand_over import world_in
from ua_fleet.bridge.journals import ExecutionJournals
from ua_fleet.skill.executions import ExecutionState


def test_executions_of_both_journals_are_found_and_forgotten_in_their_own(tmp_path: Path) -> None:
    with world_in(tmp_path) as world:
        world.until(lambda: world.cell.robot.begun)
        assert world.cell.records is not None
        own = world.cell.records.executions
        (ours,) = own.executions()
        theirs = ours._replace(execution_id=bytes(16), requestor_id="0.x", space=0, issued=ours.issued - 5)
        before = ours._replace(execution_id=bytes(15) + b"\1", issued=ours.issued - 9)
        world.cell.journal.recorded(before)  # by a version that had one journal
        journals = ExecutionJournals(300, world.cell.journal)
        assert [*journals.record_own_in(own)] == [ours]
        journals.recorded(theirs)
        assert [*journals.executions()] == [before, theirs, ours]
        for each in (before, ours):
            done = each.report._replace(state=ExecutionState.DONE)
            journals.reported(each.execution_id, done)
        states = [one.report.state for one in (*world.cell.journal.executions(), *own.executions())]
        assert states == [ExecutionState.DONE, ExecutionState.RUNNING, ExecutionState.DONE]
        journals.forget_executions([before.execution_id, ours.execution_id], {300: ours.issued})
        assert [*journals.executions()] == [theirs]
        assert journals.forgotten() == own.forgotten() == {300: ours.issued}
