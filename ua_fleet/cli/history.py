"""`ua-fleet history`: values of the past."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Sequence
from contextlib import aclosing
from datetime import UTC, datetime, timedelta
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message
from ua_fleet.cli.process import run
from ua_fleet.cli.read import Nodes
from ua_fleet.cli.readings import Full, ReadingLines, Utc
from ua_fleet.cli.screen import ColorOption, ColorWhen
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.printing import harmless

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient, Reading, SelectedNode
    from ua_fleet.client.history import HistoryWanted

__all__ = ["EXAMPLES", "history"]

EXAMPLES = (
    "ua-fleet history ned.battery -u anna",
    "ua-fleet history ned.battery --since 1d --every 1h --calculate average -u anna",
    "ua-fleet history '*.battery' --since 2026-03-01T08:00 --until 2026-03-01T12:00 --csv -u anna",
    "ua-fleet history ned.battery carrier.battery --since 8h --plot batteries.png -u anna",
)
_UNITS: Final = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0}
_MOST_S: Final = 100 * 366 * 86_400.0
AGGREGATE_NAMES: Final = (
    "interpolated",
    "average",
    "time-average",
    "minimum",
    "maximum",
    "count",
    "start",
    "end",
    "duration-good",
    "percent-good",
)


@connecting
def history(
    connection: ConnectionOptions,
    nodes: Nodes,
    since: Annotated[
        str, typer.Option(help="Begin this long ago (90s, 10m, 8h, 7d), or at a time such as 2026-03-01T08:00.")
    ] = "1h",
    until: Annotated[str, typer.Option(help="End this long ago or at such a time; default: now.")] = "",
    newest: Annotated[int, typer.Option(help="Print no more than the newest values, the last one first.", min=0)] = 0,
    calculate: Annotated[
        str, typer.Option(help=f"Calculate in place of printing each value: {', '.join(AGGREGATE_NAMES)}.")
    ] = "",
    every: Annotated[
        str, typer.Option(help="With --calculate: length of each interval (10s, 5m, 1h); 0: one interval for all.")
    ] = "0",
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV: node, time, value, status.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw a diagram into this file (png, svg or pdf).")] = None,
    full: Full = False,
    utc: Utc = False,
    color: ColorOption = ColorWhen.AUTO,
    as_json: Json = False,
) -> None:
    """Print what the server has kept of some values.

    Nodes are given as for `read`. The server keeps what `history` in fleet.yaml says (docs/history.md). A time without
    a zone is local time.
    """
    if sum((as_csv, as_json, plot is not None)) > 1:
        raise UsageError("choose one of --csv, --json and --plot")
    if calculate and calculate not in AGGREGATE_NAMES:
        raise UsageError(f"--calculate {calculate}: there are {', '.join(AGGREGATE_NAMES)}")
    if calculate and newest:
        raise UsageError("--newest is for values as they were kept; leave it or --calculate out")
    now = datetime.now(UTC)
    begin, end = moment_of(since, now), moment_of(until, now) if until else now
    if begin >= end:
        raise UsageError(f"--since {since} is not before the end; choose an earlier time")
    if plot is not None:
        check_plot(plot)
    interval_ms = 0.0 if every == "0" else 1000 * seconds_of(every)

    async def main() -> None:
        from ua_fleet.client.history import HistoryWanted

        wanted = HistoryWanted(begin, end, newest=newest, aggregate=calculate, interval_ms=interval_ms)
        async with connected(connection) as client:
            selected = list({one.node_id: one for one in await client.select(nodes)}.values())
            if plot is not None:
                await draw(client, selected, wanted, plot)
            elif as_csv:
                await write_csv(client, selected, wanted)
            else:
                lines = await ReadingLines.of(client, selected, full=full, utc=utc, color=color, as_json=as_json)
                await print_lines(client, selected, wanted, lines)

    run(main())


def moment_of(text: str, now: datetime) -> datetime:
    """A time that is given as such, or as so long ago; raises UsageError."""
    try:
        return datetime.fromisoformat(text).astimezone(UTC)
    except ValueError:
        pass
    try:
        return now - timedelta(seconds=seconds_of(text))
    except UsageError:
        raise UsageError(f"{text!r} is no time; give 90s, 10m, 8h, 7d, or 2026-03-01T08:00") from None


def seconds_of(text: str) -> float:
    """Seconds of `90s`, `10m`, `8h` or `7d`; raises UsageError."""
    try:
        seconds = float(text[:-1]) * _UNITS[text[-1:]]
    except (KeyError, ValueError):
        seconds = math.nan
    if not 0 < seconds <= _MOST_S:
        raise UsageError(f"{text!r} is no duration; write it as 90s, 10m, 8h or 7d")
    return seconds


async def print_lines(
    client: FleetClient, selected: Sequence[SelectedNode], wanted: HistoryWanted, lines: ReadingLines
) -> None:
    """A line or an object for each value."""
    for node in selected:
        count = 0
        async with aclosing(client.history(node.node_id, wanted)) as readings:
            async for reading in readings:
                lines.show(node.name, reading)
                count += 1
        if not count:
            message(f"{node.name}: nothing was kept in this time")


async def write_csv(client: FleetClient, selected: Sequence[SelectedNode], wanted: HistoryWanted) -> None:
    """A table for other programs; times in UTC."""
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(("node", "time", "value", "status"))
    for node in selected:
        async with aclosing(client.history(node.node_id, wanted)) as readings:
            async for reading in readings:
                time = "" if reading.source_time is None else reading.source_time.isoformat()
                value = "" if reading.value is None else harmless(str(reading.value))
                out.writerow((node.name, time, value, reading.status_text))


def check_plot(file: Path) -> None:
    """Raise BridgeUnavailable or UsageError where no diagram can be drawn."""
    if file.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise UsageError(f"--plot {file}: the name ends with .png, .svg or .pdf")
    if find_spec("matplotlib") is None:
        raise BridgeUnavailable("--plot needs matplotlib", extra="plot")


async def draw(client: FleetClient, selected: Sequence[SelectedNode], wanted: HistoryWanted, file: Path) -> None:
    """A diagram of numbers; what is not Good leaves a gap."""
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(10, 4.5), layout="constrained")
    axes: Any = figure.subplots()
    drawn = 0
    for node in selected:
        times, values = list[datetime](), list[float]()
        async with aclosing(client.history(node.node_id, wanted)) as readings:
            async for reading in readings:
                if (point := point_of(reading)) is not None:
                    times.append(point[0])
                    values.append(point[1])
        if any(not math.isnan(value) for value in values):
            axes.plot(times, values, label=node.name, linewidth=1.2, marker="." if len(values) < 100 else None)
            drawn += 1
    if not drawn:
        message("there is nothing to draw: no numbers were kept in this time")
        raise typer.Exit(3)
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
    figure.autofmt_xdate()
    figure.savefig(file, dpi=150)
    message(f"{file}: {drawn} of {len(selected)} values drawn")


def point_of(reading: Reading) -> tuple[datetime, float] | None:
    """Where a value stands in a diagram; NaN for a gap, None for what is no number."""
    if reading.source_time is None:
        return None
    if reading.status >> 31 or reading.value is None:
        return reading.source_time, math.nan
    if isinstance(reading.value, bool | int | float):
        return reading.source_time, float(reading.value)
    return None
