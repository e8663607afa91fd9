"""The typed client and the command line, from the call to the machine and back."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from functools import partial

import pytest

from tests.contract.skilled import ENDLESS_WORK, FAILING_WORK, REFUSED_WORK
from tests.integration.server_model.harness import OBSERVER, OPERATOR, Running, until
from tests.integration.skills.conftest import Hall
from tests.system import clean_environment, cli, forked, run
from ua_fleet.cli.status_text import problems_of
from ua_fleet.client import ClientIdentity, FleetClient, FleetStatus, NodeNotFound, ScenarioClient, fleet_status
from ua_fleet.client.skills import SkillEvent, SkillExecution
from ua_fleet.errors import AccessRefused, RobotOffline, SkillFailed, SkillRejected, SkillTimeout
from ua_fleet.values import StatusCode


@asynccontextmanager
async def connected(running: Running, user: tuple[str, str] = OPERATOR) -> AsyncGenerator[FleetClient]:
    identity = ClientIdentity(running.folder / "identity")
    async with FleetClient.connect(running.url, user=user[0], password=user[1], identity=identity) as client:
        yield client


@asynccontextmanager
async def at_work(hall: Hall) -> AsyncGenerator[FleetClient]:
    """A client once the machine's skills can be called."""
    hall.bridge()
    async with hall.server() as running, connected(running) as client:
        async with asyncio.timeout(60):
            while True:
                try:
                    await client.call_skill("machine", "work", work="warm up", seconds=0)
                except RobotOffline:
                    await asyncio.sleep(0.05)
                else:
                    break
        yield client


async def test_a_call_waits_for_the_results(hall: Hall) -> None:
    async with at_work(hall) as client:
        results = await client.call_skill("machine", "work", timeout_s=10, work="paint", seconds=0.3)
        assert results == {"done": "paint", "seconds": 0.3}
        assert await client.call_skill("machine", "quick", seconds=0) == {"done": "weld", "seconds": 0.0}


async def test_one_node_is_read_by_its_address(hall: Hall) -> None:
    async with at_work(hall) as client:
        path = "ns=2;s=Robots.machine.Capacities"
        reading = await client.read(path)
        assert await client.read([path]) == [reading]
        assert reading.status_text == "Good"
        with pytest.raises(NodeNotFound, match="'Nobody' below Objects"):
            await client.read("Nobody/Robots")


async def test_an_execution_has_events_and_keeps_its_result(hall: Hall) -> None:
    async with at_work(hall) as client:
        executions = [await client.start_skill("machine", "work", work=f"w{n}", seconds=0.2 * n) for n in (1, 2)]
        assert len({execution.id for execution in executions}) == 2
        for number, execution in enumerate(executions, start=1):
            seen = [event async for event in execution.events()]
            assert [event.transition for event in seen] == ["ReadyToRunning", "RunningToReady"]
            assert seen[-1].is_over
            for _ in range(2):
                assert (await execution.result())["done"] == f"w{number}"


async def test_failures_are_errors_that_say_why(hall: Hall) -> None:
    async with at_work(hall) as client:
        with pytest.raises(SkillFailed, match=r"^machine\.work: the machine broke$"):
            await client.call_skill("machine", "work", work=FAILING_WORK, seconds=0)
        with pytest.raises(SkillRejected, match="the machine does not do that"):
            await client.call_skill("machine", "work", work=REFUSED_WORK, seconds=0)
        with pytest.raises(SkillTimeout, match=r"did not end within 0.3 s; execution [0-9a-f]{32} goes on"):
            await client.call_skill("machine", "work", timeout_s=0.3, work=ENDLESS_WORK, seconds=0)


async def test_the_end_of_what_took_too_long_is_waited_for() -> None:
    execution = SkillExecution("machine", "work", "1f", 0.1, "opc.tcp://hall:4840")
    said = "machine.work: RunningToHalted; it took longer than 0.1 s; it was told to stop"
    end = SkillEvent("1f", "RunningToHalted", "Halted", True, StatusCode.BAD_TIMEOUT, said, datetime.now(UTC))
    asyncio.get_running_loop().call_later(0.3, execution.put, end)
    with pytest.raises(SkillFailed, match=r"^machine\.work: it took longer than 0\.1 s; it was told to stop$"):
        await execution.result(timeout_s=execution.longest_wait_s)


async def test_wrong_arguments_are_named(hall: Hall) -> None:
    async with hall.server() as running, connected(running) as client:
        with pytest.raises(
            SkillRejected, match="no argument 'speed'; the argument 'seconds' is missing; it takes work"
        ):
            await client.start_skill("machine", "work", speed=1)
        with pytest.raises(SkillRejected, match="seconds is 'long', and no Double"):
            await client.start_skill("machine", "work", seconds="long")
        with pytest.raises(SkillRejected, match=r"seconds: BadOutOfRange \(How long it takes; 0 to 10 s\)") as caught:
            await client.start_skill("machine", "work", seconds=11)
        assert caught.value.ua_status == StatusCode.BAD_INVALID_ARGUMENT
        with pytest.raises(NodeNotFound, match="there is no 'dance'"):
            await client.start_skill("machine", "dance")
        with pytest.raises(RobotOffline, match="check that its bridge, or its client, runs"):
            await client.start_skill("machine", "work", seconds=1)


async def test_observers_see_skills_and_may_not_call_them(hall: Hall) -> None:
    async with hall.server() as running, connected(running, OBSERVER) as client:
        work, quick = await client.skills("machine")
        assert await client.skills() == [work, quick]
        assert (work.name, work.timeout_s, work.description) == ("work", 20, "Works for some time.")
        assert [(argument.name, argument.type_name, argument.default) for argument in quick.arguments] == [
            ("work", "String", "weld"),
            ("seconds", "Double", None),
        ]
        with pytest.raises(AccessRefused, match="may not command robots"):
            await client.start_skill("machine", "work", seconds=1)


async def test_the_command_line_calls_skills(hall: Hall) -> None:
    async with at_work(hall) as client:

        async def command(*arguments: str) -> tuple[int, str, str]:
            words = cli("skill", *arguments, "-u", OPERATOR[0], "-e", client.endpoint)
            env = clean_environment(UA_FLEET_PASSWORD=OPERATOR[1], XDG_STATE_HOME=str(hall.folder / "config"))
            ended = await asyncio.to_thread(partial(run, *words, env=env))
            return ended.returncode, ended.stdout, ended.stderr

        code, output, errors = await command("call", "machine", "work", "work=sing", "seconds=0.1", "--json")
        assert code == 0, errors
        assert json.loads(output)["results"] == {"done": "sing", "seconds": 0.1}
        code, output, _ = await command("list", "machine")
        assert code == 0
        assert 'work(work: String = "weld", seconds: Double)  Ready  ns=2;i=1900' in output
        code, _, errors = await command("resume", "machine", "work")
        assert (code, "machine.work: the skill's state does not allow that" in errors) == (1, True), errors
        await client.start_skill("machine", "work", work=ENDLESS_WORK, seconds=0)
        for what in ("suspend", "halt"):
            code, output, errors = await command(what, "machine", "work", "--json")
            assert code == 0, errors
            assert json.loads(output) == {"robot": "machine", "skill": "work", "asked": what}
        ends = {
            ("work", f"work={FAILING_WORK}", "seconds=0"): 1,
            ("work", "seconds=99"): 2,
            ("work", "seconds"): 2,
            ("dance",): 3,
            ("work", f"work={ENDLESS_WORK}", "seconds=0", "--for", "0.3"): 5,
        }
        for arguments, expected in ends.items():
            code, _, errors = await command("call", "machine", *arguments)
            assert code == expected, errors


async def test_a_call_that_is_interrupted_says_what_becomes_of_the_skill(hall: Hall) -> None:
    async with at_work(hall) as client:

        async def interrupted(*options: str) -> tuple[int | None, str]:
            process = forked(
                *cli("skill", "call", "machine", "work", f"work={ENDLESS_WORK}"),
                *("seconds=0", "-u", OPERATOR[0], "-e", client.endpoint, *options),
                env=clean_environment(UA_FLEET_PASSWORD=OPERATOR[1], XDG_STATE_HOME=str(hall.folder / "config")),
            )
            assert process.stderr is not None
            said = ""
            async with asyncio.timeout(60):
                while "machine.work  Running  50%  " not in said or "s of at most 20.0 s  working" not in said:
                    line = await asyncio.to_thread(process.stderr.readline)
                    assert line, said
                    said += line
            process.send_signal(signal.SIGINT)
            rest = await asyncio.to_thread(process.stderr.read)
            code = await asyncio.to_thread(process.wait, 60)
            process.close()
            return code, rest

        code, said = await interrupted()
        assert (code, said.count("\n")) == (130, 1)
        assert "the robot goes on with execution " in said
        assert said.endswith("; stop it with: ua-fleet skill halt machine work\n")
        assert [skill.state for skill in await client.skills("machine") if skill.name == "work"] == ["Running"]
        await client.halt_skill("machine", "work")
        code, said = await interrupted("--halt-on-interrupt")
        assert (code, said.startswith("halted: machine.work: ")) == (130, True), said


async def test_the_status_of_a_fleet_that_is_well_at_work_and_faulted(hall: Hall) -> None:
    async with at_work(hall) as client:

        async def status() -> FleetStatus:
            return await fleet_status(client)

        well = await until(status, lambda found: found.bridges[0].connected and found.robots[0].state == "idle")
        assert problems_of(well, datetime.now(UTC)) == []
        (bridge,) = well.bridges
        assert (bridge.name, bridge.kind, bridge.space, bridge.online) == ("cell", "virtual", 300, True)
        assert bridge.since is not None
        assert well.server.started is not None
        assert well.server.started < bridge.since
        assert well.server.certificate_until is not None
        assert well.drops.get("repeated", 0) >= 0
        await client.start_skill("machine", "work", work=ENDLESS_WORK, seconds=0)
        busy = await until(status, lambda found: found.robots[0].state == "busy" and found.robots[0].tasks)
        assert busy.robots[0].tasks == ("work",)
        await ScenarioClient(client).raise_fault("machine", "it smokes")
        faulted = await until(status, lambda found: found.faults)
        (fault,) = faulted.faults
        assert (fault.fault_id, fault.reason, fault.active) == ("machine.robot", "it smokes", True)
        assert fault.since is not None
        assert [
            one.remedy for one in problems_of(faulted, datetime.now(UTC)) if one.text.startswith("machine.robot")
        ] == ["ua-fleet fault clear machine.robot"]


async def test_a_robot_that_fell_silent_is_unreachable(hall: Hall) -> None:
    bridge = hall.bridge()
    async with hall.server() as running, connected(running) as client:

        async def state() -> str | None:
            return (await client.skills("machine"))[0].state

        await until(state, lambda shown: shown == "Ready")
        bridge.end(signal.SIGKILL)
        await until(state, lambda shown: shown is None)
        with pytest.raises(RobotOffline, match="check that its bridge, or its client, runs"):
            await client.call_skill("machine", "work", seconds=1)


async def test_a_robot_stands_goes_on_and_stops_by_command(hall: Hall) -> None:
    async with at_work(hall) as client:
        execution = await client.start_skill("machine", "work", work=ENDLESS_WORK, seconds=0)

        async def shows(state: str) -> None:
            async with asyncio.timeout(60):
                while next(skill for skill in await client.skills("machine") if skill.name == "work").state != state:
                    await asyncio.sleep(0.05)

        with pytest.raises(SkillRejected, match="the skill's state does not allow that") as caught:
            await client.resume_skill("machine", "work")
        assert caught.value.ua_status == StatusCode.BAD_INVALID_STATE
        await client.suspend_skill("machine", "work")
        await shows("Suspended")
        await client.resume_skill("machine", "work")
        await shows("Running")
        await client.suspend_skill("machine", "work")
        await shows("Suspended")
        await client.halt_skill("machine", "work")
        with pytest.raises(SkillFailed, match="halted"):
            await execution.result(timeout_s=10)
        assert [event.state async for event in execution.events()] == [
            *("Running", "Suspended", "Running", "Suspended", "Halted")
        ]
