"""`ua-fleet demo talkrobots`: the nine tasks, with a robot that fails."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ua_demo.commands.run_messages import (
    CONSOLE_PORT,
    ConsolePort,
    NoConsole,
    PubSubUrls,
    WithBroker,
    check_broker,
    report_writer,
    shown_until_ctrl_c,
    tell_how_to_connect,
    tell_result,
)
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.output import message, print_line
from ua_fleet.cli.process import run
from ua_fleet.errors import BridgeUnavailable

if TYPE_CHECKING:
    from ua_demo.result import DemoResult

__all__ = ["EXAMPLES", "talkrobots"]

UNATTENDED_S = 60.0
"""With `--once` and no terminal an operator's choice is waited for so long."""

EXAMPLES = (
    "ua-fleet demo talkrobots",
    "ua-fleet demo talkrobots --once --speed 10 --resilience automatic --json result.json",
    "ua-fleet demo talkrobots --wait    # run nine_tasks with UaExpert, and Confirm who takes over",
)


class Mode(StrEnum):
    """How tasks come to robots."""

    ORCHESTRATED = "orchestrated"
    CARRIED = "carried"


class Resilience(StrEnum):
    """Who chooses a replacement."""

    AUTOMATIC = "automatic"
    OPERATOR = "operator"


def talkrobots(
    once: Annotated[bool, typer.Option("--once", help="End when the nine tasks are over.")] = False,
    speed: Annotated[float, typer.Option(help="Speed relative to the paper.", min=0.1, max=20)] = 1.0,
    mode: Annotated[
        Mode,
        typer.Option(
            help="orchestrated: the server hands out the tasks; carried: bridges do (--resilience automatic)."
        ),
    ] = Mode.ORCHESTRATED,
    resilience: Annotated[
        Resilience, typer.Option(help="Who chooses the robot that takes over: the best one at once, or a person.")
    ] = Resilience.OPERATOR,
    wait: Annotated[bool, typer.Option("--wait", help="Run nothing: wait until a client runs nine_tasks.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result to this file.")] = None,
    secure: Annotated[bool, typer.Option("--secure", help="Sign and encrypt PubSub, with the key service.")] = False,
    port: Annotated[int, typer.Option(help="TCP port of the OPC UA server.", min=1, max=65535)] = 4840,
    ros_master_port: Annotated[int, typer.Option(help="TCP port of the ROS master.", min=1, max=65535)] = 11311,
    pubsub_url: PubSubUrls = None,
    domain: Annotated[
        list[int] | None,
        typer.Option(help="ROS 2 domain of a robot; give three, or the next free ones are taken.", min=2, max=232),
    ] = None,
    folder: Annotated[Path | None, typer.Option(help="Folder for configuration, state and logs.")] = None,
    without_ros1: Annotated[bool, typer.Option("--without-ros1", help="Run Ridgeback in ROS 2.")] = False,
    broker: WithBroker = False,
    no_console: NoConsole = False,
    console_port: ConsolePort = CONSOLE_PORT,
) -> None:
    """Run the nine tasks of TalkRoBots (Ayaida et al., Future Internet 2022, section 6.1).

    Ridgeback, UR3, two Pioneers, a drone and a conveyor, each with a bridge of its own, move a box; Ridgeback's drive
    fails on its way, and another robot drives in its place. Times of the timeline are wall time times --speed.
    Exit code 0 if all nine tasks were done once.
    """
    try:
        from ua_demo.folder import claim_domains, run_folder
        from ua_demo.site import choose_site
        from ua_demo.talkrobots.run import run_talkrobots
        from ua_demo.talkrobots.setting import DOMAINS, PATIENCE_S, SCENARIO, make_setting
    except ImportError as error:
        raise BridgeUnavailable(f"the demonstration cannot run: {error}", extra="server") from error
    chooser: Literal["automatic", "operator"] = "automatic" if resilience is Resilience.AUTOMATIC else "operator"
    check_broker(broker, pubsub_url)
    is_carried = mode is Mode.CARRIED
    if is_carried and resilience is Resilience.OPERATOR:
        raise UsageError("bridges ask nobody who takes over; add `--resilience automatic`")
    ends: list[DemoResult] = []
    write_report = report_writer(json_file)

    with (
        run_folder(folder, "talkrobots", keep=not once) as place,
        claim_domains(domain or [], DOMAINS, message) as domains,
    ):
        site = choose_site(
            place,
            port=port,
            master_port=ros_master_port,
            pubsub_urls=pubsub_url or (),
            without_ros1=without_ros1,
            secure=secure,
            console_port=None if no_console else console_port,
            say=message,
            with_broker=broker,
        )
        limit_s = UNATTENDED_S if once and not sys.stdin.isatty() else PATIENCE_S
        setting = make_setting(
            site, domains=domains, speed=speed, mode=chooser, limit_s=limit_s, is_carried=is_carried, say=message
        )
        message("starting the server, seven bridges and the robots' programs (some seconds)")

        def started() -> None:
            tell_how_to_connect(site)
            if wait:
                message(f"ready: run {SCENARIO} by the Method Run of Objects/TalkRoBots/Scenarios")

        def finished(result: DemoResult) -> None:
            write_report(result.report)
            tell_result(result)
            ends.append(result)
            if not once:
                tell_how_to_connect(site)
                message("the fleet stays up until you press Ctrl-C")

        ask = partial(_ask, endpoint=site.endpoint, limit_s=limit_s)
        with shown_until_ctrl_c(lambda: bool(ends)):
            run(
                run_talkrobots(
                    setting, say=print_line, ask=ask, started=started, finished=finished, wait=wait, stay=not once
                )
            )
    if any(result.problems for result in ends):
        raise typer.Exit(1)


async def _ask(decision_id: str, robots: Sequence[str], *, endpoint: str, limit_s: float) -> str | None:
    """Ask at the terminal who takes over; where there is none, say how else it is told."""
    if not robots:
        return None
    if not sys.stdin.isatty():
        message(f"choose: ua-fleet decision confirm {decision_id} {robots[0]} -u operator -e {endpoint}")
        message(f"otherwise {robots[0]} takes over after {limit_s:g} s")
        return None
    while True:
        sys.stderr.write(f"who takes over? [{robots[0]}] ")
        sys.stderr.flush()
        said = (await _line_of_stdin()).strip() or robots[0]
        if said in robots:
            return said
        message(f"{said} is no candidate; choose one of: {', '.join(robots)}")


async def _line_of_stdin() -> str:
    """The next line, by the event loop, so that it can be cancelled when another client has decided."""
    loop = asyncio.get_running_loop()
    there = asyncio.Event()
    loop.add_reader(sys.stdin.fileno(), there.set)
    try:
        await there.wait()
    finally:
        loop.remove_reader(sys.stdin.fileno())
    return sys.stdin.readline()
