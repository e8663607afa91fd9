"""The result of a simulation beside the equations: as a table for people, as JSON, as CSV."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from ua_demo import equations
from ua_demo.equations import EQUATION_12_KINDS, equation_12_sum
from ua_demo.simulators.fleet.fleet import TASK_S, Settings
from ua_demo.simulators.fleet.run import Result
from ua_demo.simulators.fleet.world import LATENCY_S
from ua_fleet.traffic import MessageKind

__all__ = ["as_csv", "as_json", "headline", "intervals", "kinds_table", "simplifications", "situation_of"]

TOTAL: Final = "total_equation_12_kinds"
_INTERVALS: Final = 10


def situation_of(settings: Settings) -> equations.Situation:
    """The simulation as the equations see it."""
    return equations.cyclic(settings.robots, settings.tasks, settings.faults)


def headline(result: Result) -> str:
    """What was simulated, and how it ended."""
    settings = result.settings
    how = result.outcome if not result.reason else f"{result.outcome} ({result.reason})"
    parts = f"{_counted(settings.robots, 'robot')}, {_counted(settings.tasks, 'task')} of {TASK_S:g} s"
    parts += ", carried by the bridges" if settings.carried else ""
    if settings.faults:
        parts += f", {_counted(settings.faults, 'faulty robot')}"
    times = f"{result.ended_s:.1f} s of the fleet's time, computed in {result.wall_s:.1f} s"
    return f"{parts}, seed {settings.seed}: {how} after {times}"


def kinds_table(result: Result) -> list[list[str]]:
    """Messages and bytes by kind; what Eq. 12 counts first, beside what it expects."""
    traffic, situation = result.traffic, situation_of(result.settings)
    fleet = equations.boot(situation.robots) + equations.identification(situation.robots)
    expected = {
        MessageKind.REGISTRATION: f"{fleet:,} (Eq. 1 and 2: middleware and fleet)",
        MessageKind.REQUEST: f"{equations.scenario(situation):,} (Eq. 9: tasks and hand-overs), with the next three",
        MessageKind.FAULT: f"{equations.fail(situation.faulty_robots):,} (Eq. 11)",
    }
    rows = [["kind", "messages", "bytes", "the equations expect"]]
    rows += [_row(kind, traffic.messages[kind], traffic.bytes[kind], expected.get(kind)) for kind in EQUATION_12_KINDS]
    total = f"{equations.total(situation):,.0f} (Eq. 12)"
    rows.append(_row("together", equation_12_sum(traffic.messages), equation_12_sum(traffic.bytes), total))
    others = [kind for kind in MessageKind if kind not in EQUATION_12_KINDS]
    rows += [_row(kind, traffic.messages[kind], traffic.bytes[kind]) for kind in others]
    for column in (1, 2):
        width = max(len(row[column]) for row in rows)
        for row in rows:
            row[column] = row[column].rjust(width)
    return rows


def intervals(result: Result) -> list[list[str]]:
    """What was sent in each tenth of the time."""
    traffic = result.traffic
    step = max(1, -(-(int(result.ended_s) + 1) // _INTERVALS))
    rows = [["seconds", "messages of Eq. 12", "bytes", "other messages", "bytes"]]
    for start in range(0, int(result.ended_s) + 1, step):
        counts = [0, 0, 0, 0]
        for second in range(start, start + step):
            for kind in MessageKind:
                offset = 0 if kind in EQUATION_12_KINDS else 2
                counts[offset] += traffic.messages_at[second, kind]
                counts[offset + 1] += traffic.bytes_at[second, kind]
        rows.append([f"{start} to {start + step}", *(f"{count:,}" for count in counts)])
    for column in range(1, len(rows[0])):
        width = max(len(row[column]) for row in rows)
        for row in rows:
            row[column] = row[column].rjust(width)
    return rows


def simplifications(settings: Settings) -> list[str]:
    """What differs from a fleet of machines; none of it changes the messages of the kinds that Eq. 12 counts."""
    said = [
        f"each way takes {LATENCY_S * 1000:g} ms, and nothing is lost",
        "keys are there from the start and are not changed; journals are in memory",
        f"keep-alives each {settings.timing.keep_alive_s:g} s, and all that has a period is as much slower than usual",
    ]
    if settings.carried and settings.faults:
        said.append("every datagram is delivered to everybody, since bridges rank the robots of others")
    elif not settings.all_hear_all:
        said.append("a datagram is delivered to those alone who could use it; who would drop it does not get it")
    return said


def as_json(result: Result) -> dict[str, Any]:
    """Everything, as plain data. `wall_s` alone differs from one time to the next."""
    settings, traffic = result.settings, result.traffic
    situation = situation_of(settings)
    return {
        "robots": settings.robots,
        "tasks": settings.tasks,
        "seed": settings.seed,
        "mode": "carried" if settings.carried else "orchestrated",
        "keep_alive_s": settings.timing.keep_alive_s,
        "outcome": result.outcome,
        "reason": result.reason,
        "tasks_done": result.tasks_done.total(),
        "began_s": round(result.began_s, 6),
        "ended_s": round(result.ended_s, 6),
        "faults": [
            {
                "robot": failure.robot,
                "task": failure.task,
                "detected_s": round(failure.detected_s, 6),
                "replacement": failure.replacement or None,
            }
            for failure in result.failures
        ],
        "messages": {
            TOTAL: equation_12_sum(traffic.messages),
            **{kind.value: traffic.messages[kind] for kind in MessageKind},
        },
        "bytes": {TOTAL: equation_12_sum(traffic.bytes), **{kind.value: traffic.bytes[kind] for kind in MessageKind}},
        "metadata_bytes_per_robot": round(traffic.bytes[MessageKind.METADATA] / settings.robots, 1),
        "equation_12": equations.total(situation),
        "equations": {
            "boot": equations.boot(situation.robots),
            "identification": equations.identification(situation.robots),
            "task": equations.task(situation),
            "forward": equations.forward(situation),
            "fail": equations.fail(situation.faulty_robots),
        },
        "drops": {str(cause): count for cause, count in sorted(result.drops.items())},
        "simplified": simplifications(settings),
        "over_time": [
            {"second": second, "kind": kind.value, "messages": messages, "bytes": size}
            for second, kind, messages, size in _over_time(result)
        ],
        "wall_s": round(result.wall_s, 3),
    }


def as_csv(result: Result) -> Iterator[str]:
    """Messages and bytes of each kind in each second, as lines; seconds without any are left out."""
    yield "second,kind,messages,bytes"
    for second, kind, messages, size in _over_time(result):
        yield f"{second},{kind.value},{messages},{size}"


def _over_time(result: Result) -> Iterator[tuple[int, MessageKind, int, int]]:
    traffic, order = result.traffic, list(MessageKind)
    for second, kind in sorted(traffic.messages_at, key=lambda key: (key[0], order.index(key[1]))):
        yield second, kind, traffic.messages_at[second, kind], traffic.bytes_at[second, kind]


def _row(name: str, messages: int, size: int, expected: str | None = None) -> list[str]:
    return [name, f"{messages:,}", f"{size:,}", expected or ""]


def _counted(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
