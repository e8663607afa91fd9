"""What a run decides and what robots are asked for is one commit, synced before anything is sent; killed anywhere."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from tests.kill_points import counted_syncs, kill_points
from tests.unit.operation.runs.recorded_world import Machines, RecordedWorld
from ua_fleet.errors import StorageUnavailable
from ua_fleet.orchestrator import Output, RunChanged
from ua_fleet.scenario.facts import TaskAssigned, TaskOutcome, TaskOver, Then
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, Target
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.storage.database import Database
from ua_fleet.storage.server_records import ServerRecords

TASKS = 5
CHAIN = "version: 1\nname: chain\nsteps:\n" + "".join(
    f"  - {{task: t{number}, skill: grab, robot: left, arguments: {{angle: {number}}}}}\n" for number in range(TASKS)
)
PAIR = """\
version: 1
name: pair
steps:
  - parallel:
      - {task: one, skill: grab, robot: left}
      - {task: two, skill: grab, robot: right}
"""


def assigned(records: ServerRecords) -> list[str]:
    """The executions that runs have given to robots."""
    facts = [fact for run in records.runs.runs() for fact in records.runs.facts(run.run_id)]
    return [fact.execution_id for fact in facts if isinstance(fact, TaskAssigned)]


def over(records: ServerRecords) -> int:
    facts = [fact for run in records.runs.runs() for fact in records.runs.facts(run.run_id)]
    return sum(isinstance(fact, TaskOver) for fact in facts)


def requested(records: ServerRecords) -> list[str]:
    return [request.execution_id.hex() for request in records.requests.requests()]


def test_a_task_costs_two_syncs(tmp_path: Path) -> None:
    with counted_syncs() as syncs:
        world = RecordedWorld(tmp_path)
        syncs.take()
        world.start(CHAIN)
        costs = [syncs.take()]
        for number in range(TASKS):
            world.respond(world.asked()[number])
            costs.append(syncs.take())
            world.end()
            costs.append(syncs.take())
        world.close()
    assert world.ended() == ["done"]
    assert costs == [1, *[1, 1] * TASKS], "each is accepted, and ends where the next one begins"


def test_many_tasks_that_begin_at_once_cost_one_sync(tmp_path: Path) -> None:
    with counted_syncs() as syncs:
        world = RecordedWorld(tmp_path)
        syncs.take()
        world.start(PAIR)
        assert (len(world.asked()), syncs.take()) == (2, 1)
        world.close()


def test_a_task_and_the_request_for_it_are_there_both_or_neither(tmp_path: Path) -> None:
    (tmp_path / "state").mkdir()
    with kill_points(tmp_path / "state", tmp_path) as points:
        world = RecordedWorld(tmp_path / "state")
        world.start(CHAIN)
        world.do_all()
        world.close()
    assert world.ended() == ["done"]
    found: set[int] = set()
    for point, _ in points.made:
        with ServerRecords(point) as records:
            assert assigned(records) == requested(records), point
            found.add(len(requested(records)))
    assert found == set(range(TASKS + 1))


def test_what_clients_are_asked_for_is_recorded_with_it_too(tmp_path: Path) -> None:
    record = RecordedExecution(
        bytes(15) + b"\7", "0.server", 0, Target(0, 2, 1100, 1), b"", 5, 9000, ExecutionReport(ExecutionState.RUNNING)
    )
    fact = TaskAssigned(1.0, "0", "a", 1, "mechanic", record.execution_id.hex(), "fix")
    (tmp_path / "state").mkdir()
    with kill_points(tmp_path / "state", tmp_path) as points, ServerRecords(tmp_path / "state") as records:
        records.runs.write([("r1", fact)], requests=[record])
        records.runs.write([("r1", TaskOver(2.0, "0", 1, TaskOutcome.REFUSED, Then.FAILED))], unasked=[record[0]])
        assert list(records.executions.executions()) == []
    found: list[tuple[int, int, int]] = []
    for point, _ in points.made:
        with ServerRecords(point) as records:
            found.append((len(assigned(records)), len(records.executions.executions()), over(records)))
    assert set(found) == {(0, 0, 0), (1, 1, 0), (1, 0, 1)}


def test_nothing_is_sent_before_all_is_synced(tmp_path: Path) -> None:
    pending: list[bool] = []
    with counted_syncs() as syncs:
        world = RecordedWorld(tmp_path)
        world.before_send = lambda: pending.append(syncs.is_pending)
        world.start(CHAIN)
        world.do_all()
        world.close()
    assert len(pending) == 2 * TASKS, "a request, and Idle after its response"
    assert not any(pending)


@pytest.mark.parametrize(("scenario", "count"), [(CHAIN, TASKS), (PAIR, 2)])
def test_a_run_that_is_killed_anywhere_is_done_once(tmp_path: Path, scenario: str, count: int) -> None:
    (tmp_path / "state").mkdir()
    machines = Machines()
    with kill_points(tmp_path / "state", tmp_path) as points:
        points.state = lambda: dict(machines.told)
        world = RecordedWorld(tmp_path / "state", machines)
        world.start(scenario)
        world.do_all()
        world.close()
    assert len(machines.told) == count
    began = 0
    for point, told in points.made:
        again = RecordedWorld(point, Machines(told))
        is_recorded = bool(again.file.runs.runs())
        assert is_recorded or not told, "robots are asked for what is recorded"
        again.do_all()
        assert len(again.machines.told) == (count if is_recorded else 0), point
        assert [one.ended for one in again.file.runs.runs()] == [True] * is_recorded, point
        began += is_recorded
        again.close()
    assert began > count


def test_a_request_that_is_taken_back_before_its_turn_is_not_sent(tmp_path: Path) -> None:
    (tmp_path / "state").mkdir()
    with kill_points(tmp_path / "state", tmp_path) as points:
        world = RecordedWorld(tmp_path / "state")
        world.output_s = 1.0
        run_id = world.start(CHAIN)
        assert assigned(world.file) == requested(world.file), "recorded, and behind what takes its time"
        assert world.sent == []
        world.service.runs.abort(run_id, "enough", "anna")
        world.pass_time(60.0)
        assert world.sent == []
        assert world.ended() == ["aborted enough"]
        assert (len(assigned(world.file)), requested(world.file), over(world.file)) == (1, [], 1)
        world.close()
    aborted = 0
    for point, _ in points.made:
        again = RecordedWorld(point)
        outcomes = [str(run.ended) for run in again.file.runs.runs()]
        is_to_end = over(again.file) or any(again.service.must_not_begin())
        asked = [one for one in again.asked() if one.timeout_hint_ms]
        if is_to_end:
            aborted += 1
            assert asked == [], f"{point}: {outcomes}"
        again.close()
    assert aborted > 1


def test_a_request_that_could_not_be_made_at_once_is_recorded_when_it_is(tmp_path: Path) -> None:
    world = RecordedWorld(tmp_path, is_announced=False)
    world.start(CHAIN)
    assert (len(assigned(world.file)), requested(world.file), world.sent) == (1, [], [])
    world.announce()
    world.pass_time(1.0)
    assert assigned(world.file) == requested(world.file)
    world.do_all()
    assert world.ended() == ["done"]
    world.close()


def test_a_full_disk_lets_nothing_begin_and_nothing_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise StorageUnavailable("server.db: the disk is full; free some space")

    world = RecordedWorld(tmp_path)
    world.start(CHAIN)
    [first] = world.asked()
    with monkeypatch.context() as patch:
        patch.setattr(Database, "commit", full)
        world.respond(first)
        world.end()
        assert len(world.sent) == 1, "neither Idle nor the next request"
        assert world.service.problem.endswith("the disk is full; free some space")
        with pytest.raises(StorageUnavailable):
            world.start(PAIR)
    world.pass_time(2.0)
    assert world.service.problem == ""
    assert assigned(world.file) == requested(world.file)
    world.do_all()
    assert world.ended() == ["done"]
    assert len(world.machines.told) == TASKS
    world.close()


def test_a_disk_that_cannot_be_synced_lets_nothing_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    world = RecordedWorld(tmp_path)
    world.start(CHAIN)
    [first] = world.asked()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", broken)
        world.respond(first)
    assert len(world.sent) == 1
    world.end()
    for _ in range(30):
        world.pass_time(1.0)
        world.commands.poll(world.now)
    assert len(world.sent) == 1, "what the kernel says of the next sync tells nothing of the one that failed"
    assert "the disk could not be synced (Input/output error)" in world.service.problem
    with pytest.raises(StorageUnavailable, match="look at the disk, and start this process again"):
        world.start(PAIR)
    world.close()
    again = RecordedWorld(tmp_path, world.machines)
    again.do_all()
    assert again.ended() == ["done"]
    assert len(again.machines.told) == TASKS
    again.close()


def test_a_robot_is_asked_for_its_next_task_before_the_end_of_the_last_one_is_shown(tmp_path: Path) -> None:
    seen: list[str] = []

    class Seeing(RecordedWorld):
        def show(self, output: Output) -> None:
            super().show(output)
            seen.append(type(output.fact if isinstance(output, RunChanged) else output).__name__)

    world = Seeing(tmp_path)
    world.start(CHAIN)
    [first] = world.asked()
    world.respond(first)
    seen.clear()
    world.before_send = lambda: seen.append("asked")
    world.end()
    told = [what for what in seen if what in ("asked", "TaskOver", "TaskAssigned", "TaskStarted")]
    assert told == ["asked", "TaskOver", "TaskAssigned", "TaskStarted"]
    world.close()
