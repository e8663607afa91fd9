"""Figures 11, 12 and 13 of the paper with simulated values, as PNG and SVG.

Figures 11 and 12 need further simulations, of smaller fleets with fewer tasks. matplotlib is imported here alone, and
only where something is drawn.
"""

# matplotlib's types are partly unknown.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ua_demo import equations
from ua_demo.equations import EQUATION_12_KINDS, equation_12_sum
from ua_demo.simulators.fleet.run import Result, simulate
from ua_fleet.traffic import MessageKind

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "draw", "grid_of", "sweep"]

FIGURES: Final = ("figure_11_messages", "figure_12_bytes", "figure_13_over_time")
"""Names of the files, each as .png and .svg."""
PARTS: Final = (0.25, 0.5, 0.75, 1.0)
"""Of the greatest numbers of robots and tasks: where Figures 11 and 12 have points."""
_QUIET_S: Final = 600.0
"""Keep-alives are not in these figures; with so long a period the further simulations take less time."""
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#666666")
"""Told apart by the colour-blind too (Okabe and Ito)."""
_MORE_COLOURS: Final = ("#000000", "#999933", "#882255", "#44aa99")

Points = Mapping[tuple[int, int], Result]
"""Simulations by (robots, tasks)."""


def grid_of(most: int) -> list[int]:
    """1, and the parts of the greatest number."""
    return sorted({1, *(max(1, round(most * part)) for part in PARTS)})


def sweep(result: Result, progress: Callable[[int, int], None]) -> dict[tuple[int, int], Result]:
    """The simulations that Figures 11 and 12 need; none of their robots fails.

    Args:
        result: of the greatest fleet with the most tasks, which is not simulated again unless a robot has failed there.
        progress: told before each simulation how many are done, and how many there are.
    """
    settings = replace(result.settings, faults=0)
    wanted = [(robots, tasks) for robots in grid_of(settings.robots) for tasks in grid_of(settings.tasks)]
    points: dict[tuple[int, int], Result] = {}
    if not result.settings.faults:
        points[settings.robots, settings.tasks] = result
    for number, (robots, tasks) in enumerate(wanted):
        progress(number, len(wanted))
        if (robots, tasks) not in points:
            points[robots, tasks] = simulate(replace(settings, robots=robots, tasks=tasks, keep_alive_s=_QUIET_S))
    return points


def draw(result: Result, points: Points, folder: Path) -> list[Path]:
    """Draw all figures; the files.

    Args:
        result: the simulation; Figure 13 shows all that was sent in it.
        points: what `sweep` made.
        folder: where the files go.

    Raises:
        ImportError: matplotlib is not installed.
        OSError: a file cannot be written.
    """
    from matplotlib import rc_context

    files: list[Path] = []
    with rc_context({"svg.hashsalt": "ua-fleet", "font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        for name, figure in zip(FIGURES, (_messages(points), _bytes(points), _over_time(result, points)), strict=True):
            for ending, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
                files.append(folder / f"{name}.{ending}")
                figure.savefig(files[-1], dpi=150, metadata=metadata)
    return files


def _figure(width: float, height: float, panels: int = 1) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes: Any = figure.subplots(1, panels, squeeze=False)
    return figure, list(axes[0])


def _messages(points: Points) -> Figure:
    """Figure 11: messages by the number of robots, a line for each number of tasks."""
    figure, (axis,) = _figure(7, 4.5)
    _lines(axis, points, lambda result: equation_12_sum(result.traffic.messages))
    most = max(robots for robots, _ in points)
    across = sorted({max(1, round(1 + (most - 1) * part / 40)) for part in range(41)})
    for tasks, colour in zip(sorted({tasks for _, tasks in points}), _COLOURS, strict=False):
        values = [equations.total(equations.cyclic(robots, tasks)) for robots in across]
        axis.plot(across, values, color=colour, linestyle="--", linewidth=1)
    axis.plot([], [], color="black", linestyle="--", linewidth=1, label="Eq. 12, same colours")
    axis.set_ylim(bottom=0, auto=True)
    axis.set_xlabel("robots")
    axis.set_ylabel("messages (kinds of Eq. 12)")
    axis.set_title("Messages by robots and tasks")
    axis.legend()
    return figure


def _bytes(points: Points) -> Figure:
    """Figure 12: bytes by the number of tasks, a line for each number of robots."""
    figure, (axis,) = _figure(7, 4.5)
    swapped = {(tasks, robots): result for (robots, tasks), result in points.items()}
    _lines(axis, swapped, lambda result: equation_12_sum(result.traffic.bytes) / 1000, what="robots")
    axis.set_ylim(bottom=0)
    axis.set_xlabel("tasks")
    axis.set_ylabel("kB (kinds of Eq. 12, signed and encrypted)")
    axis.set_title("Data by tasks and robots")
    axis.legend()
    return figure


def _lines(
    axis: Axes, points: Mapping[tuple[int, int], Result], value: Callable[[Result], float], what: str = "tasks"
) -> None:
    for number, colour in zip(sorted({second for _, second in points}), _COLOURS, strict=False):
        across = sorted(first for first, second in points if second == number)
        values = [value(points[first, number]) for first in across]
        label = f"{number:,} {what if number != 1 else what.removesuffix('s')}"
        axis.plot(across, values, color=colour, marker="o", markersize=4, label=label)
    axis.set_xlim(left=0)


def _over_time(result: Result, points: Points) -> Figure:
    """Figure 13: messages over time, for several fleets, and all kinds of the simulation itself."""
    figure, (fleets, kinds) = _figure(11, 4.5, panels=2)
    most = max(tasks for _, tasks in points)
    for robots, colour in zip(sorted({robots for robots, _ in points}), _COLOURS, strict=False):
        _steps(fleets, points[robots, most], EQUATION_12_KINDS, f"{robots:,} robot{'s' if robots != 1 else ''}", colour)
    fleets.set_ylim(bottom=0)
    fleets.set_title(f"Messages so far (kinds of Eq. 12), {most:,} tasks")
    fleets.legend()
    settings, traffic = result.settings, result.traffic
    shown = sorted((kind for kind in MessageKind if traffic.messages[kind]), key=lambda kind: -traffic.messages[kind])
    for number, (kind, colour) in enumerate(zip(shown, (*_COLOURS, *_MORE_COLOURS), strict=False)):
        # There are as many requests as responses: through a dashed line the one behind is seen.
        style = ("-", "--")[number % 2] if kind in EQUATION_12_KINDS else ":"
        _steps(kinds, result, (kind,), f"{kind.value} ({traffic.messages[kind]:,})", colour, style)
    kinds.set_yscale("log")
    kinds.set_title(f"Messages so far by kind, {settings.robots:,} robots, {settings.tasks:,} tasks")
    kinds.legend(title="dotted: not in Eq. 12", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _steps(axis: Axes, result: Result, kinds: Sequence[MessageKind], label: str, colour: str, style: str = "-") -> None:
    """What was sent up to the end of each second."""
    at, seconds = result.traffic.messages_at, range(int(result.ended_s) + 1)
    counted = accumulate(sum(at[second, kind] for kind in kinds) for second in seconds)
    axis.step([*seconds], [*counted], where="post", color=colour, linestyle=style, label=label)
    axis.set_xlim(left=0)
    axis.set_xlabel("s")
    axis.set_ylabel("messages")
