"""`ua-fleet robot ...`: the robots of a fleet, holds, and those that stand in no `fleet.yaml` of the server."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError, UsageProblems
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line, print_table
from ua_fleet.cli.process import run
from ua_fleet.errors import ConfigInvalid

if TYPE_CHECKING:
    from ua_fleet.client import RobotClient

__all__ = [
    "HOLD_EXAMPLES",
    "LIST_EXAMPLES",
    "REGISTER_EXAMPLES",
    "RELEASE_EXAMPLES",
    "UNREGISTER_EXAMPLES",
    "definition",
    "hold",
    "register",
    "release",
    "show",
    "unregister",
]

LIST_EXAMPLES = ("ua-fleet robot list -u anna", "ua-fleet robot list -u anna --json")
REGISTER_EXAMPLES = (
    "ua-fleet robot register cart.yaml -u eva",
    "ua-fleet robot register cart.yaml --name cart --bridge yard -u eva",
    "ua-fleet robot register yard/fleet.yaml --bridge 301 -u eva",
)
UNREGISTER_EXAMPLES = ("ua-fleet robot unregister cart -u eva",)
HOLD_EXAMPLES = (
    "ua-fleet robot hold rover -u anna",
    'ua-fleet robot hold rover --reason "the tyre is changed" -u anna',
)
RELEASE_EXAMPLES = ("ua-fleet robot release rover -u anna",)


@connecting
def show(
    connection: ConnectionOptions,
    as_json: Json = False,
) -> None:
    """List the robots: state, hold, and how each came to the fleet."""

    async def work(robots: RobotClient) -> None:
        found = await robots.robots()
        if as_json:
            for robot in found:
                print_json(asdict(robot))
            return
        rows = [
            (
                robot.name,
                robot.state,
                robot.held_by or "-",
                robot.origin,
                " ".join(robot.capacities),
                " ".join(robot.skills),
            )
            for robot in found
        ]
        print_table([("robot", "state", "held by", "from", "capacities", "skills"), *rows])

    _with_robots(connection, work)


@connecting
def register(
    connection: ConnectionOptions,
    file: Annotated[
        Path,
        typer.Argument(help="File with robots as in fleet.yaml: `robots:`, or, with --name, the keys of one robot."),
    ],
    name: Annotated[str | None, typer.Option(help="Name of the robot; without it, all robots under `robots`.")] = None,
    bridge: Annotated[
        str, typer.Option(help="Name of its bridge, or the number of the bridge's space; replaces the file's value.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Add the robots of a file to a running fleet; they stay until they are unregistered.

    If the file has mistakes, all of them are printed with their lines, and the robot is not registered. A second call
    with the same file changes nothing.
    """
    text, names = definition(file, name)

    async def work(robots: RobotClient) -> None:
        from ua_fleet.client import RobotInvalid

        for one in names:
            try:
                node_id = await robots.register(one, text, bridge=bridge)
            except RobotInvalid as error:
                # The server does not know the file's name.
                lines = [problem.text.replace("definition", str(file), 1) for problem in error.problems]
                raise UsageProblems(lines) from None
            if as_json:
                print_json({"robot": one, "node_id": node_id})
            else:
                print_line(f"{one} is registered: {node_id}")

    _with_robots(connection, work)


def definition(file: Path, name: str | None) -> tuple[str, list[str]]:
    """The text of a file, and the robots in it that are meant; raises UsageError or ConfigInvalid."""
    from ua_fleet.document import as_mapping, read_document

    try:
        content = file.read_bytes()
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    document = read_document(content, str(file))
    if document.problems:
        raise ConfigInvalid(document.problems)
    robots = as_mapping(document.data.get("robots"))
    if name is not None:
        return content.decode(), [name]
    if not robots:
        raise UsageError(f"{file} has no `robots`; with the keys of one robot alone, give its --name")
    return content.decode(), list(robots)


@connecting
def unregister(
    connection: ConnectionOptions,
    robot: Annotated[str, typer.Argument(help="Name of the robot.")],
    as_json: Json = False,
) -> None:
    """Take a robot that was registered, or announced by a bridge that is gone, out of the fleet."""

    async def work(robots: RobotClient) -> None:
        await robots.unregister(robot)
        if as_json:
            print_json({"robot": robot, "done": True})
        else:
            message(f"{robot} is unregistered")

    _with_robots(connection, work)


@connecting
def hold(
    connection: ConnectionOptions,
    robot: Annotated[str, typer.Argument(help="Name of the robot.")],
    reason: Annotated[str, typer.Option(help="Reason, shown to users who need the robot.")] = "",
    as_json: Json = False,
) -> None:
    """Hold a robot: no run gives it a task until it is released. Its present task goes on."""

    async def work(robots: RobotClient) -> None:
        await robots.hold(robot, reason)
        if as_json:
            print_json({"robot": robot, "held": True})
        else:
            message(f"{robot} is held; when it may have tasks again: ua-fleet robot release {robot}")

    _with_robots(connection, work)


@connecting
def release(
    connection: ConnectionOptions,
    robot: Annotated[str, typer.Argument(help="Name of the robot.")],
    as_json: Json = False,
) -> None:
    """Release a robot: runs give it tasks again, also if another user holds it."""

    async def work(robots: RobotClient) -> None:
        await robots.release(robot)
        if as_json:
            print_json({"robot": robot, "held": False})
        else:
            message(f"{robot} is released")

    _with_robots(connection, work)


def _with_robots(connection: ConnectionOptions, work: Callable[[RobotClient], Awaitable[None]]) -> None:
    async def main() -> None:
        async with connected(connection) as client:
            from ua_fleet.client import RobotClient

            await work(RobotClient(client))

    run(main())
