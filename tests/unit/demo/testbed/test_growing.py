"""What robots' programs append to files is read once, however the files change."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from ua_demo import report as reporting
from ua_demo.testbed.growing import GrowingFiles


def test_whole_lines_come_once(tmp_path: Path) -> None:
    files = GrowingFiles(tmp_path, ".events")
    assert files.new_lines() == []
    path = tmp_path / "ned.events"
    path.write_text("one\ntw")
    (tmp_path / "ned.traffic").write_text("another\n")
    assert files.new_lines() == ["one"]
    with path.open("a") as file:
        file.write("o\nthree\n")
    assert files.new_lines() == ["two", "three"]
    assert files.new_lines() == []
    path.unlink()
    assert files.new_lines() == []
    path.write_text("anew\n")
    assert files.new_lines() == ["anew"]


def test_only_files_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "events"
    folder.mkdir()
    (tmp_path / "password").write_text("secret\n")
    (folder / "link.events").symlink_to(tmp_path / "password")
    os.mkfifo(folder / "pipe.events")
    (folder / "ned.events").write_text("one\n")
    assert GrowingFiles(folder, ".events").new_lines() == ["one"]


def test_nothing_is_missed_or_read_twice_when_a_file_is_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("UA_FLEET_EVENTS", str(tmp_path / "ned.events"))
    monkeypatch.setattr(reporting, "MOST_BYTES", 300)
    files = GrowingFiles(tmp_path, ".events")
    numbers: list[int] = []
    for number in range(20):
        reporting.report("ned", "moves", number=number)
        if number % 3 == 0:
            numbers += [json.loads(line)["number"] for line in files.new_lines()]
    numbers += [json.loads(line)["number"] for line in files.new_lines()]
    assert numbers == list(range(20))
    assert len(capsys.readouterr().out.splitlines()) == 20
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 1000


def test_a_heart_beats_where_one_is_wanted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UA_FLEET_HEARTBEAT", raising=False)
    reporting.beat()
    heart = tmp_path / "heartbeat"
    monkeypatch.setenv("UA_FLEET_HEARTBEAT", str(heart))
    reporting.beat()
    first = heart.stat().st_mtime_ns
    reporting.beat()
    assert heart.stat().st_mtime_ns >= first
    monkeypatch.setenv("UA_FLEET_HEARTBEAT", str(tmp_path / "missing" / "heartbeat"))
    reporting.beat()
