"""One line when something goes away, one when it comes back; and two for each execution."""

from __future__ import annotations

from typing import Any

import pytest
import structlog
from structlog.testing import capture_logs

from ua_fleet.bridge.driver import DriverStatus
from ua_fleet.bridge.execution_log import ExecutionLog
from ua_fleet.bridge.link_log import LinkLog
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, Target
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.values import StatusCode

THERE, AWAY = DriverStatus(True, "here"), DriverStatus(False, "no cable")


def several(**reasons: str) -> DriverStatus:
    return DriverStatus(not any(reasons.values()), "some", reasons)


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ([THERE, THERE, AWAY, AWAY, THERE], ["connected", "not connected", "connected"]),
        ([AWAY, THERE, THERE], ["connected"]),
        ([AWAY, AWAY, AWAY, THERE], ["not connected", "connected"]),
        ([AWAY, DriverStatus(False, "another reason"), AWAY], ["not connected"]),
    ],
)
def test_a_space_has_one_line_for_each_change(seen: list[DriverStatus], said: list[str]) -> None:
    with capture_logs() as lines:
        log = LinkLog(structlog.get_logger())
        for status in seen:
            log.take(status)
    assert [line["event"].removesuffix(" to the space") for line in lines] == said
    assert {line["log_level"] for line in lines if line["event"].startswith("not")} <= {"warning"}


def test_each_of_several_devices_has_lines_of_its_own() -> None:
    with capture_logs() as lines:
        log = LinkLog(structlog.get_logger())
        for status in (
            several(press="not asked yet", oven=""),
            several(press="", oven=""),
            several(press="no cable", oven=""),
            several(press="no power", oven="no power"),
            several(press="no power", oven=""),
            several(press="", oven=""),
        ):
            log.take(status)
    assert [(line["device"], line["event"], line.get("reason", "")) for line in lines] == [
        ("oven", "device answers again", ""),
        ("press", "device answers again", ""),
        ("press", "device does not answer", "no cable"),
        ("oven", "device does not answer", "no power"),
        ("oven", "device answers again", ""),
        ("press", "device answers again", ""),
    ]


def test_a_source_that_is_put_aside_has_a_line_each_way_and_a_crowd_has_one() -> None:
    crowd = {f"/ua_1_2_{number}": "rubbish" for number in range(100)}
    with capture_logs() as lines:
        log = LinkLog(structlog.get_logger())
        for aside in ({}, {"/a": "no type"}, {"/a": "no type"}, {}, crowd, {}):
            log.take(DriverStatus(True, "here", aside=aside))
    said = [(line["event"], line.get("source")) for line in lines if "space" not in line["event"]]
    assert said[:2] == [("source is put aside", "/a"), ("source is gone, or sends valid data again", "/a")]
    assert len(said) == 2 + 6 + 6
    assert [line["put_aside"] for line in lines if line["event"] == "more sources"] == [95, 0]


def execution(state: ExecutionState, number: int = 1, status: int = 0, message: str = "") -> RecordedExecution:
    target = Target(300, 2, 1900, 1)
    return RecordedExecution(
        bytes([number] * 16), "0.server", 0, target, b"", 1, 1000, ExecutionReport(state, status, message)
    )


def test_an_execution_has_a_line_for_its_begin_and_one_for_its_end() -> None:
    with capture_logs() as lines:
        log = ExecutionLog(structlog.get_logger())
        for state in (ExecutionState.RUNNING, ExecutionState.RUNNING, ExecutionState.DONE, ExecutionState.DONE):
            log.take(execution(state), "arm", "lift")
        failed = execution(ExecutionState.FAILED, 2, StatusCode.BAD_TIMEOUT, "too heavy")
        log.take(failed, "arm", "lift")
    ids: dict[str, Any] = {"robot": "arm", "skill": "lift", "execution_id": "01" * 16}
    assert lines == [
        {"event": "execution begins", "log_level": "info", **ids, "requestor": "0.server"},
        {"event": "execution ended", "log_level": "info", **ids, "outcome": "done"},
        {
            "event": "execution ended",
            "log_level": "warning",
            **ids,
            "execution_id": "02" * 16,
            "outcome": "failed",
            "status": "BadTimeout",
            "reason": "too heavy",
        },
    ]


def test_an_execution_that_stands_goes_on() -> None:
    states = (
        ExecutionState.RUNNING,
        ExecutionState.SUSPENDED,
        ExecutionState.RUNNING,
        ExecutionState.ASKING,
        ExecutionState.UNKNOWN,
    )
    with capture_logs() as lines:
        log = ExecutionLog(structlog.get_logger())
        for state in states:
            log.take(execution(state), "arm", "lift")
    assert [line["event"] for line in lines] == [
        "execution begins",
        "execution suspended",
        "execution goes on",
        "the robot is asked what became of an execution",
        "execution ended",
    ]


def test_what_is_remembered_is_bounded() -> None:
    log = ExecutionLog(structlog.get_logger())
    with capture_logs() as lines:
        for number in range(1200):
            made = execution(ExecutionState.DONE)._replace(execution_id=number.to_bytes(16, "big"))
            log.take(made, "arm", "lift")
        lines.clear()
        for number in (1199, 0):
            log.take(execution(ExecutionState.DONE)._replace(execution_id=number.to_bytes(16, "big")), "arm", "lift")
    assert [line["execution_id"] for line in lines] == ["00" * 16], "the oldest was forgotten"
