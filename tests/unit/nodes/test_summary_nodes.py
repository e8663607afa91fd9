"""The nodes of the summaries, with a clock that the test moves."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

from tests.unit.fleet.fleet_of import fleet_config
from tests.unit.nodes.model_server import fleet_built
from ua_fleet.config.nodes import fleet_model
from ua_fleet.counters import Counters
from ua_fleet.fleet import FleetState, ValueChanged
from ua_fleet.fleet.model import RobotState
from ua_fleet.fleet.summaries import SummaryRecord
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.summary_nodes import (
    GROUPS_AT_ONCE,
    MOST_CAPACITIES,
    MOST_TEXT,
    ROBOTS_AT_ONCE,
    SUMMARY_SHAPE,
    SummaryNodes,
)
from ua_fleet.operation.runs.activity import RobotActivities
from ua_fleet.orchestrator import Hold, HoldChanged
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

DOUBLE = int(BuiltinType.DOUBLE)
METADATA = DataSetMetaData("v", (make_field("data", DOUBLE),), ConfigurationVersion(1, 1))


class Summarised:
    """A fleet of so many robots with a value each, and what is written of it."""

    def __init__(self, parts: NodeFactory, count: int) -> None:
        robots = {
            f"r{number}": {"bridge": "mobile", "data": {"v": {"id": 1 + number, "type": "Double"}}}
            for number in range(count)
        }
        self.model = fleet_model(fleet_config(robots))
        self.state = FleetState(self.model, Counters())
        self.activities = RobotActivities()
        self.told: list[ValueChanged] = []
        self.parts = parts
        self.mistakes = Mistakes()
        self.nodes = SummaryNodes(parts, self.state, self.activities, self.told.append, lambda: 77, self.mistakes)

    def hear(self, robot: int, ticks: int) -> None:
        topic = Topic(2, 2, 1 + robot)
        message = DataSetMessage(topic.id, types=(DOUBLE,), values=(0.5,), timestamp=ticks)
        self.state.apply(DataReceived(topic, message, METADATA), ticks)

    def settle(self, now: float) -> int:
        """Poll as the hub does, until nothing is due; the number of turns."""
        turns = 0
        while (due := self.nodes.next_deadline(now)) is not None and due <= now:
            self.nodes.poll(now)
            turns += 1
        return turns

    def summaries(self, number: int) -> list[Any]:
        """What was told last of a group."""
        key = NodeId(2, f"Fleet.Summaries.{number}")
        last = next(change for change in reversed(self.told) if change.key == key)
        return [SUMMARY_SHAPE.decode(Cursor(one.body)) for one in last.value]


@asynccontextmanager
async def summarised(count: int) -> AsyncGenerator[Summarised]:
    async with fleet_built() as (server, nodes):
        parts = NodeFactory(server.iserver.aspace, nodes.ns)
        parts.values = nodes.values
        yield Summarised(parts, count)


async def test_all_robots_are_there_from_the_start() -> None:
    async with summarised(150) as fleet:
        fleet.nodes.build()
        there = [key.identifier for key in fleet.parts.values if "Summaries" in str(key.identifier)]
        assert there == [f"Fleet.Summaries.{number}" for number in (1, 2, 3)]
        held = fleet.parts.values[NodeId(2, "Fleet.Summaries.2")].value
        assert held is not None
        assert held.Value is not None
        assert len(held.Value.Value) == 50


async def test_others_are_told_of_each_robot_that_may_have_changed() -> None:
    async with summarised(2) as fleet:
        heard: list[tuple[str, int]] = []

        def told(summary: SummaryRecord) -> None:
            heard.append((summary.name, summary.state))

        put = fleet.told.append
        nodes = SummaryNodes(fleet.parts, fleet.state, fleet.activities, put, lambda: 77, fleet.mistakes, told)
        nodes.build()
        assert heard == [("r0", RobotState.OFFLINE), ("r1", RobotState.OFFLINE)]
        fleet.hear(1, 5)
        nodes.poll(1.0)
        assert heard[2:] == [("r1", RobotState.IDLE)]


async def test_a_second_of_a_large_fleet_is_many_turns_and_one_write_of_each_group() -> None:
    count = 2 * ROBOTS_AT_ONCE + 150
    async with summarised(count) as fleet:
        fleet.nodes.build()
        fleet.settle(0.0)
        fleet.told.clear()
        for robot in range(count):
            fleet.hear(robot, 5)
        fleet.state.tick(6)
        groups = -(-count // 100)
        turns = fleet.settle(1.0)
        # Some turns to take the robots in, then some to write.
        assert turns == -(-count // ROBOTS_AT_ONCE) + -(-groups // GROUPS_AT_ONCE) - 1
        written = [str(change.key.identifier) for change in fleet.told]
        assert sorted(written) == sorted(f"Fleet.Summaries.{number + 1}" for number in range(groups))
        assert all(change.can_wait and change.source_timestamp == 77 for change in fleet.told)
        assert [one.name for one in fleet.summaries(2)] == [f"r{number}" for number in range(100, 200)]
        assert {(one.quality, one.last_update) for number in range(groups) for one in fleet.summaries(number + 1)} == {
            (0, 5)
        }


async def test_values_alone_write_nothing() -> None:
    async with summarised(3) as fleet:
        fleet.nodes.build()
        fleet.hear(0, 5)
        fleet.state.tick(6)
        fleet.settle(0.0)
        fleet.told.clear()
        for ticks in range(7, 50):
            fleet.hear(0, ticks)
        assert fleet.nodes.next_deadline(5.0) is None
        fleet.settle(5.0)
        assert fleet.told == []


async def test_robots_come_and_go_and_long_texts_are_cut() -> None:
    async with summarised(1) as fleet:
        fleet.nodes.build()
        fleet.settle(0.0)
        lift = fleet_model(fleet_config({"lift": {"bridge": "mobile", "capacities": ["lift"]}})).robots[0]
        fleet.state.add_robot(lift)
        fleet.activities.take(HoldChanged(Hold("lift", "anna", 1.0, "a new tyre"), is_held=True, by="anna"), None)
        skill_status = Topic(2, 2, 99)
        assert fleet.state.set_busy(skill_status, ("x",), 3) == []
        fleet.settle(1.0)
        assert [(one.name, one.held_by, one.held_reason, one.capacities) for one in fleet.summaries(1)] == [
            ("r0", "", "", ()),
            ("lift", "anna", "a new tyre", ("lift",)),
        ]
        robot = fleet.state.robot_status("r0")
        assert robot is not None
        robot.skills = ("x" * 300,)
        many = tuple([f"c{number}" for number in range(MOST_CAPACITIES + 1)])
        fleet.state.add_robot(replace(lift, name="able", capacities=many))
        robot.has_moved()
        fleet.state.remove_robot("lift")
        fleet.settle(2.0)
        first, able = fleet.summaries(1)
        assert first.task == "x" * MOST_TEXT
        assert able.capacities == many[:MOST_CAPACITIES]


async def test_a_text_that_cannot_be_told_costs_its_own_robot_alone() -> None:
    async with summarised(3) as fleet:
        fleet.nodes.build()
        fleet.settle(0.0)
        for name, task in (("r0", "fetch"), ("r1", "half a \udc80"), ("r2", "look")):
            robot = fleet.state.robot_status(name)
            assert robot is not None
            robot.skills = (task,)
            robot.has_moved()
        fleet.settle(1.0)
        assert [(one.name, one.task) for one in fleet.summaries(1)] == [("r0", "fetch"), ("r2", "look")]
        assert fleet.mistakes.count == 1
        robot = fleet.state.robot_status("r1")
        assert robot is not None
        robot.skills = ("a whole",)
        robot.has_moved()
        fleet.settle(2.0)
        assert sorted((one.name, one.task) for one in fleet.summaries(1))[1] == ("r1", "a whole")
