"""`ua-fleet login`: one password, and then none, until the key ends; and no key for another server."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import pytest
from typer.testing import CliRunner

from tests.integration.cli.conftest import PASSWORD, Ended, Site, command
from tests.system import clean_environment, forked, run
from ua_fleet.cli.app import app
from ua_fleet.cli.endings import exit_code_of
from ua_fleet.errors import UaFleetError

GOAL: Final = "Fleet/Robots/rover/Data/goal"


@dataclass(frozen=True)
class Home:
    """A user of the machine, whose client the server trusts, with nothing in the environment."""

    folder: Path
    site: Site

    @property
    def contexts_file(self) -> Path:
        return self.folder / "ua-fleet" / "client" / "contexts.json"

    @property
    def stored(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.contexts_file.read_text())
        return content

    def change(self, **fields: Any) -> None:
        """Change the fields of the first context in the file."""
        content = self.stored
        content["contexts"][0].update(fields)
        self.contexts_file.write_text(json.dumps(content))

    def run(self, *arguments: str, stdin: str = "", **environment: str) -> Ended:
        if "PYTHONPATH" not in environment:
            return self._run_here(arguments, stdin, environment)
        inherited = {k: v for k, v in clean_environment().items() if not k.startswith("UA_FLEET_")}
        whole = inherited | {"XDG_STATE_HOME": str(self.folder)} | environment
        ended = run(*command(*arguments), env=whole, stdin=stdin)
        assert "Traceback" not in ended.stderr
        assert PASSWORD not in ended.stdout + ended.stderr
        return Ended(ended.returncode, ended.stdout, ended.stderr)

    def _run_here(self, arguments: Sequence[str], stdin: str, environment: Mapping[str, str]) -> Ended:
        """Without a process of its own, which takes longer than what it does."""
        unset: dict[str, str | None] = {name: None for name in os.environ if name.startswith("UA_FLEET_")}
        given = {**unset, "XDG_STATE_HOME": str(self.folder), **environment}
        result = CliRunner().invoke(app, list(arguments), input=stdin, env=given, prog_name="ua-fleet")
        assert PASSWORD not in result.output
        error = result.exception
        if isinstance(error, UaFleetError):
            return Ended(exit_code_of(error), result.stdout, f"{result.stderr}ua-fleet: {error}\n")
        assert error is None or isinstance(error, SystemExit), error
        return Ended(result.exit_code, result.stdout, result.stderr)

    def login(self, *arguments: str, user: str = "oscar") -> Ended:
        return self.run("login", self.site.endpoint, "--user", user, "--password-file", "-", *arguments, stdin=PASSWORD)


@pytest.fixture
def home(site: Site, tmp_path: Path) -> Home:
    shutil.copytree(site.folder / "state-of-client", tmp_path / "home")
    made = Home(tmp_path / "home", site)
    assert not made.contexts_file.exists()
    return made


def keys_of(site: Site, user: str) -> list[str]:
    """Ids of the keys of a user, as the server keeps them."""
    kept = json.loads((site.folder / "state" / "session-keys.json").read_text())
    return [one["id"] for one in kept["keys"] if one["user"] == user]


def test_after_a_login_commands_need_nothing_more(home: Home) -> None:
    before = home.run("read", GOAL, "-e", home.site.endpoint)
    assert before.code == 1
    assert "log in: ua-fleet login --user NAME" in before.stderr
    ended = home.login()
    assert ended.code == 0, ended.stderr
    assert ended.stdout.startswith(f"logged in as oscar at {home.site.endpoint}: context Hall, until ")
    assert home.run("read", GOAL).code == 0
    assert home.run("write", GOAL, "0.5").code == 0
    assert home.run("skill", "list", "rover").code == 0
    assert home.run("robot", "list").code == 0
    assert home.contexts_file.stat().st_mode & 0o777 == 0o600
    assert PASSWORD not in home.contexts_file.read_text()


def test_contexts_are_listed_and_chosen(home: Home) -> None:
    assert "not logged in anywhere" in home.run("contexts").stderr
    assert home.login().code == 0
    assert home.login(user="olga").code == 0
    shown = home.run("contexts").stdout.splitlines()
    assert [line.split()[:2] for line in shown[1:]] == [["Hall", "oscar"], ["*", "Hall-olga"]]
    # olga only looks; oscar may write
    assert home.run("write", GOAL, "0.5").code == 1
    assert home.run("write", GOAL, "0.5", "-c", "Hall").code == 0
    assert home.run("write", GOAL, "0.5", "--user", "oscar").code == 0
    assert home.run("write", GOAL, "0.5", UA_FLEET_CONTEXT="Hall").code == 0
    assert home.run("contexts", "--use", "Hall").code == 0
    assert home.run("write", GOAL, "0.5").code == 0
    listed = home.run("contexts", "--json").objects
    assert [(one["name"], one["user"], one["current"]) for one in listed] == [
        ("Hall", "oscar", True),
        ("Hall-olga", "olga", False),
    ]
    assert "key" not in listed[0]
    until = datetime.fromisoformat(listed[0]["valid_until"])
    assert timedelta(days=6.9) < until - datetime.now(UTC) < timedelta(days=7.1)


def test_what_is_not_there_is_told(home: Home) -> None:
    assert home.login().code == 0
    missing = home.run("read", GOAL, "-c", "attic")
    assert (missing.code, missing.stdout) == (3, "")
    assert missing.stderr == (
        "ua-fleet: no context 'attic', but: Hall; log in: ua-fleet login ENDPOINT --user USER -c attic\n"
    )
    both = home.run("read", GOAL, "-c", "Hall", "--user", "olga")
    assert both.code == 2
    assert "context Hall has the user oscar; leave out --context or --user olga" in both.stderr
    assert home.run("contexts", "--use", "attic").code == 3
    assert "is no name of a context" in home.login("-c", "a b").stderr


def test_logging_in_again_ends_the_old_key(home: Home) -> None:
    assert home.login("-c", "work").code == 0
    first = home.stored["contexts"][0]
    assert first["key_id"] in keys_of(home.site, "oscar")
    # Endpoint and user are the context's.
    again = home.run("login", "-c", "work", "--password-file", "-", stdin=PASSWORD)
    assert again.code == 0, again.stderr
    (second,) = home.stored["contexts"]
    assert (second["name"], second["user"], second["endpoint"]) == ("work", "oscar", home.site.endpoint)
    assert first["key_id"] not in keys_of(home.site, "oscar")
    assert second["key_id"] in keys_of(home.site, "oscar")


def test_a_context_of_another_user_ends_the_key_of_the_one_before(home: Home) -> None:
    assert home.login("-c", "work").code == 0
    first = home.stored["contexts"][0]["key_id"]
    assert home.login("-c", "work", user="olga").code == 0
    assert home.stored["contexts"][0]["user"] == "olga"
    assert first not in keys_of(home.site, "oscar")


def test_logout_ends_the_key_here_and_there(home: Home) -> None:
    assert home.login().code == 0
    key_id = home.stored["contexts"][0]["key_id"]
    ended = home.run("logout")
    assert (ended.code, ended.stderr) == (0, "")
    assert ended.stdout == f"logged out: context Hall (oscar at {home.site.endpoint})\n"
    assert home.stored["contexts"] == []
    assert key_id not in keys_of(home.site, "oscar")
    assert home.run("logout").code == 3


def test_logout_without_a_server_says_what_is_left(home: Home) -> None:
    assert home.login().code == 0
    key_id = home.stored["contexts"][0]["key_id"]
    home.change(endpoint="opc.tcp://127.0.0.1:9/ua_fleet")
    ended = home.run("logout")
    assert ended.code == 0
    assert "the server at 127.0.0.1:9 does not answer (connection refused)" in ended.stderr
    assert f"ua-fleet user logout oscar --key {key_id}" in ended.stderr
    assert home.stored["contexts"] == []
    assert home.site.run("user", "logout", "oscar", "--key", key_id).code == 0


def test_a_key_that_has_ended_says_what_to_run(home: Home) -> None:
    assert home.login().code == 0
    home.change(valid_until="2026-01-31T12:00:00+00:00")
    ended = home.run("read", GOAL)
    assert (ended.code, ended.stdout) == (2, "")
    assert ended.stderr == (
        "ua-fleet: the key of context Hall ended 2026-01-31 12:00 UTC; log in again: ua-fleet login -c Hall\n"
    )
    assert "ended; run: ua-fleet login -c Hall" in home.run("contexts").stdout


def test_a_key_that_the_server_has_ended_says_what_to_run(home: Home) -> None:
    assert home.login().code == 0
    key_id = home.stored["contexts"][0]["key_id"]
    assert home.site.run("user", "logout", "oscar", "--key", key_id).code == 0
    ended = home.run("read", GOAL)
    assert ended.code == 1
    assert ended.stderr.startswith(f"ua-fleet: context Hall: {home.site.endpoint} does not take the key of oscar")
    assert ended.stderr.endswith("log in again: ua-fleet login -c Hall\n")
    assert home.login().code == 0
    assert home.run("read", GOAL).code == 0


def test_a_key_is_not_given_to_another_server(home: Home) -> None:
    """At an endpoint of this machine another fleet may answer tomorrow; it is met, and gets no key of this one."""
    assert home.login().code == 0
    home.change(server_uri="urn:ua-fleet:Attic:server")
    ended = home.run("read", GOAL)
    assert ended.code == 1
    assert "another server answers" in ended.stderr
    assert "its key was not sent" in ended.stderr
    assert f"ua-fleet login {home.site.endpoint} --user oscar" in ended.stderr
    # The context of the other fleet stays; this one gets a name of its own.
    assert home.login().code == 0
    assert {one["name"] for one in home.stored["contexts"]} == {"Hall", "Hall-oscar"}


def on_a_terminal(home: Home, *arguments: str) -> tuple[int, str]:
    """Run a command that asks for a password, and type it."""
    ours, theirs = os.openpty()
    inherited = {k: v for k, v in clean_environment().items() if not k.startswith("UA_FLEET_")}
    whole = inherited | {"XDG_STATE_HOME": str(home.folder)}
    process = forked(*command(*arguments), env=whole, terminal=theirs)
    os.close(theirs)
    said = ""
    try:
        while chunk := os.read(ours, 1024).decode():
            said += chunk
            if chunk.endswith(": ") and "Password of" in said:
                os.write(ours, f"{PASSWORD}\n".encode())
    except OSError:  # the end of the other side is an error where it is a terminal
        pass
    os.close(ours)
    return process.wait(60), said


def test_the_password_is_asked_for_once_all_else_is_right(home: Home) -> None:
    code, said = on_a_terminal(home, "login", home.site.endpoint, "--user", "oscar")
    assert code == 0, said
    assert said.count("Password of oscar: ") == 1
    assert PASSWORD not in said
    assert home.run("read", GOAL).code == 0
    code, said = on_a_terminal(home, "login", "opc.tcp://127.0.0.1:9/ua_fleet", "--user", "oscar")
    assert code == 4
    assert "does not answer" in said
    assert "Password" not in said
    stranger = Home(home.folder.parent / "stranger", home.site)
    code, said = on_a_terminal(stranger, "login", home.site.endpoint, "--user", "oscar")
    assert code == 1
    assert "ua-fleet cert trust --last --show" in said
    assert "Password" not in said


@pytest.mark.parametrize("content", ["{}", "not json", '{"version": 1, "current": "x", "contexts": [{"name": 3}]}'])
def test_a_file_that_cannot_be_read_is_told(home: Home, content: str) -> None:
    home.contexts_file.write_text(content)
    home.contexts_file.chmod(0o600)
    ended = home.run("read", GOAL)
    assert ended.code == 2
    assert f"{home.contexts_file}: cannot be read" in ended.stderr
    assert "remove it, and log in again" in ended.stderr


def test_keys_that_others_can_read_are_not_used(home: Home) -> None:
    assert home.login().code == 0
    home.contexts_file.chmod(0o644)
    ended = home.run("read", GOAL)
    assert ended.code == 2
    assert f"run: chmod 600 {home.contexts_file}" in ended.stderr


def test_a_wrong_password_keeps_nothing(home: Home) -> None:
    ended = home.run("login", home.site.endpoint, "--user", "oscar", "--password-file", "-", stdin="not the password")
    assert ended.code == 1
    assert "user or password is wrong" in ended.stderr
    assert not home.contexts_file.exists()
    assert "the user is missing" in home.run("login", home.site.endpoint).stderr


def test_what_the_environment_names_goes_before_the_current_context(home: Home) -> None:
    assert home.login().code == 0
    named = {"UA_FLEET_ENDPOINT": home.site.endpoint, "UA_FLEET_USER": "olga", "UA_FLEET_PASSWORD": PASSWORD}
    assert home.run("write", GOAL, "0.5", **named).code == 1
    assert home.run("write", GOAL, "0.5", "-c", "Hall", **named).code == 0


KEYRING = """
import json, os, pathlib
_FILE = pathlib.Path(os.environ["TEST_KEYRING"])
class _Backend:
    priority = float(os.environ.get("TEST_KEYRING_PRIORITY", "5"))
def get_keyring():
    return _Backend()
def _load():
    return json.loads(_FILE.read_text()) if _FILE.exists() else {}
def set_password(service, name, secret):
    if os.environ.get("TEST_KEYRING_LOCKED"):
        raise RuntimeError("locked")
    _FILE.write_text(json.dumps(_load() | {f"{service} {name}": secret}))
def get_password(service, name):
    if os.environ.get("TEST_KEYRING_LOCKED"):
        raise RuntimeError("locked")
    return _load().get(f"{service} {name}")
def delete_password(service, name):
    kept = _load()
    del kept[f"{service} {name}"]
    _FILE.write_text(json.dumps(kept))
"""
"""A keyring with the functions of the package, since that is not there in the tests and a desktop's is not either."""


def test_with_a_keyring_the_file_has_no_key(home: Home, tmp_path: Path) -> None:
    (tmp_path / "keyring.py").write_text(KEYRING)
    kept = tmp_path / "kept.json"
    desktop = {"PYTHONPATH": str(tmp_path), "TEST_KEYRING": str(kept)}
    login = ("login", home.site.endpoint, "--user", "oscar", "--password-file", "-")
    ended = home.run(*login, stdin=PASSWORD, **desktop)
    assert ended.code == 0, ended.stderr
    assert "in the keyring" in ended.stderr
    assert home.stored["contexts"][0]["key"] is None
    assert len(json.loads(kept.read_text())) == 1
    assert home.run("read", GOAL, **desktop).code == 0
    for missing in ({"PYTHONPATH": ""}, {"TEST_KEYRING_LOCKED": "1"}, {"TEST_KEYRING_PRIORITY": "0"}):
        gone = home.run("read", GOAL, **(desktop | missing))
        assert gone.code == 2
        assert "log in again: ua-fleet login -c Hall" in gone.stderr
    again = home.run(*login, stdin=PASSWORD, **desktop)
    assert again.code == 0
    assert len(json.loads(kept.read_text())) == 1  # the old key is forgotten
    assert home.run("logout", **desktop).code == 0
    assert json.loads(kept.read_text()) == {}


def test_a_keyring_that_does_not_work_is_no_reason_to_fail(home: Home, tmp_path: Path) -> None:
    (tmp_path / "keyring.py").write_text(KEYRING)
    broken = {"PYTHONPATH": str(tmp_path), "TEST_KEYRING": str(tmp_path / "kept"), "TEST_KEYRING_LOCKED": "1"}
    ended = home.run("login", home.site.endpoint, "-u", "oscar", "--password-file", "-", stdin=PASSWORD, **broken)
    assert ended.code == 0, ended.stderr
    assert home.stored["contexts"][0]["key"]
    assert home.run("read", GOAL, **broken).code == 0
