"""Hold and Release over OPC UA: Methods of each robot's Object, Variables, an event, rights, and a restart."""

from __future__ import annotations

import asyncio
import json
from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.integration.scenarios.conftest import ENGINEER, SECOND, Plant, run, run_is, value, watching
from tests.integration.server_model.harness import OBSERVER, OPERATOR, ua, until
from ua_fleet.nodes.nodeset import TypeId

LEFT = "ns=2;s=Robots.left"
HOLD, RELEASE = "3:Hold", "3:Release"
NAMES = ("Held", "HeldBy", "HeldSince", "HeldReason")

NOT_HELD = [False, "", datetime(1601, 1, 1, tzinfo=UTC), ""]
"""The null of a DateTime is its first one (OPC 10000-6 5.2.2.5)."""


def text(value: str) -> Any:
    return ua.Variant(value, ua.VariantType.String)


async def held(client: Client, robot: str = "left") -> list[Any]:
    return [await client.get_node(f"ns=2;s=Robots.{robot}.{name}").read_value() for name in NAMES]


async def heard(client: Client) -> None:
    await until(client.get_node(f"{LEFT}.State").read_value, lambda state: state != 0, timeout_s=60)


async def test_a_run_waits_for_a_held_robot_and_everybody_sees_by_whom(plant: Plant) -> None:
    plant.scenario("one", "  - {task: a, skill: work, robot: left}\n")
    plant.bridge("left")
    async with plant.server() as running, running.client() as client, running.client(SECOND) as second:
        await heard(client)
        assert await held(client) == NOT_HELD
        async with watching(client, TypeId.ROBOT_HOLD_EVENT) as seen:
            assert await client.get_node(LEFT).call_method(HOLD, text("new tyre")) == [0, ""]
            event = await seen.wait_for("left is held by")
        assert event.Message.Text.endswith("(new tyre); when it may have tasks again, run: ua-fleet robot release left")
        assert (event.Robot, event.Held, event.By, event.Reason) == ("left", True, OPERATOR[0], "new tyre")
        assert event.SourceNode.to_string() == LEFT
        is_held, by, since, why = await held(second)
        assert (is_held, by, why) == (True, OPERATOR[0], "new tyre")
        assert since > NOT_HELD[2]
        status, message = await second.get_node(LEFT).call_method(HOLD, text(""))
        assert (status, message.startswith(f"left is held by {OPERATOR[0]} since")) == (3, True)

        run_id = await run(client, "one")
        reason = await until(lambda: value(client, f"Scenarios.Runs.{run_id}.Reason"), bool, timeout_s=5)
        assert f"task a waits: left is held by {OPERATOR[0]} since" in reason
        assert "run: ua-fleet robot release left" in reason
        # A person who stands at the robot uses it all the same.
        skill = client.get_node("ns=2;i=1100")
        await skill.call_method("0:Start", text("by hand"), ua.Variant(0.0, ua.VariantType.Double))
        await until(lambda: asyncio.to_thread(plant.told), bool, timeout_s=10)
        assert plant.told() == [("left", "by hand")]

        assert await second.get_node(LEFT).call_method(RELEASE) == [0, ""]
        assert await run_is(client, run_id, "done", "failed") == "done"
        assert plant.told() == [("left", "by hand"), ("left", "weld")]
        await until(lambda: held(client), lambda found: found == NOT_HELD)
        assert await second.get_node(LEFT).call_method(RELEASE) == [3, "left is not held"]
        log = (running.folder / plant.config.server.state_dir / "audit.log").read_text().splitlines()
        calls = [line for line in map(json.loads, log) if line.get("object") == LEFT]
        assert [(line["user"], line["method"]) for line in calls] == [
            *((user, "ns=3;i=72051") for user in (OPERATOR[0], SECOND[0])),
            *((user, "ns=3;i=72052") for user in (SECOND[0], SECOND[0])),
        ]
        assert "new tyre" in str(calls[0]["value"])


async def test_who_may_hold_a_robot(plant: Plant) -> None:
    async with plant.server() as running, running.client(OBSERVER) as observer, running.client(ENGINEER) as engineer:
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            await observer.get_node(LEFT).call_method(HOLD, text(""))
        assert await engineer.get_node(LEFT).call_method(HOLD, text("")) == [0, ""]
        robot_type = engineer.get_node(f"ns=3;i={TypeId.ROBOT}")
        with pytest.raises(ua.uaerrors.BadNodeIdInvalid):
            await robot_type.call_method(HOLD, text(""))
        with pytest.raises(ua.uaerrors.BadInvalidArgument):
            await engineer.get_node(LEFT).call_method(HOLD, ua.Variant(1.0, ua.VariantType.Double))


async def test_a_hold_is_there_after_a_restart(plant: Plant) -> None:
    plant.scenario("one", "  - {task: a, skill: work, robot: left}\n")
    plant.bridge("left")
    async with plant.server() as server, server.client() as client:
        assert await client.get_node(LEFT).call_method(HOLD, text("new tyre")) == [0, ""]
        before = await until(lambda: held(client), lambda found: found[0])
    async with plant.server() as server, server.client() as client:
        assert await until(lambda: held(client), lambda found: found[0]) == before
        await heard(client)
        run_id = await run(client, "one")
        await until(lambda: value(client, f"Scenarios.Runs.{run_id}.Reason"), lambda said: "is held by" in said)
        assert plant.told() == []
        assert await client.get_node(LEFT).call_method(RELEASE) == [0, ""]
        assert await run_is(client, run_id, "done", "failed") == "done"
