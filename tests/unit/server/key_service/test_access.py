from __future__ import annotations

import pytest

from tests.unit.server.key_service.fleet import fleet
from ua_fleet.endpoint.call_limit import LEAST_BURST, CallLimit
from ua_fleet.server.key_service.access import KeyAccess

ACCESS = KeyAccess(fleet())


def test_groups_of_a_fleet() -> None:
    assert ACCESS.group_ids == ("t-0", "t-1", "c-1", "t-2", "c-2", "t-300", "c-300")


@pytest.mark.parametrize(
    ("bridge", "commands"),
    [
        ("arm", {"c-1", "c-2"}),
        ("rover", {"c-2"}),
        ("plc", {"c-300"}),
        ("stranger", None),
        ("", None),
    ],
)
def test_what_a_bridge_may_have(bridge: str, commands: set[str] | None) -> None:
    expected = set[str]() if commands is None else {"t-0", "t-1", "t-2", "t-300"} | commands
    assert {group for group in ACCESS.group_ids if ACCESS.bridge_may(bridge, group)} == expected
    assert not ACCESS.bridge_may(bridge, "t-9")


def test_what_the_server_may_have() -> None:
    given = {group for group in ACCESS.group_ids if ACCESS.space_may(0, group)}
    assert given == {"t-0", "t-1", "c-1", "t-2", "c-2", "t-300"}
    assert not ACCESS.space_may(9, "t-0")


def test_a_caller_is_limited_and_others_are_not() -> None:
    limit = CallLimit(groups=7, lifetime_s=3600.0)
    assert all(limit.take("arm", 100.0) for _ in range(LEAST_BURST))
    assert not limit.take("arm", 100.0)
    assert limit.take("rover", 100.0)
    assert limit.take("arm", 100.5)
    assert not limit.take("arm", 100.5)
    assert all(limit.take("arm", 1000.0) for _ in range(LEAST_BURST))
    assert not limit.take("arm", 1000.0)


def test_many_groups_and_short_lifetimes_need_more_calls() -> None:
    limit = CallLimit(groups=100, lifetime_s=2.0)
    now = 0.0
    for _ in range(50):
        assert all(limit.take("arm", now) for _ in range(100))
        now += 1.0
