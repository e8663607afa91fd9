"""`ua-fleet simulate`: a virtual fleet, and what its messages come to."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Generator
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.command_group import add_command, command_group
from ua_fleet.cli.endings import UsageError, extra_needed
from ua_fleet.cli.options import Json
from ua_fleet.cli.output import message, print_json, print_line, print_table

if TYPE_CHECKING:
    from ua_demo.simulators.fleet import Result

__all__ = ["app"]

_EXAMPLES = (
    "ua-fleet simulate --robots 50 --tasks 100",
    "ua-fleet simulate --robots 5 --tasks 9 --faults 1 --json",
    "ua-fleet simulate --robots 20 --tasks 40 --csv traffic.csv --plot figures",
    "ua-fleet simulate --robots 50 --tasks 100 --carried    # the bridges carry the run; beside the server's way",
)


def simulate(
    robots: Annotated[int, typer.Option(help="Number of robots, each with its own bridge.")],
    tasks: Annotated[int, typer.Option(help="Number of tasks of 3 s each; the robots take them in turn.")],
    faults: Annotated[
        int, typer.Option(help="Number of robots that fail during their first task; others take over.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers: the same seed gives the same report.")] = 0,
    keep_alive: Annotated[
        float | None,
        typer.Option(
            help="Seconds between keep-alives; all else that is sent with a period slows down with it. Without it, "
            "1 s for up to 100 robots, and longer with more of them."
        ),
    ] = None,
    carried: Annotated[
        bool,
        typer.Option(
            "--carried", help="Have the bridges carry the run, and simulate it orchestrated too, for comparison."
        ),
    ] = False,
    csv: Annotated[Path | None, typer.Option(help="Write messages and bytes of each second to this file.")] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the paper's figures 11 to 13 into this folder; simulates smaller fleets.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Simulate a fleet and count its messages by kind, beside what Eq. 1 to 12 of the TalkRoBots paper expect.

    Requestor, engine, bridges, responders, codec and security are the real ones. The network is in memory, and the
    clock is virtual. The exit code is 0 if the scenario was done with each of its tasks once.
    """
    from ua_demo.simulators.fleet import Settings, figures, report
    from ua_demo.simulators.fleet import simulate as simulated

    settings = Settings(robots, tasks, faults, seed, keep_alive, carried=carried)
    # Whatever cannot be done is said before anything is simulated.
    if plot is not None:
        with extra_needed("--plot", "plot"):
            import_module("matplotlib")
        with _writing(plot):
            plot.mkdir(parents=True, exist_ok=True)
    if csv is not None:
        with _writing(csv):
            csv.touch()
    result = simulated(settings)
    if csv is not None:
        with _writing(csv):
            csv.write_text("\n".join(report.as_csv(result)) + "\n", encoding="utf-8")
    if plot is not None:
        points = figures.sweep(result, _progress)
        with _writing(plot):
            for file in figures.draw(result, points, plot):
                message(f"drawn: {file}")
    if as_json:
        print_json(report.as_json(result))
    else:
        _print(result)
    if not result.is_right:
        message(f"ua-fleet: the simulated scenario ended as {result.outcome}: {result.reason or 'tasks are missing'}")
        raise typer.Exit(1)


def _print(result: Result) -> None:
    from ua_demo.simulators.fleet import modes, report

    print_line(report.headline(result))
    for failure in result.failures:
        took_over = f"{failure.replacement} took over" if failure.replacement else "nobody took over"
        print_line(f"  {failure.detected_s:8.1f} s  {failure.robot} failed in {failure.task}: {took_over}")
    print_line("")
    print_table(report.kinds_table(result))
    print_line("")
    print_table(report.intervals(result))
    print_line("")
    if result.settings.carried:
        print_table(modes.modes_table(*modes.both_modes(result.settings, result)))
        print_line("")
    for line in report.simplifications(result.settings):
        print_line(f"simplified: {line}")


def _progress(done: int, of: int) -> None:
    if sys.stderr.isatty():
        message(f"figures: simulation {done + 1} of {of}")


@contextlib.contextmanager
def _writing(path: Path) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}") from error


app = command_group()
add_command(app, "simulate", simulate, _EXAMPLES)
