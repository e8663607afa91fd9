from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
import yaml

from ua_fleet.endpoint.users import (
    DEFAULT_COST,
    MAX_WAITING,
    MAX_WAITING_OF_ORIGIN,
    Role,
    ScryptCost,
    UserFileError,
    UserStore,
)
from ua_fleet.errors import ServerStartError

CHEAP = ScryptCost(2**4, 8, 1)


@pytest.fixture
def store(tmp_path: Path) -> UserStore:
    return UserStore(tmp_path / "users.yaml", CHEAP)


def test_roles_are_ordered() -> None:
    assert Role.ENGINEER.covers(Role.OPERATOR)
    assert Role.OPERATOR.covers(Role.OPERATOR)
    assert not Role.OBSERVER.covers(Role.OPERATOR)


def test_add_verify_remove(store: UserStore) -> None:
    store.add("alice", "correct horse", Role.OPERATOR)
    store.add("bob", "battery staple", Role.OBSERVER)
    user = store.verify("alice", "correct horse")
    assert user is not None
    assert (user.name, user.role) == ("alice", Role.OPERATOR)
    assert store.verify("alice", "battery staple") is None
    assert store.verify("nobody", "correct horse") is None
    assert store.verify("alice", "") is None
    assert store.verify("alice", "x" * 100_000) is None
    assert [user.name for user in store.list()] == ["alice", "bob"]
    store.remove("alice")
    assert store.verify("alice", "correct horse") is None
    with pytest.raises(UserFileError, match="no user alice"):
        store.remove("alice")


def test_existing_users_are_not_replaced_by_accident(store: UserStore) -> None:
    store.add("alice", "password-1", Role.OPERATOR)
    with pytest.raises(UserFileError, match="exists"):
        store.add("alice", "password-2", Role.ENGINEER)
    store.add("alice", "password-2", Role.ENGINEER, replace_existing=True)
    assert store.verify("alice", "password-1") is None
    assert store.verify("alice", "password-2") is not None


@pytest.mark.parametrize(
    ("name", "password"),
    [
        ("", "password"),
        ("a b", "password"),
        ("-x", "password"),
        ("anonymous", "password"),
        ("x" * 65, "password"),
        ("alice", "short"),
        ("alice", "x" * 1025),
    ],
)
def test_bad_names_and_passwords(store: UserStore, name: str, password: str) -> None:
    with pytest.raises(UserFileError):
        store.add(name, password, Role.OBSERVER)
    assert not store.path.exists()


def test_file_has_no_passwords_and_a_salt_for_each(store: UserStore) -> None:
    store.add("alice", "same password", Role.OPERATOR)
    store.add("bob", "same password", Role.OPERATOR)
    text = store.path.read_text()
    assert "same password" not in text
    users: dict[str, dict[str, Any]] = yaml.safe_load(text)["users"]
    assert users["alice"]["salt"] != users["bob"]["salt"]
    assert users["alice"]["hash"] != users["bob"]["hash"]
    assert store.path.stat().st_mode & 0o777 == 0o600
    assert [path.name for path in store.path.parent.iterdir() if "lock" not in path.name] == ["users.yaml"]


def test_default_cost_is_a_real_one() -> None:
    assert 128 * DEFAULT_COST.n * DEFAULT_COST.r >= 32 * 1024 * 1024


def test_changes_by_others_are_seen(store: UserStore) -> None:
    reader = UserStore(store.path, CHEAP)
    assert reader.list() == ()
    generation = reader.generation
    store.add("alice", "password-1", Role.OPERATOR)
    assert reader.verify("alice", "password-1") is not None
    assert reader.generation > generation
    store.remove("alice")
    assert reader.verify("alice", "password-1") is None


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o622])
def test_file_open_to_others_is_refused(store: UserStore, mode: int) -> None:
    store.add("alice", "password-1", Role.OPERATOR)
    store.path.chmod(mode)
    with pytest.raises(ServerStartError, match="chmod 600"):
        store.check()
    assert store.get("alice") is None
    with pytest.raises(UserFileError):
        store.verify("alice", "password-1")
    store.path.chmod(0o600)
    store.check()
    assert store.verify("alice", "password-1") is not None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "users: {}",
        "version: 2\nusers: {}",
        "version: 1\nusers: [alice]",
        "version: 1\nusers: {a: {role: king}}",
        "{",
        "version: 1\nusers: {a: {role: operator, n: 3, r: 8, p: 1, salt: AAAA, hash: AAAA}}",
        "version: 1\nusers: {a: {role: operator, n: 1073741824, r: 8, p: 1, salt: AAAA, hash: AAAA}}",
    ],
)
def test_broken_files_are_one_line(store: UserStore, text: str) -> None:
    store.path.write_text(text)
    store.path.chmod(0o600)
    with pytest.raises(ServerStartError) as refused:
        store.check()
    assert str(store.path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_no_file_means_no_users(store: UserStore) -> None:
    store.check()
    assert store.list() == ()
    assert store.verify("alice", "password-1") is None


def test_unknown_users_cost_what_known_ones_do(store: UserStore, monkeypatch: pytest.MonkeyPatch) -> None:
    costly = UserStore(store.path, ScryptCost(2**6, 8, 1))
    costly.add("alice", "password-1", Role.OPERATOR)
    hashed: list[ScryptCost] = []
    original = ScryptCost.hash

    def counted(cost: ScryptCost, password: str, salt: bytes) -> bytes:
        hashed.append(cost)
        return original(cost, password, salt)

    monkeypatch.setattr(ScryptCost, "hash", counted)
    store.verify("alice", "wrong")
    store.verify("nobody", "wrong")
    assert hashed == [ScryptCost(2**6, 8, 1)] * 2


async def test_authenticate_refuses_a_queue_without_end(store: UserStore) -> None:
    store.add("alice", "password-1", Role.OPERATOR)
    origins = [f"10.0.0.{number % 9}" for number in range(MAX_WAITING + 5)]
    logins = [store.authenticate("alice", "password-1", origin=origin) for origin in origins]
    results = await asyncio.gather(*logins, return_exceptions=True)
    assert sum(isinstance(result, UserFileError) for result in results) == 5
    assert sum(getattr(result, "name", "") == "alice" for result in results) == MAX_WAITING


async def test_one_address_does_not_fill_the_queue(store: UserStore) -> None:
    store.add("alice", "password-1", Role.OPERATOR)
    greedy = [asyncio.ensure_future(store.authenticate("alice", "wrong", origin="10.0.0.9")) for _ in range(100)]
    await asyncio.sleep(0)
    other = await store.authenticate("alice", "password-1", origin="10.0.0.7")
    assert other is not None
    results = await asyncio.gather(*greedy, return_exceptions=True)
    assert sum(isinstance(result, UserFileError) for result in results) == 100 - MAX_WAITING_OF_ORIGIN


def test_a_nul_character_makes_no_other_password(store: UserStore) -> None:
    """scrypt's PBKDF2 fills short keys up with zeros, so both have the same hash."""
    store.add("alice", "password-1", Role.OPERATOR)
    assert store.verify("alice", "password-1") is not None
    for wrong in ("password-1\0", "password-1\0\0", "\0password-1"):
        assert store.verify("alice", wrong) is None
    with pytest.raises(UserFileError, match="NUL"):
        store.add("bob", "password-1\0", Role.OPERATOR)


def test_without_a_look_at_the_file_there_are_no_users(store: UserStore) -> None:
    store.add("anna", "password-1", Role.OPERATOR)
    before = store.generation
    store.path.unlink()
    store.path.symlink_to(store.path)
    with pytest.raises(UserFileError, match="cannot be read"):
        store.refresh()
    assert store.get("anna") is None
    assert store.generation > before
