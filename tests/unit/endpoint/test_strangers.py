from __future__ import annotations

import pytest

from ua_fleet.endpoint.strangers import AT_ONCE_S, SHARE, StrangersTime


def test_an_address_costs_so_much_at_once_and_then_a_share() -> None:
    time = StrangersTime()
    assert not time.exhausted("10.0.0.9", 0.0)
    time.spend("10.0.0.9", AT_ONCE_S, 0.0)
    assert time.exhausted("10.0.0.9", 0.0)
    assert not time.exhausted("10.0.0.9", 1.0)
    time.spend("10.0.0.9", SHARE, 1.0)
    assert time.exhausted("10.0.0.9", 1.0)


def test_others_are_not_refused_for_it() -> None:
    time = StrangersTime()
    time.spend("10.0.0.9", 3 * AT_ONCE_S, 0.0)
    assert not time.exhausted("10.0.0.8", 0.0)


def test_who_logs_in_owes_nothing() -> None:
    """A gateway with a hundred clients."""
    time = StrangersTime()
    for _ in range(100):
        time.spend("10.0.0.9", 0.1, 0.0)
        time.repay("10.0.0.9", 0.1)
    assert not time.exhausted("10.0.0.9", 0.0)


@pytest.mark.parametrize("network", ["10.0.0.{}", "2001:db8:1:{}::1"])
def test_many_addresses_are_of_one_network(network: str) -> None:
    time = StrangersTime()
    for number in range(40):
        time.spend(network.format(number), AT_ONCE_S / 8, 0.0)
    assert time.exhausted(network.format(99), 0.0), "an address that has not been seen"
    assert not time.exhausted("192.168.0.1", 0.0)


def test_new_addresses_do_not_make_it_forget_who_owes_most() -> None:
    time = StrangersTime()
    time.spend("10.0.0.9", 2 * AT_ONCE_S, 0.0)
    for number in range(20_000):
        time.spend(f"{20 + number // 65_536}.{number // 256 % 256}.{number % 256}.1", 0.001, 0.0)
    assert time.exhausted("10.0.0.9", 0.0)
    assert len(time) <= 4_096
