"""`ua-fleet drive`, by a script and on a terminal, at a real server and bridge."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from tests import system
from tests.forking import ForkedProcess
from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR
from tests.integration.teleoperation.served import Floor, fleet, floor, until_value
from tests.system import clean_environment
from ua_fleet.client import ClientIdentity, FleetClient, driving

WAIT_S = 60.0


@pytest.fixture
async def made(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Floor]:
    async with floor(tmp_path, fleet(udp_url, tcp_port)) as found:
        yield found


def environment(made: Floor, user: tuple[str, str]) -> dict[str, str]:
    return clean_environment(
        UA_FLEET_ENDPOINT=made.running.url,
        XDG_STATE_HOME=str(made.running.folder / "state-of-client"),
        UA_FLEET_USER=user[0],
        UA_FLEET_PASSWORD=user[1],
        TERM="xterm",
    )


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "ua_fleet.cli", "drive", *arguments]


async def run(made: Floor, *arguments: str, user: tuple[str, str] = OPERATOR) -> subprocess.CompletedProcess[str]:
    ended = await asyncio.to_thread(partial(system.run, *command(*arguments), env=environment(made, user)))
    assert "Traceback" not in ended.stderr
    return ended


async def test_a_script_drives_for_a_time_and_gives_the_robot_back_at_a_standstill(made: Floor) -> None:
    ended = await run(made, "carrier", "--axis", "linear=-0.2", "--for", "1500ms", "--json")
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["robot"] == "carrier"
    assert told["ended"] == "released"
    assert told["setpoints"] > 5
    assert min(one[0] for one in made.carrier.written) == pytest.approx(-0.2)
    assert made.carrier.written[-1] == (0.0, 0.0)
    assert {one[1] for one in made.carrier.written} == {0.0}


@pytest.mark.parametrize(
    ("arguments", "user", "code", "said"),
    [
        (("nobody", "--axis", "linear=0", "--for", "1s"), OPERATOR, 3, "nobody"),
        (("carrier", "--axis", "sideways=0.1", "--for", "1s"), OPERATOR, 2, "there are: linear, angular"),
        (("carrier", "--axis", "linear=0.6", "--for", "1s"), OPERATOR, 2, "beyond the limit of 0.5"),
        (("carrier", "--axis", "linear=nan", "--for", "1s"), OPERATOR, 2, "beyond the limit of 0.5"),
        (("carrier", "--axis", "linear", "--for", "1s"), OPERATOR, 2, "write name=value"),
        (("carrier", "--axis", "linear=0.1"), OPERATOR, 2, "give both"),
        (("carrier",), OPERATOR, 2, "stdin is no terminal"),
        (("carrier", "--axis", "linear=0.1", "--for", "1s"), OBSERVER, 1, "role does not allow"),
    ],
)
async def test_what_cannot_be_is_told_in_one_line(
    made: Floor, arguments: tuple[str, ...], user: tuple[str, str], code: int, said: str
) -> None:
    ended = await run(made, *arguments, user=user)
    assert ended.returncode == code, ended.stderr
    assert said in ended.stderr
    assert not any(any(one) for one in made.carrier.written)


class Terminal:
    """A terminal with the command in it."""

    def __init__(self, process: ForkedProcess, file: int) -> None:
        self.process, self._file = process, file
        self.shown = ""

    def type(self, text: str) -> None:
        os.write(self._file, text.encode())

    async def until(self, is_so: Callable[[], object], *, typing: str = "") -> None:
        """Wait until something is so; meanwhile a key repeats itself."""
        end = time.monotonic() + WAIT_S
        while not is_so():
            assert time.monotonic() < end, self.shown
            with contextlib.suppress(BlockingIOError, OSError):
                self.shown += os.read(self._file, 65_536).decode(errors="replace")
            if typing:
                self.type(typing)
            await asyncio.sleep(0.03)


@contextmanager
def terminal(made: Floor, *arguments: str, user: tuple[str, str] = OPERATOR) -> Generator[Terminal]:
    ours, theirs = pty.openpty()
    process = system.forked(*command("carrier", *arguments), env=environment(made, user), terminal=theirs)
    os.close(theirs)
    os.set_blocking(ours, False)
    try:
        yield Terminal(process, ours)
    finally:
        process.kill()
        process.wait()
        os.close(ours)


async def test_a_held_key_drives_and_stops_with_its_repetitions(made: Floor) -> None:
    with terminal(made, "--speed", "1.0") as seen:
        await seen.until(lambda: "you drive carrier" in seen.shown and "round trip" in seen.shown)
        await seen.until(lambda: made.carrier.written[-1:] == [(0.5, 0.0)], typing="w")
        await seen.until(lambda: made.carrier.written[-1] == (0.0, 0.0))
        await seen.until(lambda: made.carrier.written[-1] == (0.0, -1.0), typing="\x1b[C")
        assert "0.50" in seen.shown
        assert "age" in seen.shown
        seen.type("x")
        await seen.until(lambda: seen.process.poll() is not None)
        assert seen.process.returncode == 0
        await seen.until(lambda: "carrier: released" in seen.shown)
    async with made.running.client(OBSERVER) as client:
        await until_value(client, "State", 0)
    assert made.carrier.written[-1] == (0.0, 0.0)


@pytest.mark.parametrize(("how", "code"), [("focus", 0), ("interrupt", 130), ("hang up", None)])
async def test_who_looks_away_has_given_it_back(made: Floor, how: str, code: int | None) -> None:
    with terminal(made) as seen:
        await seen.until(lambda: made.carrier.written[-1:] == [(0.25, 0.0)], typing="w")
        if how == "focus":
            assert "\x1b[?1004h" in seen.shown
            seen.type("\x1b[O")
        elif how == "interrupt":
            seen.process.send_signal(signal.SIGINT)
        else:
            seen.process.send_signal(signal.SIGHUP)
        await seen.until(lambda: seen.process.poll() is not None)
        if code is not None:
            assert seen.process.returncode == code
            await seen.until(lambda: "\x1b[?1004l" in seen.shown)
    async with made.running.client(OBSERVER) as client:
        await until_value(client, "State", 0)
        ended = await until_value(client, "LastEnd", bool)
    assert ended in ("oscar: released", "oscar: the session or its connection has ended")
    assert made.carrier.written[-1] == (0.0, 0.0)


async def test_an_engineer_takes_over_and_the_command_says_so(made: Floor) -> None:
    identity = ClientIdentity(made.running.folder / "identity")
    with terminal(made) as seen:
        await seen.until(lambda: made.carrier.written[-1:] == [(0.25, 0.0)], typing="w")
        async with (
            FleetClient.connect(made.running.url, user=ENGINEER[0], password=ENGINEER[1], identity=identity) as client,
            driving(client, "carrier", take_over=True),
        ):
            await seen.until(lambda: seen.process.poll() is not None)
        assert seen.process.returncode == 1
        await seen.until(lambda: "taken over by erna" in seen.shown)
