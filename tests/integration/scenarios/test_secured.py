"""Skills and scenarios over signed and encrypted PubSub."""

from __future__ import annotations

import json
import shutil
import signal
import time
from pathlib import Path
from typing import Any, Final

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.peer import Peer
from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, call, run, run_is, says, value, watching
from tests.integration.server_model.harness import reader, ua, until
from tests.system import Processes
from ua_fleet.counters import Drop
from ua_fleet.keys.files import FileKeySource
from ua_fleet.nodes.nodeset import TypeId
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.wire.security import SecurityMode, SecurityPolicy, read_security

SERVICE: Final = {"security": "sign_and_encrypt", "keys": {"lifetime_s": 2.0, "future_keys": 8}}
FILES: Final = {"security": "sign_and_encrypt", "keys": {"source": "files"}}
REFUSED: Final = (Drop.NOT_SECURED, Drop.BAD_SIGNATURE, Drop.REPLAYED, Drop.UNKNOWN_TOKEN, Drop.NO_KEY)
RIGHT: Final = 302

STEPS = """
  - {task: first, skill: work, robot: left, arguments: {work: first, seconds: 0.2}}
  - {task: long, skill: work, robot: left, arguments: {work: long, seconds: 1.5}, on_unknown: replace}
  - {task: after, skill: work, robot: left, arguments: {work: after}}
  - repeat: [{task: lap, skill: work, robot: right, arguments: {work: lap, seconds: 0.1}}]
    while: go_on > 0
  - {task: back, skill: work, robot: left, arguments: {work: back}}
"""


@pytest.fixture
def plant(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Plant:
    """A fleet with message security; the parameter is its `pubsub`."""
    return Plant(tmp_path, udp_url, tcp_port, processes, "automatic", request.param)


def tokens(peer: Peer, space: int) -> set[int]:
    """The keys, by their tokens, that a space has sent data with; nothing of it may be less than encrypted."""
    heard = [found for found in map(read_security, peer.datagrams) if found.publisher_id == space]
    sent = [found for found in heard if found.writer_group_id is not None and not found.is_discovery]
    assert {found.mode for found in sent} == {SecurityMode.SIGN_AND_ENCRYPT}
    return {found.token_id for found in sent if not found.is_action}


async def refused(client: Client) -> dict[str, int]:
    """What the server has dropped for want of security."""
    nodes = {cause.value: client.get_node(f"ns=2;s=Fleet.Traffic.Drops.{cause.value}") for cause in REFUSED}
    return {cause: await node.read_value() for cause, node in nodes.items()}


@pytest.mark.parametrize("plant", [SERVICE], indirect=True)
async def test_a_run_goes_on_through_new_keys_a_fault_and_a_bridge_that_comes_back(plant: Plant) -> None:
    await plant.prepare()
    plant.scenario("work_on", STEPS)

    async def told() -> Any:
        return plant.told()

    async with plant.server() as server:
        bridges = {robot: plant.start_bridge(robot) for robot in ROBOTS}
        for child in bridges.values():
            await says(child, "ready")
        async with server.client() as client, watching(client, TypeId.DECISION_EVENT) as seen:
            await all_heard(client)
            skill = client.get_node("ns=2;i=1101")
            start: Any = ua.NodeId.from_string("ns=2;s=1101.Start")

            async def started() -> Any:
                return await skill.call_method(start, "by hand", 0.0)

            await started()
            await until(told, lambda jobs: jobs == [("middle", "by hand")])

            run_id = await run(client, "work_on")
            await until(told, lambda jobs: ("left", "long") in jobs)
            bridges["left"].end(signal.SIGKILL)
            await seen.wait_for("middle takes over from left")
            await until(told, lambda jobs: ("middle", "after") in jobs)
            await until(told, lambda jobs: ("right", "lap") in jobs)
            before = tokens(server.peer, RIGHT)
            await says(plant.start_bridge("left"), "ready")
            active = client.get_node("ns=2;s=Fleet.Faults.left.silent.ActiveState.Id")
            await until(active.read_value, lambda is_active: is_active is False)

            async def rotated() -> Any:
                return len(tokens(server.peer, RIGHT) - before)

            await until(rotated, lambda new: new >= 3)
            await client.get_node("ns=2;i=1300").write_value(ua.DataValue(ua.Variant(0, ua.VariantType.Int32)))
            assert await run_is(client, run_id, "done", "failed") == "done"
            assert set(await value(client, f"Scenarios.Runs.{run_id}.States")) == {"done"}
            assert await refused(client) == dict.fromkeys([cause.value for cause in REFUSED], 0)
    jobs = [job for job in plant.told() if job != ("right", "lap")]
    assert jobs == [
        ("middle", "by hand"),
        *[("left", "first"), ("left", "long"), ("middle", "long"), ("middle", "after"), ("left", "back")],
    ]
    assert plant.told().count(("right", "lap")) >= 3, "one at least with each key"


@pytest.mark.parametrize("plant", [FILES], indirect=True)
async def test_a_bridge_with_a_wrong_key_is_shown_and_replaced_until_it_has_the_right_one(plant: Plant) -> None:
    await plant.prepare()
    keys, other = KeyFolder(plant.folder / "keys"), KeyFolder(plant.folder / "other")
    right = keys.path_of("t-300").read_bytes()
    shutil.copytree(keys.path, other.path)
    other.path.chmod(0o700)
    other.write(KeyFile.new("t-300", SecurityPolicy.AES256_CTR, 3600.0, time.time()))
    raw = json.loads((plant.folder / "fleet.json").read_text())
    raw["pubsub"]["keys"]["folder"] = "other"
    (plant.folder / "wrong.json").write_text(json.dumps(raw))
    plant.scenario("two", "".join(f"  - {{task: {name}, skill: work, robot: left}}\n" for name in ("a", "b")))

    children = [plant.start_bridge("left", "wrong.json"), *map(plant.start_bridge, ROBOTS[1:])]
    for child in children:
        await says(child, "ready")
    async with plant.server() as server, server.client() as client:
        async with watching(client, TypeId.FAULT_ALARM, TypeId.DECISION_EVENT) as seen:
            run_id = await run(client, "two")
            for node_id in ("ns=2;s=900.Detail", "ns=2;s=1100.CurrentState"):
                status = reader(client, node_id)
                await until(status, lambda data: data.StatusCode.name == "BadSecurityChecksFailed")
            alarm = await seen.wait_for("left: it is not heard")
            await seen.wait_for("middle takes over from left")
        assert await run_is(client, run_id, "done", "failed") == "done"
        assert plant.told() == [("middle", "weld")] * 2
        assert (await refused(client))["bad_signature"] > 0
        assert alarm.SourceNode.to_string() == "ns=2;s=Robots.left"

        fresh = other.path_of("t-300").with_suffix(".new")
        fresh.touch(mode=0o600)
        fresh.write_bytes(right)
        fresh.replace(other.path_of("t-300"))
        for node_id in ("ns=2;s=900.Detail", "ns=2;s=1100.CurrentState"):
            await until(reader(client, node_id), lambda data: data.StatusCode.is_good())
        assert await run_is(client, await run(client, "two"), "done", "failed") == "done"
    assert plant.told()[2:] == [("left", "weld")] * 2


@pytest.mark.parametrize("plant", [FILES], indirect=True)
async def test_a_bridge_with_its_own_keys_cannot_answer_for_the_robot_of_another(plant: Plant) -> None:
    await plant.prepare()
    plant.scenario("endless", f"  - {{task: a, skill: work, robot: right, arguments: {{work: {ENDLESS_WORK}}}}}\n")
    plant.bridge("right")
    status, keys = Topic(300, 2, 1200), FileKeySource(plant.folder / "keys", SecurityPolicy.AES256_CTR)
    async with (
        plant.server() as server,
        server.client() as client,
        Peer.secured(plant.config, 300, plant.folder, keys) as left,
    ):
        run_id = await run(client, "endless")

        async def states() -> Any:
            return await value(client, f"Scenarios.Runs.{run_id}.States")

        await until(states, lambda shown: shown == ["accepted"])
        (job,) = plant.machines["right"].told()
        left.announce(status, SKILL_STATUS_FIELDS)
        for state in (ExecutionState.DONE, ExecutionState.FAILED):
            lie = SkillStatus()
            lie.show(ExecutionStatus(job.execution_id, "work", state))
            left.publish(status, *lie.fields()[1])

        async def heard() -> Any:
            return (await reader(client, "ns=2;s=1200.State")()).Value.Value

        await until(heard, lambda shown: list(shown or ()) == [ExecutionState.FAILED])
        assert await states() == ["accepted"]
        assert await value(client, f"Scenarios.Runs.{run_id}.State") == "running"
        await call(client, "Scenarios", "Abort", run_id, "seen enough")
        await run_is(client, run_id, "aborted")
