"""`ua-fleet config add-topics`: the topics of a running graph as data of the fleet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.names import closest, listed

if TYPE_CHECKING:
    from ua_fleet.config.topics_seen import Addition, Plan

__all__ = ["EXAMPLES", "add_topics"]

EXAMPLES: Final = (
    "ua-fleet config add-topics floor --dry-run",
    "ua-fleet config add-topics floor --robot carrier --topic '/carrier/*'",
)


def add_topics(
    bridge: Annotated[str, typer.Argument(help="The bridge whose space is searched.")],
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot that gets the data; it is added to the file if it is missing.", show_default=False
        ),
    ] = None,
    topic: Annotated[str, typer.Option(help="Only topics whose names match this shell pattern.")] = "*",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the changes without writing them.")] = False,
    max_rate_hz: Annotated[
        float, typer.Option(help="Greatest rate of the data that is read, in messages per second.", min=0.001)
    ] = 10.0,
    within: Annotated[float, typer.Option(help="ROS 2: duration of the search for nodes, in seconds.", min=0.1)] = 3.0,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Look at the running ROS graph of a bridge, and write its topics into the configuration file as data, with ids.

    Topics that a robot publishes become data that clients read. Topics that a robot only subscribes to become data that
    clients write, and these are commands. Topics that are mapped already, or cannot be mapped, are left out, each with
    the reason. Without --robot, a topic goes to the robot whose name it begins with, or to the only robot of the
    bridge. Comments and order of the file stay. The file is checked before it is replaced, as a whole or not at all.
    """
    from ua_fleet.bridge.registry import topics_of
    from ua_fleet.config.add_data import add_data, write
    from ua_fleet.config.topics_seen import is_name, plan_additions

    fleet = load_config(config, allow_missing_ids=True)
    if bridge not in fleet.bridges:
        hint = closest(bridge, fleet.bridges) or f"there are: {listed(fleet.bridges)}"
        raise UsageError(f"{config}: there is no bridge {bridge!r}; {hint}")
    if robot is not None and robot in fleet.robots and fleet.robots[robot].bridge != bridge:
        raise UsageError(f"{config}: {robot} is a robot of bridge {fleet.robots[robot].bridge}; name another --robot")
    if robot is not None and robot not in fleet.robots and not is_name(robot):
        raise UsageError(f"{robot!r} is no name of a robot; use 1 to 64 letters, digits, _ and -, first a letter")
    seen = topics_of(fleet, bridge, within)
    plan = plan_additions(seen, fleet.robots, bridge, robot=robot, pattern=topic, max_rate_hz=max_rate_hz)
    ids: dict[str, int] = {}
    if plan.additions:
        content, ids = add_data(config, bridge, plan.additions)
        if not dry_run:
            write(config, content)
    _tell(plan, ids, config, as_json=as_json, dry_run=dry_run)


def _tell(plan: Plan, ids: dict[str, int], config: Path, *, as_json: bool, dry_run: bool) -> None:
    for one in plan.additions:
        key = f"robots.{one.robot}.data.{one.name}"
        if as_json:
            number = ids.get(f"{key}.id")
            command = one.seen.is_command
            said = {"key": key, "id": number, "topic": one.seen.topic, "type": one.seen.type, "command": command}
            print_json({**said, "fields": len(one.seen.fields), "written": not dry_run})
        else:
            _print(one, key)
            for line in one.lines() if dry_run else ():
                print_line(f"    {line}")
    for left in plan.left_out:
        if as_json:
            print_json({"topic": left.topic, "left_out": left.reason})
        else:
            message(f"left out: {left.topic}: {left.reason}")
    if not plan.additions:
        message(f"{config}: nothing to add")
    elif dry_run:
        message(f"{config}: nothing was written (--dry-run); {len(plan.additions)} data sources would be")
    else:
        message(f"{config}: {len(plan.additions)} data sources written; start the server and the bridge again")


def _print(one: Addition, key: str) -> None:
    way = "to" if one.seen.is_command else "from"
    count = len(one.seen.fields)
    print_line(f"{key}: {way} {one.seen.topic} ({one.seen.type}), {count} {'value' if count == 1 else 'values'}")
