"""The driver while the dashboard server alone does not answer."""

from __future__ import annotations

import asyncio

import pytest

from tests.integration.ur.test_driver import bad, good, started
from tests.ur_controller import UrController
from tests.waiting import until
from ua_fleet.values import StatusCode

pytestmark = pytest.mark.needs("ur")


async def test_moves_are_halted_at_once_while_the_dashboard_server_is_silent(controller: UrController) -> None:
    async with started(controller.host, answer_timeout_s=6) as one:
        good(await one.do("turn", 0.1, 2.0))
        controller.do("silence", port="dashboard")
        await asyncio.sleep(0.5)
        for place in (3.0, -3.0):
            execution = one.begin("turn", place, 0.5)
            await one.moves(execution)
            await asyncio.sleep(0.6)  # it is asked once a second
            began = asyncio.get_running_loop().time()
            one.driver.halt(execution)
            assert bad(await one.end(execution), StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT) == "halted"
            assert asyncio.get_running_loop().time() - began < 4, "the answer is waited for"
        controller.do("silence", on=False)
        controller.do("remote_control", on=False)
        await until(lambda: "remote control is off" in one.driver.status().detail, "the status", 15)
