"""`ua-fleet decision ...` and `ua-fleet fault ...`: robots that fail, and who takes over."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import print_json, print_line, print_table
from ua_fleet.cli.scenario import with_scenarios

if TYPE_CHECKING:
    from ua_fleet.client import FaultInfo, ScenarioClient

__all__ = [
    "ACK_EXAMPLES",
    "CLEAR_EXAMPLES",
    "CONFIRM_EXAMPLES",
    "FAULT_EXAMPLES",
    "JUDGE_EXAMPLES",
    "LIST_EXAMPLES",
    "MODE_EXAMPLES",
    "RAISE_EXAMPLES",
    "WHATIF_EXAMPLES",
    "ack",
    "clear_fault",
    "confirm",
    "faults",
    "judge",
    "raise_fault",
    "set_mode",
    "show",
    "taken_away",
    "whatif",
]

_SILENT: Final = "silent"
"""The source of a fault that takes nothing away: it is there to be seen."""

FAULT_EXAMPLES = ("ua-fleet fault list -u anna",)
ACK_EXAMPLES = ('ua-fleet fault ack ur3.silent --comment "I look after it" -u anna',)
RAISE_EXAMPLES = (
    'ua-fleet fault raise ur3 "gripper stuck" -u anna',
    'ua-fleet fault raise rover "the drive is hot" --capacity mobile -u anna',
)
CLEAR_EXAMPLES = ("ua-fleet fault clear ur3 -u anna", "ua-fleet fault clear ur3.not_halted -u anna")
LIST_EXAMPLES = ("ua-fleet decision list -u anna", "ua-fleet decision list -u anna --json")
CONFIRM_EXAMPLES = ("ua-fleet decision confirm 20300131-120000-a1b2c3.0 ur3 -u anna",)
MODE_EXAMPLES = (
    "ua-fleet decision mode automatic -u eva",
    "ua-fleet decision mode operator --limit-s 30 --on-limit abort -u eva",
)
JUDGE_EXAMPLES = ("ua-fleet decision judge battery/distance=2 battery/availability=3 distance/availability=1 -u eva",)
WHATIF_EXAMPLES = ("ua-fleet decision whatif ur3 -u anna",)


class DecisionModeName(StrEnum):
    """The modes of `resilience`; a test compares them. Importing those would slow down `--help`."""

    OPERATOR = "operator"
    AUTOMATIC = "automatic"
    ABORT = "abort"


class LimitName(StrEnum):
    """What happens when an operator takes too long; likewise."""

    BEST_IF_KNOWN = "best_if_known"
    BEST = "best"
    ABORT = "abort"


def taken_away(fault: FaultInfo) -> str:
    """What a fault takes away from its robot, in words."""
    return "nothing" if fault.source == _SILENT else " ".join(fault.capacities) or "all"


@connecting
def faults(
    connection: ConnectionOptions,
    as_json: Json = False,
) -> None:
    """List the faults that are active or not acknowledged.

    `fault clear ID` ends a fault of the sources skill, robot and not_halted; the others end by themselves.
    """

    async def work(scenarios: ScenarioClient) -> None:
        found = await scenarios.faults()
        if as_json:
            for fault in found:
                print_json(asdict(fault))
            return
        rows = [
            (
                fault.fault_id,
                "active" if fault.active else "over",
                "acknowledged" if fault.acknowledged else "-",
                (fault.since or "")[:19].replace("T", " "),
                taken_away(fault),
                fault.reason,
            )
            for fault in found
        ]
        print_table([("fault", "state", "seen", "since (UTC)", "takes away", "reason"), *rows])

    with_scenarios(connection, work)


@connecting
def ack(
    connection: ConnectionOptions,
    fault: Annotated[str, typer.Argument(help="Id of the fault, e.g. ur3.silent.")],
    comment: Annotated[str, typer.Option(help="Text for other users.")] = "",
    as_json: Json = False,
) -> None:
    """Acknowledge a fault. This also ends a fault of the source skill."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.acknowledge(fault, comment)
        if as_json:
            print_json({"fault": fault, "done": True})

    with_scenarios(connection, work)


@connecting
def raise_fault(
    connection: ConnectionOptions,
    robot: Annotated[str, typer.Argument(help="The robot that cannot work.")],
    reason: Annotated[str, typer.Argument(help="Text for other users.")],
    capacity: Annotated[
        list[str] | None,
        typer.Option(help="A capacity that the robot has lost; may be repeated. Without it: all capacities."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Raise a fault: a robot cannot work, or lacks a capacity. Other robots take its tasks over, as the mode says."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.raise_fault(robot, reason, capacity or ())
        if as_json:
            print_json({"robot": robot, "done": True})

    with_scenarios(connection, work)


@connecting
def clear_fault(
    connection: ConnectionOptions,
    robot: Annotated[
        str, typer.Argument(help="The robot that can work again, or the id of one of its faults: ur3.robot.")
    ],
    as_json: Json = False,
) -> None:
    """Clear a fault: the robot can work again. Refused while the cause of the fault is still present."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.clear_fault(robot)
        if as_json:
            print_json({"robot": robot, "done": True})

    with_scenarios(connection, work)


@connecting
def show(
    connection: ConnectionOptions,
    as_json: Json = False,
) -> None:
    """List the decisions that are open, and the last that were made, with their rankings."""

    async def work(scenarios: ScenarioClient) -> None:
        for decision in await scenarios.decisions():
            if as_json:
                print_json(asdict(decision))
                continue
            by = f": {decision.chosen}, by {decision.chosen_by}" if decision.chosen else ""
            print_line(f"{decision.decision_id} {decision.state}{by}")
            print_line(f"  {decision.task}: {decision.failed or 'nobody'}: {decision.reason}")
            for robot, score, missing in zip(decision.robots, decision.scores, decision.missing, strict=False):
                print_line("; ".join([f"  {score:.3f} {robot}", *missing]))
            for robot, reason in zip(decision.excluded, decision.reasons, strict=False):
                print_line(f"  -     {robot} {reason}")

    with_scenarios(connection, work)


@connecting
def confirm(
    connection: ConnectionOptions,
    decision: Annotated[str, typer.Argument(help="Id of the decision.")],
    robot: Annotated[str, typer.Argument(help="Who takes over.")],
    as_json: Json = False,
) -> None:
    """Choose who takes over.

    The exit code is 1 if another user has chosen another robot before, and 3 if the decision does not exist.
    """

    async def work(scenarios: ScenarioClient) -> None:
        outcome = await scenarios.confirm(decision, robot)
        if as_json:
            print_json({"decision": decision, "robot": robot, "outcome": outcome})
        else:
            print_line(outcome)

    with_scenarios(connection, work)


@connecting
def set_mode(
    connection: ConnectionOptions,
    mode: Annotated[DecisionModeName, typer.Argument(help="Who chooses who takes over.")],
    limit_s: Annotated[
        float | None, typer.Option(help="Time limit for the operator's decision, in seconds.", min=0.001)
    ] = None,
    on_limit: Annotated[LimitName | None, typer.Option(help="Action when the time limit is over.")] = None,
    as_json: Json = False,
) -> None:
    """Set who chooses a replacement from now on. An option that is left out keeps its value.

    Needs the role engineer. The setting stays over restarts of the server, until fleet.yaml gets another value.
    """

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.set_mode(mode.value, limit_s=limit_s, on_limit=on_limit.value if on_limit is not None else "")
        if as_json:
            print_json({"mode": mode.value, "done": True})

    with_scenarios(connection, work)


@connecting
def judge(
    connection: ConnectionOptions,
    judgements: Annotated[
        list[str], typer.Argument(help="battery/distance=2: battery is twice as important. Each pair once.")
    ],
    as_json: Json = False,
) -> None:
    """Compare the criteria in pairs, and print the weights that follow.

    Needs the role engineer. Judgements that contradict each other are refused; the error names the pair that fits
    least.
    """
    pairs = dict(_judgement(one) for one in judgements)

    async def work(scenarios: ScenarioClient) -> None:
        weights = await scenarios.set_judgements(pairs)
        if as_json:
            print_json({"weights": weights})
        else:
            print_table([("criterion", "weight"), *((name, f"{weight:.3f}") for name, weight in weights.items())])

    with_scenarios(connection, work)


def _judgement(text: str) -> tuple[str, float]:
    pair, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = 0.0
    if not all(pair.partition("/")) or not 0 < number < float("inf"):
        raise UsageError(f"{text!r} is no judgement; write e.g. battery/distance=2")
    return pair, number


@connecting
def whatif(
    connection: ConnectionOptions,
    robot: Annotated[str, typer.Argument(help="The robot that would fail.")],
    as_json: Json = False,
) -> None:
    """Print which robot would take over each later task of a robot. No robot is asked."""

    async def work(scenarios: ScenarioClient) -> None:
        forecasts = await scenarios.what_if(robot)
        if as_json:
            for forecast in forecasts:
                print_json(asdict(forecast))
            return
        rows = [(one.run_id, one.task, one.best or "nobody", one.explanation) for one in forecasts]
        print_table([("run", "task", "robot", "ranking"), *rows])

    with_scenarios(connection, work)
