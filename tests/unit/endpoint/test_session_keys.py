from __future__ import annotations

import json
from pathlib import Path

import pytest

from ua_fleet.endpoint.key_text import KeyText, new_key, parse_key
from ua_fleet.endpoint.session_keys import DAY_S, MOST_OF_USER, KeyFileError, KeyUnknown, SessionKeys
from ua_fleet.endpoint.users import Role, ScryptCost, User, UserFileError, UserStore
from ua_fleet.errors import ServerStartError, StorageUnavailable
from ua_fleet.storage.files import write_whole

CHEAP = ScryptCost(2**4, 8, 1)
NOW = 1_800_000_000.0


@pytest.fixture
def users(tmp_path: Path) -> UserStore:
    store = UserStore(tmp_path / "users.yaml", CHEAP)
    store.add("anna", "password-1", Role.OPERATOR)
    store.add("bert", "password-2", Role.OBSERVER)
    return store


def keys_of(users: UserStore, longest_s: float = 30 * DAY_S) -> SessionKeys:
    return SessionKeys(users.path.with_name("session-keys.json"), users, longest_s)


def names(keys: SessionKeys, now: float = NOW, user: str | None = None) -> list[str]:
    return [key.name for key in keys.list(now, user)]


def test_a_key_is_its_users_and_nobody_elses(users: UserStore) -> None:
    keys = keys_of(users)
    issued = keys.issue("anna", "desk", DAY_S, NOW)
    text, key = issued.text, issued.key
    assert parse_key(str(text)) == text
    assert keys.verify("anna", text, NOW) == User("anna", Role.OPERATOR, session_key=key.id)
    assert keys.verify("bert", text, NOW) is None
    assert keys.verify("nobody", text, NOW) is None
    assert keys.verify("anna", KeyText(text.id, new_key().secret), NOW) is None
    assert keys.verify("anna", new_key(), NOW) is None


def test_the_file_does_not_give_a_key_away(users: UserStore) -> None:
    keys = keys_of(users)
    text = keys.issue("anna", "desk", DAY_S, NOW).text
    assert text.secret not in keys.path.read_text()
    assert keys.path.stat().st_mode & 0o777 == 0o600


def test_a_key_lasts_over_a_restart_and_ends_by_itself(users: UserStore) -> None:
    text = keys_of(users).issue("anna", "desk", DAY_S, NOW).text
    again = keys_of(users)
    user = again.verify("anna", text, NOW + DAY_S - 1)
    assert user is not None
    assert again.holds(user, NOW + DAY_S - 1)
    assert again.verify("anna", text, NOW + DAY_S) is None
    assert not again.holds(user, NOW + DAY_S)


def test_no_key_is_valid_for_longer_than_the_server_lets_it(users: UserStore) -> None:
    issued = keys_of(users).issue("anna", "desk", 365 * DAY_S, NOW)
    text = issued.text
    assert issued.key.until == NOW + 30 * DAY_S
    assert keys_of(users).issue("anna", "other", 0, NOW).key.until == NOW + 30 * DAY_S
    stricter = keys_of(users, DAY_S)
    assert stricter.verify("anna", text, NOW + DAY_S - 1) is not None
    assert stricter.verify("anna", text, NOW + DAY_S) is None


def test_a_new_password_ends_the_keys_and_a_removed_user_has_none(users: UserStore) -> None:
    keys = keys_of(users)
    annas, berts = (keys.issue(name, "desk", DAY_S, NOW).text for name in ("anna", "bert"))
    holder = keys.verify("anna", annas, NOW)
    assert holder is not None
    users.add("anna", "password-1", Role.OPERATOR, replace_existing=True)
    users.remove("bert")
    assert keys.verify("anna", annas, NOW) is None
    assert keys.verify("bert", berts, NOW) is None
    assert not keys.holds(holder, NOW)
    users.add("bert", "password-2", Role.OBSERVER)
    assert keys.verify("bert", berts, NOW) is None
    assert names(keys) == []


def test_a_changed_role_holds_for_a_key(users: UserStore) -> None:
    keys = keys_of(users)
    text = keys.issue("anna", "desk", DAY_S, NOW).text
    content = users.path.read_text().replace("role: operator", "role: engineer")
    users.path.write_text(content)
    user = keys.verify("anna", text, NOW)
    assert user is not None
    assert user.role is Role.ENGINEER


def test_a_user_revokes_only_keys_of_his_own(users: UserStore) -> None:
    keys = keys_of(users)
    issued = keys.issue("anna", "desk", DAY_S, NOW)
    with pytest.raises(KeyUnknown, match="bert has no session key"):
        keys.revoke("bert", issued.key.id, NOW)
    assert keys.revoke("anna", issued.key.id, NOW) == issued.key
    assert keys.verify("anna", issued.text, NOW) is None
    with pytest.raises(KeyUnknown):
        keys.revoke("anna", issued.key.id, NOW)


def test_the_greedy_lose_their_own_keys(users: UserStore) -> None:
    keys = keys_of(users)
    keys.issue("bert", "bert's", DAY_S, NOW)
    for number in range(MOST_OF_USER):
        assert keys.issue("anna", f"{number}", DAY_S + number, NOW).ended == ()
    (ended,) = keys.issue("anna", "one more", DAY_S, NOW).ended
    assert ended.name == "0"
    assert len(names(keys, user="anna")) == MOST_OF_USER
    assert names(keys, user="bert") == ["bert's"]


def test_another_process_revokes_and_is_told(users: UserStore) -> None:
    server, command = keys_of(users), keys_of(users)
    first, second = (server.issue("anna", name, DAY_S, NOW) for name in ("desk", "lab"))
    server.revoke("anna", first.key.id, NOW)
    server.refresh()
    assert server.drain_gone(NOW) == []  # what it has done itself, it has told
    assert command.revoke_all("anna", NOW) == [second.key]
    server.refresh()
    assert server.drain_gone(NOW) == [second.key]
    assert server.drain_gone(NOW) == []
    assert server.verify("anna", second.text, NOW) is None


def test_a_file_that_cannot_be_used_for_a_while_revokes_no_key(users: UserStore) -> None:
    server, command = keys_of(users), keys_of(users)
    first, second = (server.issue("anna", name, DAY_S, NOW) for name in ("desk", "lab"))
    server.path.chmod(0o644)
    with pytest.raises(KeyFileError):
        server.refresh()
    assert server.drain_gone(NOW) == []
    server.path.chmod(0o600)
    command.revoke("anna", first.key.id, NOW)
    server.refresh()
    assert server.drain_gone(NOW) == [first.key]
    assert server.verify("anna", second.text, NOW) is not None


def test_what_is_being_written_is_not_taken_for_another_processs_work(
    users: UserStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever revokes his own key gets the answer first: the key holds until the disk has it."""
    keys = keys_of(users)
    issued = keys.issue("anna", "desk", DAY_S, NOW)
    holder = User("anna", Role.OPERATOR, session_key=issued.key.id)

    def slow(path: Path, data: bytes) -> None:
        assert keys.holds(holder, NOW)
        write_whole(path, data)
        keys.refresh()

    monkeypatch.setattr("ua_fleet.endpoint.session_keys.write_whole", slow)
    keys.revoke("anna", issued.key.id, NOW)
    assert not keys.holds(holder, NOW)
    keys.refresh()
    assert keys.drain_gone(NOW) == []


def test_no_key_where_it_cannot_be_written(users: UserStore, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = keys_of(users)
    keys.issue("anna", "desk", DAY_S, NOW)

    def full(*_args: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr("ua_fleet.endpoint.session_keys.write_whole", full)
        with pytest.raises(StorageUnavailable, match="No space left"):
            keys.issue("anna", "lab", DAY_S, NOW)
    assert names(keys) == ["desk"]


@pytest.mark.parametrize(
    ("content", "mode", "why"),
    [
        ("{}", 0o600, "is no file of session keys"),
        ("not json", 0o600, "is no file of session keys"),
        ('{"version": 1, "keys": [{"id": 1}]}', 0o600, "is no file of session keys"),
        ('{"version": 2, "keys": []}', 0o600, "upgrade ua-fleet"),
        ('{"version": 1, "keys": []}', 0o640, "run: chmod 600"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(users: UserStore, content: str, mode: int, why: str) -> None:
    keys = keys_of(users)
    text = keys.issue("anna", "desk", DAY_S, NOW).text
    keys.path.write_text(content)
    keys.path.chmod(mode)
    with pytest.raises(KeyFileError, match=why):
        keys.verify("anna", text, NOW)
    with pytest.raises(ServerStartError, match=why):
        keys_of(users).check()


def test_what_is_kept_is_what_is_needed(users: UserStore) -> None:
    keys = keys_of(users)
    keys.issue("anna", "old", DAY_S, NOW)
    keys.issue("anna", "n" * 1000, DAY_S, NOW + 2 * DAY_S)
    (kept,) = json.loads(keys.path.read_text())["keys"]
    assert kept["name"] == "n" * 64


def test_a_key_is_no_password(users: UserStore) -> None:
    with pytest.raises(UserFileError, match="looks like a session key"):
        users.add("carl", str(new_key()), Role.OBSERVER)


def test_keys_of_one_server_are_nothing_at_another(tmp_path: Path, users: UserStore) -> None:
    """Also where both have the same user with the same password."""
    text = keys_of(users).issue("anna", "desk", DAY_S, NOW).text
    other = UserStore(tmp_path / "other" / "users.yaml", CHEAP)
    other.add("anna", "password-1", Role.OPERATOR)
    assert keys_of(other).verify("anna", text, NOW) is None


@pytest.mark.parametrize("is_loop", [True, False])
def test_a_file_that_cannot_be_looked_at_makes_no_key_valid(users: UserStore, is_loop: bool) -> None:
    keys = keys_of(users)
    text = keys.issue("anna", "desk", DAY_S, NOW).text
    user = keys.verify("anna", text, NOW)
    assert user is not None
    keys.path.unlink()
    if is_loop:
        keys.path.symlink_to(keys.path)
    else:
        keys.path.write_text("[" * 100_000)
        keys.path.chmod(0o600)
    with pytest.raises(KeyFileError):
        keys.refresh()
    assert not keys.holds(user, NOW)
    with pytest.raises(ServerStartError):
        keys_of(users).check()
