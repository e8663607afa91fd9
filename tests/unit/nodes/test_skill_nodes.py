"""Skills as clients browse them."""

from __future__ import annotations

from typing import Any

from tests.unit.nodes.model_server import children, fleet_built
from tests.unit.nodes.skilled import ROBOTS


async def value(server: Any, node_id: str) -> Any:
    return await server.get_node(node_id).read_value()


async def test_a_robots_skills_stand_below_it_with_their_numeric_ids() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        skills = await children(server, "ns=2;s=Robots.arm.Skills")
        assert skills == {"2:turn": "ns=2;i=1500", "2:blink": "ns=2;i=1501"}
        assert (await server.get_node("ns=2;i=1500").read_type_definition()).to_string() == "ns=3;i=1010"
        members = await children(server, "ns=2;i=1500")
        assert members["0:Start"] == "ns=2;s=1500.Start"
        assert members["0:Halt"] == "ns=3;i=71004"
        assert {"0:CurrentState", "0:LastTransition", "3:Progress", "3:LastResult", "3:Limits"} <= members.keys()
        assert (await children(server, "ns=2;s=Robots.arm"))["2:SkillStatus"] == "ns=2;i=1502"


async def test_the_arguments_of_start_are_the_skills_own() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        arguments = await value(server, "ns=2;s=1500.Start.InputArguments")
        assert [(one.Name, one.DataType.Identifier, one.ValueRank) for one in arguments] == [
            ("angle", 11, -1),
            ("times", 6, -1),
            ("how", 12, -1),
        ]
        assert arguments[0].Description.Text == "Where to; -90 to 90 deg; usually 20"
        assert arguments[1].Description.Text == "1 to 5"
        (returned,) = await value(server, "ns=2;s=1500.Start.OutputArguments")
        assert (returned.Name, returned.DataType.Identifier) == ("ExecutionId", 12)
        assert "0:InputArguments" not in await children(server, "ns=2;s=1501.Start")


async def test_each_argument_is_described_with_its_default_range_and_unit() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        start = server.get_node("ns=2;s=1500.Start")
        described = {(await node.read_browse_name()).Name: node for node in await start.get_referenced_nodes(129)}
        assert list(described) == ["angle", "times", "how"]
        assert await described["angle"].read_value() == 20.0
        assert isinstance(await described["angle"].read_value(), float)
        assert await described["times"].read_value() is None
        assert (await value(server, "ns=2;s=1500.Argument.angle.EURange")).High == 90
        assert (await value(server, "ns=2;s=1500.Argument.angle.EngineeringUnits")).DisplayName.Text == "deg"


async def test_what_a_skill_needs_brings_and_takes() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        assert await value(server, "ns=2;s=1500.Capacities") == ["grab"]
        assert await value(server, "ns=2;s=1500.Timeout") == 30_000
        assert await value(server, "ns=2;s=1501.Immediate") is True
        assert await value(server, "ns=2;s=1500.Limits.RequestsAtOnce") == 2
        assert await value(server, "ns=2;s=1500.Limits.LeastInterval") == 2000
        assert await value(server, "ns=2;s=1500.Limits.VisibleTo") is None
        assert await value(server, "ns=2;s=1501.Limits.VisibleTo") == [7]
        results = await children(server, "ns=2;s=1500.LastResult")
        assert results["2:reached"] == "ns=2;s=1500.Result.reached"
        assert (await server.get_node("ns=2;s=1500.Result.count").read_data_type()).Identifier == 5


async def test_a_skill_that_the_server_must_not_ask_for_cannot_be_started() -> None:
    async with fleet_built(ROBOTS) as (server, _):
        executable = [
            (await server.get_node(f"ns=2;s={number}.Start").read_attribute(21)).Value.Value for number in (1500, 1501)
        ]
        assert executable == [True, False]


async def test_many_skills_are_grouped() -> None:
    skills = {f"s{number}": {"id": 2000 + number} for number in range(101)}
    robots = {"arm": {"bridge": "mobile", "skill_status_id": 1502, "skills": skills}}
    async with fleet_built(robots) as (server, _):
        assert set(await children(server, "ns=2;s=Robots.arm.Skills")) == {"2:G00", "2:G01"}
