"""`ua-fleet bridge` and `ua-fleet pubsub listen` beside a server that `ua-fleet serve` runs."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from tests.integration.cli.conftest import Site, command
from tests.system import ROS1_PYTHON, Processes, clean_environment, free_multicast_url, free_tcp_port
from ua_fleet.transport.udp import UdpTransport

GOAL = "ua_0_2_1003"


def test_listen_prints_what_a_write_sends(site: Site) -> None:
    child = site.start("pubsub", "listen", user=None)
    child.wait_for(f"metadata  {GOAL}  (goal)  goal=double", 30)
    site.run("write", GOAL, "0.5")
    line = child.wait_for(f"{GOAL}  (goal)  goal=0.5")
    assert not line.startswith("metadata")
    assert child.end(signal.SIGINT) == 130
    assert child.lines[-1].startswith("messages: ")
    assert not any("Traceback" in line for line in child.lines)


def test_listen_json_ends_by_count_and_tells_its_counters(site: Site) -> None:
    site.run("write", GOAL, "0.75")
    ended = site.run("pubsub", "listen", "--count", "1", "--timeout", "30", "--json", user=None)
    assert ended.code == 0, ended.stderr
    shown = ended.objects[0]
    assert shown["event"] in ("data", "metadata", "announcement")  # the server announces what it has now and then
    assert shown["event"] == "announcement" or shown["topic"].startswith("ua_0_2_")
    figures = json.loads(ended.stderr.splitlines()[-1])
    assert set(figures) == {"messages", "kinds", "gaps", "drops", "malformed", "kernel_drops"}


def test_listen_elsewhere_hears_nothing(site: Site) -> None:
    ended = site.run("pubsub", "listen", "--url", free_multicast_url(), "--timeout", "0.5", user=None)
    assert ended.code == 5
    assert "no message arrived within 0.5 s" in ended.stderr
    assert "messages: 0, gaps: 0, dropped: nothing" in ended.stderr


async def test_listen_counts_what_is_no_message(site: Site) -> None:
    url = free_multicast_url()
    child = site.start("pubsub", "listen", "--url", url, "--count", "1", "--timeout", "1.5", user=None)
    sender = UdpTransport(url, "lo")
    await sender.start(lambda _datagram, _address: None)
    try:
        import asyncio

        while child.process.poll() is None:
            sender.send(b"\x00\xff garbage")
            await asyncio.sleep(0.05)
    finally:
        await sender.close()
    assert child.end() == 5
    assert any("(malformed: " in line for line in child.lines)


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("--url", "udp://x"), 4, "is no PubSub address; write opc.udp://<host>:<port>"),
        (("--interface", "nope0"), 4, "nope0"),
    ],
)
def test_listen_where_one_cannot(site: Site, options: tuple[str, ...], code: int, said: str) -> None:
    ended = site.run("pubsub", "listen", *options, user=None)
    assert (ended.code, ended.stdout) == (code, "")
    assert said in ended.stderr.splitlines()[-1]


def fleet_file(folder: Path, bridge: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(
        f"version: 1\npubsub: {{security: none, url: '{free_multicast_url()}'}}\n"
        f"bridges:\n  it: {{status_id: 1, {bridge}}}\n"
    )
    return path


@pytest.mark.needs("ros2")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_ros2_bridge_runs_and_ends_in_order(
    processes: Processes, tmp_path: Path, ros_domain: int, number: int
) -> None:
    path = fleet_file(tmp_path, f"kind: ros2, space: {ros_domain}")
    child = processes.start(*command("bridge", "it", "-c", str(path)))
    child.wait_for("ready: bridge it")
    assert child.end(number) == 130
    assert not any("Traceback" in line for line in child.lines)


@pytest.mark.needs("ros1")
def test_a_ros1_bridge_waits_for_its_master_without_asyncua(processes: Processes, tmp_path: Path) -> None:
    path = fleet_file(tmp_path, f"kind: ros1, master_uri: 'http://127.0.0.1:{free_tcp_port()}'")
    child = processes.start(ROS1_PYTHON, "-m", "ua_fleet.cli", "bridge", "it", "-c", path, "--json")
    assert json.loads(child.wait_for('{"ready"')) == {"ready": True, "bridge": "it"}
    assert child.end(signal.SIGINT) == 130
    assert not any("Traceback" in line for line in child.lines)


def test_a_bridge_whose_library_is_missing_is_one_line(processes: Processes, tmp_path: Path) -> None:
    # The main environment has no rospy: its packages clash with those of ROS 2.
    path = fleet_file(tmp_path, "kind: ros1")
    child = processes.start(*command("bridge", "it", "-c", str(path)), env=clean_environment(UA_FLEET_LOG="error"))
    code = child.process.wait(60)
    child.end()
    if code == 130:
        pytest.skip("this environment has rospy")
    assert code == 2
    assert "rospy" in child.lines[-1] or "rosgraph" in child.lines[-1]
    assert not any("Traceback" in line for line in child.lines)
