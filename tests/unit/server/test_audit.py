from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.errors import ServerStartError
from ua_fleet.server.audit import REFUSALS_PER_MINUTE, AuditLog, Caller, summary

CALLER = Caller("10.0.0.7:5000", "alice", "operator", "3f2a")


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_one_line_for_each(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "audit.log")
    log.record("write", CALLER, "Good", node="ns=2;i=1", value="1.5")
    log.record_all("write", CALLER, [{"node": "a", "status": "Good"}, {"node": "b", "status": "BadNotWritable"}])
    log.close()
    first, second, third = lines(tmp_path / "audit.log")
    assert {key: first[key] for key in ("event", "user", "role", "session", "client", "node", "value", "status")} == {
        "event": "write",
        "user": "alice",
        "role": "operator",
        "session": "3f2a",
        "client": "10.0.0.7:5000",
        "node": "ns=2;i=1",
        "value": "1.5",
        "status": "Good",
    }
    assert first["time"].endswith("Z")
    assert (second["node"], third["status"]) == ("a", "BadNotWritable")
    assert (tmp_path / "audit.log").stat().st_mode & 0o777 == 0o600


def test_no_line_can_be_forged(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "audit.log")
    log.refuse(Caller("10.0.0.7:1"), "login", "Bad", reason='x"}\n{"event": "login", "status": "Good"}\x1b[2J\u2028')
    log.close()
    text = (tmp_path / "audit.log").read_text()
    assert text.count("\n") == 1
    assert text.isascii()
    assert "\x1b" not in text


def test_size_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "audit.log"
    log = AuditLog(path, max_bytes=1_000, backups=2)
    for number in range(100):
        log.record("write", CALLER, "Good", node=f"ns=2;i={number}")
    log.close()
    names = sorted(entry.name for entry in tmp_path.iterdir())
    assert names == ["audit.log", "audit.log.1", "audit.log.2"]
    assert all((tmp_path / name).stat().st_size <= 1_000 for name in names)
    assert all((tmp_path / name).stat().st_mode & 0o777 == 0o600 for name in names)
    assert lines(path)[-1]["node"] == "ns=2;i=99"
    assert lines(tmp_path / "audit.log.1")[-1]["node"] < lines(path)[0]["node"]


def test_old_lines_stay_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "audit.log"
    for number in range(3):
        log = AuditLog(path)
        log.record("write", CALLER, "Good", node=str(number))
        log.close()
    assert [line["node"] for line in lines(path)] == ["0", "1", "2"]


def test_refusals_cannot_push_other_lines_out(tmp_path: Path) -> None:
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", clock=lambda: now)
    for _ in range(10_000):
        log.refuse(Caller("10.0.0.9:1"), "login", "BadUserAccessDenied")
    log.refuse(Caller("10.0.0.10:1"), "login", "BadUserAccessDenied")
    assert log.omitted == 10_000 - REFUSALS_PER_MINUTE
    now = 60.0
    log.refuse(Caller("10.0.0.9:2"), "login", "BadUserAccessDenied")
    log.close()
    written = lines(tmp_path / "audit.log")
    assert len(written) == REFUSALS_PER_MINUTE + 2
    assert written[-1]["omitted_before"] == 10_000 - REFUSALS_PER_MINUTE


def test_a_full_disk_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = AuditLog(tmp_path / "audit.log")

    def full(_descriptor: int, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context:
        context.setattr(os, "write", full)
        log.record("write", CALLER, "Good")
    log.record("write", CALLER, "Good", node="after")
    log.close()
    assert [line.get("node") for line in lines(tmp_path / "audit.log")] == ["after"]


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ServerStartError, match="state_dir"):
        AuditLog(tmp_path / "file" / "audit.log")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.5, "1.5"),
        ("a", "'a'"),
        (b"secret", "6 bytes"),
        ([1, 2], "[1, 2]"),
        (list(range(9)), "array of 9"),
        (None, "None"),
    ],
)
def test_summary(value: object, text: str) -> None:
    assert summary(value) == text


def test_summary_is_short() -> None:
    assert len(summary("x" * 1_000_000)) < 210
