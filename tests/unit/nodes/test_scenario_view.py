"""What bridges that carry a run ask people: each question once, whatever else is asked of the run."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from tests.unit.nodes.model_server import fleet_built
from ua_fleet.endpoint.convert import node_id
from ua_fleet.endpoint.stack import AttributeIds
from ua_fleet.nodes.alarm_nodes import AlarmNodes
from ua_fleet.nodes.dialogs import DialogNodes
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.scenario_nodes import ScenarioNodes
from ua_fleet.nodes.scenario_view import ScenarioView
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.orchestrator import BridgesFollowed, BridgeTold, RunChanged
from ua_fleet.scenario.facts import (
    Fact,
    RunAdopted,
    RunCarried,
    RunCreated,
    RunEnded,
    RunOutcome,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.values import UNIX_EPOCH_TICKS, NodeId

STEPS = ("0", "1", "2")
TEXT = "version: 1\nname: night\ndescription: for a test\nsteps:\n" + "".join(
    f"  - {{task: t{step}, skill: work, robot: arm{step}}}\n" for step in STEPS
)


class Heard(ServerEvents):
    """The events that were told, by what they are about."""

    def __init__(self, iserver: Any, projection: Projection) -> None:
        super().__init__(iserver)
        self._projection = projection
        self.dialogs, self.questions = Counter[str](), Counter[str]()
        self._space = iserver.aspace

    def value_of(self, path: str) -> Any:
        """The value of a node of the fleet."""
        return self._space.read_attribute_value(node_id(NodeId(2, path)), AttributeIds.Value).Value.Value

    def emit(self, event_type: Any, *, fields: Any, **told: Any) -> None:
        super().emit(event_type, fields=fields, **told)
        if "DialogState" in fields:
            self.dialogs[fields["ConditionName"].value] += 1
        elif "Fact" in fields and fields["Fact"].value == "OperatorAsked":
            self.questions[fields["Step"].value] += 1

    def all(self) -> tuple[dict[str, int], dict[str, int]]:
        """How often each question, and each dialog, was told when nothing waits any more."""
        while self._projection.waiting:
            self._projection.poll(0.0)
        return dict(self.questions), dict(self.dialogs)


@asynccontextmanager
async def view_of_a_fleet() -> AsyncGenerator[tuple[ScenarioView, Heard]]:
    """What shows runs, and what it tells."""
    async with fleet_built() as (server, fleet):
        parts = NodeFactory(server.iserver.aspace, 2)
        parts.values = fleet.values
        projection = Projection(fleet)
        heard = Heard(server.iserver, projection)
        nodes = ScenarioNodes(parts, projection.write, lambda: UNIX_EPOCH_TICKS, {300: "cell", 301: "yard"})
        nodes.build()
        AlarmNodes(parts, heard, projection).build()
        dialogs = DialogNodes(parts, heard, projection, lambda: UNIX_EPOCH_TICKS)
        yield ScenarioView(nodes, heard, projection, lambda: UNIX_EPOCH_TICKS, dialogs=dialogs), heard


def begun() -> list[Fact]:
    """A carried run whose tasks all are under way."""
    tasks = [TaskAssigned(2.0, step, f"t{step}", 1, f"arm{step}", f"e{step}", "work") for step in STEPS]
    return [RunCreated(1.0, "run1", TEXT), RunCarried(1.0, (300, 301), "00"), *tasks]


def lost(step: str) -> TaskOver:
    """Nobody knows the end of a task."""
    return TaskOver(3.0, step, 1, TaskOutcome.UNKNOWN, Then.ASK, "the robot was away")


def once(steps: Sequence[str]) -> tuple[dict[str, int], dict[str, int]]:
    """Each of these asked about once."""
    return dict.fromkeys(steps, 1), {f"question.run1.{step}": 1 for step in steps}


async def test_a_further_question_of_a_carried_run_does_not_tell_the_others_again() -> None:
    async with view_of_a_fleet() as (view, heard):
        for fact in begun():
            view.show(RunChanged("run1", fact))
        for number, step in enumerate(STEPS):
            view.show(RunChanged("run1", lost(step)))
            assert heard.all() == once(STEPS[: number + 1])


async def test_all_questions_of_a_carried_run_are_told_once_when_a_server_starts() -> None:
    async with view_of_a_fleet() as (view, heard):
        view.restored([RunRecord.of("run1", [*begun(), *map(lost, STEPS[:2])])], [])
        assert heard.all() == once(())
        view.show_questions()
        assert heard.all() == once(STEPS[:2])


async def test_the_bridges_of_a_carried_run_are_shown_and_keep_their_names() -> None:
    async with view_of_a_fleet() as (view, heard):

        def shown() -> list[Any]:
            heard.all()
            names = ("Bridges", "BridgeStates", "Tokens", "BridgeMessages")
            return [heard.value_of(f"Fleet.Scenarios.Runs.run1.{name}") for name in names]

        for fact in begun():
            view.show(RunChanged("run1", fact))
        assert shown() == [["cell", "yard"], ["", ""], [False, False], ["", ""]]
        told = {300: BridgeTold("answers", True, ""), 301: BridgeTold("away", False, "it is not heard")}
        view.show(BridgesFollowed("run1", told))
        assert shown() == [["cell", "yard"], ["answers", "away"], [True, False], ["", "it is not heard"]]
        view.show(RunChanged("run1", RunAdopted(2.0, 301, 300, (), "anna")))
        assert shown() == [["cell"], ["answers"], [True], [""]]
        view.show(RunChanged("run1", RunEnded(3.0, RunOutcome.DONE, "")))
        assert shown() == [["cell"], [""], [False], [""]]
