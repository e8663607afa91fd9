"""`ua-fleet skill offer`: a person, or any program, does a skill of the fleet."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError, UsageProblems
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run
from ua_fleet.cli.skill import argument
from ua_fleet.errors import SkillFailed, UaFleetError

if TYPE_CHECKING:
    from ua_fleet.client import OfferedSkill, SkillRequest

__all__ = ["OFFER_EXAMPLES", "answer", "offer"]

OFFER_EXAMPLES = (
    "ua-fleet skill offer mechanic call_mechanic --definition call_mechanic.yaml -u eva",
    "ua-fleet skill offer mechanic call_mechanic -u anna",
    "ua-fleet skill offer camera look --run ./look.sh -u anna",
)
_END = "\x04"
"""After the last line that was typed."""
_HOW = "answer with: accept | done [name=value ..] | fail REASON"


@connecting
def offer(
    connection: ConnectionOptions,
    robot: Annotated[
        str, typer.Argument(help="The robot that offers the skill; the server adds the robot if it is missing.")
    ],
    skill: Annotated[str, typer.Argument(help="Name of the skill.")],
    file: Annotated[
        Path | None, typer.Option("--definition", help="File with the skill, as under `skills.<skill>` in fleet.yaml.")
    ] = None,
    command: Annotated[
        str | None,
        typer.Option(
            "--run", help="Program that does the skill: arguments as JSON on stdin, results as JSON on stdout."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Do a skill of the fleet while this command runs: by hand, or by a program.

    By hand: each request is printed; type `accept`, then `done` with the results, or `fail` with the reason. With a
    program: exit code 0 means that the skill is done; with another code the last line of its stderr is the reason of
    the failure. The program gets the execution's id in its environment as UA_FLEET_EXECUTION.
    """
    text = ""
    if file is not None:
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"{file} cannot be read: {error}") from None

    async def main() -> None:
        async with connected(connection) as client:
            from ua_fleet.client import RobotInvalid

            try:
                async with client.offer_skill(robot, skill, text) as offered:
                    message(f"{robot}.{skill} is offered; end with Ctrl-C")
                    if command is None:
                        await _by_hand(offered, as_json=as_json)
                    else:
                        await offered.serve(partial(_by_program, command))
            except RobotInvalid as error:
                lines = [problem.text.replace("definition", str(file), 1) for problem in error.problems]
                raise UsageProblems(lines) from None

    run(main())


async def _by_hand(offered: OfferedSkill, *, as_json: bool) -> None:
    """Print each request, and do what the lines of stdin say, one request after the other, until stdin ends."""
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    typed: asyncio.Queue[str] = asyncio.Queue()
    async with asyncio.TaskGroup() as tasks:
        reading = tasks.create_task(_read(lines, typed))
        while (request := await _next(offered, reading, typed)) is not None:
            if as_json:
                print_json({"execution_id": request.id, "arguments": request.arguments})
            else:
                given = " ".join(f"{name}={json.dumps(value)}" for name, value in request.arguments.items())
                print_line(f"{request.robot}.{request.skill} {given}".rstrip())
            message(_HOW)
            await _work_on(request, typed)
        reading.cancel()


async def _read(lines: asyncio.StreamReader, typed: asyncio.Queue[str]) -> None:
    while line := await lines.readline():
        typed.put_nowait(line.decode(errors="replace").strip())
    typed.put_nowait(_END)


async def _next(offered: OfferedSkill, reading: asyncio.Task[None], typed: asyncio.Queue[str]) -> SkillRequest | None:
    """The next request; None once nothing more can be typed for it."""
    coming = asyncio.ensure_future(anext(offered))
    try:
        while not coming.done():
            if reading.done() and typed.qsize() < 2:  # the end itself
                return None
            await asyncio.wait([coming] if reading.done() else [coming, reading], return_when=asyncio.FIRST_COMPLETED)
        return coming.result()
    finally:
        coming.cancel()


async def _work_on(request: SkillRequest, typed: asyncio.Queue[str]) -> None:
    is_over = False
    while not is_over:
        line = await typed.get()
        if line == _END:
            typed.put_nowait(_END)
            return
        try:
            is_over = await answer(request, line)
        except UsageError as error:
            message(str(error))
        except UaFleetError as error:
            if getattr(error, "return_status", None) is None:
                raise
            message(str(error))
            is_over = request.is_over


async def answer(request: SkillRequest, line: str) -> bool:
    """Do what a person has typed; whether that ends the request."""
    word, _, rest = line.partition(" ")
    if word == "accept" and not rest:
        await request.accept()
        return False
    if word == "done":
        await request.complete(dict(argument(part) for part in rest.split()))
        return True
    if word == "fail" and rest.strip():
        await request.fail(rest.strip())
        return True
    if word:
        message(_HOW)
    return False


async def _by_program(command: str, request: SkillRequest) -> Mapping[str, Any]:
    """Have a program do it; raises SkillFailed with its reason. It is ended when it is to stop."""
    process = await asyncio.create_subprocess_shell(
        command,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "UA_FLEET_EXECUTION": request.id},
        start_new_session=True,
    )
    ended = asyncio.ensure_future(process.communicate(json.dumps(request.arguments).encode()))
    halted = asyncio.ensure_future(request.halted.wait())
    try:
        await asyncio.wait([ended, halted], return_when=asyncio.FIRST_COMPLETED)
        if not ended.done():
            os.killpg(process.pid, 15)
        output, errors = await ended
    finally:
        halted.cancel()
        if process.returncode is None:
            os.killpg(process.pid, 9)
    if process.returncode:
        said = errors.decode(errors="replace").strip().splitlines()
        raise SkillFailed(said[-1] if said else f"{command} ended with {process.returncode}")
    from ua_fleet.document import as_mapping

    try:
        results = as_mapping(json.loads(output or b"{}"))
    except ValueError:
        results = None
    if results is None:
        raise SkillFailed(f"{command} has printed no JSON object")
    return results
