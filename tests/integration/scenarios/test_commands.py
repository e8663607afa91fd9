"""The command line and the typed client, with a real server."""

from __future__ import annotations

import asyncio
import json
import signal
from functools import partial
from typing import Any, NamedTuple

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import ENGINEER, ROBOTS, Plant, all_heard
from tests.integration.server_model.harness import OPERATOR, Running, until
from tests.system import clean_environment, cli, run
from ua_fleet.config.schema import ResilienceConfig


class Ended(NamedTuple):
    code: int
    objects: list[Any]
    errors: str


async def command(running: Running, *arguments: str, user: tuple[str, str] = OPERATOR) -> Ended:
    """Run a command as a process."""
    environment = clean_environment(
        UA_FLEET_ENDPOINT=running.url,
        UA_FLEET_USER=user[0],
        UA_FLEET_PASSWORD=user[1],
        XDG_STATE_HOME=str(running.folder / "xdg"),
    )
    ended = await asyncio.to_thread(partial(run, *cli(*arguments, "--json"), env=environment))
    return Ended(ended.returncode, [json.loads(line) for line in ended.stdout.splitlines()], ended.stderr)


async def test_scenarios(plant: Plant) -> None:
    plant.scenario("short", "  - {task: a, skill: work, robot: left}\n")
    plant.scenario("door", "  - {wait: null, event: door_open}\n")
    (plant.folder / "wrong.yaml").write_text("version: 1\nname: w\nsteps:\n  - {task: a, skill: jump, robot: left}\n")
    plant.bridge("left")
    async with plant.server() as running:
        async with running.client() as client:
            await until(lambda: client.get_node("ns=2;s=Robots.left.State").read_value(), lambda state: state != 0)
        listed = await command(running, "scenario", "list")
        names = ("door", "short")
        assert listed.objects == [{"name": one, "description": "for a test", "problems": 0} for one in names]
        wrong = await command(running, "scenario", "validate", str(plant.folder / "wrong.yaml"))
        assert wrong.code == 2
        assert wrong.objects[0]["line"] == 4
        assert (await command(running, "scenario", "validate", "short")).code == 0
        ran = await command(running, "scenario", "run", "short", "--wait")
        assert ran.code == 0, ran.errors
        assert ran.objects[-1]["state"] == "done"
        run_id = ran.objects[0]["run_id"]
        seen = await command(running, "scenario", "watch", run_id)
        assert (seen.code, seen.objects[-1]["states"]) == (0, ["done"])
        would = await command(running, "scenario", "dryrun", "short")
        assert (would.code, would.objects[0]["outcome"]) == (0, "done"), would.errors
        assert any("left" in moment["text"] for moment in would.objects[0]["timeline"])
        too_hot = plant.folder / "hot.yaml"
        too_hot.write_text(
            "version: 1\nname: hot\nparameters: {limit: 20}\nsteps:\n"
            "  - {if: limit > 30, then: [{end: done}], else: [{end: failed, reason: too hot}]}\n"
        )
        assert (await command(running, "scenario", "dryrun", str(too_hot), "limit=31")).code == 0
        cold = await command(running, "scenario", "dryrun", str(too_hot))
        assert (cold.code, cold.objects[0]["outcome"]) == (1, "failed")
        assert "it would fail: too hot" in cold.errors
        (waits,) = (await command(running, "scenario", "run", "door")).objects
        assert (await command(running, "scenario", "tell", "door_open")).code == 0
        assert (await command(running, "scenario", "watch", waits["run_id"])).objects[-1]["state"] == "done"
        late = await command(running, "scenario", "abort", run_id)
        assert late.code == 3
        assert "there is no run" in late.errors
        assert (await command(running, "scenario", "run", "nothing")).code == 3
        assert (await command(running, "scenario", "watch", "nothing")).code == 3


async def test_faults_and_decisions(plant: Plant) -> None:
    plant.scenario(
        "long", f"  - {{task: a, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 60}}\n"
    )
    bridges = {robot: plant.bridge(robot) for robot in ROBOTS}
    async with plant.server() as running:
        async with running.client() as client:
            await all_heard(client)
        (run,) = (await command(running, "scenario", "run", "long")).objects
        forecast = await command(running, "decision", "whatif", "left")
        assert [(one["task"], one["best"]) for one in forecast.objects] == [("a", "middle")]
        bridges["left"].end(signal.SIGKILL)

        async def found() -> Any:
            return (await command(running, "decision", "list")).objects

        (decision,) = await until(found, bool, timeout_s=60)
        assert (decision["state"], decision["robots"]) == ("open", ["middle", "right"])
        (fault,) = (await command(running, "fault", "list")).objects
        assert (fault["fault_id"], fault["active"], fault["acknowledged"]) == ("left.silent", True, False)
        assert (await command(running, "fault", "ack", "left.silent", "--comment", "seen")).code == 0
        assert (await command(running, "fault", "list")).objects[0]["acknowledged"] is True
        refused = await command(running, "decision", "confirm", decision["decision_id"], "left")
        assert refused.code == 1
        assert "cannot take over" in refused.errors
        taken = await command(running, "decision", "confirm", decision["decision_id"], "right")
        assert taken.objects[0]["outcome"] == "taken"
        await command(running, "scenario", "abort", run["run_id"], "--reason", "enough")


async def test_a_fault_that_a_person_raises_and_who_decides(plant: Plant) -> None:
    criterion = {"kind": "benefit", "range": [0, 100], "tasks_ahead": True}
    resilience = ResilienceConfig.model_validate(
        {"criteria": {"one": criterion, "other": criterion}, "judgements": {"one": {"other": 1}}}
    )
    plant.config = plant.config.model_copy(update={"resilience": resilience})
    async with plant.server() as running, running.client() as client:

        async def raised() -> list[tuple[str, str, bool]]:
            listed = (await command(running, "fault", "list")).objects
            return [(one["robot"], one["reason"], one["active"]) for one in listed if one["source"] == "robot"]

        assert (await command(running, "fault", "raise", "left", "gripper stuck")).code == 0
        # Without bridges all robots are silent too.
        assert await raised() == [("left", "gripper stuck", True)]
        assert (await command(running, "fault", "clear", "left")).code == 0
        assert await raised() == [("left", "gripper stuck", False)]
        nobody = await command(running, "fault", "raise", "nobody", "x")
        assert (nobody.code, "there is no robot 'nobody'" in nobody.errors) == (3, True)

        refused = await command(running, "decision", "mode", "automatic")
        assert refused.code == 1
        assert "role" in refused.errors
        done = await command(running, "decision", "mode", "abort", "--limit-s", "5", user=ENGINEER)
        assert done.objects == [{"mode": "abort", "done": True}]
        assert await client.get_node("ns=2;s=Fleet.Resilience.Mode").read_value() == "abort"
        judged = await command(running, "decision", "judge", "one/other=3", user=ENGINEER)
        assert judged.objects == [{"weights": {"one": 0.75, "other": 0.25}}]
        wrong = await command(running, "decision", "judge", "one/another=3", user=ENGINEER)
        assert (wrong.code, "another" in wrong.errors) == (2, True)
        assert "write e.g. battery/distance=2" in (await command(running, "decision", "judge", "one=3")).errors


async def test_a_run_says_which_fault_it_waits_for_and_goes_on_when_that_is_cleared(plant: Plant) -> None:
    plant.scenario("short", "  - {task: a, skill: work, robot: left}\n")
    plant.bridge("left")
    async with plant.server() as running:
        async with running.client() as client:
            await until(lambda: client.get_node("ns=2;s=Robots.left.State").read_value(), lambda state: state != 0)
        assert (await command(running, "fault", "raise", "left", "gripper stuck")).code == 0
        waits = asyncio.create_task(command(running, "scenario", "run", "short", "--wait"))

        async def found() -> Any:
            return (await command(running, "decision", "list")).objects

        (decision,) = await until(found, bool, timeout_s=60)
        told = "left has a fault: gripper stuck (left.robot, since "
        assert decision["reason"].startswith(told)
        assert decision["reason"].endswith("run: ua-fleet fault clear left.robot")
        (fault,) = [one for one in (await command(running, "fault", "list")).objects if one["source"] == "robot"]
        assert fault["since"] is not None
        unknown = await command(running, "fault", "clear", "left.gripper")
        assert (unknown.code, "its faults now: left.robot" in unknown.errors) == (3, True)
        assert (await command(running, "fault", "clear", "left.robot")).code == 0
        ran = await waits
        assert ran.code == 0, ran.errors
        reasons = [one["reason"] for one in ran.objects if one.get("states") == ["replacing"]]
        assert reasons[-1].startswith(f"task a waits: {told}")
        assert "no other robot can do it now: ua-fleet scenario abort " in reasons[-1]
        assert ran.objects[-1]["reason"] == ""


async def test_a_robot_is_held_and_released(plant: Plant) -> None:
    plant.scenario("short", "  - {task: a, skill: work, robot: left}\n")
    plant.bridge("left")
    async with plant.server() as running:
        async with running.client() as client:
            await until(lambda: client.get_node("ns=2;s=Robots.left.State").read_value(), lambda state: state != 0)
        assert (await command(running, "robot", "hold", "left", "--reason", "new tyre")).code == 0
        (left,) = [one for one in (await command(running, "robot", "list")).objects if one["name"] == "left"]
        assert (left["held_by"], left["held_reason"], left["held_since"][:2]) == (OPERATOR[0], "new tyre", "20")
        other = await command(running, "robot", "hold", "left", user=ENGINEER)
        assert other.code == 1
        assert f"left is held by {OPERATOR[0]} since" in other.errors
        (begun,) = (await command(running, "scenario", "run", "short")).objects
        assert (await command(running, "robot", "release", "left", user=ENGINEER)).objects == [
            {"robot": "left", "held": False}
        ]
        assert (await command(running, "scenario", "watch", begun["run_id"])).objects[-1]["state"] == "done"
        again = await command(running, "robot", "release", "left")
        assert (again.code, "left is not held" in again.errors) == (1, True)
        assert (await command(running, "robot", "hold", "lefd")).code == 3
