"""`ua-fleet decision ...` and `ua-fleet fault ...`: robots that fail, and who takes over."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.options import Connection, Json, connecting
from ua_fleet.cli.output import print_json, print_line, print_table
from ua_fleet.cli.scenario import with_scenarios

if TYPE_CHECKING:
    from ua_fleet.client import ScenarioClient

__all__ = [
    "ACK_EXAMPLES",
    "CONFIRM_EXAMPLES",
    "FAULT_EXAMPLES",
    "LIST_EXAMPLES",
    "WHATIF_EXAMPLES",
    "ack",
    "confirm",
    "faults",
    "show",
    "whatif",
]

FAULT_EXAMPLES = ("ua-fleet fault list -u anna",)
ACK_EXAMPLES = ('ua-fleet fault ack ur3.silent --comment "I look after it" -u anna',)
LIST_EXAMPLES = ("ua-fleet decision list -u anna", "ua-fleet decision list -u anna --json")
CONFIRM_EXAMPLES = ("ua-fleet decision confirm 20300131-120000-a1b2c3.0 ur3 -u anna",)
WHATIF_EXAMPLES = ("ua-fleet decision whatif ur3 -u anna",)


@connecting
def faults(
    connection: Connection,
    as_json: Json = False,
) -> None:
    """List the faults that are active, or that nobody has acknowledged."""

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
                fault.reason,
            )
            for fault in found
        ]
        print_table([("fault", "state", "seen", "reason"), *rows])

    with_scenarios(connection, work)


@connecting
def ack(
    connection: Connection,
    fault: Annotated[str, typer.Argument(help="Id of the fault, e.g. ur3.silent.")],
    comment: Annotated[str, typer.Option(help="What others should know.")] = "",
    as_json: Json = False,
) -> None:
    """Say that a fault was seen. A failed skill is over with that: nobody else can tell."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.acknowledge(fault, comment)
        if as_json:
            print_json({"fault": fault, "done": True})

    with_scenarios(connection, work)


@connecting
def show(
    connection: Connection,
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
            for robot, score in zip(decision.robots, decision.scores, strict=False):
                print_line(f"  {score:.3f} {robot}")
            for robot, reason in zip(decision.excluded, decision.reasons, strict=False):
                print_line(f"  -     {robot} {reason}")

    with_scenarios(connection, work)


@connecting
def confirm(
    connection: Connection,
    decision: Annotated[str, typer.Argument(help="Id of the decision.")],
    robot: Annotated[str, typer.Argument(help="Who takes over.")],
    as_json: Json = False,
) -> None:
    """Choose who takes over.

    Exit code 1 if somebody has chosen another robot before, 3 if there is no such decision.
    """

    async def work(scenarios: ScenarioClient) -> None:
        outcome = await scenarios.confirm(decision, robot)
        if as_json:
            print_json({"decision": decision, "robot": robot, "outcome": outcome})
        else:
            print_line(outcome)

    with_scenarios(connection, work)


@connecting
def whatif(
    connection: Connection,
    robot: Annotated[str, typer.Argument(help="The robot that would fail.")],
    as_json: Json = False,
) -> None:
    """Print who would take over each task that a robot has ahead. Nothing happens."""

    async def work(scenarios: ScenarioClient) -> None:
        forecasts = await scenarios.what_if(robot)
        if as_json:
            for forecast in forecasts:
                print_json(asdict(forecast))
            return
        rows = [(one.run_id, one.task, one.best or "nobody", one.explanation) for one in forecasts]
        print_table([("run", "task", "robot", "ranking"), *rows])

    with_scenarios(connection, work)
