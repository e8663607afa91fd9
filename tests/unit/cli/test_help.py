from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from tests.system import clean_environment
from tests.unit.cli.conftest import Invoke
from ua_fleet import __version__
from ua_fleet.cli.app import app

COMMANDS = [
    "serve",
    "bridge",
    "up",
    "login",
    "logout",
    "console",
    "contexts",
    "completion",
    "status",
    "browse",
    "read",
    "write",
    "watch",
    "simulate",
    "healthcheck",
    "history",
    "config init",
    "config check",
    "config add-topics",
    "config assign-ids",
    "config schema",
    "config show",
    "user add",
    "user list",
    "user remove",
    "user keys",
    "user logout",
    "cert create",
    "cert revoke",
    "cert forget",
    "cert trust",
    "cert list",
    "audit verify",
    "keys create",
    "keys rotate",
    "keys list",
    *(f"state {name}" for name in ("backup", "check", "restore")),
    *(f"scenario {name}" for name in ("list", "validate", "dryrun", "run", "watch")),
    *(f"scenario {name}" for name in ("pause", "resume", "abort", "adopt", "answer", "tell")),
    "fault list",
    "drive",
    "fault ack",
    "fault clear",
    "fault raise",
    "decision list",
    "decision confirm",
    "decision judge",
    "decision mode",
    "decision whatif",
    "skill list",
    "skill call",
    "skill halt",
    "skill suspend",
    "skill resume",
    "skill offer",
    "robot list",
    "robot hold",
    "robot release",
    "robot register",
    "robot unregister",
    "modbus map",
    "modbus serve",
    "pubsub listen",
    "pubsub decode",
    "pubsub probe",
    "pubsub record",
    "pubsub relay",
    "pubsub replay",
    "pubsub export",
    "demo pal",
    "demo talkrobots",
    "testbed prepare",
    "testbed robot",
    "testbed run",
    "testbed login",
]
WITHOUT_JSON = {
    "config schema",  # prints nothing else
    "testbed prepare",  # tells no data
    "testbed robot",  # is another program then
    "completion",  # prints a script
    "up",  # shows the lines of other processes
    "testbed run",  # its result stands in a file
}


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_explains_itself(command: str, invoke: Invoke) -> None:
    ended = invoke(*command.split(), "--help")
    assert ended.code == 0
    assert f"Usage: ua-fleet {command} " in ended.stdout
    assert ("--json" in ended.stdout) is (command not in WITHOUT_JSON)
    assert "Examples:\n  " in ended.stdout
    assert f"ua-fleet {command}" in ended.stdout.partition("Examples:")[2]
    assert "  --password " not in ended.stdout


def test_the_list_above_is_complete() -> None:
    def names(commands: Mapping[str, Any], before: str) -> Iterator[str]:
        for name, command in commands.items():
            if isinstance(command, TyperGroup):
                yield from names(command.commands, f"{before}{name} ")
            else:
                yield before + name

    whole: Any = get_command(app)
    assert sorted(names(whole.commands, "")) == sorted(COMMANDS)


@pytest.mark.parametrize("arguments", [[], ["config"], ["user"], ["cert"], ["audit"], ["keys"], ["pubsub"], ["demo"]])
def test_without_a_command_the_help_is_shown(arguments: list[str], invoke: Invoke) -> None:
    ended = invoke(*arguments)
    assert ended.code == 2
    assert "Usage: ua-fleet" in ended.stdout + ended.stderr


def test_version(invoke: Invoke) -> None:
    assert invoke("--version").stdout == f"ua-fleet {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["read"], "Missing argument"),
        (["read", "i=85", "--nope"], "No such option"),
        (["read", "i=85", "--timeout", "soon"], "Invalid value for '--timeout'"),
        (["watch", "i=85", "--count", "0"], "Invalid value for '--count'"),
        (["user", "add", "x", "--role", "king"], "Invalid value for '--role'"),
        (["user", "add", "x", "--password", "secret"], "No such option"),
    ],
)
def test_usage_errors_end_with_2(arguments: list[str], said: str, invoke: Invoke) -> None:
    ended = invoke(*arguments)
    assert ended.code == 2
    assert said in ended.stderr
    assert ended.stdout == ""


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; import ua_fleet.cli;"
        "heavy = ('asyncua', 'rclpy', 'rospy', 'pydantic', 'yaml', 'cryptography', 'structlog.dev', 'ua_fleet.server');"
        "print([name for name in heavy if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_the_entry_point_ends_without_traceback() -> None:
    for arguments, code in ((["nonsense"], 2), (["config", "check", "/no/such/file"], 2), (["--help"], 0)):
        run = subprocess.run(
            [sys.executable, "-m", "ua_fleet.cli", *arguments],
            capture_output=True,
            text=True,
            check=False,
            env=clean_environment(),
        )
        assert run.returncode == code
        assert "Traceback" not in run.stderr
