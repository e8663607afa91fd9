"""A robot is driven by hand through a server: leases, who may, and what ends them."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR, connected, until
from tests.integration.teleoperation.served import (
    DEADMAN_MS,
    METHODS,
    OBJECT,
    WAVE,
    Floor,
    Operator,
    Refused,
    call,
    fleet,
    floor,
    ua,
    until_value,
    value,
)
from ua_fleet.client import ClientIdentity, FleetClient, issue_session_key, revoke_session_key
from ua_fleet.endpoint.audit.log import LOG_FILE
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.server import asked_actions

OTHER = ("otto", "operate-2")


def users(made: Floor) -> UserStore:
    return UserStore(made.running.folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))


def audited(made: Floor, event: str) -> list[dict[str, Any]]:
    lines = (made.running.folder / "state" / LOG_FILE).read_text().splitlines()
    return [record for record in map(json.loads, lines) if record["event"] == event]


@pytest.fixture
async def made(tmp_path: Path, udp_url: str, tcp_port: int) -> Any:
    async with floor(tmp_path, fleet(udp_url, tcp_port)) as found:
        yield found


async def test_acquired_driven_and_released(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.watch()
        assert await oscar.acquire() == ""
        assert await value(client, "Holder") == "oscar"
        assert await value(client, "HeldSince") is not None
        began = time.monotonic()
        await oscar.drive_for(1.2, 0.4, -0.2)
        lasted_s = time.monotonic() - began
        assert made.carrier.written[-1] == pytest.approx((0.4, -0.2))
        assert len(oscar.counters) > lasted_s / 0.2, "the counter was not seen each 50 ms"
        await until_value(client, "LastNumber", oscar.number)
        assert await value(client, "Output") == pytest.approx([0.4, -0.2])
        await oscar.release()
        await until_value(client, "State", 0)
        assert made.carrier.written[-1] == (0.0, 0.0)
        assert await value(client, "LastEnd") == "oscar: released"
        assert (await value(client, "Lease"), await value(client, "Holder")) == (0, "")
        assert [await value(client, f"Drops.{cause}") for cause in ("lease", "number", "echo", "setpoint")] == [0] * 4
        with pytest.raises(Refused) as refused:
            await oscar.drive(0.1, 0.0)
        assert str(refused.value) == f"BadInvalidState: lease {oscar.lease} of carrier is over (oscar: released)"
    (record,) = audited(made, "teleoperation")
    assert (record["user"], record["robot"], record["ended"]) == ("oscar", "carrier", "oscar: released")
    assert record["setpoints"] == oscar.number - 1
    methods = [each["method"] for each in audited(made, "call")]
    assert f"ns=3;i={METHODS['Drive']}" not in methods
    assert methods.count(f"ns=3;i={METHODS['Acquire']}") == 1


async def test_what_the_robot_is_like_stands_below_it(made: Floor) -> None:
    async with made.running.client(OBSERVER) as client:
        robot = client.get_node("ns=2;s=Robots.carrier")
        found = await robot.get_child("3:Teleoperation")
        assert found.nodeid.to_string() == OBJECT
        assert await value(client, "Axes") == ["linear", "angular"]
        assert await value(client, "Speed") == [0.5, 1.0]
        assert await value(client, "Deceleration") == [2.0, 4.0]
        assert (await value(client, "DeadmanMs"), await value(client, "RobotTimeoutMs")) == (3000, 10_000)


async def test_observers_see_it_and_may_do_nothing(made: Floor) -> None:
    async with made.running.client(OBSERVER) as client:
        for number in METHODS.values():
            node = client.get_node(ua.NodeId(number, 3))
            told: Any = await node.read_attribute(ua.AttributeIds.UserExecutable)
            assert told.Value.Value is False
        with pytest.raises(Refused, match="BadUserAccessDenied"):
            await Operator(client).acquire()
        with pytest.raises(Refused, match="BadUserAccessDenied"):
            await Operator(client).drive(0.1, 0.1)
        assert await value(client, "Holder") == ""


async def test_two_operators_contend_and_an_engineer_takes_over(made: Floor) -> None:
    users(made).add(*OTHER, Role.OPERATOR)
    running = made.running
    async with running.client() as one, running.client(OTHER) as two, running.client(ENGINEER) as three:
        oscar, otto, erna = Operator(one), Operator(two), Operator(three)
        for operator in (oscar, otto, erna):
            await operator.watch()
        await oscar.acquire()
        with pytest.raises(Refused) as refused:
            await otto.acquire()
        assert refused.value.name == "BadResourceUnavailable"
        assert "carrier is driven by oscar" in refused.value.reason
        with pytest.raises(Refused, match="BadUserAccessDenied: only engineers"):
            await otto.acquire(take_over=True)
        await oscar.drive_for(0.5, 0.4, 0.0)
        assert await erna.acquire(take_over=True) == "oscar"
        assert await value(one, "Holder") == "erna"
        for attempt in (oscar.drive(0.4, 0.0), oscar.renew()):
            with pytest.raises(Refused) as refused:
                await attempt
            assert refused.value.name == "BadResourceUnavailable"
            assert refused.value.reason.endswith("is over (oscar: taken over by erna)")
        await erna.drive_for(1.0, -0.3, 0.0)
        assert made.carrier.written[-1][0] == pytest.approx(-0.3)
    ended = [record["ended"] for record in audited(made, "teleoperation")]
    assert ended == ["oscar: taken over by erna", "erna: the session or its connection has ended"]


async def test_a_stolen_lease_moves_nothing_and_is_counted(made: Floor) -> None:
    users(made).add(*OTHER, Role.OPERATOR)
    async with made.running.client() as one, made.running.client(OTHER) as two:
        oscar, otto = Operator(one), Operator(two)
        await otto.watch()
        await oscar.acquire()
        otto.lease = oscar.lease
        for attempt in (otto.drive(0.5, 0.0), otto.renew(), otto.release()):
            with pytest.raises(Refused, match=f"BadUserAccessDenied: lease {oscar.lease} of carrier is another"):
                await attempt
        assert await until_value(two, "Refused", 3) == 3
        assert await value(one, "Holder") == "oscar"
        assert set(made.carrier.written) <= {(0.0, 0.0)}
        otto.lease = oscar.lease + 1
        with pytest.raises(Refused, match="BadInvalidState: this session has no lease"):
            await otto.drive(0.5, 0.0)
    stolen = [one for one in audited(made, "call") if one["status"] == "BadUserAccessDenied"]
    assert {record["user"] for record in stolen} == {"otto"}


async def held_by_nobody(client: Any) -> str:
    """Wait for the end of the lease; why it has ended. By silence it would, too, and would say so."""
    await until_value(client, "Lease", 0)
    return str(await value(client, "LastEnd"))


async def test_a_connection_that_is_lost_releases_at_once(made: Floor) -> None:
    """Its session lives on, and the lease would for five seconds."""
    running = made.running
    cut: Any
    async with running.client(OBSERVER) as onlooker, connected(running.url, running.folder, OPERATOR) as cut:
        await Operator(cut).acquire()
        assert await value(onlooker, "Holder") == "oscar"
        cut.uaclient.protocol.transport.abort()
        assert await held_by_nobody(onlooker) == "oscar: the session or its connection has ended"


async def test_a_session_that_is_closed_releases(made: Floor) -> None:
    async with made.running.client(OBSERVER) as onlooker:
        async with made.running.client() as client:
            await Operator(client).acquire()
        assert await held_by_nobody(onlooker) == "oscar: the session or its connection has ended"


async def test_who_loses_the_role_loses_the_robot(made: Floor) -> None:
    async with made.running.client(OBSERVER) as onlooker, made.running.client() as client:
        oscar = Operator(client)
        await oscar.acquire()
        users(made).add(*OPERATOR, Role.OBSERVER, replace_existing=True)
        assert await held_by_nobody(onlooker) == "oscar: oscar may not drive any more"
        with pytest.raises(Refused, match="BadUserAccessDenied"):
            await oscar.drive(0.1, 0.0)


async def test_who_is_removed_loses_the_robot(made: Floor) -> None:
    users(made).add(*OTHER, Role.OPERATOR)
    async with made.running.client(OBSERVER) as onlooker, made.running.client(OTHER) as client:
        await Operator(client).acquire()
        users(made).remove(OTHER[0])
        assert await held_by_nobody(onlooker) == "otto: the session or its connection has ended"


async def test_whose_session_key_is_revoked_loses_the_robot(made: Floor) -> None:
    running, identity = made.running, ClientIdentity(made.running.folder / "identity")
    async with (
        running.client(OBSERVER) as onlooker,
        FleetClient.connect(running.url, user=OPERATOR[0], password=OPERATOR[1], identity=identity) as with_password,
    ):
        issued = await issue_session_key(with_password, "tablet")
        async with running.client((OPERATOR[0], issued.key)) as client:
            await Operator(client).acquire()
            await revoke_session_key(with_password, issued.id)
            assert await held_by_nobody(onlooker) == "oscar: the session or its connection has ended"


async def test_who_has_gone_before_the_bridge_answers_gets_nothing(
    made: Floor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(asked_actions, "ANSWER_S", 15.0)  # until the bridge is there again
    await made.end_bridge()
    async with made.running.client(OBSERVER) as onlooker:
        async with connected(made.running.url, made.running.folder, OPERATOR) as client:
            asking = asyncio.ensure_future(Operator(client).acquire())
            await value(client, "Axes")  # it was asked for before that
            assert client.uaclient.protocol is not None
            assert client.uaclient.protocol.transport is not None
            client.uaclient.protocol.transport.abort()
            await asyncio.wait([asking])
            asking.exception()
        await made.begin_bridge()
        why = ("the session or its connection has ended", "who asked for it has gone")  # before or after a Call's time
        assert await until_value(onlooker, "LastEnd", bool) in [f"oscar: {one}" for one in why]
    assert audited(made, "teleoperation") == []


async def test_calls_that_wait_are_bounded(made: Floor) -> None:
    await made.end_bridge()
    async with made.running.client() as client:
        attempts = [Operator(client).acquire() for _ in range(18)]
        answers = await asyncio.gather(*attempts, return_exceptions=True)
        refused = [one for one in answers if isinstance(one, ua.uaerrors.BadTooManyOperations)]
        assert len(refused) == 2
        assert {one.name for one in answers if isinstance(one, Refused)} <= {"BadTimeout", "BadNoCommunication"}


async def test_a_robot_at_a_skill_is_not_given_out_and_one_that_is_driven_takes_none(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await client.get_node(WAVE).call_method("0:Start", ua.Variant(1.5, ua.VariantType.Double))
        with pytest.raises(Refused) as refused:
            await oscar.acquire()
        assert refused.value.name == "BadInvalidState"
        assert "it is at wave" in refused.value.reason
        state = client.get_node("ns=2;s=Robots.carrier.State")
        await until(state.read_value, lambda found: found == 1)
        await oscar.acquire()
        await until(state.read_value, lambda found: found == 2)
        with pytest.raises(ua.uaerrors.BadTooManyOperations):
            await client.get_node(WAVE).call_method("0:Start", ua.Variant(0.1, ua.VariantType.Double))
        user, password = OBSERVER
        identity = ClientIdentity(made.running.folder / "identity")
        async with FleetClient.connect(
            made.running.url, user=user, password=password, identity=identity
        ) as fleet_client:

            async def tasks() -> list[str]:
                return [one.task for one in await fleet_client.summaries()]

            await until(tasks, lambda found: found == ["driven by hand by oscar"])
        await oscar.release()
        await until(state.read_value, lambda found: found == 1)
        await client.get_node(WAVE).call_method("0:Start", ua.Variant(0.1, ua.VariantType.Double))


async def test_what_is_late_repeated_or_no_setpoint_is_dropped_by_the_bridge_and_shown(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.watch()
        await oscar.acquire()
        await oscar.drive_for(0.5, 0.2, 0.0)
        old = oscar.echo
        await oscar.send(oscar.number, oscar.echo, 0.5, 0.0)
        assert await until_value(client, "Drops.number", 1) == 1
        until_at = asyncio.get_running_loop().time() + DEADMAN_MS / 1000 + 0.3
        while asyncio.get_running_loop().time() < until_at:
            await oscar.drive(0.2, 0.0)
            await asyncio.sleep(0.02)
        oscar.number += 1
        await oscar.send(oscar.number, old, 0.5, 0.0)
        assert await until_value(client, "Drops.echo", bool)
        await oscar.drive(0.2, 0.0)
        assert await value(client, "State") == 1
        for values in ((0.1,), (float("nan"), 0.0)):
            with pytest.raises(Refused, match="BadInvalidArgument"):
                await oscar.drive(*values)
            assert await until_value(client, "Lease", 0) == 0
            assert "a setpoint with a value that is no number" in await value(client, "LastEnd")
            await oscar.acquire()
        assert await value(client, "Drops.setpoint") == 2


async def test_setpoints_that_cease_end_the_lease(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.watch()
        await oscar.acquire()
        await oscar.drive_for(0.5, 0.2, 0.0)
        assert await until_value(client, "LastEnd", bool) == "oscar: no setpoint was fresh for 3000 ms"
        with pytest.raises(Refused, match=r"BadInvalidState.*no setpoint was fresh"):
            await oscar.renew()
    (record,) = audited(made, "teleoperation")
    assert record["ended"] == "oscar: no setpoint was fresh for 3000 ms"


async def test_renew_keeps_a_lease_without_setpoints(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.acquire()
        began = time.monotonic()
        while time.monotonic() - began < 6:
            await asyncio.sleep(1)
            await oscar.renew()
        assert await value(client, "Holder") == "oscar"
    assert f"ns=3;i={METHODS['Renew']}" not in [each["method"] for each in audited(made, "call")]


async def test_a_bridge_that_does_not_answer_holds_up_nothing_else(made: Floor) -> None:
    await made.end_bridge()
    async with made.running.client() as client:
        asking = asyncio.ensure_future(Operator(client).acquire())
        await value(client, "Axes")
        assert not asking.done()
        with pytest.raises(Refused, match=r"BadTimeout|BadNoCommunication"):
            await asking
        await until_value(client, "State", "BadNoCommunication")
        with pytest.raises(Refused, match="BadNoCommunication: the bridge of carrier is silent"):
            await Operator(client).acquire()
        await made.begin_bridge()
        await until_value(client, "State", 0)
        assert await Operator(client).acquire() == ""


async def test_a_bridge_that_ends_takes_its_leases_along(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.acquire()
        await made.end_bridge()
        await made.begin_bridge()

        async def refused() -> str:
            try:
                await oscar.drive(0.1, 0.0)
            except Refused as error:
                return str(error.name)
            return ""

        await until(refused, lambda name: name == "BadInvalidState")
        assert not [each for each in made.carrier.written if each != (0.0, 0.0)]
        first = oscar.lease
        await until_value(client, "State", 0)
        await oscar.acquire()
        assert oscar.lease > first


async def test_who_asks_for_what_is_no_robot_is_told_so(made: Floor) -> None:
    async with made.running.client() as client:
        with pytest.raises(Refused, match=r"BadNodeIdInvalid|BadMethodInvalid|BadNotExecutable"):
            await call(client, "Acquire", ua.Variant(False), node="ns=3;i=1032")
