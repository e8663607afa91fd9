"""Somebody who may operate wants a robot to move as nobody may have it move: by odd setpoints, and by very many."""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path
from typing import Any, Final

import pytest

from tests.integration.server_model.harness import ENGINEER
from tests.integration.teleoperation.conftest import SPEED
from tests.integration.teleoperation.served import METHODS, OBJECT, Floor, Operator, Refused, call, fleet, floor, ua
from tests.integration.teleoperation.served import until_value as shown
from ua_fleet.endpoint.audit.log import LOG_FILE

IN_A_REQUEST: Final = 100
"""As many as a server takes."""
FLOODS: Final = 10


def uint32(number: int) -> Any:
    return ua.Variant(number, ua.VariantType.UInt32)


def doubles(*values: float) -> Any:
    return ua.Variant(list(values), ua.VariantType.Double, is_array=True)


def double_matrix(values: list[list[float]]) -> Any:
    return ua.Variant(values, ua.VariantType.Double, Dimensions=[len(values), len(values[0])])


NO_ARGUMENTS: Final = {
    "a scalar": ua.Variant(SPEED, ua.VariantType.Double),
    "two rows": double_matrix([[SPEED], [0.0]]),
    "two columns": double_matrix([[SPEED, 0.0]]),
    "floats": ua.Variant([SPEED, 0.0], ua.VariantType.Float, is_array=True),
    "texts": ua.Variant([str(SPEED), "0"], ua.VariantType.String, is_array=True),
    "variants": ua.Variant([ua.Variant(SPEED), ua.Variant(0.0)], ua.VariantType.Variant, is_array=True),
}
"""What no Double[] is never leaves the server: the lease goes on by the setpoints that are some."""
NO_SETPOINTS: Final = {
    "null": ua.Variant(None, ua.VariantType.Null),
    "no value": doubles(),
    "a value too few": doubles(SPEED),
    "very many": doubles(*[SPEED] * 10_000),
    "infinite": doubles(math.inf, 0.0),
    "infinite backwards": doubles(0.0, -math.inf),
    "no numbers": doubles(math.nan, math.nan),
}
"""These stop the robot."""


@pytest.fixture
async def made(tmp_path: Path, udp_url: str, tcp_port: int) -> Any:
    async with floor(tmp_path, fleet(udp_url, tcp_port)) as found:
        yield found


def drive(lease: int, number: int, echo: int, values: Any) -> Any:
    arguments = [uint32(lease), uint32(number), uint32(echo), values]
    return ua.CallMethodRequest(ua.NodeId.from_string(OBJECT), ua.NodeId(METHODS["Drive"], 3), arguments)


async def _drive_until(over: asyncio.Event, oscar: Operator) -> None:
    while not over.is_set():
        await oscar.drive(0.1, 0.0)
        await asyncio.sleep(0.02)


async def flood(client: Any, calls: list[Any]) -> set[str]:
    """Ask for all of them in one request; the names of the results."""
    request = ua.CallRequest()
    request.Parameters.MethodsToCall = calls
    content = await client.uaclient.protocol.send_request(request)
    return {result.StatusCode.name for result in ua.ua_binary.struct_from_binary(ua.CallResponse, content).Results}


async def test_what_is_no_setpoint_moves_nothing(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.watch()
        await oscar.acquire()
        for what, values in NO_ARGUMENTS.items():
            await oscar.drive_for(0.1, 0.1, 0.0)
            with pytest.raises(Refused, match="BadInvalidArgument"):
                await call(client, "Drive", *[uint32(each) for each in (oscar.lease, 1000, oscar.echo)], values)
            assert await shown(client, "LastNumber", oscar.number) == oscar.number, what
        for what, values in NO_SETPOINTS.items():
            with pytest.raises(Refused, match=r"BadInvalidArgument.* finite numbers: it is stopped"):
                await call(client, "Drive", *[uint32(each) for each in (oscar.lease, 1000, oscar.echo)], values)
            assert await shown(client, "Lease", 0) == 0, what
            await oscar.acquire()
        assert await shown(client, "Drops.setpoint", len(NO_SETPOINTS)) == len(NO_SETPOINTS)
    assert max(abs(linear) for linear, _ in made.carrier.written) <= 0.1 + 1e-9


async def test_a_speed_beyond_all_limits_is_held_to_them(made: Floor) -> None:
    async with made.running.client() as client:
        oscar = Operator(client)
        await oscar.watch()
        await oscar.acquire()
        for speed in (1.7976931348623157e308, -1.7976931348623157e308):
            wanted = math.copysign(SPEED, speed)
            async with asyncio.timeout(20):
                while not made.carrier.written or made.carrier.written[-1][0] != wanted:
                    await oscar.drive(speed, 5e-324)
                    await asyncio.sleep(0.02)
    assert {abs(linear) <= SPEED and abs(angular) <= 5e-324 for linear, angular in made.carrier.written} == {True}


async def test_floods_of_setpoints_move_nothing_that_is_not_theirs_and_fill_no_log(made: Floor) -> None:
    async with made.running.client() as one, made.running.client(ENGINEER) as two:
        oscar = Operator(one)
        await oscar.watch()
        await oscar.acquire()
        await oscar.drive(0.1, 0.0)
        over = asyncio.Event()
        async with asyncio.TaskGroup() as beside:
            beside.create_task(_drive_until(over, oscar))
            for _ in range(FLOODS):
                stolen = drive(oscar.lease, 0xFFFF_FFFF, oscar.echo, doubles(SPEED, 0.0))
                assert await flood(two, [stolen] * IN_A_REQUEST) == {"BadUserAccessDenied"}
            over.set()
        assert await shown(one, "LastNumber", oscar.number) == oscar.number
        assert max(linear for linear, _ in made.carrier.written) <= 0.1 + 1e-9
        # Its own: each is newer than the one before, and the last one counts.
        for _ in range(FLOODS):
            first = oscar.number + 1
            oscar.number += IN_A_REQUEST
            own = [drive(oscar.lease, n, oscar.echo, doubles(0.1, 0.0)) for n in range(first, oscar.number + 1)]
            assert await flood(one, own) == {"Good"}
            assert await shown(one, "LastNumber", oscar.number) == oscar.number
        assert await shown(one, "Lease", oscar.lease) == oscar.lease
    records = [json.loads(line) for line in (made.running.folder / "state" / LOG_FILE).read_text().splitlines()]
    refused = [record for record in records if record.get("status") == "BadUserAccessDenied"]
    assert 0 < len(refused) < 200
    (ended,) = [record for record in records if record["event"] == "teleoperation"]
    assert ended["setpoints"] == oscar.number
