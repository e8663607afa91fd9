"""Scenarios over OPC UA: a client's Methods, a real server, robots behind bridges of their own."""

from __future__ import annotations

import asyncio
import json
import signal
from functools import partial
from operator import le
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import (
    ENGINEER,
    ROBOTS,
    SECOND,
    Plant,
    all_heard,
    call,
    open_decision,
    run,
    run_is,
    texts,
    value,
    watching,
)
from tests.integration.server_model.harness import OBSERVER, OPERATOR, Running, ua, until
from ua_fleet.nodes.nodeset import TypeId

STEPS = """
  - {task: first, skill: work, robot: left, arguments: {work: one}}
  - parallel:
      - [{task: second, skill: work, robot: middle, arguments: {work: two, seconds: "=wait_s"}}]
      - [{task: third, skill: work, robot: right, arguments: {work: three}}]
  - if: first.done == "one"
    then: [{task: fourth, skill: work, capacity: weld, arguments: {work: four}}]
"""
HEAD = "parameters: {wait_s: {default: 0.2, unit: s, range: [0, 5]}}\n"


async def test_a_scenario_of_several_tasks_runs_and_is_seen(plant: Plant) -> None:
    plant.scenario("weld_all", STEPS, HEAD)
    for robot in ROBOTS:
        plant.bridge(robot)
    async with plant.server() as server, server.client() as client:
        await all_heard(client)
        listed = await call(client, "Scenarios", "List")
        assert listed.outputs == [["weld_all"], ["for a test"], [0]]
        async with watching(client, TypeId.RUN_EVENT, TypeId.STEP_EVENT) as seen:
            run_id = await run(client, "weld_all", {"wait_s": "0.1"})
            assert await run_is(client, run_id, "done", "failed") == "done"
            ended = await seen.wait_for(f"{run_id}: done")
        assert (ended.RunId, ended.Scenario, ended.State) == (run_id, "weld_all", "done"), ended.Message.Text
        assert ended.SourceNode.to_string() == f"ns=2;s=Fleet.Scenarios.Runs.{run_id}"
        begun = [event.Task for event in seen.events if getattr(event, "Fact", "") == "TaskAssigned"]
        assert begun == ["first", "second", "third", "fourth"]
        tasks = await value(client, f"Scenarios.Runs.{run_id}.Tasks")
        results = await value(client, f"Scenarios.Runs.{run_id}.Results")
        assert json.loads(results[tasks.index("second")]) == {"done": "two", "seconds": 0.1}
        assert await value(client, f"Scenarios.Runs.{run_id}.States") == ["done"] * 4
        assert await value(client, f"Scenarios.Runs.{run_id}.StartedBy") == OPERATOR[0]
    assert plant.told()[0] == ("left", "one")
    assert sorted(work for _, work in plant.told()) == ["four", "one", "three", "two"]


async def test_problems_come_with_their_lines_and_nothing_is_started(plant: Plant) -> None:
    async with plant.server() as server, server.client() as client:
        text = """version: 1
name: wrong
steps:
  - {task: a, skill: work, robot: lefd}
  - {task: b, skill: work, robot: left, arguments: {seconds: 99}}
  - {task: c, skill: jump, robot: left}
  - {if: nothing > 2, then: [{wait: 1}]}
"""
        valid, problems, lines = (await call(client, "Scenarios", "Validate", text)).outputs
        assert not valid
        assert lines == [4, 5, 6, 7]
        assert "did you mean" in problems[0] or "left" in problems[0]
        called = await call(client, "Scenarios", "Run", text, texts(), texts())
        assert called.status == 2
        assert "there is no robot 'lefd'" in called.message
        unknown = await call(client, "Scenarios", "Run", "not_there", texts(), texts())
        assert (unknown.status, unknown.outputs) == (1, [""])
        fine = "version: 1\nname: fine\nsteps:\n  - {task: a, skill: work, robot: left}\n"
        assert (await call(client, "Scenarios", "Validate", fine)).outputs == [True, [], []]
        wrong = await call(client, "Scenarios", "Run", fine, texts(["speed"]), texts(["1"]))
        assert (wrong.status, wrong.message) == (2, "there is no parameter 'speed'")
        rehearsed = await call(client, "Scenarios", "DryRun", fine, texts(), texts(), texts(), texts())
        assert rehearsed.outputs[0] == "done"
        assert rehearsed.outputs[4][0] == "a: left work(work=weld, seconds=0)"
        assert await client.get_node("ns=2;s=Fleet.Scenarios.Runs").get_children() == []


async def test_roles(plant: Plant) -> None:
    plant.scenario("nothing", "  - {wait: 1}\n")
    async with plant.server() as server:
        async with server.client(OBSERVER) as client:
            assert (await call(client, "Scenarios", "List")).outputs[0] == ["nothing"]
            with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                await run(client, "nothing")
        async with server.client(SECOND) as client:
            with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                await call(client, "Resilience", "SetMode", "automatic", 0.0, "")
        async with server.client(ENGINEER) as client:
            assert (await call(client, "Resilience", "SetMode", "automatic", 0.0, "")).status == 0
            assert await value(client, "Resilience.Mode") == "automatic"
            refused = await call(
                client,
                "Resilience",
                "SetJudgements",
                texts(["a/b"]),
                ua.Variant([2.0], ua.VariantType.Double, None, True),
            )
            assert refused.status == 2
            assert "a" in refused.message


async def test_pause_resume_abort_and_the_limit_of_runs(plant: Plant) -> None:
    plant.scenario("slow", "  - {wait: 0.3}\n  - {task: a, skill: work, robot: left}\n")
    plant.scenario("long", "  - {wait: 60}\n")
    plant.bridge("left")
    async with plant.server() as server, server.client() as client:
        run_id = await run(client, "slow")
        assert (await call(client, "Scenarios", "Pause", run_id)).status == 0
        await run_is(client, run_id, "paused")
        await asyncio.sleep(0.6)
        assert plant.told() == []
        assert (await call(client, "Scenarios", "Resume", run_id)).status == 0
        await run_is(client, run_id, "done")
        other = await run(client, "slow")
        assert (await call(client, "Scenarios", "Abort", other, "enough")).status == 0
        await run_is(client, other, "aborted")
        assert await value(client, f"Scenarios.Runs.{other}.Reason") == "enough"
        assert (await call(client, "Scenarios", "Abort", other, "again")).status == 1
        ids = [await run(client, "long") for _ in range(plant.config.scenarios.most_runs)]
        full = await call(client, "Scenarios", "Run", "slow", texts(), texts())
        assert full.status == 3
        assert "more may not be" in full.message
        for one in ids:
            await call(client, "Scenarios", "Abort", one, "")


async def begin_and_lose(plant: Plant, server: Running, client: Client, on_unknown: str) -> str:
    """A run whose first robot is killed while it works; the run's id."""
    arguments = f"{{work: {ENDLESS_WORK}}}"
    plant.scenario(
        "replaced",
        f"""
  - {{task: long, skill: work, robot: left, arguments: {arguments}, timeout_s: 60, on_unknown: {on_unknown}}}
  - {{task: after, skill: work, robot: left, arguments: {{work: after}}}}
""",
    )
    bridges = {robot: plant.bridge(robot) for robot in ROBOTS}
    await all_heard(client)
    run_id = await run(client, "replaced")

    async def read() -> object:
        return plant.told()

    await until(read, lambda told: told == [("left", ENDLESS_WORK)])
    bridges["left"].end(signal.SIGKILL)
    return run_id


@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_a_robot_that_stays_silent_is_replaced_by_itself_where_the_author_consents(plant: Plant) -> None:
    async with plant.server() as server, server.client() as client:
        async with watching(client, TypeId.DECISION_EVENT, TypeId.FAULT_ALARM) as seen:
            run_id = await begin_and_lose(plant, server, client, "replace")
            alarm = await seen.wait_for("left: it is silent")
            chosen = await seen.wait_for("takes over from left, chosen by automatic")
        assert alarm.SourceNode.to_string() == "ns=2;s=Robots.left"
        assert chosen.Robots == ["middle", "right"]
        assert chosen.Chosen == "middle"
        assert chosen.Excluded == ["left"]
        assert await value(client, "Faults.left.silent.ActiveState.Id") is True
        assert plant.told()[1] == ("middle", ENDLESS_WORK)
        await call(client, "Scenarios", "Abort", run_id, "seen enough")


async def test_operators_confirm_at_once_and_one_decides(plant: Plant) -> None:
    async with plant.server() as server, server.client() as client, server.client(SECOND) as other:
        await begin_and_lose(plant, server, client, "ask")
        forecast = await call(client, "Resilience", "WhatIf", "right")
        assert (forecast.status, forecast.outputs[0]) == (0, [])
        decision = await open_decision(client)
        assert await value(client, f"Resilience.Decisions.{decision}.Robots") == ["middle", "right"]
        assert sum(await value(client, f"Resilience.Decisions.{decision}.Scores")) == pytest.approx(1)
        nobody = await call(client, "Resilience", "Confirm", decision, "left")
        assert nobody.status == 3
        assert "cannot take over" in nobody.message
        one, two = await asyncio.gather(
            call(client, "Resilience", "Confirm", decision, "middle"),
            call(other, "Resilience", "Confirm", decision, "right"),
        )
        assert sorted((one.status, two.status)) == [0, 3]
        chosen = "middle" if one.status == 0 else "right"
        assert f"has chosen {chosen} before" in (one.message + two.message)
        again = await call(client, "Resilience", "Confirm", decision, chosen)
        assert again.outputs == ["repeated"]

        async def read() -> object:
            return plant.told()

        await until(read, lambda told: told[1:] == [(chosen, ENDLESS_WORK)])


async def test_alarms_are_raised_acknowledged_and_cleared(plant: Plant) -> None:
    plant.bridge("left")
    async with plant.server() as server, server.client() as client:
        async with watching(client, TypeId.FAULT_ALARM) as seen:
            assert (await call(client, "Faults", "RaiseFault", "left", "gripper stuck")).status == 0
            raised = await seen.wait_for("left: gripper stuck")
            condition = client.get_node("ns=2;s=Fleet.Faults.left.robot")
            acknowledge = ua.NodeId(9111, 0)
            comment = ua.Variant(ua.LocalizedText("I go and look"), ua.VariantType.LocalizedText)
            with pytest.raises(ua.UaStatusCodeError, match="BadEventIdUnknown"):
                await condition.call_method(acknowledge, ua.Variant(b"no", ua.VariantType.ByteString), comment)
            event_id = ua.Variant(raised.EventId, ua.VariantType.ByteString)
            await condition.call_method(acknowledge, event_id, comment)
            assert await value(client, "Faults.left.robot.AckedState.Id") is True
            assert (await value(client, "Faults.left.robot.Comment")).Text == "I go and look"
            with pytest.raises(ua.UaStatusCodeError, match="BadConditionBranchAlreadyAcked"):
                await condition.call_method(acknowledge, event_id, comment)
            assert (await call(client, "Faults", "ClearFault", "left")).status == 0
            await seen.wait_for("left: over: gripper stuck")
        retained = [event.Retain for event in seen.events if event.SourceName == "left"]
        assert retained == [True, True, False]
        unknown = await call(client, "Faults", "RaiseFault", "nobody", "x")
        assert unknown.status == 1


async def test_a_server_that_is_killed_goes_on_without_doing_anything_twice(plant: Plant) -> None:
    plant.scenario(
        "chain",
        "".join(
            f"  - {{task: t{number}, skill: work, robot: {ROBOTS[number % 3]},"
            f" arguments: {{work: t{number}, seconds: 0.6}}}}\n"
            for number in range(6)
        ),
    )
    for robot in ROBOTS:
        plant.bridge(robot)
    plant.users()
    server = plant.server_process()
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run(client, "chain")

        async def told() -> object:
            return len(plant.told())

        await until(told, lambda count: count == 2)
        server.end(signal.SIGKILL)
    for count in (4, 6):
        server = plant.server_process()
        await until(told, partial(le, count))
        if count < 6:
            server.end(signal.SIGKILL)
    async with plant.client() as client:
        assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
        assert await value(client, f"Scenarios.Runs.{run_id}.States") == ["done"] * 6
    assert plant.told() == [(ROBOTS[number % 3], f"t{number}") for number in range(6)]


async def test_an_abort_halts_a_robot_that_can_be_halted(plant: Plant) -> None:
    plant.scenario("endless", f"  - {{task: a, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}}}\n")
    plant.bridge("left")
    async with plant.server() as server, server.client() as client:
        run_id = await run(client, "endless")

        async def read() -> object:
            return await value(client, f"Scenarios.Runs.{run_id}.States")

        await until(read, lambda states: states == ["accepted"])
        await call(client, "Scenarios", "Abort", run_id, "door open")
        await run_is(client, run_id, "aborted")
        assert await value(client, f"Scenarios.Runs.{run_id}.Reason") == "door open", "nobody had to be waited for"
        messages = await value(client, f"Scenarios.Runs.{run_id}.Messages")
        assert messages == ["halted (BadRequestCancelledByClient)"]


async def test_alarms_are_told_again_to_who_asks(plant: Plant) -> None:
    async with plant.server() as server, server.client() as client, server.client(SECOND) as other:
        await call(client, "Faults", "RaiseFault", "left", "gripper stuck")
        async with watching(client, TypeId.FAULT_ALARM) as seen:
            assert seen.events == []
            refresh = ua.NodeId(3875, 0)
            condition_type = client.get_node("i=2782")
            number = ua.Variant(seen.subscription_id, ua.VariantType.UInt32)
            await condition_type.call_method(refresh, number)
            told = await seen.wait_for("left: gripper stuck")
            assert told.Retain is True
            with pytest.raises(ua.UaStatusCodeError, match="BadSubscriptionIdInvalid"):
                await other.get_node("i=2782").call_method(refresh, number)


async def test_mode_and_judgements_are_kept_over_a_restart(plant: Plant) -> None:
    async with plant.server() as server, server.client(ENGINEER) as client:
        assert (await call(client, "Resilience", "SetMode", "abort", 12.5, "abort")).status == 0
    log = (plant.folder / plant.config.server.state_dir / "audit.log").read_text()
    (line,) = [json.loads(line) for line in log.splitlines() if "Resilience.SetMode" in line]
    assert (line["event"], line["user"], line["value"]) == ("call", ENGINEER[0], "['abort', 12.5, 'abort']")
    async with plant.server() as server, server.client(OBSERVER) as client:
        for name, expected in (("Mode", "abort"), ("Limit", 12_500.0), ("OnLimit", "abort")):
            assert await value(client, f"Resilience.{name}") == expected


async def test_an_alarm_view_finds_all_that_it_shows(plant: Plant) -> None:
    """What UaExpert selects, by the types that declare it, from what is a ConditionType (OPC 10000-9 5.5 to 5.8)."""
    condition, acknowledgeable, alarm = 2782, 2881, 2915
    selected = {
        (2041, ("Severity",)): 800,
        (2041, ("SourceName",)): "left",
        (condition, ("ConditionName",)): "left.robot",
        (condition, ("ConditionClassName",)): ua.LocalizedText("SystemConditionClass"),
        (condition, ("BranchId",)): ua.NodeId(),
        (condition, ("Retain",)): True,
        (condition, ("EnabledState", "Id")): True,
        (condition, ("EnabledState",)): ua.LocalizedText("Enabled"),
        (condition, ("Quality",)): ua.StatusCode(0),
        (condition, ("LastSeverity",)): 800,
        (condition, ("Comment",)): ua.LocalizedText(""),
        (acknowledgeable, ("AckedState", "Id")): False,
        (acknowledgeable, ("AckedState",)): ua.LocalizedText("Unacknowledged"),
        (alarm, ("ActiveState", "Id")): True,
        (alarm, ("ActiveState",)): ua.LocalizedText("Active"),
        (alarm, ("SuppressedOrShelved",)): False,
    }
    wanted = ua.EventFilter()
    for kind, path in selected:
        clause = ua.SimpleAttributeOperand()
        clause.TypeDefinitionId, clause.AttributeId = ua.NodeId(kind, 0), ua.AttributeIds.Value
        clause.BrowsePath = [ua.QualifiedName(name, 0) for name in path]
        wanted.SelectClauses.append(clause)
    clause = ua.SimpleAttributeOperand()  # ConditionId
    clause.TypeDefinitionId, clause.AttributeId = ua.NodeId(condition, 0), ua.AttributeIds.NodeId
    wanted.SelectClauses.append(clause)
    of_type = ua.ContentFilterElement()
    of_type.FilterOperator = ua.FilterOperator.OfType
    of_type.FilterOperands = [ua.LiteralOperand(Value=ua.Variant(ua.NodeId(condition, 0)))]
    wanted.WhereClause.Elements = [of_type]
    async with plant.server() as server, server.client() as client:
        found: asyncio.Queue[Any] = asyncio.Queue()

        class Handler:
            def event_notification(self, event: Any) -> None:
                found.put_nowait(event)

        subscription = await client.create_subscription(50, Handler())
        await subscription.subscribe_events(client.nodes.server, evfilter=wanted)
        await call(client, "Faults", "RaiseFault", "left", "gripper stuck")
        event = await asyncio.wait_for(found.get(), 10)
        assert {key: getattr(event, "/".join(key[1])) for key in selected} == selected
        assert event.NodeId.to_string() == "ns=2;s=Fleet.Faults.left.robot"
        node = client.get_node(event.NodeId)
        assert {f"{child.Name}" for child in [await one.read_browse_name() for one in await node.get_children()]} >= {
            *(path[0] for kind, path in selected if kind != 2041),
            *("Acknowledge", "AddComment", "Enable", "Disable"),
        }
        with pytest.raises(ua.UaStatusCodeError, match="BadConditionAlreadyEnabled"):
            await node.call_method(ua.NodeId(9027, 0))
        with pytest.raises(ua.UaStatusCodeError, match="BadNotSupported"):
            await node.call_method(ua.NodeId(9028, 0))
        await subscription.delete()
