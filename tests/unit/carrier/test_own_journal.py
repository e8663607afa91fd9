"""The executions of a bridge in two journals: its own runs' and all others."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.unit.carrier.test_hand_over import world_in
from ua_fleet.bridge.journals import ExecutionJournals
from ua_fleet.errors import StorageUnavailable
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


def test_a_failed_sync_of_the_own_journal_is_told_to_those_who_need_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with world_in(tmp_path) as world:
        world.until(lambda: world.cell.robot.begun)
        assert world.cell.records is not None
        own = world.cell.records.executions
        (ours,) = own.executions()
        theirs = ours._replace(execution_id=bytes(16), requestor_id="0.x", space=0)
        journals = ExecutionJournals(300, world.cell.journal)
        journals.record_own_in(own)

        records = world.cell.records

        def failed(_file: int) -> None:
            raise OSError(5, "Input/output error")

        def turn() -> None:
            with records.one_sync():
                journals.recorded(ours._replace(execution_id=bytes(15) + b"\1"))
                with pytest.raises(StorageUnavailable, match="could not be synced"):
                    journals.settle()

        with monkeypatch.context() as patched:
            patched.setattr(os, "fdatasync", failed)
            with pytest.raises(StorageUnavailable, match="could not be synced"):
                turn()
        journals.recorded(theirs)
        journals.settle()
        assert [*world.cell.journal.executions()] == [theirs]
        with pytest.raises(StorageUnavailable, match="could not be synced"):
            journals.settle(is_own=True)
        with pytest.raises(StorageUnavailable, match="could not be synced"):
            journals.reported(ours.execution_id, ours.report)
