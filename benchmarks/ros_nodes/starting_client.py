"""The OPC UA client of the benchmark `skill_start`: calls the Start of skills, one time after the other.

    starting_client.py URL FOLDER ROBOT.SKILL...

Each skill is called until it is done once; then stdout: `ready`. stdin: `ROBOT.SKILL COUNT PAUSE_S`, answered with a
JSON list of the monotonic times before each call; `run SCENARIO`, answered with the state in which the run ended.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path

from benchmarks.skill_start import PASSWORD, USER
from ua_fleet.client import ClientIdentity, FleetClient, ScenarioClient
from ua_fleet.errors import RobotOffline, SkillError

PATIENCE_S = 40.0


async def warm_up(client: FleetClient, robot: str, skill: str) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            try:
                await client.call_skill(robot, skill, to=0.5)
            except (RobotOffline, SkillError):
                await asyncio.sleep(0.2)
            else:
                return


async def outcome(scenarios: ScenarioClient, name: str) -> str:
    state = ""
    async for info in scenarios.follow(await scenarios.run(name)):
        state = info.state
    return state


async def main(url: str, folder: str, *names: str) -> None:
    identity = ClientIdentity(Path(folder))
    async with FleetClient.connect(url, user=USER, password=PASSWORD, identity=identity) as client:
        for name in names:
            await warm_up(client, *name.split("."))
        print("ready", flush=True)
        while line := (await asyncio.to_thread(sys.stdin.readline)).split():
            if line[0] == "run":
                print(json.dumps(await outcome(ScenarioClient(client), line[1])), flush=True)
                continue
            robot, skill = line[0].split(".")
            times: list[float] = []
            for _ in range(int(line[1])):
                await asyncio.sleep(float(line[2]))
                times.append(time.monotonic())
                execution = await client.start_skill(robot, skill, to=0.5)
                await execution.result(timeout_s=10)
            print(json.dumps(times), flush=True)


asyncio.run(main(*sys.argv[1:]))
