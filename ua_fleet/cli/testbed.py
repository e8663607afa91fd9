"""`ua-fleet testbed`: what the containers of `compose.yaml` run."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.endings import NotFound, extra_needed
from ua_fleet.cli.output import message
from ua_fleet.cli.process import run as run_until_done

if TYPE_CHECKING:
    from ua_fleet.demo.testbed.plan import Options, Testbed

__all__ = ["PREPARE_EXAMPLES", "ROBOT_EXAMPLES", "prepare", "robot"]

PREPARE_EXAMPLES = ("ua-fleet testbed prepare talkrobots --folder /var/lib/ua-fleet",)
ROBOT_EXAMPLES = ("ua-fleet testbed robot talkrobots pioneer_1", "ua-fleet testbed robot pal ned")


class Name(StrEnum):
    """The testbeds of `demo/testbed/plan.py`; a test compares them."""

    PAL = "pal"
    TALKROBOTS = "talkrobots"


_Which = Annotated[Name, typer.Argument(help="Which of the two demonstrations.")]
_Folder = Annotated[Path, typer.Option(help="The volumes are folders in it, one for each process.")]
_DEFAULT_FOLDER = Path("/var/lib/ua-fleet")


def _plan(name: Name) -> tuple[Testbed, Options]:
    with extra_needed("the testbed", "server"):
        from ua_fleet.demo.testbed.plan import TESTBEDS, Options
    return TESTBEDS[name], Options.of(os.environ)


def prepare(testbed: _Which, folder: _Folder = _DEFAULT_FOLDER) -> None:
    """Write what the processes of a testbed need into their volumes, and end.

    That is fleet.yaml, certificates, by which server and bridges know each other, and the user `operator` with a
    password. It may be run again at any time: what is there stays, and a file that you have edited does too.
    UA_FLEET_SPEED and UA_FLEET_RESILIENCE (operator or automatic) say what the demonstration is like.
    """
    plan, options = _plan(testbed)
    with extra_needed("the testbed", "server"):
        from ua_fleet.demo.testbed.prepare import prepare as prepare_testbed
    run_until_done(prepare_testbed(plan, folder, options, message))


def robot(
    testbed: _Which,
    name: Annotated[str, typer.Argument(help="A robot, or what stands for a person.")],
) -> None:
    """Become what simulates a robot of a testbed: its program, or the simulator of its controller."""
    plan, options = _plan(testbed)
    if name not in plan.robots:
        raise NotFound(f"the testbed {testbed} has no {name}; there are: {', '.join(plan.robots)}")
    from ua_fleet.bridge.launch import child_environment

    arguments, added = plan.robot(name, options)
    os.execve(sys.executable, [sys.executable, *arguments], {**child_environment(os.environ), **added})  # noqa: S606
