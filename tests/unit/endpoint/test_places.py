from __future__ import annotations

import pytest

from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.places import Holder, NoPlace, SessionPlaces, Standing, holder_of, standing_of
from ua_fleet.endpoint.users import ANONYMOUS, Role, User

PLACES = SessionPlaces(EndpointLimits(sessions=6, sessions_per_user=3, reserved_sessions=2))


def held(
    *owners: str, standing: Standing = Standing.ORDINARY, detached: dict[int, float] | None = None
) -> list[Holder[int]]:
    gone = detached or {}
    return [Holder(number, owner, standing, gone.get(number)) for number, owner in enumerate(owners)]


def test_a_user_has_so_many() -> None:
    assert PLACES.make_room(held("a", "a"), "a", Standing.ORDINARY) == []
    with pytest.raises(NoPlace, match="max_sessions_per_user"):
        PLACES.make_room(held("a", "a", "a"), "a", Standing.ORDINARY)
    assert PLACES.make_room(held("a", "a", "a"), "b", Standing.ORDINARY) == []


def test_the_own_session_that_is_detached_longest_goes_first() -> None:
    mine = held("a", "a", "a", detached={1: 7.0, 2: 5.0})
    assert PLACES.make_room(mine, "a", Standing.ORDINARY) == [2]


def test_places_are_kept_for_engineers_and_bridges() -> None:
    full = held("a", "a", "b", "b")
    with pytest.raises(NoPlace, match="reserved"):
        PLACES.make_room(full, "c", Standing.ORDINARY)
    assert PLACES.make_room(full, "eva", Standing.ENGINEER) == []


def test_a_detached_session_of_the_greediest_gives_way() -> None:
    full = held("b", "a", "a", "c", detached={0: 1.0, 2: 9.0})
    assert PLACES.make_room(full, "d", Standing.ORDINARY) == [2]


def left(key: int, owner: str, detached_at: float, standing: Standing = Standing.ORDINARY) -> Holder[int]:
    """A session that has neither a connection nor subscriptions."""
    return Holder(key, owner, standing, detached_at, subscribes=False)


def test_of_a_users_own_those_without_subscriptions_go_first() -> None:
    mine = [*held("a", "a", detached={0: 1.0}), left(2, "a", 9.0)]
    assert PLACES.make_room(mine, "a", Standing.ORDINARY) == [2]


def test_sessions_without_connection_and_subscriptions_give_way_to_everybody() -> None:
    """Killed programs of engineers would keep others out, and the greediest lose its subscriptions for an empty one."""
    full = [
        *held("a", "a", detached={0: 1.0, 1: 2.0}),
        *held("c", "c", standing=Standing.BRIDGE)[:1],
        left(3, "eva", 5.0, Standing.ENGINEER),
        left(4, "eva", 4.0, Standing.ENGINEER),
        left(5, "erik", 3.0, Standing.ENGINEER),
    ]
    for standing in Standing:
        assert PLACES.make_room(full, "d", standing) == [4]
    open_ones = [*held("a", "a", "b", detached={0: 1.0}), left(3, "c", 7.0)]
    assert PLACES.make_room(open_ones, "d", Standing.ORDINARY) == [3]
    bridges = [*held("one", "two", "three", "four", standing=Standing.BRIDGE, detached={0: 1.0}), left(4, "five", 2.0)]
    assert PLACES.make_room(bridges, "six", Standing.BRIDGE) == [4]


def test_an_engineers_session_gives_way_to_nobody_but_engineers() -> None:
    full = [
        *held("a", "a", "b", "b"),
        Holder(4, "eva", Standing.ENGINEER, 1.0),
        Holder(5, "bridge:cell", Standing.BRIDGE),
    ]
    with pytest.raises(NoPlace):
        PLACES.make_room(full, "c", Standing.ORDINARY)
    assert PLACES.make_room(full, "erik", Standing.ENGINEER) == [4]
    full[0] = Holder(0, "a", Standing.ORDINARY, 3.0)
    assert PLACES.make_room(full, "erik", Standing.ENGINEER) == [0]


def test_all_may_be_reserved_but_half() -> None:
    places = SessionPlaces(EndpointLimits(sessions=1, reserved_sessions=10))
    assert places.make_room([], "a", Standing.ORDINARY) == []
    with pytest.raises(NoPlace):
        places.make_room(held("a"), "eva", Standing.ENGINEER)


def test_whom_a_session_counts_for() -> None:
    anna = User("anna", Role.OBSERVER)
    assert holder_of(anna, "10.0.0.1") == holder_of(anna, "10.0.0.2")
    assert holder_of(ANONYMOUS, "10.0.0.1") != holder_of(ANONYMOUS, "10.0.0.2")
    assert holder_of(ANONYMOUS, "10.0.0.1") != holder_of(User("10.0.0.1", Role.OBSERVER), "10.0.0.1")
    assert standing_of(User.of_bridge("cell")) is Standing.BRIDGE
    assert standing_of(User("eva", Role.ENGINEER)) is Standing.ENGINEER
    assert standing_of(User("oscar", Role.OPERATOR)) is Standing.ORDINARY


def test_bridges_leave_places_to_engineers() -> None:
    """Stolen certificates of bridges took all places, so that nobody could take them away."""
    bridges = held("one", "one", "two", "two", "three", standing=Standing.BRIDGE)
    with pytest.raises(NoPlace, match="for engineers"):
        PLACES.make_room(bridges, "four", Standing.BRIDGE)
    assert PLACES.make_room(bridges, "eva", Standing.ENGINEER) == []
    with pytest.raises(NoPlace, match="for engineers"):
        PLACES.make_room(bridges, "anna", Standing.ORDINARY)


def test_a_bridge_that_is_gone_makes_room_for_one_that_is_there() -> None:
    bridges = held("one", "two", "three", "four", "five", standing=Standing.BRIDGE, detached={3: 2.0})
    assert PLACES.make_room(bridges, "six", Standing.BRIDGE) == [3]


def test_a_bridge_has_few() -> None:
    places = SessionPlaces(EndpointLimits())
    with pytest.raises(NoPlace, match="3 sessions"):
        places.make_room(held("one", "one", "one", standing=Standing.BRIDGE), "one", Standing.BRIDGE)
