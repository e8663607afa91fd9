"""Connections count for their addresses, and those of people who are logged in do not."""

from __future__ import annotations

import pytest

from ua_fleet.console.connections import Connections
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.origins import TrustedProxies

ONE, TWO, THREE = [("192.0.2.1", port) for port in (1, 2, 3)]


@pytest.fixture
def counts() -> ConsoleCounts:
    return ConsoleCounts()


@pytest.fixture
def connections(counts: ConsoleCounts) -> Connections:
    return Connections(TrustedProxies(["10.0.0.1"]), 2, counts)


def test_an_address_has_so_many_and_others_have_theirs(connections: Connections, counts: ConsoleCounts) -> None:
    assert [connections.accepted(peer) for peer in (ONE, TWO, THREE)] == [True, True, False]
    assert connections.accepted(("192.0.2.2", 1))
    assert counts.drops["too_many_connections"] == 1
    connections.closed(THREE)  # it has no place, and gives none back
    assert not connections.accepted(THREE)
    connections.closed(ONE)
    connections.closed(ONE)
    assert connections.accepted(THREE)
    assert not connections.accepted(ONE)


def test_a_network_of_addresses_is_one_and_a_proxy_is_many(connections: Connections) -> None:
    peers = [(f"2001:db8::{number}", 1, 0, 0) for number in range(3)]
    assert [connections.accepted(peer) for peer in peers] == [True, True, False]
    connections.closed(peers[0])
    assert connections.accepted(peers[2])
    assert all(connections.accepted(("10.0.0.1", port)) for port in range(10))


def test_one_that_is_logged_in_does_not_count_meanwhile(connections: Connections) -> None:
    assert connections.accepted(ONE)
    assert connections.accepted(TWO)
    with connections.logged_in(ONE):
        assert connections.accepted(THREE)
        assert not connections.accepted(("192.0.2.1", 4))
        connections.closed(THREE)
    assert not connections.accepted(THREE), "after that it counts again until it is closed"
    with connections.logged_in(ONE):
        connections.closed(ONE)
    assert connections.accepted(THREE)
    assert not connections.accepted(ONE)


def test_who_is_not_counted_is_served_too(connections: Connections) -> None:
    for peer in (None, ("10.0.0.1", 1)):
        with connections.logged_in(peer):
            assert connections.accepted(ONE)
        connections.closed(ONE)
