"""`ua-fleet skill list`, `call`, `halt`, `suspend` and `resume`: what robots can do, and having them do it."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import Connection, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run

if TYPE_CHECKING:
    from ua_fleet.client import SkillInfo

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

LIST_EXAMPLES = ("ua-fleet skill list ur3 -u anna", "ua-fleet skill list ur3 -u anna --json")
CALL_EXAMPLES = (
    "ua-fleet skill call ur3 turn angle=20 -u anna",
    "ua-fleet skill call ur3 turn angle=-20 --for 60 -u anna --json",
    "ua-fleet skill call ur3 turn angle=20 --start -u anna",
)
HALT_EXAMPLES = ("ua-fleet skill halt ur3 turn -u anna",)
SUSPEND_EXAMPLES = ("ua-fleet skill suspend ur3 turn -u anna",)
RESUME_EXAMPLES = ("ua-fleet skill resume ur3 turn -u anna",)

_Robot = Annotated[str, typer.Argument(help="Name of the robot.")]
_Skill = Annotated[str, typer.Argument(help="Name of the skill.")]


@connecting
def show(
    connection: Connection,
    robot: _Robot,
    as_json: Json = False,
) -> None:
    """List the skills of a robot, with their arguments and their state."""

    async def main() -> None:
        async with connected(connection) as client:
            for skill in await client.skills(robot):
                if as_json:
                    print_json(asdict(skill))
                else:
                    _print(skill)

    run(main())


@connecting
def call(
    connection: Connection,
    robot: _Robot,
    skill: _Skill,
    arguments: Annotated[
        list[str] | None, typer.Argument(help="Arguments as name=value; what has a default may be left out.")
    ] = None,
    wait_s: Annotated[
        float | None, typer.Option("--for", help="Wait so many seconds for the end; else its timeout.", min=0.1)
    ] = None,
    start_only: Annotated[bool, typer.Option("--start", help="Print the execution's id, and do not wait.")] = False,
    as_json: Json = False,
) -> None:
    """Have a robot do a skill, and print its results when it is done.

    Exit code 1 if it failed or was refused, 3 if there is no such skill, 4 if the robot or the server cannot be
    reached, 5 if it did not end in time; it goes on then.
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
                results = await execution.result(timeout_s=wait_s or execution.timeout_s)
            except asyncio.CancelledError:
                message(f"the robot goes on with execution {execution.id}")
                raise
            if as_json:
                print_json({"execution_id": execution.id, "results": results})
            else:
                for name, value in results.items():
                    print_line(f"{name} = {json.dumps(value, ensure_ascii=False)}")

    run(main())


@connecting
def halt(connection: Connection, robot: _Robot, skill: _Skill, as_json: Json = False) -> None:
    """Ask a robot to stop all that it does for a skill. Whether it stops is seen in the skill's state."""
    _ask(connection, "halt", robot, skill, as_json=as_json)


@connecting
def suspend(connection: Connection, robot: _Robot, skill: _Skill, as_json: Json = False) -> None:
    """Ask a robot to stand in the middle of what it does for a skill. Its timeout goes on meanwhile."""
    _ask(connection, "suspend", robot, skill, as_json=as_json)


@connecting
def resume(connection: Connection, robot: _Robot, skill: _Skill, as_json: Json = False) -> None:
    """Ask a robot to go on with the skill in which it stands."""
    _ask(connection, "resume", robot, skill, as_json=as_json)


def _ask(
    connection: Connection, what: Literal["halt", "suspend", "resume"], robot: str, skill: str, *, as_json: bool
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


def _print(skill: SkillInfo) -> None:
    arguments = ", ".join(
        f"{one.name}: {one.type_name}"
        + ("" if one.default is None else f" = {json.dumps(one.default, ensure_ascii=False)}")
        for one in skill.arguments
    )
    print_line(f"{skill.name}({arguments})  {skill.state or 'not heard'}  {skill.node_id}")
    if skill.description:
        print_line(f"  {skill.description}")
    for one in skill.arguments:
        if one.description:
            print_line(f"  {one.name}: {one.description}")
