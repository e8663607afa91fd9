"""RegisterRobot and UnregisterRobot, seen by a client."""

from __future__ import annotations

import json
from typing import Any

import pytest
from asyncua.client.client import Client
from asyncua.ua.uaerrors import UaStatusCodeError

from tests.contract.skilled import ENDLESS_WORK, WORK
from tests.integration.robots.conftest import MACHINE, Yard, below, call, invoke, register, unregister
from tests.integration.server_model.harness import ENGINEER, OPERATOR, reader, ua, until


async def names(client: Client, node_id: str) -> list[str]:
    children = await below(client, node_id)
    return sorted(child.BrowseName.Name for child in children)


async def start(client: Client, *arguments: Any) -> Any:
    request = ua.CallMethodRequest(
        ua.NodeId(WORK, 2), ua.NodeId(f"{WORK}.Start", 2), [ua.Variant(argument) for argument in arguments]
    )
    return await invoke(client, request)


class Changes:
    """Model changes that a client is told of."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, str, int]] = []

    def event_notification(self, event: Any) -> None:
        for change in event.Changes:
            self.seen.append((change.Affected.to_string(), change.AffectedType.to_string(), change.Verb))


async def test_a_registered_robot_is_one_of_the_fleet_until_it_is_unregistered(yard: Yard) -> None:
    yard.bridge()
    async with yard.server() as running, running.client(ENGINEER) as client:
        changes = Changes()
        subscription: Any = await client.create_subscription(50, changes)
        await subscription.subscribe_events(ua.ObjectIds.Server, ua.ObjectIds.GeneralModelChangeEventType)
        before = await names(client, "ns=2;s=Fleet.Capabilities")
        done = await register(client, "machine", "cell", MACHINE)
        assert (done.status, done.message, done.outputs[1:]) == (0, "", [[], []])
        assert done.outputs[0].to_string() == "ns=2;s=Robots.machine"
        assert await names(client, "ns=2;s=Robots.machine.Skills") == ["quick", "work"]
        assert await names(client, "ns=2;s=Fleet.Capabilities") == ["weld"]
        assert await client.get_node("ns=2;s=Robots.machine.Origin").read_value() == "registered"
        state = reader(client, "ns=2;s=Robots.machine.State")
        await until(state, lambda value: value.Value.Value == 1)
        result = await until(lambda: start(client, "weld", 0.1), lambda result: result.StatusCode.is_good())
        execution = str(result.OutputArguments[0].Value)
        done_by = reader(client, f"ns=2;s={WORK}.LastResult.ExecutionId")
        await until(done_by, lambda value: value.Value is not None and value.Value.Value == execution)
        assert [job.work for job in yard.machine.told()] == ["weld"]
        assert (await call(client, "Fleet.Faults", "RaiseFault", "machine", "it smokes")).status == 0
        await until(state, lambda value: value.Value.Value == 3)
        assert (await call(client, "Fleet.Faults", "ClearFault", "machine")).status == 0
        await until(state, lambda value: value.Value.Value == 1)
        assert (await register(client, "machine", "cell", MACHINE)).status == 0
        gone = await unregister(client, "machine")
        assert (gone.status, gone.message) == (0, "")
        assert (await start(client, "weld", 0.1)).StatusCode.name == "BadNodeIdUnknown"
        assert await names(client, "ns=2;s=Fleet.Robots.G00") == []
        assert await names(client, "ns=2;s=Fleet.Capabilities") == before == []

        async def told() -> list[Any]:
            return changes.seen

        node = ("ns=2;s=Robots.machine", "ns=3;i=1004")
        await until(told, lambda seen: seen == [(*node, 1), (*node, 2)])
        again = await unregister(client, "machine")
        assert (again.status, again.message) == (1, "there is no robot 'machine'")


async def test_it_is_there_again_after_a_restart_and_scenarios_use_it(yard: Yard) -> None:
    yard.bridge()
    steps = "version: 1\nname: one\nsteps:\n  - {task: weld, skill: work, capacity: weld, arguments: {seconds: 0.1}}\n"
    async with yard.server() as running, running.client(ENGINEER) as client:
        invalid = await call(client, "Fleet.Scenarios", "Validate", steps)
        assert invalid.outputs[0] is False
        assert (await register(client, "machine", "cell", MACHINE)).status == 0
        valid = await call(client, "Fleet.Scenarios", "Validate", steps)
        assert valid.outputs[0] is True, valid.outputs[1]
    async with yard.server() as running, running.client(ENGINEER) as client:
        state = reader(client, "ns=2;s=Robots.machine.State")
        await until(state, lambda value: value.Value.Value == 1)
        ran = await call(client, "Fleet.Scenarios", "Run", steps, [], [])
        assert ran.status == 0, ran.message
        run_state = reader(client, f"ns=2;s=Fleet.Scenarios.Runs.{ran.outputs[0]}.State")
        await until(run_state, lambda value: value.Value is not None and value.Value.Value == "done")
        assert (await unregister(client, "machine")).status == 0
    async with yard.server() as running, running.client(ENGINEER) as client:
        assert "Robots.machine" not in await names(client, "ns=2;s=Fleet.Robots")
    assert len(yard.machine.told()) == 1


async def test_a_robot_that_is_needed_stays(yard: Yard) -> None:
    yard.bridge()
    async with yard.server() as running, running.client(ENGINEER) as client:
        await register(client, "machine", "cell", MACHINE)
        result = await until(lambda: start(client, ENDLESS_WORK, 0.0), lambda result: result.StatusCode.is_good())
        assert result.StatusCode.is_good()
        refused = await unregister(client, "machine")
        assert refused.status == 3
        assert "robot machine is in use: skill work is under way; wait for the end, or abort it" in refused.message
    task = "{task: weld, robot: machine, skill: work, arguments: {seconds: 0}}"
    steps = f"version: 1\nname: two\nsteps:\n  - {{wait: null, event: never}}\n  - {task}\n"
    async with yard.server() as running, running.client(ENGINEER) as client:
        ran = await call(client, "Fleet.Scenarios", "Run", steps, [], [])
        assert ran.status == 0, ran.message
        refused = await unregister(client, "machine")
        assert refused.status == 3
        assert f"run {ran.outputs[0]}" in refused.message


async def test_a_held_robot_begins_nothing_as_it_leaves_and_is_held_when_it_comes_again(yard: Yard) -> None:
    yard.bridge()
    task = "{task: a, skill: work, capacity: weld, arguments: {work: weld, seconds: 0.5}}"
    text = f"version: 1\nname: any\nsteps:\n  - {task}\n"
    async with yard.server() as running, running.client(ENGINEER) as client:
        assert (await register(client, "machine", "cell", MACHINE)).status == 0
        await until(reader(client, "ns=2;s=Robots.machine.State"), lambda value: value.Value.Value == 1)
        node = client.get_node("ns=2;s=Robots.machine")
        assert list(await node.call_method("3:Hold", "the guard is open")) == [0, ""]
        ran = await call(client, "Fleet.Scenarios", "Run", text, [], [])
        assert (await unregister(client, "machine")).status == 0
        reason = reader(client, f"ns=2;s=Fleet.Scenarios.Runs.{ran.outputs[0]}.Reason")
        await until(reason, lambda value: "no robot can do work: there is none" in (value.Value.Value or ""))
        assert (await call(client, "Fleet.Scenarios", "Abort", ran.outputs[0], "")).status == 0
        assert (await register(client, "machine", "cell", MACHINE)).status == 0
        await until(reader(client, "ns=2;s=Robots.machine.Held"), lambda value: value.Value.Value is True)
        held = await client.get_node("ns=2;s=Robots.machine.HeldReason").read_value()
        await until(reader(client, "ns=2;s=Robots.machine.State"), lambda value: value.Value.Value == 1)
        assert (held, yard.machine.told()) == ("the guard is open", [])
        assert list(await node.call_method("3:Release")) == [0, ""]
        await until(reader(client, "ns=2;s=Robots.machine.Held"), lambda value: value.Value.Value is False)


async def test_a_robot_of_the_file_is_not_unregistered(yard: Yard) -> None:
    async with (
        yard.server(robots={"machine": {"bridge": "cell", **MACHINE}}) as running,
        running.client(ENGINEER) as client,
    ):
        for refused in (await unregister(client, "machine"), await register(client, "machine", "cell", {})):
            assert refused.status == 3
            assert "stands in fleet.yaml" in refused.message
        assert await client.get_node("ns=2;s=Robots.machine.Origin").read_value() == "fleet.yaml"
        taken = await register(client, "other", "cell", MACHINE)
        assert taken.status == 2
        assert f"{WORK} is in use already (robots.machine)" in " ".join(taken.outputs[1])


async def test_all_mistakes_are_told_at_once_with_their_lines(yard: Yard) -> None:
    text = (
        "capacities: [weld]\nskills:\n  work: {needs: [fly]}\n  quick:\n    id: 5\n    arguments: {x: {type: Duble}}\n"
    )
    async with yard.server() as running, running.client(ENGINEER) as client:
        wrong = await register(client, "machine", "sell", text)
        assert wrong.status == 2
        robot, problems, lines = wrong.outputs
        assert robot.is_null()
        assert len(problems) == len(lines) == 5
        assert lines == [0, 0, 3, 3, 6]
        assert "did you mean `cell`?" in problems[0]
        assert await names(client, "ns=2;s=Fleet.Robots") == []


async def test_only_engineers_may_and_the_audit_log_has_it(yard: Yard) -> None:
    async with yard.server() as running:
        async with running.client(OPERATOR) as client:
            with pytest.raises(UaStatusCodeError, match="BadUserAccessDenied"):
                await register(client, "machine", "cell", MACHINE)
        async with running.client(ENGINEER) as client:
            await register(client, "machine", "cell", MACHINE)
    lines = [json.loads(line) for line in (yard.folder / "state" / "audit.log").read_text().splitlines()]
    calls = [line for line in lines if line["event"] == "call" and "RegisterRobot" in line["method"]]
    assert [(line["user"], line["status"]) for line in calls] == [
        (OPERATOR[0], "BadUserAccessDenied"),
        (ENGINEER[0], "Good"),
    ]
