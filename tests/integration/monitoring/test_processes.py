"""Health, metrics and logs of real processes, whose robot, bridge and server go away and come back."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import struct
from base64 import b64encode
from urllib.request import urlopen

from tests.integration.monitoring.conftest import PASSWORD, Plant, names, until
from ua_fleet.client import ScenarioClient
from ua_fleet.errors import SkillFailed
from ua_fleet.monitoring import METRICS, ProcessKind
from ua_fleet.server.key_service.files import GROUPS_FILE, load_groups


def total(samples: dict[tuple[str, ...], float], name: str) -> float:
    """The sum over all labels."""
    return sum(value for key, value in samples.items() if key[0] == name)


async def ready(plant: Plant, process: str) -> None:
    async def asked() -> bool:
        return (await plant.health(process)).is_well

    await until(asked, f"{process} ready")


def shout(url: str, datagram: bytes) -> None:
    """Send to the multicast group as anybody could."""
    host, _, port = url.removeprefix("opc.udp://").partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        sender.sendto(datagram, (host, int(port)))


UNSIGNED = bytes([0xD1, 0x01]) + struct.pack("<H", 300) + bytes([0x01]) + struct.pack("<H", 10) + bytes(20)
"""A NetworkMessage of the bridge without security: PublisherId UInt16, a payload header with one DataSetWriterId."""


async def test_from_start_to_end(plant: Plant) -> None:
    """One life of the processes, which are slow to start."""
    for process in ("server", "bridge", "modbus"):
        await ready(plant, process)

    # Each process has the metrics that the table says, and no others.
    for process in ("server", "bridge", "modbus"):
        with urlopen(f"{plant.monitoring_url(process)}/metrics", timeout=10) as answer:
            shown = names(answer.read().decode())
        assert shown == {metric.name for metric in METRICS if ProcessKind(process) in metric.processes}, process

    # Data, and what is no data.
    await until(lambda: plant.said("server", "bridge cell is there", bridge="cell"), "the bridge")
    server, bridge = await plant.samples("server"), await plant.samples("bridge")
    assert server["ua_fleet_bridge_up", "cell"] == server["ua_fleet_robot_up", "machine"] == 1
    assert bridge["ua_fleet_space_connected",] == bridge["ua_fleet_key_source_up",] == 1
    assert server["ua_fleet_key_remaining_seconds", "t-300"] > 3000
    assert server["ua_fleet_opcua_sessions",] >= 1
    assert server["ua_fleet_opcua_monitored_items",] >= 1
    shout(plant.url, b"\xff" * 50)
    shout(plant.url, UNSIGNED)
    await asyncio.sleep(1.2)
    moved = await plant.samples("server")
    assert moved["ua_fleet_dataset_messages_received_total",] > server["ua_fleet_dataset_messages_received_total",]
    assert moved["ua_fleet_datagrams_received_total",] > server["ua_fleet_datagrams_received_total",]
    assert moved["ua_fleet_loop_lag_seconds_count",] > server["ua_fleet_loop_lag_seconds_count",]
    assert moved["ua_fleet_drops_total", "malformed"] == total(moved, "ua_fleet_malformed_total") >= 1
    assert moved["ua_fleet_drops_total", "not_secured"] >= 1

    async with plant.client() as client:
        # Skills, by outcome.
        await client.call_skill("machine", "work", work="weld", seconds=0.3)
        try:
            await client.call_skill("machine", "work", work="fail", seconds=0.1)
            raise AssertionError("it did not fail")
        except SkillFailed:
            pass
        now = await plant.samples("server")
        assert now["ua_fleet_skill_seconds_count", "done", "work"] == 1
        assert 0.3 <= now["ua_fleet_skill_seconds_sum", "done", "work"] < 10
        assert now["ua_fleet_robot_executions_total", "done", "machine"] == 1
        assert now["ua_fleet_robot_executions_total", "failed", "machine"] == 1
        assert now["ua_fleet_executions_under_way",] == 0
        execution = await client.start_skill("machine", "work", work="drill", seconds=2.0)
        assert (await plant.samples("server"))["ua_fleet_executions_under_way",] == 1
        await execution.result(timeout_s=20)

        # A run, which can be followed by its ids from the server's log into the bridge's.
        scenarios = ScenarioClient(client)
        run_id = await scenarios.run("shift", {})

        async def run_is_over() -> bool:
            return (await scenarios.run_info(run_id)).is_over

        await until(run_is_over, "the end of the run")
        assert (await plant.samples("server"))["ua_fleet_runs_total", "done"] == 1
        assert len(plant.said("server", "run started", run_id=run_id, scenario="shift")) == 1
        begun = plant.said("server", "task begins", run_id=run_id, robot="machine", skill="work")
        assert [line["task"] for line in begun] == ["first", "second"]
        for line in begun:
            ids = {"execution_id": line["execution_id"], "robot": "machine", "skill": "work"}
            assert len(plant.said("server", "skill begins", **ids)) == 1
            assert len(plant.said("server", "skill ended", **ids, outcome="done")) == 1
            assert len(plant.said("server", "task ended", run_id=run_id, **ids, outcome="done")) == 1
            assert len(plant.said("bridge", "execution begins", bridge="cell", **ids)) == 1
            assert len(plant.said("bridge", "execution ended", bridge="cell", **ids, outcome="done")) == 1
        assert len(plant.said("server", "run ended", run_id=run_id, outcome="done")) == 1

        # The robot goes away during a run: a fault and a decision that is open; then it comes back.
        (plant.folder / "scenarios" / "long.yaml").write_text(
            "version: 1\nname: long\nsteps:\n  - {task: it, robot: machine, skill: work, "
            "arguments: {work: weld, seconds: 60}}\n"
        )
        run_id = await scenarios.run("long", {})
        await until(lambda: plant.said("bridge", "execution begins"), "the long work")
        assert (await plant.samples("server"))["ua_fleet_runs_under_way",] == 1
        await plant.end("robot", signal.SIGKILL)

        async def away() -> bool:
            return (await plant.samples("server"))["ua_fleet_robot_up", "machine"] == 0

        await until(away, "the robot's absence")
        is_ready, text = await plant.health("bridge")
        assert not is_ready
        assert text.startswith("not ready: not connected to the space: ")
        assert (await plant.health("bridge", live=True)).is_well
        assert (await plant.samples("bridge"))["ua_fleet_space_connected",] == 0

        async def decision_is_open() -> bool:
            now = await plant.samples("server")
            return now["ua_fleet_decisions_open",] == 1 and now["ua_fleet_faults", "active"] >= 1

        await until(decision_is_open, "the decision")
        (chosen,) = plant.said("server", "a replacement has to be chosen", run_id=run_id, robot="machine")
        assert "nothing is heard of machine for 4 s" in chosen["reason"], "the silence's, not the task's own time-out"
        now = await plant.samples("server")
        assert now["ua_fleet_sources", "silent"] >= 1
        assert now["ua_fleet_robots", "offline"] == 1
        await until(lambda: plant.said("bridge", "not connected to the space"), "the line")  # looked at each second
        await plant.start_robot()
        await ready(plant, "bridge")
        await until(lambda: len(plant.said("bridge", "connected to the space")) == 2, "the line")
        assert len(plant.said("bridge", "not connected to the space")) == 1
        await scenarios.abort(run_id, "the test has seen enough")
        await until(run_is_over, "the end of the first run")
        await until(
            lambda: plant.said("server", "run ended", run_id=run_id, outcome="aborted"), "the end of the second run"
        )
        # Looked at each second: in part first, where not all of its sources have fallen silent by then.
        silent = [line for line in plant.log("server") if line["event"].startswith("robot machine is silent")]
        assert len(silent) in (1, 2)
        await until(lambda: plant.said("server", "robot machine is there, with all its sources"), "its return")

    # The bridge is killed, and comes back; nobody answers meanwhile.
    await plant.end("bridge", signal.SIGKILL)
    is_ready, text = await plant.health("bridge")
    assert not is_ready
    assert text.endswith(": connection refused; check that the process runs")

    async def bridge_is_away() -> bool:
        return (await plant.samples("server"))["ua_fleet_bridge_up", "cell"] == 0

    await until(bridge_is_away, "the bridge's absence")
    is_ready, text = await plant.health("server")
    assert is_ready, "a server without its bridges is ready: they need it"
    assert text.endswith("0 of 1 bridges heard; not heard: cell")
    await plant.start("bridge")
    await until(lambda: len(plant.said("server", "bridge cell is there")) == 2, "its return")
    assert len(plant.said("server", "bridge cell is silent: its status is Bad_NoCommunication")) == 1

    # The server stands still; then it goes on.
    os.kill(plant.children["server"].process.pid, signal.SIGSTOP)
    try:
        is_live, text = await plant.health("server", live=True, timeout_s=0.5)
    finally:
        os.kill(plant.children["server"].process.pid, signal.SIGCONT)
    assert not is_live
    assert text.endswith("did not answer within 0.5 s: its event loop is blocked, or the machine is busy")
    assert (await plant.health("server", live=True)).is_well

    # Without the server the gateway is not ready, and says so once.
    await plant.end("server", signal.SIGKILL)

    async def gateway_is_not_ready() -> bool:
        return (await plant.health("modbus")).text.startswith("not ready: the OPC UA server is not reachable: ")

    await until(gateway_is_not_ready, "the gateway's word")
    assert (await plant.samples("modbus"))["ua_fleet_server_connected",] == 0
    await plant.start("server")
    await ready(plant, "modbus")
    assert len(plant.said("modbus", "the OPC UA server is not reachable")) == 1
    assert len(plant.said("modbus", "the OPC UA server is reachable")) == 2

    # In all that was logged each line names its process, and none shows a secret.
    for process in ("server", "bridge", "modbus"):
        log = plant.log(process)
        assert {line["process"] for line in log} == {process}
        assert all({"event", "level", "timestamp"} <= line.keys() for line in log)
    logged = plant.everything_logged()
    groups = load_groups(plant.folder / "state" / GROUPS_FILE)
    keys = [key for group in groups.values() for key in group.keys]
    secrets = [PASSWORD.encode(), *[part for key in keys for part in (key[:16], key[32:48])]]
    assert len(secrets) > 4
    for secret in secrets:
        for text in (secret.hex(), b64encode(secret).decode(), repr(secret)[2:-1]):
            assert text not in logged
    assert "PRIVATE KEY" not in logged
