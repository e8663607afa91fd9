"""Skills called by their Methods, as any OPC UA client does."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import ENDLESS_WORK, FAILING_WORK, QUICK, REFUSED_WORK, WORK
from tests.integration.server_model.harness import OBSERVER, reader, ua, until
from tests.integration.skills.conftest import Hall
from ua_fleet.values import StatusCode

START = f"ns=2;s={WORK}.Start"


class Events:
    """A subscription to the Server object."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.seen.append(event)

    def of(self, execution_id: str) -> list[str]:
        return [event.Transition.Text for event in self.seen if event.ExecutionId == execution_id]


async def subscribed(client: Client) -> Events:
    events = Events()
    subscription: Any = await client.create_subscription(50, events)
    await subscription.subscribe_events(ua.ObjectIds.Server, client.get_node("ns=3;i=1011"))
    return events


async def call(client: Client, skill: int, *arguments: Any, method: str = "Start") -> Any:
    """Call a Method of a skill, with plain values; the CallMethodResult."""
    shared = {"Suspend": 71002, "Resume": 71003, "Halt": 71004, "Reset": 71005}
    method_id = f"ns=2;s={skill}.Start" if method == "Start" else f"ns=3;i={shared[method]}"
    request = ua.CallMethodRequest(
        ua.NodeId.from_string(f"ns=2;i={skill}"),
        ua.NodeId.from_string(method_id),
        [argument if isinstance(argument, ua.Variant) else ua.Variant(argument) for argument in arguments],
    )
    (result,) = await client.uaclient.call([request])
    return result


async def started(client: Client, skill: int, *arguments: Any) -> str:
    """Start a skill, as soon as the bridge has announced it."""
    result = await until(lambda: call(client, skill, *arguments), lambda result: result.StatusCode.is_good())
    return str(result.OutputArguments[0].Value)


async def told(hall: Hall, *works: str) -> None:
    """Wait until the machine was told this, and nothing else: its skill shows Running before."""

    async def read() -> list[str]:
        return [job.work for job in hall.machine.told()]

    await until(read, lambda found: found == list(works))


async def test_a_skill_is_started_followed_and_brings_its_results(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        events = await subscribed(client)
        execution = await started(client, WORK, "weld", 0.5)
        assert len(bytes.fromhex(execution)) == 16
        state = reader(client, f"ns=2;s={WORK}.CurrentState")
        assert (await state()).Value.Value.Text == "Running"
        await until(state, lambda value: value.Value.Value.Text == "Ready")
        assert await client.get_node(f"ns=2;s={WORK}.Result.done").read_value() == "weld"
        assert await client.get_node(f"ns=2;s={WORK}.Result.seconds").read_value() == 0.5
        assert await client.get_node(f"ns=2;s={WORK}.LastResult.ExecutionId").read_value() == execution
        assert await client.get_node(f"ns=2;s={WORK}.Progress").read_value() == 1.0

        async def transitions() -> list[str]:
            return events.of(execution)

        await until(transitions, lambda seen: seen == ["ReadyToRunning", "RunningToReady"])
        last = events.seen[-1]
        assert last.SourceNode.to_string() == f"ns=2;i={WORK}"
        assert (last.Robot, last.Skill, last.IsOver) == ("machine", "work", True)
        assert (last.ResultNames, [variant.Value for variant in last.Results]) == (["done", "seconds"], ["weld", 0.5])
        assert (last.FromState.Text, last.ToState.Text) == ("Running", "Ready")
    assert [job.work for job in hall.machine.told()] == ["weld"]


async def test_robots_are_busy_while_they_do_something(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        state = reader(client, "ns=2;s=Robots.machine.State")
        await started(client, WORK, "weld", 3.0)
        await until(state, lambda value: value.Value.Value == 2)
        await until(state, lambda value: value.Value.Value == 1)


async def test_an_immediate_skill_answers_with_its_results(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        await started(client, QUICK, "measure", 0.1)
        done = reader(client, f"ns=2;s={QUICK}.Result.done")
        await until(done, lambda value: value.Value is not None and value.Value.Value == "measure")
        too_soon = await call(client, QUICK, "measure", 0.1)
        assert too_soon.StatusCode.name == "BadServerTooBusy"


async def test_what_fails_is_halted_with_the_reason_and_can_be_reset(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        events = await subscribed(client)
        execution = await started(client, WORK, FAILING_WORK, 0.1)
        state = reader(client, f"ns=2;s={WORK}.CurrentState")
        await until(state, lambda value: value.Value.Value.Text == "Halted")
        assert await client.get_node(f"ns=2;s={WORK}.Message").read_value() == "the machine broke"
        failed = await client.get_node(f"ns=2;s={WORK}.LastStatus").read_value()
        assert failed.is_bad()
        assert (await call(client, WORK, method="Reset")).StatusCode.is_good()
        await until(state, lambda value: value.Value.Value.Text == "Ready")
        assert (await call(client, WORK, method="Reset")).StatusCode.name == "BadInvalidState"

        async def transitions() -> list[str]:
            return events.of(execution)

        await until(transitions, lambda seen: len(seen) == 3)
        assert events.of(execution) == ["ReadyToRunning", "RunningToHalted", "HaltedToReady"]


async def test_what_the_robot_refuses_is_told(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        await started(client, WORK, REFUSED_WORK, 0.0)
        message = reader(client, f"ns=2;s={WORK}.Message")
        await until(message, lambda value: value.Value is not None and "does not do that" in str(value.Value.Value))
        assert (await reader(client, f"ns=2;s={WORK}.CurrentState")()).Value.Value.Text == "Ready"


@pytest.mark.parametrize(
    ("arguments", "status", "results"),
    [
        (("weld",), "BadArgumentsMissing", []),
        (("weld", 1.0, 2.0), "BadTooManyArguments", []),
        (("weld", 11.0), "BadInvalidArgument", ["Good", "BadOutOfRange"]),
        (("weld", float("nan")), "BadInvalidArgument", ["Good", "BadOutOfRange"]),
        (("weld", 1), "BadInvalidArgument", ["Good", "BadTypeMismatch"]),
        ((1.0, 1.0), "BadInvalidArgument", ["BadTypeMismatch", "Good"]),
    ],
)
async def test_arguments_are_exactly_those_declared(
    hall: Hall, arguments: tuple[Any, ...], status: str, results: list[str]
) -> None:
    async with hall.server() as running, running.client() as client:
        result = await call(client, WORK, *arguments)
        assert result.StatusCode.name == status
        assert [one.name for one in result.InputArgumentResults] == results


async def test_only_operators_may_start_and_a_silent_robot_is_told(hall: Hall) -> None:
    async with hall.server() as running:
        async with running.client(OBSERVER) as client:
            assert (await call(client, WORK, "weld", 0.0)).StatusCode.name == "BadUserAccessDenied"
        async with running.client() as client:
            assert (await call(client, WORK, "weld", 0.0)).StatusCode.name == "BadNoCommunication"
    assert hall.machine.told() == []


async def test_no_more_run_at_once_than_declared(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        for _ in range(2):
            await started(client, WORK, ENDLESS_WORK, 0.0)
        assert (await call(client, WORK, "weld", 0.0)).StatusCode.name == "BadTooManyOperations"
        await told(hall, ENDLESS_WORK, ENDLESS_WORK)
    assert len(hall.machine.told()) == 2


async def test_a_skill_is_halted_where_the_robot_can_stop(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        events = await subscribed(client)
        assert (await call(client, WORK, method="Halt")).StatusCode.name == "BadInvalidState"
        execution = await started(client, WORK, ENDLESS_WORK, 0.0)
        state = reader(client, f"ns=2;s={WORK}.CurrentState")
        halted = await until(lambda: call(client, WORK, method="Halt"), lambda result: result.StatusCode.is_good())
        assert halted.OutputArguments == []
        await until(state, lambda value: value.Value.Value.Text == "Halted")
        assert await client.get_node(f"ns=2;s={WORK}.Message").read_value() == "halted"

        async def transitions() -> list[str]:
            return events.of(execution)

        await until(transitions, lambda seen: seen == ["ReadyToRunning", "RunningToHalted"])
        await started(client, WORK, "weld", 3.0)
        assert (await call(client, WORK, method="Halt")).StatusCode.is_good()
        await until(state, lambda value: value.Value.Value.Text == "Ready")
    assert [job.work for job in hall.machine.told()] == [ENDLESS_WORK, "weld"]


async def test_a_skill_is_suspended_goes_on_and_is_halted_while_its_robot_stands(hall: Hall) -> None:
    bridge = hall.bridge()
    async with hall.server() as running, running.client() as client:
        events = await subscribed(client)
        for method in ("Suspend", "Resume"):
            assert (await call(client, WORK, method=method)).StatusCode.name == "BadInvalidState"
        execution = await started(client, WORK, ENDLESS_WORK, 0.0)
        state = reader(client, f"ns=2;s={WORK}.CurrentState")

        async def shows(text: str) -> None:
            await until(state, lambda value: value.StatusCode.is_good() and value.Value.Value.Text == text)

        await until(lambda: call(client, WORK, method="Suspend"), lambda result: result.StatusCode.is_good())
        await shows("Suspended")
        assert (await call(client, WORK, method="Suspend")).StatusCode.name == "BadInvalidState"
        assert (await call(client, WORK, method="Resume")).StatusCode.is_good()
        await shows("Running")
        assert (await call(client, WORK, method="Suspend")).StatusCode.is_good()
        await shows("Suspended")
        bridge.end(signal.SIGKILL)
        await until(state, lambda value: value.StatusCode.value == StatusCode.BAD_NO_COMMUNICATION)
        hall.bridge()
        await shows("Suspended")
        assert (await call(client, WORK, method="Halt")).StatusCode.is_good()
        await shows("Halted")

        async def transitions() -> list[str]:
            return events.of(execution)

        await until(transitions, lambda seen: seen[-1:] == ["SuspendedToHalted"])
        to_and_fro = ["RunningToSuspended", "SuspendedToRunning", "RunningToSuspended"]
        assert events.of(execution) == ["ReadyToRunning", *to_and_fro, "SuspendedToHalted"]
        await started(client, WORK, "weld", 0.8)
        assert (await call(client, WORK, method="Suspend")).StatusCode.is_good()
        await shows("Ready")
    assert [job.work for job in hall.machine.told()] == [ENDLESS_WORK, "weld"]


async def test_a_killed_bridge_makes_nodes_bad_and_its_return_makes_them_true(hall: Hall) -> None:
    bridge = hall.bridge()
    async with hall.server() as running, running.client() as client:
        state = reader(client, f"ns=2;s={WORK}.CurrentState")
        await started(client, WORK, "weld", 3.0)
        await until(state, lambda value: value.StatusCode.is_good() and value.Value.Value.Text == "Running")
        await told(hall, "weld")
        bridge.end(signal.SIGKILL)
        silent = await until(state, lambda value: value.StatusCode.value == StatusCode.BAD_NO_COMMUNICATION)
        assert silent.Value.Value.Text == "Running"
        assert (await call(client, WORK, "weld", 0.0)).StatusCode.name == "BadNoCommunication"
        hall.bridge()
        await until(state, lambda value: value.StatusCode.is_good() and value.Value.Value.Text == "Ready")
    assert len(hall.machine.told()) == 1


async def test_a_server_that_was_started_anew_shows_the_truth(hall: Hall) -> None:
    hall.bridge()
    async with hall.server() as running, running.client() as client:
        execution = await started(client, WORK, "weld", 1.5)
        await told(hall, "weld")
    async with hall.server() as running, running.client() as client:
        state = reader(client, f"ns=2;s={WORK}.CurrentState")
        await until(state, lambda value: value.Value is not None and value.Value.Value is not None)
        assert await client.get_node(f"ns=2;s={WORK}.ExecutionId").read_value() == execution
        await until(state, lambda value: value.Value.Value.Text == "Ready")
        assert await client.get_node(f"ns=2;s={WORK}.Result.done").read_value() == "weld"
    assert len(hall.machine.told()) == 1
