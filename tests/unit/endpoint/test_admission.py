from __future__ import annotations

import pytest

from ua_fleet.endpoint.admission import Admission, Progress, Waiting
from ua_fleet.endpoint.origin import networks, origin


def bare(key: int, address: str, progress: Progress = Progress.CONNECTED) -> Waiting[int]:
    return Waiting(key, address, progress, float(key))


def test_there_is_room() -> None:
    waiting = [bare(number, f"10.0.0.{number}") for number in range(4)]
    assert Admission(20).make_room(waiting, 4) == ([], True)


def test_the_greediest_address_gives_way_not_the_oldest_connection() -> None:
    waiting = [bare(0, "10.0.0.1"), *(bare(number, "10.0.0.9") for number in range(1, 5))]
    assert Admission(20).make_room(waiting, 5) == ([1], True)


def test_at_the_same_address_who_came_further_stays() -> None:
    waiting = [bare(number, "10.0.0.9", Progress.HELLO) for number in range(4)]
    waiting.append(bare(4, "10.0.0.9"))
    assert Admission(20).make_room(waiting, 5) == ([4], True)


def test_newcomers_push_nobody_out_who_has_progressed() -> None:
    waiting = [bare(number, "10.0.0.9", Progress.TRUSTED) for number in range(5)]
    waiting += [bare(number, f"10.0.1.{number}") for number in range(5, 10)]
    assert Admission(20).make_room(waiting, 10) == ([5], True)


def test_those_who_progressed_have_no_more_than_their_places() -> None:
    waiting = [bare(0, "10.0.0.1", Progress.SESSION)]
    waiting += [bare(number, "10.0.0.9", Progress.TRUSTED) for number in range(1, 9)]
    assert Admission(20).make_room(waiting, 9) == ([1, 2, 3, 4], True)


def test_users_alone_fill_the_server() -> None:
    assert Admission(20).make_room([], 20) == ([], False)
    assert Admission(20).make_room([bare(1, "10.0.0.1", Progress.SESSION)], 20) == ([1], True)


@pytest.mark.parametrize(
    ("address", "counts_as"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("::ffff:10.0.0.7", "10.0.0.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::1"),
        ("::1", "::1"),
        ("unknown", "unknown"),
    ],
)
def test_origin(address: str, counts_as: str) -> None:
    assert origin(address) == counts_as


def test_many_addresses_of_a_network_count_together() -> None:
    """Who has a /16, or a /48 of IPv6, is not many who come a little."""
    waiting = [bare(0, "10.1.0.1"), *(bare(number, f"10.2.{number}.7") for number in range(1, 5))]
    assert Admission(20).make_room(waiting, 5) == ([1], True)
    waiting = [bare(0, "2001:db8:1::1"), *(bare(number, f"2001:db8:2:{number}::7") for number in range(1, 5))]
    assert Admission(20).make_room(waiting, 5) == ([1], True)


@pytest.mark.parametrize(
    ("address", "counts_in"),
    [
        ("10.1.2.3", ("10.1.2.3", "10.1.2.0/24", "10.1.0.0/16")),
        ("::ffff:10.1.2.3", ("10.1.2.3", "10.1.2.0/24", "10.1.0.0/16")),
        ("2001:db8:1:2::7", ("2001:db8:1:2::/64", "2001:db8:1::/48", "2001:db8::/32")),
        ("unknown", ("unknown", "network of unknown", "wide network of unknown")),
    ],
)
def test_networks(address: str, counts_in: tuple[str, str, str]) -> None:
    assert networks(address) == counts_in


# --- gateways


def gateways(key: int, name: str, progress: Progress = Progress.SESSION) -> Waiting[int]:
    return Waiting(key, f"gateway console {name}", progress, float(key), is_gateways=True)


def beside(key: int, progress: Progress = Progress.CONNECTED) -> Waiting[int]:
    return Waiting(key, "10.0.0.1", progress, float(key), is_gateways=True)


def test_who_logs_in_through_a_gateway_has_the_place_of_nobody_else() -> None:
    strangers = [bare(number, "10.0.0.1", Progress.TRUSTED) for number in range(5)]
    people = [gateways(number, f"user{number}") for number in range(5, 10)]
    assert Admission(40).make_room([*strangers, *people], 10) == ([], True)
    assert Admission(20).make_room([*strangers, *people], 10) == ([], True)
    assert Admission(20).make_room([bare(10, "10.0.0.1", Progress.TRUSTED), *strangers, *people], 11) == ([0], True)


def test_who_waits_with_most_logins_for_one_name_gives_way() -> None:
    people = [gateways(0, "anna"), *(gateways(number, "bert") for number in range(1, 6))]
    assert Admission(20).make_room(people, 6) == ([1], True)


def test_newcomers_from_a_gateways_address_have_places_of_their_own() -> None:
    others = [bare(number, "10.0.0.9") for number in range(5)]
    near = [beside(number) for number in range(5, 9)]
    assert Admission(20).make_room([*others, *near], 9, beside_gateway=True) == ([], True)
    assert Admission(20).make_room([*others, *near], 9) == ([0], True)
    near.append(beside(9))
    assert Admission(20).make_room([*others, *near], 10, beside_gateway=True) == ([5], True)


def test_newcomers_go_before_gateways_where_all_places_are_taken() -> None:
    people = [gateways(number, f"user{number}") for number in range(3)]
    assert Admission(20).make_room([beside(4), *people], 20) == ([4], True)
    assert Admission(20).make_room([bare(3, "10.0.0.9"), beside(4), *people], 20) == ([3], True)
    assert Admission(20).make_room(people, 20) == ([0], True)
