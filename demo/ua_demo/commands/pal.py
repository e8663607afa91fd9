"""`ua-fleet demo pal`: the fault-tolerant assembly line."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from ua_fleet.cli.options import WithoutLoopRule
from ua_fleet.cli.output import message, print_line
from ua_fleet.cli.process import run
from ua_fleet.errors import BridgeUnavailable

if TYPE_CHECKING:
    from ua_demo.result import DemoResult

__all__ = ["EXAMPLES", "pal"]

EXAMPLES = ("ua-fleet demo pal", "ua-fleet demo pal --once --speed 10 --secure")


def pal(
    once: Annotated[bool, typer.Option("--once", help="End when all covers have arrived.")] = False,
    speed: Annotated[float, typer.Option(help="Speed relative to the paper.", min=0.1, max=20)] = 1.0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result to this file.")] = None,
    domain: Annotated[int, typer.Option(help="ROS 2 domain of the TurtleBot3.", min=2, max=232)] = 2,
    port: Annotated[int, typer.Option(help="TCP port of the OPC UA server.", min=1, max=65535)] = 4840,
    ros_master_port: Annotated[int, typer.Option(help="TCP port of the ROS master.", min=1, max=65535)] = 11311,
    pubsub_url: PubSubUrls = None,
    folder: Annotated[Path | None, typer.Option(help="Folder for configuration, state and logs.")] = None,
    without_ros1: Annotated[bool, typer.Option("--without-ros1", help="Run the arm in ROS 2.")] = False,
    secure: Annotated[bool, typer.Option("--secure", help="Sign and encrypt PubSub, with the key service.")] = False,
    arm_domain: Annotated[int, typer.Option(help="ROS 2 domain of the arm without ROS 1.", min=2, max=232)] = 3,
    without_loop_rule: WithoutLoopRule = False,
    broker: WithBroker = False,
    no_console: NoConsole = False,
    console_port: ConsolePort = CONSOLE_PORT,
) -> None:
    """Run the fault-tolerant assembly line of Nguyen et al. (ONCON 2022).

    A robot arm in ROS 1 places covers on a conveyor belt; after 25 s the belt is turned off, and a TurtleBot3 in ROS 2
    carries the rest. Times of the timeline are the line's seconds: wall time times --speed. Exit code 0 if all four
    covers arrived and nothing was delivered twice.
    """
    try:
        from ua_demo.folder import claim_domain, run_folder
        from ua_demo.pal.run import run_pal
        from ua_demo.pal.setting import make_setting
        from ua_demo.site import choose_site
    except ImportError as error:
        raise BridgeUnavailable(f"the demonstration cannot run: {error}", extra="server") from error

    check_broker(broker, pubsub_url)
    ends: list[DemoResult] = []
    write_report = report_writer(json_file)

    with (
        run_folder(folder, "pal", keep=not once) as place,
        claim_domain(domain, message) as mobile_domain,
        ExitStack() as claimed,
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
        # One that both are asked to have is refused there.
        is_claimed = site.ros1_python is None and arm_domain != domain
        setting = make_setting(
            site,
            domain=mobile_domain,
            arm_domain=claimed.enter_context(claim_domain(arm_domain, message)) if is_claimed else arm_domain,
            speed=speed,
            loop_rule=not without_loop_rule,
            say=message,
        )
        message("starting the server, the bridges and the robots' programs (some seconds)")
        started = partial(tell_how_to_connect, site)

        def finished(result: DemoResult) -> None:
            write_report(result.report)
            tell_result(result)
            ends.append(result)
            if not once:
                tell_how_to_connect(site)
                message("the line stays up until you press Ctrl-C")

        with shown_until_ctrl_c(lambda: bool(ends)):
            run(run_pal(setting, say=print_line, started=started, finished=finished, stay=not once))
    if any(result.problems for result in ends):
        raise typer.Exit(1)
