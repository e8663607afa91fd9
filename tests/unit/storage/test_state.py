"""Backups of the state: what is in them, what damage is found, and what a restore makes safe."""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import sqlite3
import stat
import tarfile
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.carrying.facts import PartTaken, RunClosed
from ua_fleet.errors import StorageUnavailable, UaFleetError
from ua_fleet.pubsub.security.nonces import LAST_NUMBER
from ua_fleet.server.key_service.files import load_groups, save_groups
from ua_fleet.server.key_service.store import GroupState
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, Target
from ua_fleet.skill.journal import RecordedRequest
from ua_fleet.storage.carried_records import CARRIED_FILE, CarriedRecords
from ua_fleet.storage.files import UNFINISHED
from ua_fleet.storage.lease_numbers import LeaseNumbers
from ua_fleet.storage.nonces import FileNonces
from ua_fleet.storage.process_lock import process_lock
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.storage.state_backup import write_backup
from ua_fleet.storage.state_files import BackupDamaged, Manifest, state_files
from ua_fleet.storage.state_restore import Restored, open_work, put_in_place, unpacked
from ua_fleet.wire.security import SecurityPolicy

MADE = datetime(2026, 3, 1, 8, tzinfo=UTC)
ABOUT = Manifest("Hall", MADE.isoformat(), "0.1.0", "", {})
POLICY = SecurityPolicy.named("PubSub-Aes256-CTR")
DONE = ExecutionReport(ExecutionState.DONE)
REQUEST = "INSERT INTO requests VALUES (1, x'01', 2, 2, 7, 1, x'', 0, 5000, 0, NULL, NULL, NULL, NULL, NULL)"


def fleet(base: Path) -> dict[str, Path]:
    """The folders of a server and, within its own, of a bridge."""
    return {"server": base / "state", "bridge-cell": base / "state" / "bridges" / "cell"}


@pytest.fixture
def folders(tmp_path: Path) -> dict[str, Path]:
    """Some state."""
    folders = fleet(tmp_path / "hall")
    server, bridge = folders.values()
    bridge.mkdir(parents=True)
    ServerRecords(server).close()
    (server / "users.yaml").write_text("users")
    (server / "users.yaml").chmod(0o600)
    (server / "pki").mkdir()
    (server / "pki" / "own.der").write_bytes(b"certificate")
    (server / "pki" / "own.der").chmod(0o644)
    (server / "audit.log").write_text('{"seq": 1}\n{"seq": 2}\n{"se')
    (server / "audit.head").write_text('{"seq": 1}')
    for name in ("server.lock", "monitoring.json", ".users.yaml.0a1b2c3d", "server.control"):
        (server / name).write_text("no state")
    (server / "link").symlink_to("/etc/passwd")
    (bridge / "nonces.json").write_text('{"version": 1, "groups": {}}')
    return folders


def backup(tmp_path: Path, folders: dict[str, Path]) -> Path:
    for control in folders["server"].glob("*.control"):
        control.unlink()
    write_backup(tmp_path / "hall.tar", folders, ABOUT)
    return tmp_path / "hall.tar"


def restore(file: Path, folders: dict[str, Path], tmp_path: Path, after: timedelta = timedelta(hours=1)) -> Restored:
    with unpacked(file, "0.1.0", tmp_path) as (manifest, within):
        return put_in_place(within, folders, manifest, MADE + after)


def test_all_state_is_in_it_and_nothing_else(tmp_path: Path, folders: dict[str, Path]) -> None:
    file = backup(tmp_path, folders)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    with unpacked(file, "0.1.0", tmp_path) as (manifest, within):
        assert sorted(manifest.files) == [
            "bridge-cell/nonces.json",
            "server/audit.head",
            "server/audit.log",
            "server/pki/own.der",
            "server/server.db",
            "server/users.yaml",
        ]
        assert (within / "server/audit.log").read_text() == '{"seq": 1}\n{"seq": 2}\n', "whole lines"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hall", "hall.tar"]


def test_the_head_of_the_audit_log_is_read_before_its_lines(folders: dict[str, Path]) -> None:
    names = [file.name for file in state_files(folders)]
    assert names.index("server/audit.head") < names.index("server/audit.log")


def test_a_backup_takes_the_place_of_none_and_is_not_in_the_state(tmp_path: Path, folders: dict[str, Path]) -> None:
    file = backup(tmp_path, folders)
    whole = file.read_bytes()
    with pytest.raises(StorageUnavailable, match="is there already"):
        write_backup(file, folders, ABOUT)
    assert file.read_bytes() == whole
    with pytest.raises(StorageUnavailable, match="would be in the state"):
        write_backup(folders["server"] / "hall.tar", folders, ABOUT)


def test_a_database_that_somebody_uses_without_holding_it_is_no_backup(
    tmp_path: Path, folders: dict[str, Path]
) -> None:
    with ServerRecords(folders["server"]), pytest.raises(StorageUnavailable, match="in use by another process"):
        backup(tmp_path, folders)
    assert [path.name for path in tmp_path.iterdir()] == ["hall"]


def test_any_damage_is_found(tmp_path: Path, folders: dict[str, Path]) -> None:
    file = backup(tmp_path, folders)
    whole = file.read_bytes()
    random_ = random.Random(17)
    kept = [number for number in range(len(whole)) if whole[number]]  # not the empty ends of blocks
    for place in [*random_.sample(kept, 40), whole.index(b'"fleet": "Hall"') + 10]:
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << random_.randrange(8)]) + whole[place + 1 :])
        with pytest.raises(BackupDamaged, match=r"hall\.tar"), unpacked(file, "0.1.0", tmp_path):
            pass
    for size in (0, 100, 512, len(whole) // 2, whole.index(b'"sha256"')):
        file.write_bytes(whole[:size])
        with pytest.raises(BackupDamaged), unpacked(file, "0.1.0", tmp_path):
            pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hall", "hall.tar"], "nothing is left"


def test_a_database_that_was_broken_before_is_found(tmp_path: Path, folders: dict[str, Path]) -> None:
    path = folders["server"] / "runs.db"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE a (b PRIMARY KEY)")
        database.executemany("INSERT INTO a VALUES (?)", [(str(number) * 50,) for number in range(200)])
    data = bytearray(path.read_bytes())
    data[4096 : 4096 + 900] = b"\xff" * 900
    path.write_bytes(data)
    with (
        pytest.raises(BackupDamaged, match=r"runs\.db is broken"),
        unpacked(backup(tmp_path, folders), "0.1.0", tmp_path),
    ):
        pass


@pytest.mark.parametrize("name", ["server/../../x", "/etc/x", "alone"])
def test_a_name_that_leads_elsewhere_is_refused(tmp_path: Path, folders: dict[str, Path], name: str) -> None:
    file = backup(tmp_path, folders)
    with tarfile.open(file, "w") as archive:
        archive.addfile(tarfile.TarInfo(name), io.BytesIO())
    with pytest.raises(BackupDamaged, match="is no file of a state"), unpacked(file, "0.1.0", tmp_path):
        pass


def test_one_of_a_newer_version_is_refused(tmp_path: Path, folders: dict[str, Path]) -> None:
    file = backup(tmp_path, folders)
    with (
        pytest.raises(StorageUnavailable, match=r"made by ua-fleet 0\.1\.0.*upgrade"),
        unpacked(file, "0.0.9", tmp_path),
    ):
        pass


def test_a_restore_takes_the_place_of_what_is_there(tmp_path: Path, folders: dict[str, Path]) -> None:
    file = backup(tmp_path, folders)
    server, bridge = folders.values()
    (server / "users.yaml").write_text("others")
    (server / "later.json").write_text("later")
    (server / "pki" / "later.der").write_text("later")
    moved, broken = restore(file, folders, tmp_path)
    assert broken == []
    assert (server / "users.yaml").read_text() == "users"
    assert stat.S_IMODE((server / "users.yaml").stat().st_mode) == 0o600
    assert stat.S_IMODE((server / "pki" / "own.der").stat().st_mode) == 0o644
    assert not (server / "later.json").exists()
    assert not (server / "pki" / "later.der").exists()
    assert (server / "server.lock").exists(), "who holds it keeps others out until the end"
    assert moved == [
        server / "before-restore-20260301T090000Z",
        bridge / "before-restore-20260301T090000Z",
    ] or moved == [
        bridge / "before-restore-20260301T090000Z",
        server / "before-restore-20260301T090000Z",
    ]
    before = server / "before-restore-20260301T090000Z"
    assert (before / "users.yaml").read_text() == "others"
    assert (before / "later.json").read_text() == "later"
    ServerRecords(server).close()
    assert [one.name for one in state_files(folders) if "before" in one.name] == []


def test_a_restore_in_an_empty_place(tmp_path: Path, folders: dict[str, Path]) -> None:
    there = fleet(tmp_path / "new")
    assert restore(backup(tmp_path, folders), there, tmp_path) == ([], [])
    assert [file.name for file in state_files(there)] == [
        file.name for file in state_files(folders) if not file.path.name.endswith("control")
    ]
    assert stat.S_IMODE((tmp_path / "new" / "state").stat().st_mode) == 0o700


def test_after_a_restore_that_was_killed_no_process_starts_until_it_is_done_again(
    tmp_path: Path, folders: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = backup(tmp_path, folders)
    expected = {name: (folders["server"] / name).read_bytes() for name in ("users.yaml", "audit.head", "pki/own.der")}
    for most in range(1, 12):
        left = iter(range(most))

        def killed(source: Path, target: Path, left: Any = left) -> Path:
            if next(left, None) is None:
                raise KeyboardInterrupt
            source.replace(target)
            return target

        with monkeypatch.context() as patched:
            patched.setattr(Path, "rename", killed)
            with pytest.raises(KeyboardInterrupt):
                restore(file, folders, tmp_path, timedelta(hours=most))
        assert (folders["server"] / UNFINISHED).exists()
        with pytest.raises(StorageUnavailable, match="a restore did not end"):
            ServerRecords(folders["server"])
        with (
            pytest.raises(StorageUnavailable, match="a restore did not end"),
            process_lock(folders["server"] / "server.lock", "a server"),
        ):
            pass
        with process_lock(folders["server"] / "server.lock", "a server", restores=True):
            restore(file, folders, tmp_path, timedelta(hours=most, minutes=1))
        ServerRecords(folders["server"]).close()
        assert {name: (folders["server"] / name).read_bytes() for name in expected} == expected


def test_no_nonce_is_used_twice_after_a_restore(tmp_path: Path, folders: dict[str, Path]) -> None:
    bridge = folders["bridge-cell"]
    assert FileNonces(bridge).reserve("t-2", 7, 100) == 1
    file = backup(tmp_path, folders)
    assert FileNonces(bridge).reserve("t-2", 7, 100) == 101, "used after the backup"
    restore(file, folders, tmp_path)
    nonces = FileNonces(bridge)
    assert nonces.reserve("t-2", 7, 100) > LAST_NUMBER, "none is left"
    assert nonces.reserve("t-2", 8, 100) == 1, "of a new key"


def test_the_key_service_begins_with_keys_that_nobody_has(tmp_path: Path, folders: dict[str, Path]) -> None:
    path = folders["server"] / "security-groups.json"
    old = GroupState(POLICY, 3600.0, 7, (bytes(POLICY.key_data_bytes), b"x" * POLICY.key_data_bytes), 1, 1000.0)
    save_groups(path, {"t-2": old})
    restore(backup(tmp_path, folders), folders, tmp_path)
    [new] = load_groups(path).values()
    assert not set(new.keys) & set(old.keys)
    assert (new.first_token_id, new.current) == (7 + 2 + 100_000, 0)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_no_number_of_a_lease_is_given_twice(tmp_path: Path, folders: dict[str, Path]) -> None:
    bridge = folders["bridge-cell"]
    LeaseNumbers(bridge).next()
    file = backup(tmp_path, folders)
    later = LeaseNumbers(bridge)
    last = max(later.next() for _ in range(3_000))
    restore(file, folders, tmp_path)
    assert LeaseNumbers(bridge).next() > last


@pytest.mark.parametrize("content", ["", "{}", "[]", '"text"', '{"groups": []}', '{"groups": {"a": 1}}', "[" * 100_000])
@pytest.mark.parametrize("name", ["nonces.json", "security-groups.json", "lease_numbers.json"])
def test_a_file_that_is_broken_is_restored_as_it_is_and_told(
    tmp_path: Path, folders: dict[str, Path], name: str, content: str
) -> None:
    path = folders["bridge-cell"] / name
    path.write_text(content)
    file = backup(tmp_path, folders)
    path.unlink()
    assert restore(file, folders, tmp_path).broken == [path]
    assert path.read_text() == content
    opened: dict[str, Callable[[], object]] = {
        "nonces.json": lambda: FileNonces(path.parent),
        "security-groups.json": lambda: load_groups(path),
        "lease_numbers.json": lambda: LeaseNumbers(path.parent).next(),
    }
    with pytest.raises(UaFleetError, match="json"):
        opened[name]()


def test_requests_without_an_end_are_only_asked_after(tmp_path: Path, folders: dict[str, Path]) -> None:
    path = folders["server"] / "server.db"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(REQUEST)
        database.execute("INSERT INTO runs VALUES (1, 'run', 0)")
    file = backup(tmp_path, folders)
    with unpacked(file, "0.1.0", tmp_path) as (_, within):
        assert open_work(within) == (1, 1)
    restore(file, folders, tmp_path)
    with ServerRecords(folders["server"]) as records:
        assert [request.timeout_ms for request in records.requests.requests()] == [0]


def test_a_run_that_bridges_carry_begins_nothing_again(tmp_path: Path, folders: dict[str, Path]) -> None:
    bridge = folders["bridge-cell"]
    with closing(sqlite3.connect(folders["server"] / "server.db")) as database, database:
        database.execute("INSERT INTO runs VALUES (1, 'run', 0)")
    with CarriedRecords(bridge) as records:
        for run_id in ("run", "other", "over"):
            records.note(PartTaken(1.0, run_id, "00"))
        records.note(RunClosed(2.0, "over", "done", "", 300))
        for number, outcome in enumerate([None, RequestOutcome(OutcomeKind.ACCEPTED, DONE)]):
            target = Target(301, 2, 7, 1)
            records.requests.requested(RecordedRequest(bytes([number] * 16), target, b"", number, 5000, outcome))
    file = backup(tmp_path, folders)
    with unpacked(file, "0.1.0", tmp_path) as (_, within):
        assert open_work(within) == (2, 1), "the server's run is one of the bridge's"
    restore(file, folders, tmp_path)
    with CarriedRecords(bridge) as records:
        assert [request.timeout_ms for request in records.requests.requests()] == [0, 5000]
        assert len(records.facts()) == 4


def test_files_that_were_just_begun_are_restored(tmp_path: Path, folders: dict[str, Path]) -> None:
    (folders["bridge-cell"] / CARRIED_FILE).touch()
    file = backup(tmp_path, folders)
    with unpacked(file, "0.1.0", tmp_path) as (_, within):
        assert open_work(within) == (0, 0)
    restore(file, folders, tmp_path)
    CarriedRecords(folders["bridge-cell"]).close()


def test_a_folder_that_the_fleet_has_not_is_told(tmp_path: Path, folders: dict[str, Path]) -> None:
    file = backup(tmp_path, folders)
    with pytest.raises(UaFleetError, match="'bridge-cell'"):
        restore(file, {"server": folders["server"]}, tmp_path)
    assert not (folders["server"] / UNFINISHED).exists()


def test_a_disk_that_fails_is_told(tmp_path: Path, folders: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    file = backup(tmp_path, folders)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "move", full)
    with pytest.raises(StorageUnavailable, match=r"No space left.*until this restore is done again"):
        restore(file, folders, tmp_path)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageUnavailable, match=r"No space left.*no backup was made"):
        write_backup(tmp_path / "b.tar", folders, ABOUT)
    assert not (tmp_path / "b.tar").exists()


def test_the_manifest_has_no_key(tmp_path: Path, folders: dict[str, Path]) -> None:
    with unpacked(backup(tmp_path, folders), "0.1.0", tmp_path) as (manifest, _):
        document = json.loads(manifest.encode())
    assert sorted(document) == ["files", "fleet", "made", "postgres", "program", "sha256", "version"]
