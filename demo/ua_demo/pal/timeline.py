"""What happened on the line, from what its members say: pure, fed with events, asked for the report at the end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ua_demo.lines import LineEvent

__all__ = ["COVERS", "Cover", "Timeline", "percentiles"]

COVERS = 4
"""Covers in the storage, as in Figure 7 of the paper."""

_QUIET = frozenset({"hears of the joints", "hears of the park", "hears of the bucket", "is ready"})
"""Said too often, or before the line starts: measured, but not printed."""

PAPER_S = {"conveyor_off": 2.0, "counter_to_server": 4.0, "placed_to_move": 10.0}
"""The paper's delays in seconds (section V): between arm and server for the conveyor, from placing a cover to the
counter in the server, and from placing a cover on the TurtleBot3 to its first move."""


@dataclass(slots=True)
class Cover:
    """One cover's way; times are the line's seconds from its start."""

    carrier: str
    placed_s: float
    delivered_s: float | None = None


class Timeline:
    """Collects the events of one run. The line's seconds are wall seconds times `speed`."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self.started: float | None = None
        self.covers: list[Cover] = []
        self.events: list[tuple[float, str]] = []
        self.ros1_to_ros2_ms: list[float] = []
        self.ros1_to_server_ms: list[float] = []
        self.ros2_to_server_ms: list[float] = []
        self.conveyor_off_ms: list[float] = []
        self.counter_to_server_ms: list[float] = []
        self.placed_to_move_ms: list[float] = []
        self._arm_saw_off: float | None = None
        self._placed_at: dict[tuple[str, int], float] = {}

    def line_s(self, t: float) -> float:
        """The line's time of a moment; 0 before the start."""
        return 0.0 if self.started is None else (t - self.started) * self.speed

    def add(self, event: LineEvent) -> str | None:
        """Take in one event; the line to print for it, or None."""
        key = (event.who, event.what)
        details = event.details
        if key == ("ned", "starts"):
            self.started = event.t
        elif key == ("ned", "places a cover"):
            self.covers.append(Cover(str(details["carrier"]), self.line_s(event.t)))
            self._placed_at[str(details["carrier"]), int(details["count"])] = event.t
        elif key == ("human", "takes a cover"):
            self._deliver(str(details["carrier"]), self.line_s(event.t))
        elif key == ("ned", "sees the conveyor") and not details["on"]:
            self._arm_saw_off = event.t
        elif key == ("turtlebot3", "moves to the worker"):
            placed = self._placed_at.get(("turtlebot3", int(details["count"])))
            if placed is not None:
                self.placed_to_move_ms.append((event.t - placed) * 1000)
        elif key == ("human", "hears of the joints"):
            self.ros1_to_ros2_ms.append(float(details["delay_ms"]))
        if self.started is None or event.what in _QUIET:
            return None
        return self._note(event)

    def _note(self, event: LineEvent) -> str:
        at_s = self.line_s(event.t)
        self.events.append((round(at_s, 3), event.text()))
        return f"{at_s:7.2f} s  {event.text()}"

    def _deliver(self, carrier: str, at_s: float) -> None:
        for cover in self.covers:
            if cover.carrier == carrier and cover.delivered_s is None:
                cover.delivered_s = at_s
                return

    def server_saw_conveyor(self, on: bool, server_time: float) -> str | None:
        """The server's node of the conveyor changed; `server_time` is its ServerTimestamp."""
        if on or self._arm_saw_off is None:
            return None
        self.conveyor_off_ms.append((server_time - self._arm_saw_off) * 1000)
        return self._note(LineEvent(server_time, "server", "sees the conveyor", {"on": False}))

    def server_saw_counter(self, carrier: str, count: int, server_time: float) -> None:
        """The server's node of a counter of placed covers changed."""
        placed = self._placed_at.get((carrier, count))
        if placed is not None:
            self.counter_to_server_ms.append((server_time - placed) * 1000)

    @property
    def all_delivered(self) -> bool:
        """Whether every cover has reached the human."""
        return len(self.covers) == COVERS and all(cover.delivered_s is not None for cover in self.covers)

    def report(self, *, looped: int, drops: Mapping[str, int], ros1: bool, secure: bool) -> dict[str, Any]:
        """The result of the run as it is written to a file."""
        return {
            "covers": [
                {
                    "carrier": cover.carrier,
                    "placed_s": round(cover.placed_s, 3),
                    "delivered_s": None if cover.delivered_s is None else round(cover.delivered_s, 3),
                }
                for cover in self.covers
            ],
            "delays_ms": {
                "ros1_to_ros2": percentiles(self.ros1_to_ros2_ms),
                "ros1_to_server": percentiles(self.ros1_to_server_ms),
                "ros2_to_server": percentiles(self.ros2_to_server_ms),
                "conveyor_off_to_server": percentiles(self.conveyor_off_ms),
                "counter_to_server": percentiles(self.counter_to_server_ms),
                "placed_to_turtlebot3_moves": percentiles(self.placed_to_move_ms),
            },
            "looped": looped,
            "drops": dict(drops),
            "events": [{"t_s": t_s, "what": what} for t_s, what in self.events],
            "ros1": ros1,
            "secure": secure,
            "speed": self.speed,
        }

    def delay_table(self, *, ros1: bool) -> list[tuple[str, str, str]]:
        """(what, in the paper, here), for people. `ros1`: whether the arm runs in ROS 1."""
        arm = "ROS 1" if ros1 else "arm's ROS 2"
        rows = [
            ("conveyor off: arm sees it -> server", "conveyor_off", self.conveyor_off_ms),
            ("cover placed -> its counter in the server", "counter_to_server", self.counter_to_server_ms),
            ("cover in the bucket -> TurtleBot3 moves", "placed_to_move", self.placed_to_move_ms),
            (f"{arm} message -> TurtleBot3's ROS 2 (joint states)", "", self.ros1_to_ros2_ms),
            (f"{arm} message -> server's node (joint states)", "", self.ros1_to_server_ms),
            ("ROS 2 message -> server's node (pose)", "", self.ros2_to_server_ms),
        ]
        return [(what, f"{PAPER_S[key]:.0f} s" if key else "not given", _shown(samples)) for what, key, samples in rows]


def _shown(samples: Sequence[float]) -> str:
    if not samples:
        return "not seen"
    figures = percentiles(samples)
    if len(samples) < 5:
        return f"max {figures['max']:.2f} ms of {len(samples)}"
    return f"p50 {figures['p50']:.2f} ms, p99 {figures['p99']:.2f} ms, max {figures['max']:.2f} ms of {len(samples)}"


def percentiles(samples: Sequence[float]) -> dict[str, float | None]:
    """The 50th and 99th percentile (nearest rank) and the greatest of some samples; None without samples."""
    if not samples:
        return {"p50": None, "p99": None, "max": None}
    ordered = sorted(samples)
    count = len(ordered)
    p50, p99 = (ordered[math.ceil(count * share / 100) - 1] for share in (50, 99))
    return {"p50": round(p50, 3), "p99": round(p99, 3), "max": round(ordered[-1], 3)}
