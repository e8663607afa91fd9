"""`ua-fleet console` as a process: what it says, and that its end is in order."""

from __future__ import annotations

import json
import signal
import time
import urllib.request
from pathlib import Path

from tests.integration.cli.conftest import command
from tests.system import Processes, clean_environment


def test_it_says_its_url_serves_and_ends_within_two_seconds(
    processes: Processes, tmp_path: Path, tcp_port: int
) -> None:
    environment = clean_environment(XDG_STATE_HOME=str(tmp_path))
    endpoint = f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet"
    child = processes.start(
        *command("console", "--listen", "127.0.0.1:0", "--fleet", f"hall={endpoint}"), env=environment
    )
    url = child.wait_for("ready: ", 40).partition("ready: ")[2]
    assert url.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(f"{url}api/fleets") as answer:
        assert [one["endpoint"] for one in json.load(answer)["fleets"]] == [endpoint]
    began = time.monotonic()
    code = child.end(signal.SIGTERM)
    assert time.monotonic() - began < 2, "it takes too long"
    assert code == 130
    assert not [line for line in child.lines if "Traceback" in line]


def test_mistakes_of_its_file_are_told_at_once_with_their_lines(processes: Processes, tmp_path: Path) -> None:
    file = tmp_path / "console.yaml"
    file.write_text("version: 1\nlisten: 0.0.0.0:8080\nfleets:\n  hall: {endpoint: http://x}\nlimits:\n  sesions: 3\n")
    child = processes.start(*command("console", "--config", str(file)), env=clean_environment())
    assert child.process.wait(40) == 2
    said = "\n".join(child.lines)
    assert f"{file}:4" in said
    assert "sesions" in said
    file.write_text("version: 1\nlisten: 0.0.0.0:8080\nfleets:\n  hall: {endpoint: opc.tcp://127.0.0.1:1}\n")
    child = processes.start(*command("console", "--config", str(file)), env=clean_environment())
    assert child.process.wait(40) == 2
    assert "allowed_hosts is missing" in "\n".join(child.lines)


def test_what_is_weak_is_asked_for_by_name_and_said(processes: Processes, tmp_path: Path) -> None:
    given = ("--listen", "0.0.0.0:0", "--allow-host", "fleet.example", "--plain-http")
    child = processes.start(*command("console", *given), env=clean_environment(XDG_STATE_HOME=str(tmp_path)))
    url = child.wait_for("ready: ", 40).partition("ready: ")[2]
    assert url.startswith("http://fleet.example:")
    assert any("unencrypted" in line for line in child.lines)
