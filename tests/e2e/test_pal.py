"""The fault-tolerant assembly line as a user runs it: one command, real ROS nodes, ten times faster."""

from __future__ import annotations

import json
import re
import signal
import socket
import sys
from pathlib import Path
from typing import Any

import pytest
from ua_demo.pal.conductor import POSE

from tests import forking, terminal
from tests.e2e.console import check_console, told_of_console
from tests.system import ROOT, Child, Processes, clean_environment, free_multicast_url, free_tcp_port
from tests.system import ros_domain as ros_domain_lock
from ua_fleet.endpoint.certificates import CertificateState, list_certificates

RUN_TIMEOUT_S = 90
CHILDREN_ARE_FORKED = Path(__file__).with_name("children_are_forked")


def _start(processes: Processes, folder: Path, domain: int, *options: str, once: bool = True) -> tuple[Child, Path]:
    report = folder / "report.json"
    command = [
        *(sys.executable, "-m", "ua_fleet.cli", "demo", "pal", "--speed", "10", "--json", str(report)),
        *(["--once"] if once else []),
        *("--domain", str(domain), "--port", str(free_tcp_port()), "--ros-master-port", str(free_tcp_port())),
        *([] if "--broker" in options else ["--pubsub-url", free_multicast_url()]),
        *("--folder", str(folder / "run")),
        *("--console-port", str(free_tcp_port())),
        *options,
    ]
    return processes.start(*command), report


def _finish(child: Child) -> int:
    return child.process.wait(RUN_TIMEOUT_S)


def _run(processes: Processes, folder: Path, domain: int, *options: str) -> tuple[dict[str, Any], list[str]]:
    """What it reports and prints."""
    child, path = _start(processes, folder, domain, *options)
    code = _finish(child)
    assert code == 0, "\n".join(child.lines)
    return json.loads(path.read_text()), child.lines


# Of the counter that is 0 at first; whether that comes before the line begins, and so before its timeline, is chance.
HEARS_OF_NONE = "turtlebot3 hears of covers for its bucket (count 0)"


def _page_of_the_site() -> list[str]:
    return (ROOT / "docs" / "index.md").read_text(encoding="utf-8").splitlines()


def _told(lines: list[str]) -> set[str]:
    """What a timeline tells, without when."""
    told = {found[1] for line in lines if (found := re.fullmatch(r" *\d+\.\d\d s  (.+)", line))}
    assert len(told) > 20
    return told


def _check_line(report: dict[str, Any]) -> None:
    covers = report["covers"]
    assert [cover["carrier"] for cover in covers] == ["conveyor", "conveyor", "turtlebot3", "turtlebot3"]
    placed = [cover["placed_s"] for cover in covers]
    assert placed == sorted(placed)
    # As in Figure 7: two covers before the belt stops at 25 s, two after it.
    assert placed[1] < 25 < placed[2]
    assert all(cover["placed_s"] < cover["delivered_s"] for cover in covers)
    # The last cover had to wait until the TurtleBot3 had delivered the one before.
    assert covers[3]["placed_s"] > covers[2]["delivered_s"]
    assert report["looped"] == 0
    assert report["drops"]["loop"] > 0
    for way in ("ros1_to_ros2", "ros1_to_server", "ros2_to_server"):
        assert 0 < report["delays_ms"][way]["p50"] <= report["delays_ms"][way]["p99"] <= report["delays_ms"][way]["max"]
    said = [event["what"] for event in report["events"]]
    assert any("turns the conveyor off" in what for what in said)
    assert any(what.startswith("server sees the conveyor") for what in said)


@pytest.mark.needs("ros1", "ros2")
def test_the_line_with_the_arm_in_ros1(processes: Processes, tmp_path: Path, ros_domain: int) -> None:
    report, lines = _run(processes, tmp_path, ros_domain, "--no-console")
    _check_line(report)
    assert report["ros1"] is True
    assert _told(_page_of_the_site()) - _told(lines) <= {HEARS_OF_NONE}, "docs/index.md shows what no run prints"
    assert told_of_console(lines) == []
    assert not (tmp_path / "run" / "log" / "console.log").exists()


@pytest.mark.needs("ros2")
def test_the_line_without_ros1_has_the_arm_in_ros2(processes: Processes, tmp_path: Path, ros_domain: int) -> None:
    with ros_domain_lock() as arm_domain, socket.create_server(("127.0.0.1", 0)) as somebody:
        port = somebody.getsockname()[1]
        options = ("--without-ros1", "--arm-domain", str(arm_domain), "--console-port", str(port))
        child, path = _start(processes, tmp_path, ros_domain, *options, once=False)
        child.wait_for("the line stays up until you press Ctrl-C", RUN_TIMEOUT_S)
        check_console(child, "AssemblyLine", ("niryo_ned", "turtlebot3", "human"), ("turtlebot3", POSE))
        assert child.end(signal.SIGINT) == 0
    logs = "".join(log.read_text() for log in (tmp_path / "run" / "log").glob("*.log"))
    assert "was killed" not in logs, "who is logged in at the console does not keep it up"
    if len(told_of_console(child.lines)) == 2:
        assert any(f"port {port} is in use; the web console takes " in line for line in child.lines)
        known = list_certificates(tmp_path / "run" / "state")
        assert [info.gateway for info in known if info.state is CertificateState.GATEWAY] == ["console"]
    report = json.loads(path.read_text())
    _check_line(report)
    assert report["ros1"] is False
    # Told again at the end: by then the first time has scrolled away.
    assert sum("user operator, password" in line for line in child.lines) == 2
    (lost,) = (line for line in child.lines if "lost, by cause" in line)
    (there,) = (line for line in child.lines if line.startswith("there already"))
    assert "loop" in there
    assert "loop" not in lost


@pytest.mark.needs("ros1", "ros2")
def test_the_secured_line_has_the_same_result(processes: Processes, tmp_path: Path, ros_domain: int) -> None:
    report, _ = _run(processes, tmp_path, ros_domain, "--secure")
    _check_line(report)
    assert report["secure"] is True
    refused = report["drops"].keys() & {
        "not_secured",
        "bad_signature",
        "replayed",
        "unknown_token",
        "no_key",
        "secured",
    }
    assert not refused, report["drops"]
    config = (tmp_path / "run" / "fleet.yaml").read_text()
    assert "security: sign_and_encrypt" in config
    logged = "".join(path.read_text() for path in (tmp_path / "run" / "log").glob("*.log"))
    for kept in (tmp_path / "run" / "state").rglob("*.json"):
        for word in kept.read_text().split('"'):
            assert not (len(word) >= 64 and word in logged), f"a key of {kept.name} stands in a log"


@pytest.mark.needs("ros1", "ros2", "mosquitto")
def test_over_a_broker_the_line_has_the_same_result(processes: Processes, tmp_path: Path, ros_domain: int) -> None:
    report, lines = _run(processes, tmp_path, ros_domain, "--broker", "--secure", "--no-console")
    _check_line(report)
    assert "url: mqtt://127.0.0.1:" in (tmp_path / "run" / "fleet.yaml").read_text()
    assert any("mosquitto_sub -h 127.0.0.1 -p " in line for line in lines)
    assert "New client connected" in (tmp_path / "run" / "log" / "mosquitto.log").read_text()


@pytest.mark.needs("ros1", "ros2")
def test_without_the_loop_rule_messages_come_round_again(processes: Processes, tmp_path: Path, ros_domain: int) -> None:
    # Bridges compute without a pause while messages go round: a quicker line ends that sooner.
    child, path = _start(processes, tmp_path, ros_domain, "--without-loop-rule", "--speed", "20")
    assert _finish(child) == 1
    assert json.loads(path.read_text())["looped"] > 0
    assert any("delivered twice" in line for line in child.lines)


@pytest.mark.needs("ros2")
@pytest.mark.parametrize("shown", ["starting the server", "ned picks a cover"])
def test_ctrl_c_before_the_end_is_no_error_of_make(tmp_path: Path, ros_domain: int, shown: str) -> None:
    forking.share()
    with ros_domain_lock() as arm_domain:
        options = (
            *("--speed", "20", "--without-ros1", "--domain", ros_domain, "--arm-domain", arm_domain),
            *("--port", free_tcp_port(), "--pubsub-url", free_multicast_url(), "--folder", tmp_path / "run"),
        )
        ended = terminal.typed_after(
            ("make", "--old-file=setup", "demo", f"ARGS={' '.join(map(str, options))}"),
            shown,
            terminal.CTRL_C,
            folder=ROOT,
            environment=clean_environment(PYTHONPATH=str(CHILDREN_ARE_FORKED)),
            delay_s=0.5,
        )
    assert (ended.code, "Error" in ended.shown, "Traceback" in ended.shown) == (-signal.SIGINT, False, False)
    assert "ended too early; all of its processes are ended, too" in ended.shown
