"""What a newer ua-fleet has written is refused in one line and left as it is, file by file."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
from ua_bridges.modbus.memory import HandshakeMemory

from ua_fleet.client.identity import ClientIdentity
from ua_fleet.endpoint.users import Role, ScryptCost, UserStore
from ua_fleet.errors import UPGRADE, UaFleetError, newer_version
from ua_fleet.modbus.memory import CommandMemory
from ua_fleet.server.key_service.files import load_groups, save_groups
from ua_fleet.server.key_service.store import GroupState
from ua_fleet.storage.journal import SqliteJournal
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.storage.nonces import FileNonces
from ua_fleet.storage.registry import Registry
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.storage.server_records import SERVER_FILE, ServerRecords
from ua_fleet.wire.security import SecurityPolicy

POLICY = SecurityPolicy.named("PubSub-Aes256-CTR")


def database(kept: Callable[[Path], Any]) -> Callable[[Path], Path]:
    """How such a file of SQLite is used."""

    def use(folder: Path) -> Path:
        path = folder / "kept.sqlite"
        kept(path).close()
        return path

    return use


def records(folder: Path) -> Path:
    ServerRecords(folder).close()
    return folder / SERVER_FILE


def users(folder: Path) -> Path:
    path = folder / "users.yaml"
    store = UserStore(path, cost=ScryptCost(16, 1, 1))
    if not store.list():
        store.add("anna", "a long password", Role.OPERATOR)
    return path


def keys(folder: Path) -> Path:
    kept = KeyFolder(folder)
    path = kept.path_of("t-2")
    if path.exists():
        kept.read("t-2")
    else:
        kept.write(KeyFile.new("t-2", POLICY, 3600.0, 1.0))
    return path


def nonces(folder: Path) -> Path:
    FileNonces(folder).reserve("t-2", 1, 10)
    return folder / "nonces.json"


def groups(folder: Path) -> Path:
    path = folder / "security-groups.json"
    if not load_groups(path):
        save_groups(path, {"t-2": GroupState(POLICY, 60.0, 1, (bytes(POLICY.key_data_bytes),), 0, 0.0)})
    return path


def servers(folder: Path) -> Path:
    ClientIdentity(folder).check_server("opc.tcp://a:1", b"certificate")
    return folder / "servers.json"


def raised_sqlite(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA user_version=9")
        connection.execute("CREATE TABLE new (x INT) STRICT")


def raised_document(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    document = yaml.safe_load(text) if path.suffix == ".yaml" else json.loads(text)
    document |= {"version": 9, "new": {"x": [1]}}
    path.write_text(yaml.safe_dump(document) if path.suffix == ".yaml" else json.dumps(document), encoding="utf-8")


SQLITE = {
    "what a server records": records,
    "executions of a bridge": database(SqliteJournal),
    "runs of scenarios": database(RunJournal),
    "registered robots": database(Registry),
    "commands of PLCs": database(CommandMemory),
    "handshakes with PLCs": database(HandshakeMemory),
}
DOCUMENTS = {
    "users": users,
    "key files": keys,
    "nonces": nonces,
    "groups of the key service": groups,
    "servers that a client has met": servers,
}
FILES = [
    *(pytest.param(use, raised_sqlite, id=name) for name, use in SQLITE.items()),
    *(pytest.param(use, raised_document, id=name) for name, use in DOCUMENTS.items()),
]


@pytest.mark.parametrize(("use", "raise_version"), FILES)
def test_a_newer_file_is_refused_and_left_alone(
    use: Callable[[Path], Path], raise_version: Callable[[Path], None], tmp_path: Path
) -> None:
    tmp_path.chmod(0o700)
    path = use(tmp_path)
    use(tmp_path)
    raise_version(path)
    before = path.read_bytes()
    with pytest.raises(UaFleetError) as caught:
        use(tmp_path)
    text = str(caught.value)
    assert "has version 9, and this ua-fleet reads version 1" in text.replace("reads version 2", "reads version 1")
    assert text.endswith(UPGRADE)
    assert str(path) in text
    assert "\n" not in text
    assert path.read_bytes() == before


@pytest.mark.parametrize("found", [None, True, "2", 1, 0, 1.5])
def test_what_is_no_newer_version(found: object) -> None:
    assert newer_version(found, 1) == ""
