"""The conductor of a testbed: watches and commands a demonstration from a container that sees the server alone."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Final, Protocol

from ua_demo.failing import first_failure
from ua_demo.lines import read_line
from ua_demo.pal import conductor as pal
from ua_demo.report import beat
from ua_demo.result import DemoResult
from ua_demo.site import USER
from ua_demo.talkrobots import conductor as talkrobots
from ua_demo.talkrobots.chooser import Ask
from ua_demo.testbed.growing import GrowingFiles
from ua_demo.testbed.plan import EVENTS, FLEET, IDENTITY, OPERATOR, PASSWORD, TRAFFIC, Options, Testbed
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.config.load import load
from ua_fleet.errors import AccessRefused, ConfigError, NotConnected, SendTimeout
from ua_fleet.storage.files import write_whole

__all__ = ["RESULT", "conduct"]

RESULT: Final = "result.json"
"""In the operator's folder: as `ua-fleet demo ... --json` writes it. While it is there, nothing is run by itself."""
TIMEOUT_S: Final = 10.0
AGAIN_S: Final = 2.0
"""Between two attempts to reach the server."""
BEAT_S: Final = 1.0
LOOK_S: Final = 0.2
"""Between two looks at what robots have reported."""
HOLD_S: Final = 1.0
"""So much later what the server shows is taken in: what it came from stands in a file by then."""


class _Conductor(Protocol):
    async def follow(self, client: FleetClient, *, stay: bool) -> None: ...


async def conduct(
    testbed: Testbed,
    folder: Path,
    options: Options,
    endpoint: str,
    *,
    say: Callable[[str], None],
    tell: Callable[[DemoResult], None],
    ask: Ask,
) -> None:
    """Run the demonstration once, unless it was before, and follow all further runs until cancelled.

    Args:
        testbed: which.
        folder: the volumes' folders stand in it.
        options: chosen by the user.
        endpoint: URL of the server.
        say: prints a line.
        tell: prints the result of a run, which stands in its file then.
        ask: has an operator choose who takes over.

    Raises:
        ConfigError: a volume lacks what `prepare` writes.
        DemoFailed: the scenario has mistakes, or its run does not end.
    """
    operator = folder / OPERATOR
    result = operator / RESULT
    has_run = result.exists()
    if has_run:
        say(f"it has run before, and nothing is run by itself now: {result}")

    def finished(ended: DemoResult) -> None:
        write_whole(result, f"{json.dumps(ended.report, indent=2)}\n".encode(), 0o644)
        tell(ended)

    def connect() -> AbstractAsyncContextManager[FleetClient]:
        password = _password(operator / PASSWORD)
        identity = ClientIdentity(operator / IDENTITY)
        return FleetClient.connect(endpoint, user=USER, password=password, identity=identity, timeout_s=TIMEOUT_S)

    with first_failure():
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(_beat())
            conductor: _Conductor
            if testbed.name == "pal":
                line = pal.Conductor(
                    speed=options.speed, ros1=True, secure=True, say=say, check=_go_on, finished=finished, hold_s=HOLD_S
                )
                since = result.stat().st_mtime if has_run else 0.0
                tasks.create_task(_hear(line, GrowingFiles(folder / EVENTS, ".events"), since))
                conductor = line
            else:
                is_of_the_paper = testbed.name == "talkrobots"
                conductor = talkrobots.Conductor(
                    load(folder / FLEET / "fleet.yaml"),
                    speed=options.speed,
                    mode=options.mode,
                    traffic=(lambda: (folder / TRAFFIC).glob("*.jsonl*")) if is_of_the_paper else None,
                    say=say,
                    ask=ask,
                    check=_go_on,
                    started=lambda: say("the fleet is complete"),
                    finished=finished,
                    runs=not has_run,
                    patience_s=math.inf,
                    scenario=testbed.scenario,
                    tasks=testbed.tasks,
                    is_carried=options.is_carried and is_of_the_paper,
                )
            await _follow(conductor, connect, say)


async def _follow(
    conductor: _Conductor, connect: Callable[[], AbstractAsyncContextManager[FleetClient]], say: Callable[[str], None]
) -> None:
    """Follow over any number of connections; one line when the server goes away, and one when it is back."""
    told = ""
    while True:
        try:
            async with connect() as client:
                if told:
                    say("the server is back")
                    told = ""
                await conductor.follow(client, stay=True)
        except (NotConnected, SendTimeout, AccessRefused) as error:
            why = "refused" if isinstance(error, AccessRefused) else "away"
            if told != why:
                say(f"without the server: {error}")
            told = why
        await asyncio.sleep(AGAIN_S)


async def _hear(line: pal.Conductor, files: GrowingFiles, since: float) -> None:
    """Hand on what robots report, from a moment on, in seconds since 1970."""
    while True:
        events = [event for text in files.new_lines() if (event := read_line(text)) is not None and event.t > since]
        for event in sorted(events, key=lambda event: event.t):
            line.robot_says(event)
        await asyncio.sleep(LOOK_S)


async def _beat() -> None:
    while True:
        beat()
        await asyncio.sleep(BEAT_S)


def _go_on() -> None:
    """Containers are started again by themselves: nothing that ends is a reason to end, too."""


def _password(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError as error:
        remedy = "run first: ua-fleet testbed prepare"
        raise ConfigError(f"there is no password: {error.strerror}", file=str(path), suggestion=remedy) from error
