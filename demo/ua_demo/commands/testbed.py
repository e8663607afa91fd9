"""`ua-fleet testbed`: what the containers of `compose.yaml` run."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_demo.commands.run_messages import tell_result
from ua_fleet.cli.command_group import add_command, command_group
from ua_fleet.cli.endings import NotFound, extra_needed
from ua_fleet.cli.options import DEFAULT_ENDPOINT, Endpoint, Json
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run as run_until_done

if TYPE_CHECKING:
    from ua_demo.testbed.plan import Options, Testbed

__all__ = ["Name", "app"]

_PREPARE_EXAMPLES = ("ua-fleet testbed prepare talkrobots --folder /var/lib/ua-fleet",)
_ROBOT_EXAMPLES = ("ua-fleet testbed robot talkrobots pioneer_1", "ua-fleet testbed robot pal ned")

_RUN_EXAMPLES = ("ua-fleet testbed run talkrobots -e opc.tcp://server:4840/ua_fleet",)
_LOGIN_EXAMPLES = (
    "docker compose exec tasks ua-fleet testbed login talkrobots",
    "docker compose exec line ua-fleet testbed login pal",
    "docker compose exec flights ua-fleet testbed login brokered",
)


class Name(StrEnum):
    """The testbeds of `ua_demo/testbed/plan.py`; a test compares them."""

    PAL = "pal"
    TALKROBOTS = "talkrobots"
    BROKERED = "brokered"


_Which = Annotated[Name, typer.Argument(help="Which of the demonstrations.")]
_Folder = Annotated[Path, typer.Option(help="The volumes are folders in it, one for each process.")]
_DEFAULT_FOLDER = Path("/var/lib/ua-fleet")


def _plan(name: Name) -> tuple[Testbed, Options]:
    with extra_needed("the testbed", "server"):
        from ua_demo.testbed.plan import TESTBEDS, Options
    return TESTBEDS[name], Options.of(os.environ)


def prepare(testbed: _Which, folder: _Folder = _DEFAULT_FOLDER) -> None:
    """Write what the processes of a testbed need into their volumes, and end.

    These are fleet.yaml, the certificates by which server and bridges know each other, and the user `operator` with a
    password; for `brokered` also the MQTT broker's certificate, users and rights, and the keys of PubSub. It may be run
    again at any time: existing files stay, and so does a file that you have edited.
    UA_FLEET_SPEED, UA_FLEET_RESILIENCE (operator or automatic) and UA_FLEET_MODE (orchestrated or carried) set up the
    demonstration.
    """
    plan, options = _plan(testbed)
    with extra_needed("the testbed", "server"):
        from ua_demo.testbed.prepare import prepare as prepare_testbed
    run_until_done(prepare_testbed(plan, folder, options, message))


def robot(
    testbed: _Which,
    name: Annotated[str, typer.Argument(help="Name of a robot, or of the program that simulates a person.")],
) -> None:
    """Run the simulation of a robot of a testbed: its program, or the simulator of its controller."""
    plan, options = _plan(testbed)
    if name not in plan.robots:
        raise NotFound(f"the testbed {testbed} has no {name}; there are: {', '.join(plan.robots)}")
    arguments, added = plan.robot(name, options)
    os.execve(sys.executable, [sys.executable, *arguments], {**os.environ, **added})  # noqa: S606


def run(
    testbed: _Which,
    folder: _Folder = _DEFAULT_FOLDER,
    endpoint: Endpoint = DEFAULT_ENDPOINT,
) -> None:
    """Run the demonstration of a testbed once, then show the runs of other clients, until Ctrl-C.

    The command is an ordinary OPC UA client. It waits until the fleet is complete, and goes on when the server returns.
    The result is written to operator/result.json below --folder; while that file exists, no run is started
    automatically.
    """
    plan, options = _plan(testbed)
    with extra_needed("the testbed", "server"):
        from ua_demo.testbed.plan import LIMIT_S, OPERATOR, PASSWORD
        from ua_demo.testbed.run import conduct
    confirm = f"docker compose exec {plan.conductor} ua-fleet decision confirm"

    async def ask(decision_id: str, robots: Sequence[str]) -> str | None:
        if robots:
            message(f"choose: {confirm} {decision_id} {robots[0]} --password-file {folder / OPERATOR / PASSWORD}")
            message(f"otherwise {robots[0]} takes over after {LIMIT_S:g} s")
        return None

    run_until_done(conduct(plan, folder, options, endpoint, say=print_line, tell=tell_result, ask=ask))


def login(testbed: _Which, folder: _Folder = _DEFAULT_FOLDER, as_json: Json = False) -> None:
    """Print how a browser, UaExpert or a command logs in to a testbed."""
    plan, options = _plan(testbed)
    with extra_needed("the testbed", "server"):
        from ua_demo.testbed.login import login_of
    found = login_of(folder, options)
    if as_json:
        print_json(asdict(found))
        return
    compose = "docker compose exec"
    print_line(f"browser:      {found.console}  (the web console)")
    print_line(f"endpoint:     {found.endpoint}  ({found.security})")
    print_line(f"user:         {found.user}")
    print_line(f"password:     {found.password}")
    print_line(f"certificate:  {found.server_thumbprint}  (SHA-1 of the server's; compare it)")
    message("The server trusts the web console already. UaExpert's first connection fails, since the server does not")
    message("know its certificate yet. Connect once, then trust the certificate:")
    message(f"  {compose} {plan.server} ua-fleet cert trust --last --show")
    message(f"Without UaExpert: {compose} {plan.conductor} ua-fleet browse --password-file {found.password_file}")


app = command_group("What the containers of compose.yaml run: the demonstrations, each process in a container.")
add_command(app, "prepare", prepare, _PREPARE_EXAMPLES)
add_command(app, "robot", robot, _ROBOT_EXAMPLES)
add_command(app, "run", run, _RUN_EXAMPLES)
add_command(app, "login", login, _LOGIN_EXAMPLES)
