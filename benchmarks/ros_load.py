"""What bridges take of a processor for large and fast streams, beside the least that two processes can do.

Two graphs of one version of ROS, and the same four streams on three ways: through the floor's two processes, which
take the serialised message and send its bytes in the same chunks of UDP, without security, for the other one to
publish; through our two bridges, mirrored; and mapped to fields, which is the near bridge's matter alone. All of it
runs all the time, one way at a time is given something to do, and the ways take turns. CPU is what the kernel has
counted for all threads.
"""

from __future__ import annotations

import statistics
import sys

from benchmarks._load import NAMES, STREAMS, Line, Load, line
from benchmarks._ros import Node
from benchmarks.harness import FEWEST_ROUNDS, Figure, Unavailable, at_most
from tests import system

SECONDS = 3.0
SETS: dict[str, tuple[str, ...]] = {**{stream: (stream,) for stream in STREAMS}, "together": STREAMS}
GOALS = {
    "ros2": {"imu": 1.8, "image": 1.5, "scan": 1.8, "cloud": 1.5, "together": 1.5},
    "ros1": {"imu": 2.2, "image": 2.0, "scan": 2.2, "cloud": 2.0, "together": 2.0},
}
CALLS, PAUSE_S = 40, 0.1
"""Skills that are asked for in a round."""
ACCEPTED_MS, BUSY_MS = 20.0, 60.0
MAPPED_GOAL, IDLE_GOAL_MS, ARRIVED_GOAL, AGE_GOAL_S = 1.3, 5.0, 0.99, 0.5
VERSIONS = {"ros2": "ROS 2", "ros1": "ROS 1"}
SECURED = "sign_and_encrypt"


def median(loads: list[Load]) -> Load:
    return Load(*(statistics.median(column) for column in zip(*loads, strict=True)))


def measured(
    running: Line, name: str, rounds: int, ways: tuple[str, ...] = ("floor", "mirrored", "mapped")
) -> dict[str, Load]:
    """Of each way, the median over the rounds."""
    found: dict[str, list[Load]] = {way: [] for way in ways}
    for _ in range(rounds):
        for way, loads in found.items():
            loads.append(running.measure(way, SETS[name], SECONDS))
    return {way: median(loads) for way, loads in found.items()}


def mirrored_rows(label: str, goal: float, floor: Load, mirrored: Load, reference: str) -> list[Figure]:
    """What both bridges cost, and what arrives how late."""
    return [
        at_most(
            f"{label}, mirrored, CPU of both bridges for a second",
            mirrored.cpu_ms,
            "ms",
            reference=reference,
            reference_value=floor.cpu_ms,
            goal=goal,
        ),
        Figure(
            f"{label}, mirrored, arrived",
            mirrored.arrived,
            "of all",
            reference,
            floor.arrived,
            mirrored.arrived / floor.arrived,
            ARRIVED_GOAL,
            mirrored.arrived >= ARRIVED_GOAL,
        ),
        Figure(
            f"{label}, mirrored, age p99",
            mirrored.age_p99_s,
            "s",
            reference,
            floor.age_p99_s,
            mirrored.age_p99_s / floor.age_p99_s,
            AGE_GOAL_S,
            mirrored.age_p99_s <= AGE_GOAL_S,
        ),
    ]


def rows(ros: str, name: str, found: dict[str, Load]) -> list[Figure]:
    floor, mirrored, mapped = found["floor"], found["mirrored"], found["mapped"]
    label = f"{VERSIONS[ros]}, {NAMES[name]}"
    return [
        *mirrored_rows(label, GOALS[ros][name], floor, mirrored, "two processes that carry bytes"),
        at_most(
            f"{label}, mapped, CPU of the near bridge",
            mapped.near_ms,
            "ms",
            reference="mirrored",
            reference_value=mirrored.near_ms,
            goal=MAPPED_GOAL,
        ),
    ]


def secured_figures(rounds: int, names: tuple[str, ...] = tuple(SETS)) -> list[Figure]:
    """The same of bridges that encrypt and sign, beside a floor that makes the bare AES and HMAC calls too."""
    if reason := system.missing("ros2"):
        raise Unavailable(reason)
    found: list[Figure] = []
    with line("ros2", security=SECURED) as running:
        for name in names:
            loads = measured(running, name, rounds, ("floor", "mirrored"))
            label, reference = f"ROS 2 secured, {NAMES[name]}", "two processes that encrypt, sign and carry bytes"
            found += mirrored_rows(label, GOALS["ros2"][name], loads["floor"], loads["mirrored"], reference)
    return found


def skill_rows(ros: str, running: Line, client: Node, rounds: int) -> list[Figure]:
    """How long a skill takes while all streams run, alone and with a busy loop on the same core."""
    found: list[Figure] = []
    alone = statistics.median(accepted for accepted, _ in running.skills(client, CALLS, PAUSE_S))
    for is_busy, goal_ms in ((False, ACCEPTED_MS), (True, BUSY_MS)):
        times: list[tuple[float, float]] = []
        for _ in range(rounds):
            running.begin("mirrored", STREAMS, CALLS * PAUSE_S * 1.5 + 1.0)
            times += running.skills(client, CALLS, PAUSE_S, is_busy=is_busy)
            running.end()
        where = ", a busy loop on the same core" if is_busy else ""
        label = f"{VERSIONS[ros]}, all together{where}, a skill"
        for what, column in (("accepted", 0), ("begun and ended", 1)):
            ordered = sorted(each[column] for each in times)
            p99 = ordered[len(ordered) * 99 // 100]
            goal = goal_ms if what == "accepted" else None
            found.append(
                Figure(
                    f"{label} {what}, p99",
                    p99,
                    "ms",
                    "the median of acceptance without streams",
                    alone,
                    p99 / alone,
                    goal,
                    goal is None or p99 <= goal,
                )
            )
    return found


def version_figures(ros: str, rounds: int, names: tuple[str, ...] = tuple(SETS)) -> list[Figure]:
    """All figures of one version of ROS."""
    if reason := system.missing(ros):
        raise Unavailable(reason)
    found: list[Figure] = []
    with line(ros) as running:
        for end, taken in zip(("near", "far"), running.idle_ms, strict=True):
            label = f"{VERSIONS[ros]}, idle, CPU of the {end} bridge for a second"
            found.append(at_most(label, taken, "ms", reference="goal", reference_value=IDLE_GOAL_MS, goal=1.0))
        with running.requestor() as client:
            found += skill_rows(ros, running, client, rounds)
        for name in names:
            found += rows(ros, name, measured(running, name, rounds))
    return found


def figures(rounds: int) -> list[Figure]:
    rounds = max(rounds, FEWEST_ROUNDS)
    return [*version_figures("ros2", rounds), *secured_figures(rounds), *version_figures("ros1", rounds)]


def main() -> None:
    """`python -m benchmarks.ros_load ros1|ros2|secured ROUNDS STREAM...` prints a part of it while one works on it."""
    ros, rounds, *streams = sys.argv[1:]
    names = tuple(streams) or tuple(SETS)
    found = secured_figures(int(rounds), names) if ros == "secured" else version_figures(ros, int(rounds), names)
    for figure in found:
        print(f"{figure.name:75} {figure.value:9.4g} {figure.reference_value:9.4g} {figure.ratio:6.2f} {figure.holds}")


if __name__ == "__main__":
    main()
