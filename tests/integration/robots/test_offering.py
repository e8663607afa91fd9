"""Skills that OPC UA clients do, through real sessions: asked, taken, done, failed, left alone, and left behind."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from asyncua.client.client import Client
from asyncua.ua.uaerrors import UaStatusCodeError

from tests.integration.robots.conftest import Called, Yard, below, call, invoke, unregister
from tests.integration.server_model.harness import ENGINEER, OPERATOR, reader, ua, until

OFFERS = "Fleet.Offers"
SKILL = """\
description: Asks a person to come
needs: [repair]
arguments:
  what: {type: String, description: What is broken}
  minutes: {type: Double, unit: min, range: [0, 60], default: 5}
results:
  fixed: {type: Boolean}
  cost: {type: Double, unit: EUR}
timeout_s: 20
"""


class Requests:
    """What a client is asked."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.seen.append(event)

    async def state(self, state: str) -> Any:
        """The event of the next request in a state."""

        async def found() -> Any:
            return next((event for event in self.seen if event.State == state), None)

        return await until(found, lambda event: event is not None)


async def subscribed(client: Client) -> Requests:
    requests = Requests()
    subscription: Any = await client.create_subscription(50, requests)
    await subscription.subscribe_events(ua.ObjectIds.Server, client.get_node("ns=3;i=1030"))
    return requests


async def offer(client: Client, definition: str = SKILL) -> Called:
    return await call(client, OFFERS, "OfferSkill", "mechanic", "call_mechanic", definition)


async def skill_node(client: Client) -> Any:
    children = await below(client, "ns=2;s=Robots.mechanic.Skills")
    return next(child.NodeId for child in children if child.BrowseName.Name == "call_mechanic")


async def start(client: Client, what: str = "the belt", minutes: float = 5.0) -> Any:
    node = await skill_node(client)
    request = ua.CallMethodRequest(
        node, ua.NodeId(f"{node.Identifier}.Start", 2), [ua.Variant(what), ua.Variant(minutes)]
    )
    return await invoke(client, request)


async def started(client: Client) -> str:
    result = await start(client)
    result.StatusCode.check()
    return str(result.OutputArguments[0].Value)


async def shown(client: Client, name: str) -> Any:
    node = await skill_node(client)
    return await client.get_node(f"ns=2;s={node.Identifier}.{name}").read_data_value(raise_on_bad_status=False)


async def ended(client: Client, execution: str) -> Any:
    async def status() -> Any:
        return await shown(client, "LastResult.ExecutionId"), await shown(client, "LastStatus")

    _, last = await until(status, lambda both: both[0].Value is not None and both[0].Value.Value == execution)
    return last


async def robot_state(client: Client) -> int:
    return int(await client.get_node("ns=2;s=Robots.mechanic.State").read_value())


async def test_a_person_is_asked_accepts_and_tells_the_results(yard: Yard) -> None:
    async with (
        yard.server() as running,
        running.client(ENGINEER) as person,
        running.client(OPERATOR) as caller,
    ):
        requests = await subscribed(person)
        offered = await offer(person)
        assert (offered.status, offered.message) == (0, "")
        assert await robot_state(caller) == 1
        assert await caller.get_node("ns=2;s=Robots.mechanic.Capacities").read_value() == ["repair"]
        execution = await started(caller)
        asked = await requests.state("asked")
        assert (asked.Robot, asked.Skill, asked.ExecutionId) == ("mechanic", "call_mechanic", execution)
        assert dict(zip(asked.ArgumentNames, [one.Value for one in asked.Arguments], strict=True)) == {
            "what": "the belt",
            "minutes": 5.0,
        }
        ids = reader(person, f"ns=2;s={OFFERS}.ExecutionIds")
        await until(ids, lambda value: value.Value.Value == [execution])
        texts = await person.get_node(f"ns=2;s={OFFERS}.Arguments").read_value()
        assert json.loads(texts[0]) == {"what": "the belt", "minutes": 5.0}
        early = await call(person, OFFERS, "Complete", execution, [], [], "")
        assert (early.status, early.message) == (3, "the result 'fixed' is missing; the result 'cost' is missing")
        assert (
            await call(caller, OFFERS, "Accept", execution)
        ).message == "this session does not offer mechanic.call_mechanic"
        assert (await call(person, OFFERS, "Accept", execution)).status == 0
        assert (await call(person, OFFERS, "Report", execution, 0.5, "half way")).status == 0

        async def progress() -> Any:
            return (await shown(caller, "Progress")).Value.Value, (await shown(caller, "Message")).Value.Value

        await until(progress, lambda seen: seen == (0.5, "half way"))
        assert await robot_state(caller) == 2
        wrong = await call(person, OFFERS, "Complete", execution, ["fixed", "cost"], ["perhaps", "3"], "")
        assert wrong.message == "fixed is 'perhaps'; it has to be true or false"
        done = await call(person, OFFERS, "Complete", execution, ["fixed", "cost"], ["true", "3"], "new bearing")
        assert (done.status, done.message) == (0, "")
        assert (await ended(caller, execution)).Value.Value.is_good()
        node = await skill_node(caller)
        assert await caller.get_node(f"ns=2;s={node.Identifier}.Result.cost").read_value() == 3.0
        await until(ids, lambda value: value.Value.Value == [])
        await requests.state("done")
        assert [event.State for event in requests.seen if event.ExecutionId == execution] == [
            "asked",
            "taken",
            "taken",
            "done",
        ]
        assert (await call(person, OFFERS, "Accept", execution)).message == "it is over: done"


async def test_it_is_an_engineer_who_says_what_a_skill_is_and_operators_who_do_it(yard: Yard) -> None:
    async with yard.server() as running, running.client(ENGINEER) as engineer, running.client(OPERATOR) as person:
        with pytest.raises(UaStatusCodeError, match="BadUserAccessDenied"):
            await offer(person)
        wrong = await offer(engineer, "arguments:\n  what: {type: Strng}\n")
        assert (wrong.status, wrong.outputs[2]) == (2, [2])
        assert (await offer(person, "")).status == 1
        assert (await offer(engineer)).status == 0
        assert (await offer(person)).status == 0
        assert (await offer(person, "")).status == 0
        with pytest.raises(UaStatusCodeError, match="BadUserAccessDenied"):
            await offer(person, SKILL.replace("20", "30"))
        execution = await started(person)
        assert (await call(person, OFFERS, "Accept", execution)).status == 0
        second = await call(engineer, OFFERS, "Accept", execution)
        assert (second.status, second.message) == (3, "oscar has taken it before")
        assert (await call(person, OFFERS, "Fail", execution, "no spare part")).status == 0
        last = await ended(person, execution)
        assert last.Value.Value.is_bad()
        assert (await shown(person, "Message")).Value.Value == "no spare part"
        assert (await unregister(engineer, "mechanic")).status == 0


async def test_a_skill_that_nobody_offers_now_is_offline(yard: Yard) -> None:
    async with yard.server() as running, running.client(OPERATOR) as caller:
        async with running.client(ENGINEER) as person:
            await offer(person)
            assert (await call(person, OFFERS, "WithdrawSkill", "mechanic", "call_mechanic")).status == 0
            await until(lambda: robot_state(caller), lambda state: state == 0)
            assert (await start(caller)).StatusCode.name == "BadNoCommunication"
            assert (await offer(person, "")).status == 0
            await until(lambda: robot_state(caller), lambda state: state == 1)
            untaken = await started(caller)
        assert (await ended(caller, untaken)).Value.Value.is_bad()
        await until(lambda: robot_state(caller), lambda state: state == 0)
        assert (await shown(caller, "CurrentState")).StatusCode.name == "BadNoCommunication"


async def lose(client: Client) -> None:
    """Cut the connection, as a crash does."""
    client.disconnect_socket()
    await asyncio.sleep(0.2)


async def test_what_a_lost_client_had_taken_is_unknown_until_it_is_back(yard: Yard) -> None:
    async with yard.server() as running, running.client(OPERATOR) as caller, running.client(ENGINEER) as person:
        await subscribed(person)
        await offer(person)
        execution = await started(caller)
        assert (await call(person, OFFERS, "Accept", execution)).status == 0
        await lose(person)
        last = await ended(caller, execution)
        assert last.Value.Value.value == 0x4000_0000
        async with running.client(ENGINEER) as back:
            await offer(back, "")
            done = await call(back, OFFERS, "Complete", execution, ["fixed", "cost"], ["true", "1"], "")
            assert (done.status, done.message) == (0, "")

            async def status() -> Any:
                return (await shown(caller, "LastStatus")).Value.Value.value

            await until(status, lambda code: code == 0)


async def test_time_runs_out_for_what_nobody_takes_and_what_nobody_ends(yard: Yard) -> None:
    quick = SKILL.replace("timeout_s: 20", "timeout_s: 2\nlimits: {requests_at_once: 2}")
    async with yard.server() as running, running.client(ENGINEER) as person:
        await offer(person, quick)
        untaken, taken = await started(person), await started(person)
        assert (await start(person)).StatusCode.name == "BadTooManyOperations"
        assert (await call(person, OFFERS, "Accept", taken)).status == 0
        assert (await ended(person, taken)).Value.Value.value == 0x4000_0000
        assert "did not say how it ended within 2 s" in (await shown(person, "Message")).Value.Value
        late = await call(person, OFFERS, "Accept", untaken)
        assert late.message == "it is over: timed_out"


async def test_halting_what_is_taken_tells_the_client(yard: Yard) -> None:
    async with yard.server() as running, running.client(ENGINEER) as person:
        requests = await subscribed(person)
        await offer(person)
        execution = await started(person)
        assert (await call(person, OFFERS, "Accept", execution)).status == 0
        node = await skill_node(person)
        halted = await invoke(person, ua.CallMethodRequest(node, ua.NodeId(71004, 3), []))
        assert halted.StatusCode.is_good()
        await requests.state("halt")
        assert (await call(person, OFFERS, "Fail", execution, "stopped")).status == 0
        assert (await ended(person, execution)).Value.Value.value == 0x802C_0000


async def run(client: Client) -> str:
    task = "{task: repair, robot: mechanic, skill: call_mechanic, arguments: {what: belt}}"
    steps = f"version: 1\nname: help\nsteps:\n  - {task}\n"
    ran = await call(client, "Fleet.Scenarios", "Run", steps, [], [])
    assert ran.status == 0, ran.message
    return str(ran.outputs[0])


async def run_state(client: Client, run_id: str) -> Any:
    value = await client.get_node(f"ns=2;s=Fleet.Scenarios.Runs.{run_id}.State").read_data_value(
        raise_on_bad_status=False
    )
    return value.Value.Value if value.Value is not None else None


async def open_execution(client: Client) -> str:
    ids = reader(client, f"ns=2;s={OFFERS}.ExecutionIds")
    value = await until(ids, lambda value: value.Value is not None and len(value.Value.Value or []) == 1)
    return str(value.Value.Value[0])


async def test_a_scenario_calls_it_like_any_robot_s_skill(yard: Yard) -> None:
    async with yard.server() as running, running.client(ENGINEER) as person:
        await offer(person)
        run_id = await run(person)
        execution = await open_execution(person)
        assert (await call(person, OFFERS, "Accept", execution)).status == 0
        assert (await call(person, OFFERS, "Complete", execution, ["fixed", "cost"], ["true", "0"], "")).status == 0
        await until(lambda: run_state(person, run_id), lambda state: state == "done")


async def test_a_restart_ends_what_was_under_way_and_hangs_nothing(yard: Yard) -> None:
    async with yard.server() as running, running.client(ENGINEER) as person:
        await offer(person)
        run_id = await run(person)
        execution = await open_execution(person)
        assert (await call(person, OFFERS, "Accept", execution)).status == 0
        await asyncio.sleep(0.1)
    async with yard.server() as running, running.client(ENGINEER) as person:
        states = reader(person, f"ns=2;s=Fleet.Scenarios.Runs.{run_id}.States")
        await until(states, lambda value: value.Value is not None and value.Value.Value == ["asked"])
        assert (await offer(person, "")).status == 0
        assert (await ended(person, execution)).Value.Value.value == 0x4000_0000
        again = await started(person)
        assert (await call(person, OFFERS, "Accept", again)).status == 0
        assert (await call(person, OFFERS, "Complete", again, ["fixed", "cost"], ["false", "9"], "")).status == 0
        assert (await ended(person, again)).Value.Value.is_good()
