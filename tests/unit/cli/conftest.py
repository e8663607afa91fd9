from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ua_fleet.cli.app import app
from ua_fleet.cli.endings import exit_code_of
from ua_fleet.errors import UaFleetError

FLEET = """\
version: 1
pubsub: {security: none}
bridges:
  cell: {kind: ros1, status_id: 1}
robots:
  ned:
    bridge: cell
    data:
      belt: {id: 1001, type: Boolean}
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended; an error counts as `main` counts it."""

    code: int
    stdout: str
    stderr: str


Invoke = Callable[..., Ended]


@pytest.fixture
def invoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Invoke:
    """Runs a command in this process, in a folder of its own and with none of the caller's variables."""
    monkeypatch.chdir(tmp_path)
    for variable in ("CONFIG", "ENDPOINT", "USER", "PASSWORD", "LOG", "PUBSUB_KEY", "CONTEXT"):
        monkeypatch.delenv(f"UA_FLEET_{variable}", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "xdg"))
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: str, stdin: str | None = None) -> Ended:
        result = CliRunner().invoke(app, list(arguments), input=stdin, prog_name="ua-fleet")
        error = result.exception
        if isinstance(error, UaFleetError):
            return Ended(exit_code_of(error), result.stdout, f"{result.stderr}ua-fleet: {error}\n")
        if error is not None and not isinstance(error, SystemExit):
            raise error
        return Ended(result.exit_code, result.stdout, result.stderr)

    return run


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """A valid configuration file in the command's folder."""
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET)
    return path
