"""What a run cost in messages and bytes by kind, beside the equations of the paper. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ua_demo.equations import (
    Situation,
    blocks_of,
    boot,
    devices,
    equation_12_sum,
    fail,
    forward,
    identification,
    sensor,
    task,
    total,
)
from ua_fleet.storage.traffic_log import SentMessage
from ua_fleet.traffic import MessageKind

__all__ = ["MOST_BYTES", "MOST_MESSAGES", "PAPER", "Costs", "cost_lines"]

MOST_MESSAGES: Final = 104
"""The paper's 284 messages without 180 updates of its sensor."""
MOST_BYTES: Final = 15_100
"""The paper's 15.1 kB, with everything in them."""
_MEASURED: Final = 284
_ROBOTS, _ELAPSED_S, _RATES = 5, 180.0, (1.0,)
_BEST: Final = Situation(_ROBOTS, 9, blocks=(9,), sensor_rates=_RATES, elapsed_s=_ELAPSED_S, local_requests=1)
_WORST: Final = Situation(
    _ROBOTS,
    interpreted_tasks=9,
    sensor_rates=_RATES,
    elapsed_s=_ELAPSED_S,
    remote_requests=1,
    faulty_robots=1,
)
PAPER: Final = {"measured": _MEASURED, "best": round(total(_BEST)), "worst": round(total(_WORST))}
"""Section 6.2: five robots, one sensor that says something each second, nine tasks, 180 s. The paper prints 297 for the
worst case; its equation gives 299 with the robot that fails."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Messages and bytes by kind."""

    messages: Counter[MessageKind]
    bytes: Counter[MessageKind]

    @classmethod
    def of(cls, sent: Iterable[SentMessage], *, since: float) -> Costs:
        """What was sent from a moment on, in seconds since 1970. The parts of one message share its bytes evenly."""
        costs = cls(Counter(), Counter())
        for message in sent:
            if message.at < since or not message.kinds:
                continue
            share, rest = divmod(message.size, len(message.kinds))
            for number, kind in enumerate(message.kinds):
                costs.messages[kind] += 1
                costs.bytes[kind] += share + (rest if number == 0 else 0)
        return costs

    @property
    def counted_messages(self) -> int:
        """Of the kinds that Eq. 12 counts, without the sensor's updates."""
        return equation_12_sum(self.messages)

    @property
    def counted_bytes(self) -> int:
        """Their bytes."""
        return equation_12_sum(self.bytes)

    def report(self) -> dict[str, Any]:
        """As it is written to a file."""
        return {
            "messages": {kind.value: self.messages[kind] for kind in MessageKind},
            "bytes": {kind.value: self.bytes[kind] for kind in MessageKind},
            "paper": dict(PAPER),
        }


def cost_lines(costs: Costs, *, robots: int, actors: Sequence[str], elapsed_s: float, faulty: int) -> list[str]:
    """A table for people: what was sent by kind, and how many messages TalkRoBots would have taken for this very run.

    Args:
        costs: of the run.
        robots: robots and machines in the fleet, without the sensor.
        actors: who did the tasks, in their order.
        elapsed_s: the demonstration's seconds.
        faulty: robots that failed.
    """
    here = Situation(
        robots,
        len(actors),
        blocks=blocks_of(actors),
        sensor_rates=_RATES,
        elapsed_s=elapsed_s,
        remote_requests=1,
        faulty_robots=faulty,
    )
    registration = boot(robots) + identification(robots) + devices(_RATES, 0)
    updates = devices(_RATES, elapsed_s) - devices(_RATES, 0) + sensor(0, 1)
    rows: list[tuple[str, tuple[MessageKind, ...], str, str]] = [
        ("registration", (MessageKind.REGISTRATION,), f"{registration:.0f}", "Eq. 1, 2, and 2 for the sensor (Eq. 3)"),
        (
            "request, response, status",
            (MessageKind.REQUEST, MessageKind.RESPONSE, MessageKind.STATUS),
            f"{task(here)}",
            "Eq. 7",
        ),
        ("token", (MessageKind.TOKEN,), f"{forward(here)}", "Eq. 8: the scenario, handed on"),
        ("fault", (MessageKind.FAULT,), f"{fail(faulty)}", "Eq. 11"),
        ("sensor", (MessageKind.SENSOR,), f"{updates:.0f}", "Eq. 3 and 10: its updates, and who asks for them"),
        ("metadata", (MessageKind.METADATA,), "-", "not counted there: what data and Actions look like"),
        ("run", (MessageKind.RUN,), "-", "not counted there: what bridges tell of a carried run, for who watches"),
        ("keep_alive", (MessageKind.KEEP_ALIVE,), "-", "not counted there"),
        ("repeat", (MessageKind.REPEAT,), "-", "not counted there"),
        ("telemetry", (MessageKind.TELEMETRY,), "-", "not counted there: poses, batteries, the bridges' own state"),
    ]
    lines = [f"{'':<26} {'messages':>8} {'bytes':>8}   TalkRoBots"]
    for name, kinds, there, why in rows:
        messages, size = sum(costs.messages[kind] for kind in kinds), sum(costs.bytes[kind] for kind in kinds)
        lines.append(f"{name:<26} {messages:>8} {size:>8}   {there:>4}  {why}")
    counted = total(here) - updates
    lines.append(
        f"{'what Eq. 12 counts':<26} {costs.counted_messages:>8} {costs.counted_bytes:>8}   {counted:>4.0f}  "
        "without the sensor's updates"
    )
    lines.append(
        f"The paper measured {PAPER['measured']} messages and 15.1 kB, of which {PAPER['measured'] - MOST_MESSAGES} "
        f"messages were its sensor's; its Eq. 12 gives {PAPER['best']} to {PAPER['worst']}."
    )
    return lines
