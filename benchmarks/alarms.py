"""What limits cost: values that change through the alarms of 10,000 numbers, as the server's core hands them on.

A value within its limits, as values are for most of the time, costs a comparison. One that goes over a limit, or back,
begins a delay or ends one. What is written down and told of an alarm is not counted.
"""

from __future__ import annotations

import time
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import structlog

from benchmarks.harness import Figure, interleaved, within
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.alarms.levels import Levels
from ua_fleet.operation.alarms.service import AlarmService
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.values import BuiltinType, NodeId

ALARMS = 10_000
MOST_US = 2.0


def _values(round_number: int) -> list[ValueChanged]:
    return [
        ValueChanged(NodeId(2, number), int(BuiltinType.DOUBLE), 20.0 + (number + round_number) % 50, 0, 0, True)
        for number in range(ALARMS)
    ]


def figures(rounds: int) -> list[Figure]:
    with TemporaryDirectory() as folder, ServerRecords(Path(folder)) as records:
        numbers = count()
        alarms = AlarmService(
            [
                AlarmDefinition(
                    f"r.v{number}",
                    AlarmKind.LEVEL,
                    NodeId(2, number),
                    f"r.v{number}",
                    NodeId(2, number),
                    levels=Levels(80, 90, 10, 5, 2),
                    delay_s=1,
                )
                for number in range(ALARMS)
            ],
            records.alarms,
            notify=lambda _definition, _state: None,
            found=lambda _found: None,
            make_event_id=lambda: next(numbers).to_bytes(16),
            wall_s=time.time,
            sooner=lambda: None,
            log=structlog.get_logger("benchmarks"),
        )
        seen = count(1)

        def looked_at() -> float:
            values, watched, look = _values(next(seen)), alarms.watched, alarms.look
            started = time.perf_counter()
            for change in values:
                if (alarm := watched.get(change.key)) is not None:
                    look(alarm, change)
            return (time.perf_counter() - started) / ALARMS

        def transitions() -> float:
            high = next(seen) % 2
            values = [change._replace(value=50.0 if high else 2.0) for change in _values(0)]
            started = time.perf_counter()
            for change in values:
                alarms.value_changed(change)
            return (time.perf_counter() - started) / ALARMS

        looked_at()  # the first value sets the bands
        within_limits, over_limits = interleaved(rounds, [looked_at, transitions])
    return [
        within(f"a value of {ALARMS:,} limit alarms, within its limits", within_limits * 1e6, "us", MOST_US),
        within(f"a value of {ALARMS:,} limit alarms that goes over a limit or back", over_limits * 1e6, "us", 20.0),
    ]
