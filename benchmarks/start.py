"""The start of a server, from its process's begin until clients can connect, for fleets of 100, 1,000 and 5,000 robots.

A robot has 30 Double values. Ours is `ua-fleet serve` with a `fleet.yaml`, which it reads and checks, and makes beside
the values what every robot has. The floor is a bare asyncua server with as many variables, that reads no file. CPU is
that of the process, of all its threads, as the kernel counts it; memory is what it has for itself alone (USS), beside
that of a Python with the same modules. All of them find their modules compiled, as a package that was installed has
them, wherever this runs: to compile ours takes 0.5 s when it is not kept, 3 s when it is written for the first time.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, at_most, shown

VALUES = 30
FLEETS = (100, 1_000, 5_000)
GOALS = {1_000: (5.0, 200.0)}
"""CPU seconds and MB, by robots."""
PER_NAMESPACE = 2_000
WAIT_S = 300.0
_FLOOR = Path(__file__).parent / "_start_floor.py"
_IMPORTS = "import ua_fleet.cli.serve, ua_fleet.server.app; print('ready', flush=True); input()"


class _Cost(NamedTuple):
    seconds: float
    cpu_s: float
    megabytes: float


def write_fleet(path: Path, robots: int) -> None:
    """A `fleet.yaml`; a namespace and a space for each 2,000 robots."""
    halls = range(-(-robots // PER_NAMESPACE))
    lines = ["version: 1", "server: {port: 0}", "pubsub: {security: none}", "monitoring: {enabled: false}"]
    lines.append(f"fleet: {{namespaces: [{', '.join(f'urn:hall-{hall}' for hall in halls if hall)}]}}")
    lines.append("bridges:")
    lines += [f"  hall{hall}: {{kind: ros2, space: {2 + hall}, status_id: {65_500 + hall}}}" for hall in halls]
    lines.append("robots:")
    for robot in range(robots):
        hall, number = divmod(robot, PER_NAMESPACE)
        lines += [f"  R{robot:04d}:", f"    bridge: hall{hall}", f"    namespace: {2 if not hall else 3 + hall}"]
        lines += ["    capacities: [mobile]", "    data:"]
        lines += [f"      value{at}: {{id: {1 + number * VALUES + at}, type: Double}}" for at in range(VALUES)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def floor_command(robots: int) -> list[str | Path]:
    """What starts the floor; not with its own folder first, where a module has the name of the library's `json`."""
    return [sys.executable, "-P", _FLOOR, str(robots), str(VALUES)]


@contextlib.contextmanager
def _running(command: Sequence[str | Path], folder: Path) -> Generator[subprocess.Popen[str]]:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=folder,
        env=env | {"PYTHONPYCACHEPREFIX": str(folder / "compiled")},
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def _cost(command: Sequence[str | Path], folder: Path) -> _Cost:
    started = time.perf_counter()
    with _running(command, folder) as process:
        assert process.stdout is not None
        if not any(line.startswith("ready") for line in process.stdout):
            raise Failed(f"{' '.join(str(part) for part in command)} ended before it served")
        seconds = time.perf_counter() - started
        proc = Path(f"/proc/{process.pid}")
        ticks = proc.joinpath("stat").read_text(encoding="ascii").rpartition(")")[2].split()[11:13]
        rollup = proc.joinpath("smaps_rollup").read_text(encoding="ascii").splitlines()
    own = sum(int(line.split()[1]) for line in rollup if line.startswith(("Private_Clean:", "Private_Dirty:")))
    return _Cost(seconds, sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK"), own / 1024)


def measured(robots: int, rounds: int) -> tuple[_Cost, _Cost, _Cost]:
    """The medians of a server, of the floor, and of the modules alone, which take turns."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_fleet(folder / "fleet.yaml", robots)
        commands: list[list[str | Path]] = [
            [sys.executable, "-m", "ua_fleet.cli", "serve"],
            floor_command(robots),
            [sys.executable, "-c", _IMPORTS],
        ]
        for command in commands:
            _cost(command, folder)  # compiles what is imported
        samples = [[_cost(command, folder) for command in commands] for _ in range(rounds)]
    ours, floor, modules = (
        _Cost(*(statistics.median(column) for column in zip(*costs, strict=True)))
        for costs in zip(*samples, strict=True)
    )
    return ours, floor, modules


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    found: list[Figure] = []
    for robots in FLEETS:
        ours, floor, modules = measured(robots, max(rounds, FEWEST_ROUNDS))
        name, bare = f"{robots:,} robots x {VALUES} values", "bare asyncua, as many variables"
        cpu, memory = ours.cpu_s, ours.megabytes
        found.append(shown(f"{name}, time", ours.seconds, "s", reference=bare, reference_value=floor.seconds))
        found.append(shown(f"{name}, CPU", cpu, "s", reference=bare, reference_value=floor.cpu_s))
        found.append(shown(f"{name}, memory", memory, "MB", reference=bare, reference_value=floor.megabytes))
        if (goal := GOALS.get(robots)) is not None:
            for what, value, unit, most in (("CPU", cpu, "s", goal[0]), ("memory", memory, "MB", goal[1])):
                limit = f"{name}, {what}, at most"
                found.append(at_most(limit, value, unit, reference="the limit", reference_value=most, goal=1.0))
        found.append(shown(f"{name}, modules", modules.megabytes, "MB", reference="the server", reference_value=memory))
    return found
