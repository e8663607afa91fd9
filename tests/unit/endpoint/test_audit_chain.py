"""What `ua-fleet audit verify` finds, and what a kill leaves."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ua_fleet.endpoint.audit import AuditLog, Caller
from ua_fleet.endpoint.audit.chain import ChainLink, digest_of
from ua_fleet.endpoint.audit.verification import AuditLogMissing, ChainReport, verify

ANNA = Caller("10.0.0.7:5000", "anna", "operator", "3f2a")


def write(path: Path, count: int, *, first: int = 0, backups: int = 3, max_bytes: int = 4_000) -> None:
    log = AuditLog(path, max_bytes=max_bytes, backups=backups)
    for number in range(first, first + count):
        log.record("write", ANNA, "Good", node=f"n{number}")
    log.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A log of four files, with older ones gone."""
    written = tmp_path / "state" / "audit.log"
    write(written, 60)
    write(written, 60, first=60)
    assert sorted(entry.name for entry in written.parent.iterdir()) == [
        "audit.head",
        "audit.log",
        "audit.log.1",
        "audit.log.2",
        "audit.log.3",
    ]
    return written


def said(report: ChainReport) -> str:
    return "; ".join(f"{problem.file}:{problem.line}: {problem.text}" for problem in report.problems)


def edit(path: Path, change: Callable[[list[bytes]], None]) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    change(lines)
    path.write_bytes(b"".join(lines))


def test_a_log_that_nobody_touched_is_whole(path: Path) -> None:
    report = verify(path)
    assert (said(report), report.files, report.notes) == ("", 4, [])
    assert report.last.seq > 120
    assert report.last.digest == digest_of(path.read_bytes().splitlines()[-1])


def test_a_changed_line_is_found(path: Path) -> None:
    middle = path.with_name("audit.log.2")
    edit(middle, lambda lines: lines.__setitem__(3, lines[3].replace(b"anna", b"eva!")))
    assert said(verify(path)).startswith("audit.log.2:5: the line before this one (number ")


def test_a_removed_line_is_found(path: Path) -> None:
    edit(path.with_name("audit.log.1"), lambda lines: lines.__delitem__(slice(2, 4)))
    assert "missing before this one" in said(verify(path))
    assert said(verify(path)).startswith("audit.log.1:3: lines ")


def test_an_inserted_line_is_found(path: Path) -> None:
    edit(path, lambda lines: lines.insert(1, lines[0]))
    assert "was inserted or moved" in said(verify(path))
    edit(path, lambda lines: lines.insert(1, b'{"event": "write"}\n'))
    assert "no line of the chain" in said(verify(path))
    edit(path, lambda lines: lines.insert(1, b"\xff\n"))
    assert "no JSON" in said(verify(path))


def test_a_removed_file_is_found_the_oldest_too(path: Path) -> None:
    oldest = path.with_name("audit.log.3")
    kept = oldest.read_bytes()
    oldest.unlink()
    assert "no rotation removed them" in said(verify(path))
    oldest.write_bytes(kept)
    path.with_name("audit.log.2").unlink()
    assert said(verify(path)).startswith("audit.log.1:1: lines ")


def test_a_removed_end_is_found_also_by_the_next_start(path: Path) -> None:
    edit(path, lambda lines: lines.__delitem__(slice(-2, None)))
    assert "2 line(s) are missing at the end" in said(verify(path))
    write(path, 1)
    assert "are missing before this one" in said(verify(path))
    found = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["lines"] for line in found if line["event"] == "missing"] == [2]


def test_a_removed_newest_file_is_found(path: Path) -> None:
    path.unlink()
    assert "are missing at the end" in said(verify(path))
    write(path, 1)
    assert "missing before this one" in said(verify(path))


def test_a_changed_last_line_is_found_also_by_the_next_start(path: Path) -> None:
    edit(path, lambda lines: lines.__setitem__(-1, lines[-1].replace(b"anna", b"eva!")))
    assert "is not the one that audit.head knows" in said(verify(path))
    write(path, 1)
    assert "the last line was changed" in said(verify(path))


def test_a_removed_head_is_found(path: Path) -> None:
    path.with_name("audit.head").unlink()
    assert "audit.head" in said(verify(path))


def test_a_log_made_anew_is_found_by_an_anchor_alone(path: Path, tmp_path: Path) -> None:
    last = verify(path).last
    forged = tmp_path / "forged" / "audit.log"
    write(forged, last.seq + 10, max_bytes=1_000_000)
    assert verify(forged).whole
    assert "anchor" in said(verify(forged, [ChainLink(last.seq, last.digest[:12])]))
    assert verify(path, [ChainLink(last.seq, last.digest[:12])]).whole
    assert "missing at the end" in said(verify(path, [ChainLink(last.seq + 1, "0" * 8)]))


def test_lines_of_an_older_version_come_before_the_chain(tmp_path: Path) -> None:
    path = tmp_path / "audit.log"
    path.write_text('{"event": "login"}\n{"event": "write"}\n')
    write(path, 2)
    report = verify(path)
    assert (report.whole, report.unchained, report.lines) == (True, 2, 2)
    edit(path, lambda lines: lines.__setitem__(1, b'{"event": "forged"}\n'))
    assert "before the chain was changed" in said(verify(path))


def test_a_torn_line_is_cut_off_and_told(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b'{"time": "2026-')
    report = verify(path)
    assert report.whole
    assert "incomplete line" in report.notes[0]
    write(path, 1)
    report = verify(path)
    assert (report.whole, "cut off" in report.notes[0]) == (True, True)


@pytest.mark.parametrize("steps", [0, 1, 2, 3, 4])
def test_a_rotation_that_was_killed_in_between(path: Path, monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """At each of its steps: the line is written, and some of the files have their new names or are gone."""
    done: list[Path] = []

    class Killed(BaseException):
        """The process ends here."""

    def step(act: Callable[..., None]) -> Callable[..., None]:
        def counted(of: Path, *given: Path) -> None:
            if len(done) == steps:
                raise Killed
            done.append(of)
            act(of, *given)

        return counted

    log = AuditLog(path, max_bytes=4_000, backups=3)

    def write_on() -> None:
        while True:
            log.record("write", ANNA, "Good")

    with monkeypatch.context() as context:
        context.setattr(Path, "replace", step(os.replace))
        context.setattr(Path, "unlink", step(os.unlink))
        with pytest.raises(Killed):
            write_on()
    log.close()
    assert said(verify(path)) == ""
    write(path, 60)
    assert said(verify(path)) == ""


def test_fewer_files_than_before(path: Path) -> None:
    write(path, 30, backups=1)
    assert sorted(entry.name for entry in path.parent.iterdir()) == ["audit.head", "audit.log", "audit.log.1"]
    assert said(verify(path)) == ""


_KILLED = """
import sys
from pathlib import Path
from ua_fleet.endpoint.audit import AuditLog, Caller
log = AuditLog(Path(sys.argv[1]), max_bytes=65536, backups=2)
print("begun", flush=True)
number = 0
while True:
    log.record_all("write", Caller("10.0.0.7:1", "anna", "operator"), [{"node": f"n{number}", "status": "Good"}] * 7)
    number += 1
"""


def test_killed_again_and_again_while_it_writes(tmp_path: Path) -> None:
    path = tmp_path / "audit.log"
    for turn in range(6):
        process = subprocess.Popen([sys.executable, "-c", _KILLED, str(path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        time.sleep(0.1 + 0.07 * turn)  # somewhere in its writing
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        report = verify(path)
        assert (said(report), report.files > 1) == ("", True)
    write(path, 1, max_bytes=65_536, backups=2)
    assert said(verify(path)) == ""


def test_the_head_follows_what_is_synced(tmp_path: Path) -> None:
    path = tmp_path / "audit.log"
    log = AuditLog(path)
    log.record("write", ANNA, "Good")
    deadline = time.monotonic() + 20
    while '"seq": 1' not in path.with_name("audit.head").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    log.close()


def test_no_log(tmp_path: Path) -> None:
    with pytest.raises(AuditLogMissing, match="there is no audit log"):
        verify(tmp_path / "audit.log")
