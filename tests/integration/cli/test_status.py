"""status against a server that `ua-fleet serve` runs, whose bridge is away."""

from __future__ import annotations

import signal
import time

from tests.integration.cli.conftest import Site


def test_what_is_wrong_is_told_with_the_next_command_and_by_the_exit_code(site: Site) -> None:
    ended = site.run("status", "--utc", user="olga")
    assert ended.code == 1, ended.stderr
    lines = ended.stdout.splitlines()
    assert lines[0].startswith(f"server  Hall  {site.endpoint}  ua_fleet ")
    assert "  Running for " in lines[0]
    assert "  certificate until 20" in lines[0]
    (away,) = [line for line in lines if line.startswith("  bridge floor is not heard  ")]
    assert away.endswith("  ua-fleet bridge floor")
    # Until the silence is a fault it is told as the robot's state.
    assert any(line.startswith(("  rover is offline  ", "  rover.silent: ")) for line in lines)
    assert "bridges  0 of 1 heard" in lines
    assert "robots  1: 1 offline" in lines


def test_programs_have_all_of_it_in_one_object(site: Site) -> None:
    ended = site.run("status", "--json", user="olga")
    assert ended.code == 1
    (status,) = ended.objects
    assert status["server"]["state"] == "Running"
    assert status["bridges"][0]["online"] is False
    assert [robot["state"] for robot in status["robots"]] == ["offline"]
    assert "ua-fleet bridge floor" in [problem["remedy"] for problem in status["problems"]]


def test_it_is_shown_again_until_ctrl_c(site: Site) -> None:
    child = site.start("status", "--watch", "--every", "0.2", "--json")
    child.wait_for('"problems"')
    deadline = time.monotonic() + 20
    while len([line for line in list(child.lines) if '"problems"' in line]) < 3:
        assert time.monotonic() < deadline, child.lines
        time.sleep(0.05)
    assert child.end(signal.SIGINT) == 130
    assert not any("Traceback" in line for line in child.lines)


def test_a_server_that_is_away_ends_with_4(site: Site, tcp_port: int) -> None:
    ended = site.run("status", "-e", f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet")
    assert (ended.code, ended.stdout) == (4, "")
