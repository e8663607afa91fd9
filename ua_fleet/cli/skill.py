"""`ua-fleet skill list`, `call`, `halt`, `suspend` and `resume`: what robots can do, and having them do it."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator
from contextlib import aclosing, asynccontextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run
from ua_fleet.cli.skill_progress import ProgressLine, SkillProgress, progress_text
from ua_fleet.errors import UaFleetError

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient, SkillExecution, SkillInfo

__all__ = [
    "CALL_EXAMPLES",
    "HALT_EXAMPLES",
    "LIST_EXAMPLES",
    "RESUME_EXAMPLES",
    "SUSPEND_EXAMPLES",
    "argument",
    "call",
    "halt",
    "resume",
    "show",
    "suspend",
]

LIST_EXAMPLES = ("ua-fleet skill list -u anna", "ua-fleet skill list ur3 -u anna --json")
CALL_EXAMPLES = (
    "ua-fleet skill call ur3 turn angle=20 -u anna",
    "ua-fleet skill call ur3 turn angle=-20 --for 60 -u anna --json",
    "ua-fleet skill call ur3 turn angle=20 --start -u anna",
)
HALT_EXAMPLES = ("ua-fleet skill halt ur3 turn -u anna",)
SUSPEND_EXAMPLES = ("ua-fleet skill suspend ur3 turn -u anna",)
RESUME_EXAMPLES = ("ua-fleet skill resume ur3 turn -u anna",)

_TOLD: Final = ("ExecutionId", "CurrentState", "Progress", "Message")
_TICK_S: Final = 0.2
_HALTED_S: Final = 10.0
"""So long a robot may take to halt, before it is left to itself."""

_Robot = Annotated[str, typer.Argument(help="Name of the robot.")]
_Skill = Annotated[str, typer.Argument(help="Name of the skill.")]


@connecting
def show(
    connection: ConnectionOptions,
    robot: Annotated[str | None, typer.Argument(help="Name of the robot; without it, all robots.")] = None,
    as_json: Json = False,
) -> None:
    """List the skills of a robot, or of all robots, with their arguments and their state."""

    async def main() -> None:
        async with connected(connection) as client:
            skills = await client.skills(robot)
            for skill in skills:
                if as_json:
                    print_json(asdict(skill))
                else:
                    _print(skill, with_robot=robot is None)
            if not skills:
                message("there are no skills" if robot is None else f"{robot} has no skills")

    run(main())


@connecting
def call(
    connection: ConnectionOptions,
    robot: _Robot,
    skill: _Skill,
    arguments: Annotated[
        list[str] | None, typer.Argument(help="Arguments as name=value; arguments with a default are optional.")
    ] = None,
    wait_s: Annotated[
        float | None,
        typer.Option("--for", help="Wait this number of seconds; without it, until the skill ends.", min=0.1),
    ] = None,
    start_only: Annotated[bool, typer.Option("--start", help="Print the execution's id and do not wait.")] = False,
    halts: Annotated[
        bool, typer.Option("--halt-on-interrupt", help="Ctrl-C also halts the skill; without it, the robot goes on.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Make a robot do a skill, and print its results when it is done.

    Meanwhile stderr shows state, progress and the robot's message: on a terminal in one line that is kept up to date,
    otherwise in a line for each change.

    The exit code is 1 if the skill failed or was refused, 3 if the robot has no such skill, 4 if the robot or the
    server cannot be reached, and 5 if the skill did not end in time; the skill then goes on.
    """
    given = dict(argument(text) for text in arguments or ())

    async def main() -> None:
        async with connected(connection) as client:
            execution = await client.start_skill(robot, skill, **given)
            if start_only:
                _print_id(execution.id, as_json=as_json)
                return
            message(f"{robot}.{skill} runs; execution {execution.id}")
            try:
                async with _told(client, execution):
                    results = await execution.result(timeout_s=wait_s or execution.longest_wait_s)
            except asyncio.CancelledError:
                await _interrupted(client, execution, halts=halts)
                raise
            if as_json:
                print_json({"execution_id": execution.id, "results": results})
            else:
                for name, value in results.items():
                    print_line(f"{name} = {json.dumps(value, ensure_ascii=False)}")

    run(main())


@asynccontextmanager
async def _told(client: FleetClient, execution: SkillExecution) -> AsyncGenerator[None]:
    """Tell on stderr how an execution goes on, as long as the context lasts."""
    known = SkillProgress(execution.robot, execution.skill, execution.id, execution.timeout_s)
    line = ProgressLine()
    began = time.monotonic()

    def show(*, is_change: bool) -> None:
        line.show(progress_text(known, time.monotonic() - began, with_bar=line.is_live), is_change=is_change)

    async def follow() -> None:
        names = {execution.members[name]: name for name in _TOLD if name in execution.members}
        async with aclosing(client.watch(list(names))) as changes:
            async for change in changes:
                # What a silent robot said last is not how it stands now.
                if change.status == 0 and known.take(names[change.node_id], change.value):
                    show(is_change=True)

    async def tick() -> None:
        while True:
            show(is_change=False)
            await asyncio.sleep(_TICK_S)

    tasks = [asyncio.ensure_future(follow()), asyncio.ensure_future(tick())]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        for task in tasks:
            if not task.cancelled():
                task.exception()  # what it was is told by the wait for the result
        line.end()


async def _interrupted(client: FleetClient, execution: SkillExecution, *, halts: bool) -> None:
    """Say what becomes of an execution for which nobody waits any more."""
    name = f"{execution.robot} {execution.skill}"
    if not halts:
        message(f"the robot goes on with execution {execution.id}; stop it with: ua-fleet skill halt {name}")
        return
    try:
        await client.halt_skill(execution.robot, execution.skill)
        async with asyncio.timeout(_HALTED_S):
            await execution.result()
    except TimeoutError:
        message(f"{execution.robot} was asked to halt and has not reported the end; see: ua-fleet skill list {name}")
    except UaFleetError as error:
        message(f"halted: {error}" if execution.is_over else f"not halted: {error}")
    else:
        message("the skill was done before it could be halted")


@connecting
def halt(connection: ConnectionOptions, robot: _Robot, skill: _Skill, as_json: Json = False) -> None:
    """Ask a robot to halt all executions of a skill. The skill's state shows whether it stops."""
    _ask(connection, "halt", robot, skill, as_json=as_json)


@connecting
def suspend(connection: ConnectionOptions, robot: _Robot, skill: _Skill, as_json: Json = False) -> None:
    """Ask a robot to suspend a skill. The skill's timeout runs on."""
    _ask(connection, "suspend", robot, skill, as_json=as_json)


@connecting
def resume(connection: ConnectionOptions, robot: _Robot, skill: _Skill, as_json: Json = False) -> None:
    """Ask a robot to resume a suspended skill."""
    _ask(connection, "resume", robot, skill, as_json=as_json)


def _ask(
    connection: ConnectionOptions, what: Literal["halt", "suspend", "resume"], robot: str, skill: str, *, as_json: bool
) -> None:
    async def main() -> None:
        async with connected(connection) as client:
            asks = {"halt": client.halt_skill, "suspend": client.suspend_skill, "resume": client.resume_skill}
            await asks[what](robot, skill)
        if as_json:
            print_json({"robot": robot, "skill": skill, "asked": what})
        else:
            message(f"{robot} was asked to {what} {skill}; see: ua-fleet skill list {robot}")

    run(main())


def _print_id(execution_id: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"execution_id": execution_id})
    else:
        print_line(execution_id)


def argument(text: str) -> tuple[str, Any]:
    """`name=value`; a value that is no JSON number, true, false or text in quotes is a text as it stands."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise UsageError(f"{text!r} is no argument; write name=value, e.g. angle=20")
    try:
        parsed: Any = json.loads(value)
    except ValueError:
        return name, value
    return name, parsed if isinstance(parsed, bool | int | float | str) else value


def _print(skill: SkillInfo, *, with_robot: bool) -> None:
    arguments = ", ".join(
        f"{one.name}: {one.type_name}"
        + ("" if one.default is None else f" = {json.dumps(one.default, ensure_ascii=False)}")
        for one in skill.arguments
    )
    name = f"{skill.robot}.{skill.name}" if with_robot else skill.name
    print_line(f"{name}({arguments})  {skill.state or 'not heard'}  {skill.node_id}")
    if skill.description:
        print_line(f"  {skill.description}")
    for one in skill.arguments:
        if one.description:
            print_line(f"  {one.name}: {one.description}")
