"""`ua-fleet state`: a backup while a server and a bridge run, damage, kills, and the state in another place."""

from __future__ import annotations

import shutil
import signal
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.integration.cli.conftest import FLEET, PASSWORD, Site
from tests.system import Processes, free_multicast_url, free_tcp_port
from ua_fleet.errors import StorageUnavailable
from ua_fleet.modbus.memory import CommandMemory, LastCommand
from ua_fleet.modbus.words import CommandState
from ua_fleet.storage.control import held_by


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Site]:
    """A fleet whose server a test may kill."""
    folder, port, url = tmp_path / "hall", free_tcp_port(), free_multicast_url()
    folder.mkdir()
    (folder / "fleet.yaml").write_text(FLEET.format(port=port, url=url))
    with Processes() as processes:
        site = Site(folder, f"opc.tcp://127.0.0.1:{port}/ua_fleet", url, processes)
        assert site.run("config", "assign-ids").code == 0
        ended = site.run("user", "add", "oscar", "--role", "operator", "--password-file", "-", stdin=PASSWORD)
        assert ended.code == 0, ended.stderr
        yield site


def test_a_backup_of_a_running_server_is_whole_and_restored_elsewhere(own: Site, tmp_path: Path) -> None:
    server = own.start("serve", user=None)
    server.wait_for("ready: ")
    [rejected] = _rejected(own)
    assert own.run("cert", "trust", rejected).code == 0
    assert own.run("write", "rover.goal", "0.25").code == 0
    ended = own.run("history", "rover.goal", "--json")  # it is in the store: a read is behind the writes
    assert [one["value"] for one in ended.objects][-1] == 0.25
    file = tmp_path / "hall.tar"
    broken = own.folder / "state" / "lease_numbers.json"  # a server does not read it
    broken.write_text("{}")
    begun = time.monotonic()
    ended = own.run("state", "backup", str(file), "--json", user=None)
    assert ended.code == 0, ended.stderr
    assert time.monotonic() - begun < 30
    [said] = ended.objects
    assert {"server/server.db", "server/history.db", "server/users.yaml", "server/audit.log"} <= set(said["files"])
    assert "private keys" in ended.stderr
    assert file.stat().st_mode & 0o777 == 0o600
    assert own.run("write", "rover.goal", "0.75").code == 0, "it goes on"
    assert own.run("state", "check", str(file), user=None).code == 0
    refused = own.run("state", "restore", str(file), user=None)
    assert (refused.code, "runs already" in refused.stderr) == (1, True)
    assert server.end() == 130
    ended = own.run("state", "restore", str(file), user=None)
    assert ended.code == 0, ended.stderr
    assert "what was there before" in ended.stderr
    assert f"{broken}: was broken before the backup, and is restored as it was" in ended.stderr
    assert broken.read_text() == "{}"
    again = own.start("serve", user=None)
    again.wait_for("ready: ")
    values = [one["value"] for one in own.run("history", "rover.goal", "--json").objects]
    assert 0.25 in values
    assert 0.75 not in values
    ended = own.run("audit", "verify", user=None)
    assert ended.code == 0, ended.stdout


def _rejected(site: Site) -> list[str]:
    site.run("read", "i=2258")
    return [
        info["thumbprint"][:10] for info in site.run("cert", "list", "--json").objects if info["state"] == "rejected"
    ]


def test_a_backup_that_is_killed_leaves_none_and_holds_nothing(own: Site, tmp_path: Path) -> None:
    server = own.start("serve", user=None)
    server.wait_for("ready: ")
    # A large file of the state, so that the kill comes while it is written.
    with (own.folder / "state" / "large.bin").open("wb") as large:
        large.truncate(400_000_000)
    target = tmp_path / "hall.tar"
    killed = own.start("state", "backup", str(target), user=None)
    until = time.monotonic() + 60
    while not list(tmp_path.glob(".hall.tar.*/part")):
        assert time.monotonic() < until
        time.sleep(0.005)
    killed.end(signal.SIGKILL)
    assert not target.exists()
    (own.folder / "state" / "large.bin").unlink()
    for left in tmp_path.glob(".hall.tar.*"):
        shutil.rmtree(left)
    until = time.monotonic() + 60
    while "another backup" in (ended := own.run("state", "backup", str(target), user=None)).stderr:
        assert time.monotonic() < until, "the server does not notice that who made it is gone"
    assert ended.code == 0, ended.stderr
    assert own.run("state", "check", str(target), user=None).code == 0


def test_the_state_of_a_server_that_was_killed_is_taken_with_its_logs(own: Site, tmp_path: Path) -> None:
    server = own.start("serve", user=None)
    server.wait_for("ready: ")
    [rejected] = _rejected(own)
    assert own.run("cert", "trust", rejected).code == 0
    assert own.run("write", "rover.goal", "0.5").code == 0
    assert own.run("history", "rover.goal").code == 0
    server.end(signal.SIGKILL)
    assert (own.folder / "state" / "history.db-wal").stat().st_size > 0
    file = tmp_path / "hall.tar"
    assert own.run("state", "backup", str(file), user=None).code == 0
    shutil.rmtree(own.folder / "state")
    assert own.run("state", "restore", str(file), user=None).code == 0
    with closing(sqlite3.connect(own.folder / "state" / "history.db")) as database:
        assert database.execute("SELECT count(*) FROM row").fetchone()[0] > 0


def test_a_server_that_is_killed_while_its_files_are_held_fails_the_backup(own: Site) -> None:
    server = own.start("serve", user=None)
    server.wait_for("ready: ")
    with held_by(own.folder / "state" / "server.control") as process:
        assert process is not None
        assert {path.name for path in process.files} == {"server.db", "history.db"}
        server.end(signal.SIGKILL)
        with pytest.raises(StorageUnavailable, match="make the backup again"):
            process.still()


def test_what_is_no_backup_and_what_is_not_there_is_told(site: Site, tmp_path: Path) -> None:
    missing = site.run("state", "check", str(tmp_path / "nothing.tar"), user=None)
    assert (missing.code, "there is no such file" in missing.stderr) == (3, True)
    (tmp_path / "text.tar").write_text("no backup")
    for command in ("check", "restore"):
        refused = site.run("state", command, str(tmp_path / "text.tar"), user=None)
        assert refused.code == 1
        assert len(refused.stderr.splitlines()) == 1
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(site.folder / "fleet.yaml", empty)
    nothing = site.run("state", "backup", str(tmp_path / "b.tar"), "-c", str(empty / "fleet.yaml"), user=None)
    assert (nothing.code, "has stored anything" in nothing.stderr) == (3, True)


def test_what_the_modbus_gateway_remembers_is_taken_while_it_runs(own: Site, tmp_path: Path) -> None:
    state, port = own.folder / "state" / "modbus", free_tcp_port()
    with (own.folder / "fleet.yaml").open("a") as fleet:
        fleet.write(
            f"modbus: {{host: 127.0.0.1, port: {port}, values: {{rover.speed: {{table: input, address: 100}}}}}}\n"
        )
    command = LastCommand(7, 3, CommandState.DONE, "run-1", 0, "it is done", '{"done": "weld"}')
    with closing(CommandMemory(state / "commands.db")) as memory:
        memory.record(command)
        number = memory.decision_number("decision-1")
    gateway = own.start("modbus", "serve")
    gateway.wait_for("ready: ")
    file = tmp_path / "hall.tar"
    ended = own.run("state", "backup", str(file), "--json", user=None)
    assert ended.code == 0, ended.stderr
    assert "modbus/commands.db" in ended.objects[0]["files"]
    refused = own.run("state", "restore", str(file), user=None)
    assert (refused.code, "its process runs; stop it first" in refused.stderr) == (1, True)
    assert gateway.end() == 130
    shutil.rmtree(state)
    ended = own.run("state", "restore", str(file), user=None)
    assert ended.code == 0, ended.stderr
    with closing(CommandMemory(state / "commands.db")) as memory:
        assert memory.last() == command
        assert memory.decision_number("decision-1") == number
        assert memory.decision_number("decision-2") == number + 1
