"""`ua-fleet drive`: a robot is driven by hand, with the keys of a terminal or by a script."""

from __future__ import annotations

import asyncio
import os
import sys
import termios
import time
import tty
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.drive_keys import KEY_LINE, Controls, KeyRequest, TerminalKeys
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run
from ua_fleet.cli.skill_progress import ProgressLine
from ua_fleet.errors import LeaseRefused
from ua_fleet.values import StatusCode

if TYPE_CHECKING:
    from ua_fleet.client import DrivingLease, TeleoperationInfo

__all__ = ["EXAMPLES", "drive", "duration_s"]

EXAMPLES = (
    "ua-fleet drive carrier -u anna",
    "ua-fleet drive carrier --axis linear=0.2 --axis angular=-0.1 --for 2s -u anna",
    "ua-fleet drive carrier --take-over -u erna",
)
_PERIOD_S: Final = 0.04
_SHOW_S: Final = 0.1
_FOCUS: Final = "\x1b[?1004h", "\x1b[?1004l"
"""Have the terminal tell that it has lost the focus (xterm); what does not know it ignores it."""
_STANDSTILL_S: Final = 1.0


@connecting
def drive(
    connection: ConnectionOptions,
    robot: Annotated[str, typer.Argument(help="Name of the robot.")],
    axis: Annotated[
        list[str] | None,
        typer.Option(help="Speed of an axis as name=value, in its unit; other axes have speed 0. Needs --for."),
    ] = None,
    wait: Annotated[str | None, typer.Option("--for", help="Duration of the drive, e.g. 2s or 500ms.")] = None,
    speed: Annotated[
        float, typer.Option(help="With keys: the speed of a key press as a share of the limits.", min=0.1, max=1.0)
    ] = 0.5,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="Take the robot over from its holder; only for engineers.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Drive a robot by hand while a key is held. This is no safety function.

    W, S and the arrows up and down drive the first axis, A, D, left and right the second, Q and E a third. A terminal
    does not report the release of a key: a key counts for 0.2 s after each repetition, so a tap is a nudge. Space stops
    the robot, + and - change the speed, X or Escape ends. Driving also ends when the terminal loses the focus, if the
    terminal reports it. The line shows the round trip to the server and the age of the bridge's last counter.

    With --axis and --for a script drives without keys. The exit code is 1 if the server refuses the lease or ends it
    early.
    """
    if bool(axis) != (wait is not None):
        raise UsageError("give both --axis (speed) and --for (duration), or neither to drive with keys")
    given = dict(_speed(text) for text in axis or ())
    for_s = None if wait is None else duration_s(wait)
    if for_s is None and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise UsageError("stdin is no terminal, so keys cannot be read; use --axis and --for")

    async def main() -> None:
        async with connected(connection) as client:
            from ua_fleet.client import driving, teleoperation_info

            info = await teleoperation_info(client, robot)
            _check(info, given)
            began = time.monotonic()
            async with driving(client, info, take_over=take_over) as lease:
                if lease.taken_from:
                    message(f"taken over from {lease.taken_from}")
                if for_s is not None:
                    await _drive_for(lease, given, for_s)
                else:
                    await _drive_by_keys(lease, speed)
            _told(lease, time.monotonic() - began, as_json=as_json)

    run(main())


def duration_s(text: str) -> float:
    """Seconds of `2s`, `500ms` or `1.5`; raises UsageError."""
    number, factor = (text[:-2], 0.001) if text.endswith("ms") else (text.removesuffix("s"), 1.0)
    try:
        seconds = float(number) * factor
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= 3600:
        raise UsageError(f"{text!r} is no time up to an hour; write it as 2s or 500ms")
    return seconds


def _speed(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        speed = float(value)
    except ValueError:
        raise UsageError(f"{text!r} is no speed of an axis; write name=value, e.g. linear=0.2") from None
    return name, speed


def _check(info: TeleoperationInfo, given: dict[str, float]) -> None:
    limits = {one.name: one for one in info.axes}
    for name, speed in given.items():
        if name not in limits:
            raise LeaseRefused(
                StatusCode.BAD_INVALID_ARGUMENT, f"{info.robot} has no axis {name!r}; there are: {', '.join(limits)}"
            )
        most = limits[name]
        if not abs(speed) <= most.speed:  # NaN is none either
            raise UsageError(f"{name}={speed:g} is beyond the limit of {most.speed:g} {most.unit}".rstrip())


async def _drive_for(lease: DrivingLease, given: dict[str, float], for_s: float) -> None:
    """Drive, then stand before the robot is given back."""
    line, until = ProgressLine(), time.monotonic() + for_s
    try:
        while (now := time.monotonic()) < until:
            await _send(lease, [given.get(axis.name, 0.0) for axis in lease.info.axes])
            line.show(_state(lease), is_change=False)
            await asyncio.sleep(min(_PERIOD_S, until - now))
        until = time.monotonic() + lease.info.stop_s + _STANDSTILL_S
        while time.monotonic() < until:
            await _send(lease, [0.0] * len(lease.info.axes))
            if not any(lease.status.output):
                break
            await asyncio.sleep(_PERIOD_S)
    finally:
        line.end()


async def _drive_by_keys(lease: DrivingLease, share: float) -> None:
    keys, controls = TerminalKeys(share), Controls([axis.name for axis in lease.info.axes])
    speeds = [axis.speed for axis in lease.info.axes]
    typed = asyncio.Event()
    asked = KeyRequest.NOTHING
    loop, stdin = asyncio.get_running_loop(), sys.stdin.fileno()

    def read() -> None:
        nonlocal asked
        text = os.read(stdin, 1024).decode(errors="replace")
        answer = keys.type(text, time.monotonic()) if text else KeyRequest.END  # the terminal is gone
        asked = answer if asked is KeyRequest.NOTHING else asked
        typed.set()

    line, shown_at, last = ProgressLine(), 0.0, [0.0] * len(speeds)
    message(f"you drive {lease.info.robot}: {KEY_LINE}")
    message("this is no safety function: keep the robot in sight and its emergency stop within reach")
    with _keys_at_once():
        loop.add_reader(stdin, read)
        try:
            while asked is KeyRequest.NOTHING:
                now = time.monotonic()
                control, sign = keys.held(now)
                last = controls.values(control, sign, speeds, keys.share)
                await _send(lease, last)
                if now - shown_at >= _SHOW_S:
                    shown_at = now
                    line.show(f"{_state(lease)}, {keys.share:.0%} of the limits", is_change=False)
                typed.clear()
                try:
                    async with asyncio.timeout(_PERIOD_S):
                        await typed.wait()
                except TimeoutError:
                    continue
        finally:
            loop.remove_reader(stdin)
            line.end()
    if asked is KeyRequest.AWAY:
        message("the terminal has lost the focus: the robot is released")


async def _send(lease: DrivingLease, values: Sequence[float]) -> None:
    if lease.over:
        raise LeaseRefused(StatusCode.BAD_INVALID_STATE, f"you no longer drive {lease.info.robot}: {lease.over}")
    await lease.drive(values)


def _state(lease: DrivingLease) -> str:
    output = lease.status.output or (0.0,) * len(lease.info.axes)
    axes = "  ".join(
        f"{axis.name} {value:+.2f} {axis.unit or ''}".rstrip()
        for axis, value in zip(lease.info.axes, output, strict=False)
    )
    return f"{axes}  round trip {lease.round_trip_s * 1000:.0f} ms, age {lease.age_s * 1000:.0f} ms"


def _told(lease: DrivingLease, seconds: float, *, as_json: bool) -> None:
    dropped = sum(lease.status.drops.values())
    if as_json:
        print_json(
            {
                "robot": lease.info.robot,
                "lease": lease.number,
                "seconds": round(seconds, 3),
                "setpoints": lease.setpoints,
                "round_trip_ms": round(lease.round_trip_s * 1000, 1),
                "ended": lease.over,
            }
        )
    else:
        print_line(
            f"{lease.info.robot}: {lease.over} after {seconds:.1f} s and {lease.setpoints} setpoints; "
            f"the bridge has dropped {dropped} since it runs"
        )


@contextmanager
def _keys_at_once() -> Generator[None]:
    """Each key is told as it is pressed, and not shown; Ctrl-C and Ctrl-Z do what they always do."""
    stdin = sys.stdin.fileno()
    before = termios.tcgetattr(stdin)
    tty.setcbreak(stdin)
    sys.stderr.write(_FOCUS[0])
    sys.stderr.flush()
    try:
        yield
    finally:
        sys.stderr.write(_FOCUS[1])
        sys.stderr.flush()
        termios.tcsetattr(stdin, termios.TCSADRAIN, before)
