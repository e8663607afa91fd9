from __future__ import annotations

import importlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system import clean_environment
from tests.unit.cli.conftest import Invoke
from ua_fleet.cli import app as application
from ua_fleet.cli.endings import NotFound, UsageError, exit_code_of, extra_needed, storage_error
from ua_fleet.cli.process import run
from ua_fleet.endpoint import certificates
from ua_fleet.errors import (
    AccessRefused,
    BridgeUnavailable,
    ConfigError,
    ConfigInvalid,
    NotConnected,
    RobotOffline,
    SendTimeout,
    ServerStartError,
    SkillFailed,
    SkillRejected,
    SkillTimeout,
    TopicInvalid,
    TransportError,
    UaFleetError,
    add_extra,
)
from ua_fleet.values import StatusCode


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UaFleetError("x"), 1),
        (ServerStartError("x"), 1),
        (AccessRefused(StatusCode.BAD_USER_ACCESS_DENIED, "x"), 1),
        (AccessRefused(StatusCode.BAD_OUT_OF_RANGE, "x"), 1),
        (AccessRefused(StatusCode.BAD_TYPE_MISMATCH, "x"), 2),
        (ConfigError("x"), 2),
        (ConfigInvalid([ConfigError("x")]), 2),
        (UsageError("x"), 2),
        (TopicInvalid("x", "y"), 2),
        (BridgeUnavailable("x", extra="server"), 2),
        (NotFound("x"), 3),
        (AccessRefused(StatusCode.BAD_NODE_ID_UNKNOWN, "x"), 3),
        (NotConnected("x"), 4),
        (TransportError("x"), 4),
        (RobotOffline("x"), 4),
        (SkillFailed("x"), 1),
        (SkillRejected("x"), 1),
        (AccessRefused(StatusCode.BAD_INVALID_ARGUMENT, "x"), 2),
        (SendTimeout("x"), 5),
        (SkillTimeout("x"), 5),
    ],
)
def test_exit_codes(error: UaFleetError, code: int) -> None:
    assert exit_code_of(error) == code


def test_a_missing_package_is_said_with_the_extra() -> None:
    with (
        pytest.raises(
            BridgeUnavailable, match=r"the server needs the package no_such; install ua-fleet with its extra server "
        ),
        extra_needed("the server", "server"),
    ):
        importlib.import_module("no_such")
    with pytest.raises(ModuleNotFoundError), extra_needed("the server", "server"):
        importlib.import_module("ua_fleet.no_such")


@pytest.mark.parametrize(
    ("arguments", "extra"), [(["read", "i=85"], "client"), (["serve"], "server"), (["cert", "create"], "server")]
)
def test_commands_without_asyncua(arguments: list[str], extra: str, fleet: Path) -> None:
    """In a process of its own: modules that other tests have by name would be there twice."""
    argv = ["ua-fleet", *arguments]
    code = f"import sys; sys.modules['asyncua'] = None; sys.argv = {argv!r}; from ua_fleet.cli import main; main()"
    environment = clean_environment()
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=fleet.parent, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2
    assert ended.stderr.endswith(f"needs the package asyncua; {add_extra(extra)}\n")
    assert ended.stderr.count("\n") <= 1


async def _ends() -> None:
    pass


async def _fails() -> None:
    raise NotFound("x")


async def _gets_signal(number: int, released: list[bool]) -> None:
    import asyncio

    try:
        os.kill(os.getpid(), number)
        await asyncio.Event().wait()
    finally:
        released.append(True)


def test_run_gives_results_and_errors() -> None:
    run(_ends())
    with pytest.raises(NotFound):
        run(_fails())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_lets_the_command_release_what_it_holds(number: int) -> None:
    released: list[bool] = []
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        run(_gets_signal(number, released))
    assert released == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    signal.signal(signal.SIGTERM, before)


def test_an_unknown_bridge_and_an_unknown_log_level(
    invoke: Invoke, fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = invoke("bridge", "floor")
    assert (ended.code, ended.stderr) == (3, "ua-fleet: fleet.yaml: there is no bridge 'floor'; bridges there: cell\n")
    monkeypatch.setenv("UA_FLEET_LOG", "loud")
    ended = invoke("bridge", "cell", "-c", str(fleet))
    assert ended.code == 2
    assert ended.stderr == "ua-fleet: UA_FLEET_LOG=loud is no level of logs; use one of: debug, info, warning, error\n"


def test_options_come_last(invoke: Invoke, fleet: Path) -> None:
    assert fleet.exists()
    ended = invoke("serve", "--port", "70000")
    assert (ended.code, ended.stderr) == (2, "ua-fleet: option:server.port: must be at most 65535, not 70000\n")


def test_no_password_and_nobody_to_ask(invoke: Invoke) -> None:
    ended = invoke("read", "i=85", "-u", "anna")
    assert (ended.code, ended.stderr) == (
        2,
        (
            "ua-fleet: there is no password for anna; give --password-file or UA_FLEET_PASSWORD, or log in on a "
            "terminal: ua-fleet login --user anna\n"
        ),
    )


def test_nobody_at_the_endpoint(invoke: Invoke, tcp_port: int) -> None:
    ended = invoke("read", "i=85", "-e", f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet", "--insecure")
    assert ended.code == 4
    assert ended.stderr.startswith(f"ua-fleet: the server at 127.0.0.1:{tcp_port} does not answer (connection refused)")
    assert ended.stderr.endswith("start it with: ua-fleet serve\n")


def test_a_reader_that_went_away_is_no_traceback(fleet: Path) -> None:
    command = [sys.executable, "-m", "ua_fleet.cli", "config", "check", str(fleet)]
    reading, writing = os.pipe()
    os.close(reading)
    ended = subprocess.run(
        command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False, env=clean_environment()
    )
    os.close(writing)
    assert "Traceback" not in ended.stderr
    assert ended.returncode == 1


def test_watch_of_a_server_that_does_not_answer_has_not_ended_in_order(invoke: Invoke) -> None:
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        endpoint = f"opc.tcp://127.0.0.1:{deaf.getsockname()[1]}/x"
        ended = invoke("watch", "i=85", "--timeout", "0.2", "-e", endpoint, "--insecure")
    assert ended.code == 5
    assert f"{endpoint} did not answer in time" in ended.stderr


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError(13, "Permission denied", "/state/a"), "/state/a: permission denied; run this as the user"),
        (OSError(28, "No space left on device", "/state/a"), "/state/a: no space left on device; make room on that"),
        (OSError(30, "Read-only file system", "/state/a"), "/state/a: read-only file system; name a folder that can"),
        (NotADirectoryError(20, "Not a directory", "/a/b"), "/a/b: not a directory; see that it is a file or folder"),
        (OSError(28, "No space left on device"), "a file: no space left on device; make room on that disk"),
    ],
)
def test_an_error_of_a_file_is_one_line(
    error: OSError, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(**_: object) -> None:
        raise error

    def fails_not(*_: object) -> None: ...

    monkeypatch.setattr(application, "app", fails)
    monkeypatch.setattr(application, "prepare_completion", lambda: None)
    monkeypatch.setattr(signal, "signal", fails_not)
    with pytest.raises(SystemExit) as ended:
        application.main()
    shown = capsys.readouterr().err
    assert ended.value.code == 1
    assert shown.startswith(f"ua-fleet: {said}")
    assert shown.count("\n") == 1


def test_an_error_of_no_file_is_a_mistake_of_ours() -> None:
    assert storage_error(ConnectionResetError(104, "Connection reset by peer")) is None
    assert storage_error(PermissionError(13, "Permission denied")) is None, "as a socket has it, too"
    assert storage_error(OSError(28, "No space left on device")) is not None, "as a write to an open file has it"


def test_folders_that_cannot_be_read_have_no_answer(
    invoke: Invoke, fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(_: Path) -> list[Path]:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(certificates, "certificate_paths", refused)
    for arguments in (("list",), ("trust", "--last", "--show"), ("trust", "abcdef0123")):
        ended = invoke("cert", *arguments, "-c", str(fleet))
        assert (ended.code, ended.stdout) == (1, "")
        assert ": Permission denied; run this as the user of the server" in ended.stderr


def test_ctrl_c_while_the_modules_load_ends_without_a_traceback() -> None:
    program = """
import os, signal, sys

class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == "ua_fleet.cli.app":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupted())
from ua_fleet.cli import main
main()
"""
    ended = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=60,
        env=clean_environment(),
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")
