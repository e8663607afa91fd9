"""What becomes of an execution, as its robot's SkillStatus tells it, or does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import pytest

from ua_fleet.client import FleetClient, NodeNotFound
from ua_fleet.client.fleet_client import Reading
from ua_fleet.config.load import load_content
from ua_fleet.modbus.following import Followed, Patience, follow_skill
from ua_fleet.modbus.words import CommandState
from ua_fleet.values import StatusCode

GOOD, SILENT, WAITING = StatusCode.GOOD, StatusCode.BAD_NO_COMMUNICATION, StatusCode.BAD_WAITING_FOR_INITIAL_DATA
RUNNING, DONE = 2, 3
FLEET = b"""\
version: 1
pubsub: {security: none, repeat_interval_s: 4}
bridges: {cell: {kind: ros1, status_id: 1}}
robots:
  arm: {bridge: cell, skill_status_id: 2, skills: {turn: {id: 6, timeout_s: 30}}}
"""


class Told:
    """A client to which one robot's SkillStatus is all there is."""

    def __init__(self, status: int, *executions: tuple[str, int]) -> None:
        ids, states = [[*column] for column in zip(*executions, strict=True)] or [[], []]
        some = [0.5 for _ in ids], ['{"at": 1}' for _ in ids], ["said" for _ in ids]
        self._readings = [Reading("", column, None, status, None, None) for column in (ids, states, *some, [])]

    async def read(self, addresses: Sequence[str]) -> list[Reading]:
        assert addresses[0] == "ns=2;s=2.ExecutionId"
        return self._readings


class Nothing:
    async def read(self, _addresses: Sequence[str]) -> list[Reading]:
        raise NodeNotFound("there is no node ns=2;s=2.ExecutionId")


async def followed(client: Told | Nothing) -> Followed:
    fleet = load_content(FLEET, "F", {})
    return await follow_skill(cast("FleetClient", client), fleet, "arm", "turn", "AB-cd")


@pytest.mark.parametrize("status", [GOOD, SILENT])
async def test_an_end_is_an_end_also_when_the_robot_is_silent_since(status: int) -> None:
    told = Told(status, ("ffff", RUNNING), ("abcd", DONE))
    assert await followed(told) == Followed(CommandState.DONE, 0.5, 0, "said", {"at": 1})


@pytest.mark.parametrize(
    ("client", "patience_s"),
    [
        (Told(GOOD, ("abcd", RUNNING)), None),
        (Told(GOOD, ("ffff", DONE)), 9),
        (Told(GOOD, ("abcd", 99)), 9),
        (Told(SILENT, ("abcd", RUNNING)), 40),
        (Told(SILENT, ("ffff", RUNNING)), 40),
        (Told(WAITING), 40),
        (Nothing(), 40),
    ],
    ids=["heard", "heard of others", "no state", "silent", "silent and of others", "not heard yet", "no such robot"],
)
async def test_so_long_is_believed_what_nobody_tells(client: Told | Nothing, patience_s: float | None) -> None:
    found = await followed(client)
    assert (found.state, found.patience_s) == (CommandState.RUNNING, patience_s)
    assert len(found.message.encode()) <= 40


def test_patience_begins_when_nobody_tells_and_again_after_a_word() -> None:
    told, untold = Followed(CommandState.RUNNING), Followed(CommandState.RUNNING, patience_s=9)
    patience = Patience()
    looks = [(told, 0.0), (untold, 100.0), (untold, 109.0), (told, 110.0), (untold, 120.0), (untold, 129.0)]
    assert not any(patience.is_over(look, now) for look, now in looks)
    assert patience.is_over(untold, 129.1)
