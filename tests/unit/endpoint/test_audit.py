from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua

from ua_fleet.endpoint.audit import AuditLog, Caller, summary
from ua_fleet.endpoint.audit.allowance import A_MINUTE, AT_ONCE
from ua_fleet.endpoint.audit.verification import verify
from ua_fleet.errors import ServerStartError

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
    log = AuditLog(path, max_bytes=2_000, backups=2)
    for number in range(100):
        log.record("write", CALLER, "Good", node=f"ns=2;i={number}")
    log.close()
    names = sorted(entry.name for entry in tmp_path.iterdir())
    assert names == ["audit.head", "audit.log", "audit.log.1", "audit.log.2"]
    assert all((tmp_path / name).stat().st_size <= 2_000 for name in names)
    assert all((tmp_path / name).stat().st_mode & 0o777 == 0o600 for name in names)
    assert lines(path)[-1]["node"] == "ns=2;i=99"
    assert lines(tmp_path / "audit.log.1")[0]["seq"] + len(lines(tmp_path / "audit.log.1")) == lines(path)[0]["seq"]
    report = verify(path)
    assert (report.whole, report.files) == (True, 3)
    assert report.first > 50


def test_what_goes_next_is_told_before_it_goes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "audit.log"
    log = AuditLog(path, max_bytes=20_000, backups=1)
    while not path.with_name("audit.log.1").exists():
        log.record("write", CALLER, "Good")
    assert "nearly full" not in capsys.readouterr().out
    first = path.with_name("audit.log.1").read_bytes()
    while "nearly full" not in (said := capsys.readouterr().out):
        log.record("write", CALLER, "Good")
    assert "audit.log.1" in said
    assert path.with_name("audit.log.1").read_bytes() == first, "it was told in time"
    log.close()


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
    assert log.omitted == 10_000 - AT_ONCE
    now = 61.0
    log.tick()
    assert log.refuse(Caller("10.0.0.9:2"), "login", "BadUserAccessDenied")
    log.close()
    written = lines(tmp_path / "audit.log")
    assert len(written) == AT_ONCE + 3
    total = written[-2]
    assert (total["event"], total["client"], total["lines"]) == ("omitted", "10.0.0.9", 10_000 - AT_ONCE)
    assert total["of"] == {"login BadUserAccessDenied": 10_000 - AT_ONCE}


def test_an_observer_cannot_flush_the_log(tmp_path: Path) -> None:
    """75,000 refused writes rotated five files in 3 s, and the lines of others were gone."""
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", max_bytes=200_000, backups=2, clock=lambda: now)
    log.record("write", CALLER, "Good", node="the one that matters")
    for second in range(75):
        now = float(second)
        refused = [{"node": "ns=2;i=1", "status": "BadUserAccessDenied"}] * 1_000
        log.record_all("write", Caller(f"10.0.0.{second}:1", "olga", "observer", f"s{second}"), refused)
        log.tick()
    log.close()
    written = lines(tmp_path / "audit.log")
    assert not (tmp_path / "audit.log.1").exists()
    assert written[0]["node"] == "the one that matters"
    seen = [line for line in written if line["event"] == "write" and line["status"] != "Good"]
    left_out = sum(line["lines"] for line in written if line["event"] == "omitted")
    assert len(seen) + left_out == 75_000
    assert len(seen) <= AT_ONCE + 75 / 60 * A_MINUTE


def test_logins_and_what_observers_call_are_summed_up_too(tmp_path: Path) -> None:
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", clock=lambda: now)
    observer = Caller("10.0.0.9:1", "olga", "observer")
    for event in ("login", "logout", "call"):
        for _ in range(1_000):
            log.record(event, observer, "Good")
    operator = Caller("10.0.0.9:1", "oscar", "operator")
    assert all(log.record("call", operator, "Good") for _ in range(1_000)), "what changes something has more room"
    log.close()
    assert log.omitted == 3_000 - AT_ONCE


def test_strangers_with_many_addresses_cannot_flush_it_either(tmp_path: Path) -> None:
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", clock=lambda: now)
    for number in range(20_000):
        log.refuse(Caller(f"10.{number >> 8}.{number & 255}.1:9"), "message", "BadTcpMessageTypeInvalid")
    assert log.record("login", Caller("10.0.0.7:1", "anna", "operator"), "Good"), "users have allowances of their own"
    log.close()
    written = lines(tmp_path / "audit.log")
    assert len(written) < 1_000
    refused = sum(line["event"] == "refusal" for line in written)
    assert refused + sum(line["lines"] for line in written if line["event"] == "omitted") == 20_000


def test_an_operator_cannot_flush_it_by_what_is_allowed(tmp_path: Path) -> None:
    """330,000 writes rotated all files in half a minute."""
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", max_bytes=4_000_000, backups=2, clock=lambda: now)
    log.record("write", Caller("10.0.0.7:1", "eva", "engineer"), "Good", node="the one that matters", value="1")
    for second in range(40):
        now = float(second)
        log.record_all("write", CALLER, [{"node": "ns=2;i=1", "value": str(second), "status": "Good"}] * 1_000)
        log.tick()
    log.record("call", Caller("10.0.0.7:1", "eva", "engineer"), "Good", method="ns=2;s=Fleet.Faults.ClearFault")
    log.close()
    assert not (tmp_path / "audit.log.1").exists()
    written = lines(tmp_path / "audit.log")
    assert written[0]["node"] == "the one that matters"
    assert written[-2]["method"] == "ns=2;s=Fleet.Faults.ClearFault", "others have their own room"
    assert sum(line["event"] == "write" for line in written) + written[-1]["lines"] == 40_001
    assert written[-1]["of"] == {"write ns=2;i=1": written[-1]["lines"]}
    assert written[-1]["last"] == {"write ns=2;i=1": "39"}


def test_many_addresses_do_not_renew_the_allowance_of_a_user(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "audit.log", clock=lambda: 0.0)
    olga = Caller("10.0.0.9:1", "olga", "observer")
    written = 0
    for each in range(3):
        written += sum(log.refuse(olga, "Read", "BadUserAccessDenied") for _ in range(2 * AT_ONCE))
        for number in range(1_100):
            log.refuse(Caller(f"[2001:db8:{each}:{number}::1]:9"), "message", "BadTcpMessageTypeInvalid")
    log.close()
    assert written == AT_ONCE


def test_who_logs_out_leaves_the_sum(tmp_path: Path) -> None:
    """There was neither the line of the logout nor the sum, for a minute."""
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", clock=lambda: now)
    olga = Caller("10.0.0.9:1", "olga", "observer")
    for _ in range(1_000):
        log.refuse(olga, "Read", "BadUserAccessDenied")
    for second in range(12):
        now = second / 2
        log.refuse(olga, "Read", "BadUserAccessDenied")
        log.record("logout", olga, "Good")
    written = lines(tmp_path / "audit.log")
    log.close()
    sums = [line for line in written if line["event"] == "omitted"]
    assert len(sums) == 1, "and no sum for each logout"
    assert sums[0]["of"]["Read BadUserAccessDenied"] > 1_000 - AT_ONCE
    assert sums[0]["of"]["logout Good"] > 1


class LosingCopy:
    """A syslog server that is away."""

    dropped = 0

    def put(self, line: bytes, event: str, *, refused: bool) -> None:
        self.dropped += 1

    def close(self) -> None:
        pass


def test_what_the_copy_did_not_get_is_a_line(tmp_path: Path) -> None:
    now = 0.0
    log = AuditLog(tmp_path / "audit.log", clock=lambda: now, copy=LosingCopy())
    for _ in range(7):
        log.record("write", CALLER, "Good", node="ns=2;i=1")
    log.tick()
    log.tick()
    now = 61.0
    log.tick()
    log.close()
    told = [line["lines"] for line in lines(tmp_path / "audit.log") if line["event"] == "undelivered"]
    assert told == [7, 1, 1]


def test_a_full_disk_stops_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = AuditLog(tmp_path / "audit.log")

    def full(_descriptor: int, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context:
        context.setattr(os, "write", full)
        log.record("write", CALLER, "Good")
    log.record("write", CALLER, "Good", node="after")
    log.close()
    lost, after = lines(tmp_path / "audit.log")
    assert (lost["event"], lost["lines"], after["node"], log.lost) == ("lost", 1, "after", 1)
    assert verify(tmp_path / "audit.log").whole


def test_a_line_that_fits_in_part_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = AuditLog(tmp_path / "audit.log")
    log.record("write", CALLER, "Good", node="before")
    write = os.write

    def in_part(descriptor: int, data: bytes) -> int:
        return write(descriptor, data[:30])

    with monkeypatch.context() as context:
        context.setattr(os, "write", in_part)
        log.record("write", CALLER, "Good", node="in part")
    log.record("write", CALLER, "Good", node="after")
    log.close()
    assert [line.get("node") for line in lines(tmp_path / "audit.log")] == ["before", None, "after"]
    assert verify(tmp_path / "audit.log").whole


@pytest.mark.parametrize("kind", ["link", "hard link", "pipe", "folder"])
@pytest.mark.parametrize("name", ["audit.log", "audit.head"])
def test_only_a_file_of_its_own_is_written(tmp_path: Path, kind: str, name: str) -> None:
    """A link had lines appended, and rights changed, wherever it led to."""
    victim, path = tmp_path / "victim", tmp_path / "state" / name
    path.parent.mkdir()
    victim.write_text("precious")
    victim.chmod(0o644)
    if kind == "link":
        path.symlink_to(victim)
    elif kind == "hard link":
        path.hardlink_to(victim)
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    with pytest.raises(ServerStartError, match=name):
        AuditLog(tmp_path / "state" / "audit.log")
    assert victim.read_text() == "precious"
    assert victim.stat().st_mode & 0o777 == 0o644


def test_two_servers_do_not_write_one_log(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "audit.log")
    with pytest.raises(ServerStartError, match="another server"):
        AuditLog(tmp_path / "audit.log")
    log.close()
    AuditLog(tmp_path / "audit.log").close()


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


def test_a_summary_takes_no_time() -> None:
    class Slow:
        def __repr__(self) -> str:
            raise AssertionError("it is shown")

    nested = [[[Slow()] * 3] * 3, [Slow()] * 9]
    assert summary(nested) == "[[array of 3, array of 3, array of 3], array of 9]"
    assert summary(ua.Variant([Slow()] * 9, ua.VariantType.Variant)).startswith("Variant(Value=array of 9, ")


def test_summary_is_short() -> None:
    assert len(summary("x" * 1_000_000)) < 210
