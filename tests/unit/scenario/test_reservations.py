"""Robots are had by one task at a time, in the order of asking."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.scenario.reservations import Grant, Reservations


def test_the_first_has_it_and_the_next_waits_for_it() -> None:
    made = Reservations[str]()
    assert made.want("a", "ned") == [Grant("a", "ned")]
    assert made.want("b", "ned") == []
    assert made.want("c", "ned") == []
    assert (made.holder("ned"), made.tasks_ahead("ned")) == ("a", 3)
    assert made.release("a") == [Grant("b", "ned")]
    assert made.release("b") == [Grant("c", "ned")]
    assert made.release("c") == []
    assert (made.holder("ned"), made.tasks_ahead("ned")) == (None, 0)


def test_who_leaves_the_queue_is_not_served() -> None:
    made = Reservations[str]()
    made.want("a", "ned")
    made.want("b", "ned")
    made.want("c", "ned")
    assert made.release("b") == []
    assert made.release("a") == [Grant("c", "ned")]


def test_asking_again_keeps_the_place_and_says_again_what_is_granted() -> None:
    made = Reservations[str]()
    made.want("a", "ned")
    made.want("b", "ned")
    assert made.want("a", "ned") == [Grant("a", "ned")]
    assert made.want("b", "ned") == []
    assert made.tasks_ahead("ned") == 2


def test_another_robot_frees_the_first() -> None:
    made = Reservations[str]()
    made.want("a", "ned")
    made.want("b", "ned")
    assert made.want("a", "ur3") == [Grant("b", "ned"), Grant("a", "ur3")]


steps = st.lists(
    st.tuples(st.booleans(), st.integers(0, 4), st.sampled_from(["ned", "ur3"])),
    max_size=60,
)


@given(steps)
def test_no_robot_is_had_twice_and_nobody_is_forgotten(made_steps: list[tuple[bool, int, str]]) -> None:
    made = Reservations[int]()
    wanted: dict[int, str] = {}
    has: dict[str, int] = {}
    for wants, claim, robot in made_steps:
        if wants:
            before = wanted.get(claim)
            if before != robot and before is not None and has.get(before) == claim:
                del has[before]
            wanted[claim] = robot
            grants = made.want(claim, robot)
        else:
            before = wanted.pop(claim, None)
            if before is not None and has.get(before) == claim:
                del has[before]
            grants = made.release(claim)
        for grant in grants:
            assert has.get(grant.robot, grant.claim) == grant.claim
            has[grant.robot] = grant.claim
        assert {robot: made.holder(robot) for robot in has} == has
        assert set(has) == set(wanted.values())
