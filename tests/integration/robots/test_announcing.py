"""Robots that their bridges announce: the same as registered ones, under the policy for unknown sources."""

from __future__ import annotations

import asyncio
import signal
from typing import Any

from asyncua.client.client import Client

from tests.contract.skilled import STATUS, WORK
from tests.integration.robots.conftest import MACHINE, SPACE, Yard, below, call, invoke, register, unregister
from tests.integration.server_model.harness import ENGINEER, reader, ua, until
from ua_fleet.fleet.model import RobotState
from ua_fleet.values import StatusCode

DATA = {
    "battery": {"id": 1601, "type": "Double", "unit": "%", "range": [0, 100]},
    "goal": {"id": 1602, "type": "Double", "origin": "server", "initial": 0.5},
}
WHOLE = {**MACHINE, "data": DATA}
MOVING = ("Id", "Number", "TransitionTime", "ExecutionId", "EndTime")
"""Properties that executions change."""


async def tree(client: Client, node_id: str) -> dict[str, Any]:
    """Everything below a node: ids, names, classes, types, and the values that stay, but for how the robot came."""
    found: dict[str, Any] = {}
    for child in await below(client, node_id):
        key = child.NodeId.to_string()
        if child.BrowseName.Name == "Origin":
            continue
        value = None
        if child.TypeDefinition == ua.NodeId(ua.ObjectIds.PropertyType) and child.BrowseName.Name not in MOVING:
            value = str(await client.get_node(key).read_value())
        found[key] = (
            child.ReferenceTypeId.to_string(),
            child.BrowseName.to_string(),
            child.NodeClass,
            child.TypeDefinition.to_string(),
            value,
        )
        found |= await tree(client, key)
    return found


async def is_there(client: Client, node_id: str = "ns=2;s=Robots.machine.Origin") -> bool:
    value: Any = await client.get_node(node_id).read_data_value(raise_on_bad_status=False)
    return bool(value.StatusCode.is_good())


async def announced(client: Client) -> None:
    await until(lambda: is_there(client), bool)
    state = reader(client, "ns=2;s=Robots.machine.State")
    await until(state, lambda value: value.Value.Value == 1)


async def work(client: Client) -> Any:
    request = ua.CallMethodRequest(
        ua.NodeId(WORK, 2), ua.NodeId(f"{WORK}.Start", 2), [ua.Variant("weld"), ua.Variant(0.0)]
    )
    return await invoke(client, request)


async def test_an_announced_robot_has_the_nodes_of_a_registered_one(yard: Yard) -> None:
    """The server's file does not even name the bridge; the space is enough."""
    yard.write(WHOLE)
    bridge = yard.bridge()
    async with yard.server("create", knows_bridge=False) as running, running.client(ENGINEER) as client:
        await until(lambda: is_there(client), bool)
        assert await client.get_node("ns=2;s=Robots.machine.Origin").read_value() == "announced"
        of_announcement = await tree(client, "ns=2;s=Robots.machine")
        result = await until(lambda: work(client), lambda result: result.StatusCode.is_good())
        assert result.StatusCode.is_good()
        refused = await unregister(client, "machine")
        assert refused.message == f"robot machine is announced by the bridge of space {SPACE}; stop that first"
        bridge.end()
        status = reader(client, f"ns=2;s={WORK}.CurrentState")
        await until(status, lambda value: value.StatusCode.value == StatusCode.BAD_NO_COMMUNICATION)
        assert await is_there(client)
        assert (await unregister(client, "machine")).status == 0
        assert not await is_there(client)
        done = await register(client, "machine", str(SPACE), WHOLE)
        assert done.status == 0, done.message
        of_registration = await tree(client, "ns=2;s=Robots.machine")
        assert of_registration == of_announcement
        assert len(of_announcement) > 90


async def test_it_is_bad_and_not_gone_while_its_bridge_is_away_and_after_a_restart(yard: Yard) -> None:
    bridge = yard.bridge()
    async with yard.server("create") as running, running.client(ENGINEER) as client:
        await announced(client)
        bridge.end(signal.SIGKILL)
        state = reader(client, "ns=2;s=Robots.machine.State")
        await until(state, lambda value: value.Value.Value == 0)
    async with yard.server("create") as running, running.client(ENGINEER) as client:
        assert await is_there(client)
        assert (await work(client)).StatusCode.name == "BadNoCommunication"
        yard.bridge()
        await announced(client)
        await until(lambda: work(client), lambda result: result.StatusCode.is_good())
    async with yard.server("quarantine") as running, running.client(ENGINEER) as client:
        assert not await is_there(client)


async def test_what_its_bridge_says_anew_replaces_it(yard: Yard) -> None:
    bridge = yard.bridge()
    async with yard.server("create") as running, running.client(ENGINEER) as client:
        await announced(client)
        bridge.end()
        yard.write({**MACHINE, "capacities": ["weld", "paint"], "description": "Paints, too"})
        yard.bridge()
        capacities = reader(client, "ns=2;s=Robots.machine.Capacities")
        await until(capacities, lambda value: value.StatusCode.is_good() and value.Value.Value == ["weld", "paint"])
        await until(lambda: work(client), lambda result: result.StatusCode.is_good())


async def test_what_people_say_of_it_stays_when_its_bridge_says_anew_what_it_is(yard: Yard) -> None:
    bridge = yard.bridge()
    task = "{task: a, skill: work, capacity: weld, arguments: {work: weld, seconds: 0.1}}"
    async with yard.server("create") as running, running.client(ENGINEER) as client:
        await announced(client)
        node = client.get_node("ns=2;s=Robots.machine")
        assert list(await node.call_method("3:Hold", "the guard is open")) == [0, ""]
        assert (await call(client, "Fleet.Faults", "RaiseFault", "machine", "gripper broken")).status == 0
        text = f"version: 1\nname: any\nsteps:\n  - {task}\n"
        ran = await call(client, "Fleet.Scenarios", "Run", text, [], [])
        bridge.end()
        yard.write({**MACHINE, "description": "Works, and its program is newer"})
        yard.bridge()
        description = reader(client, "ns=2;s=Robots.machine.Description")
        await until(description, lambda value: value.StatusCode.is_good() and "newer" in str(value.Value.Value))
        await until(reader(client, "ns=2;s=Robots.machine.Held"), lambda value: value.Value.Value is True)
        await until(
            reader(client, "ns=2;s=Robots.machine.State"), lambda value: value.Value.Value == RobotState.FAULTED
        )
        assert await client.get_node("ns=2;s=Fleet.Faults.machine.robot.ActiveState.Id").read_value() is True
        assert await client.get_node("ns=2;s=Robots.machine.HeldReason").read_value() == "the guard is open"
        assert yard.machine.told() == []
        assert (await call(client, "Fleet.Faults", "ClearFault", "machine")).status == 0
        assert list(await node.call_method("3:Release")) == [0, ""]
        again = await call(client, "Fleet.Scenarios", "Run", text, [], [])
        state = reader(client, f"ns=2;s=Fleet.Scenarios.Runs.{again.outputs[0]}.State")
        await until(state, lambda value: value.Value is not None and value.Value.Value == "done")
        assert ran.status == 0


async def test_in_quarantine_it_is_listed_until_somebody_registers_it(yard: Yard) -> None:
    yard.bridge()
    listed = f"ns=2;s=Fleet.Discovered.Quarantine.ua_{SPACE}_2_{STATUS}.Reason"
    async with yard.server() as running, running.client(ENGINEER) as client:
        await until(lambda: is_there(client, listed), bool)
        assert not await is_there(client)
        assert (await register(client, "machine", "cell", MACHINE)).status == 0
        assert not await is_there(client, listed)
        state = reader(client, "ns=2;s=Robots.machine.State")
        await until(state, lambda value: value.Value.Value == 1)


async def test_with_keys_only_a_signed_announcement_makes_nodes(yard: Yard) -> None:
    yard.make_keys()
    forger = yard.bridge()
    async with yard.server("create", is_secured=True) as running, running.client(ENGINEER) as client:
        await asyncio.sleep(1.5)
        assert not await is_there(client)
        forger.end()
        yard.write(MACHINE, is_secured=True)
        yard.bridge()
        await announced(client)
        await until(lambda: work(client), lambda result: result.StatusCode.is_good())
