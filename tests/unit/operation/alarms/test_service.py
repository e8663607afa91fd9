"""The alarms of a server: one commit for a storm, what cannot be written down, faults, restarts."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from itertools import count
from pathlib import Path

import pytest
import structlog

from ua_fleet.errors import StorageUnavailable
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.operation.alarms.condition import ConditionState, Shelving
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.alarms.levels import Levels
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.orchestrator import FaultFound
from ua_fleet.storage.alarm_states import AlarmStates, StoredAlarm
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.values import BuiltinType, NodeId


class Weak(AlarmStates):
    """A file that counts commits, and may be told to fail."""

    fails = False
    commits = 0

    def put(self, states: Iterable[StoredAlarm]) -> None:
        if self.fails:
            raise StorageUnavailable("the disk is full; free some space")
        self.commits += 1
        super().put(states)


class Plant:
    def __init__(self, records: ServerRecords, alarms: int = 3) -> None:
        self.now, self.told, self.found = 100.0, list[tuple[str, ConditionState]](), list[FaultFound]()
        self.states = records.alarms
        self.states.__class__ = Weak
        numbers = count(1)
        self.service = AlarmService(
            [definition(number) for number in range(alarms)],
            self.states,
            notify=lambda one, state: self.told.append((one.id, state)),
            found=self.found.extend,
            make_event_id=lambda: next(numbers).to_bytes(16),
            wall_s=lambda: self.now,
            sooner=lambda: None,
            log=structlog.get_logger("test"),
        )

    def say(self, number: int, value: float) -> None:
        self.service.value_changed(ValueChanged(NodeId(2, number), int(BuiltinType.DOUBLE), value, 0, 0, True))


def definition(number: int) -> AlarmDefinition:
    key = NodeId(2, number)
    return AlarmDefinition(
        f"r.v{number}",
        AlarmKind.LEVEL,
        key,
        f"r.v{number}",
        key,
        levels=Levels(high=10),
        robot="r",
        capacities=("fly",),
    )


def test_a_storm_is_one_commit_and_each_is_a_fault(tmp_path: Path) -> None:
    with ServerRecords(tmp_path) as records:
        plant = Plant(records, 500)
        for number in range(500):
            plant.say(number, 11)
        assert plant.service.next_deadline(5.0) == 5.0
        plant.service.poll(5.0)
        assert plant.states.commits == 1  # type: ignore[attr-defined]
        assert len(plant.told) == len(plant.found) == 500
        assert plant.found[7] == FaultFound("r", "alarm.v7", True, "r.v7: 11 is above 10", ("fly",))
    with ServerRecords(tmp_path) as records:
        again = Plant(records, 500)
        assert [one.state for one in again.service] == [state for _, state in plant.told]
        assert len([one for one in again.service.faults() if one.active]) == 500


def test_what_cannot_be_written_down_is_shown_and_written_later(tmp_path: Path) -> None:
    with ServerRecords(tmp_path) as records:
        plant = Plant(records)
        plant.states.fails = True  # type: ignore[attr-defined]
        plant.say(1, 11)
        plant.service.poll(0.0)
        assert [one for one, _ in plant.told] == ["r.v1"]
        assert "disk is full" in plant.service.problem
        one = plant.service.known("r.v1")
        with pytest.raises(StorageUnavailable):
            plant.service.do(one, lambda now: one.acknowledge(one.state.event_id, "x", "olga", now))
        assert not one.state.acked, "a person is told that it was not done"
        plant.states.fails = False  # type: ignore[attr-defined]
        plant.now += 1.0
        plant.service.poll(0.0)
        assert plant.service.problem == ""
        assert [stored.id for stored in plant.states.states()] == ["r.v1"]


def test_a_file_from_before_alarms_gets_their_table(tmp_path: Path) -> None:
    ServerRecords(tmp_path).close()
    with sqlite3.connect(tmp_path / "server.db") as connection:
        connection.execute("DROP TABLE alarms")
    connection.close()
    with ServerRecords(tmp_path) as records:
        assert records.alarms.states() == []


def test_a_value_within_its_band_is_not_looked_at(tmp_path: Path) -> None:
    with ServerRecords(tmp_path) as records:
        plant = Plant(records)
        plant.say(1, 5)
        [one] = [each for each in plant.service if each.definition.id == "r.v1"]
        assert (one.floor, one.ceiling) == (float("-inf"), 10)
        for odd in (None, "hot", (1.0,)):
            plant.service.value_changed(ValueChanged(NodeId(2, 1), 0, odd, 0, 0, False))
            assert one.state.level == 0
        plant.say(1, 9)
        plant.say(1, 10)
        assert one.value == 10
        assert plant.service.next_deadline(0.0) is None


def test_values_that_come_while_an_alarm_is_shelved_leave_nothing_behind(tmp_path: Path) -> None:
    with ServerRecords(tmp_path / "server.db") as records:
        plant = Plant(records)
        service = plant.service
        plant.say(0, 95.0)
        service.poll(0.0)
        shelved = service.known(next(iter(service.conditions)))
        service.do(shelved, lambda now: shelved.shelve_for(3600.0, now))
        sooner = service.next_deadline(0.0)
        for number in range(10_000):
            plant.say(0, 95.0 if number % 2 else -95.0)
            service.poll(0.0)
        assert len(service._due) <= 2  # pyright: ignore[reportPrivateUsage]
        assert service.next_deadline(0.0) == sooner
        plant.now += 3601.0
        service.poll(0.0)
        assert shelved.state.shelving is Shelving.UNSHELVED
