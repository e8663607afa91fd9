"""Scores, synthesis, and why a robot is not a candidate."""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.resilience import (
    Candidate,
    Criterion,
    CriterionKind,
    Excluded,
    Synthesis,
    availability,
    rank,
    weigh,
)

BATTERY = Criterion("battery", CriterionKind.BENEFIT, (0, 100), "%")
DISTANCE = Criterion("distance", CriterionKind.COST, (0, 50), "m")
CRITERIA = (BATTERY, DISTANCE)
WEIGHTS = weigh(("battery", "distance"), {("battery", "distance"): 3})


def test_a_benefit_is_shared_by_its_value() -> None:
    assert BATTERY.scores([30, 10, 60]) == pytest.approx((0.3, 0.1, 0.6))


def test_a_cost_is_shared_by_its_inverse() -> None:
    assert DISTANCE.scores([2, 4, 4]) == pytest.approx((0.5, 0.25, 0.25))


def test_a_cost_of_nothing_counts_as_one_percent_of_the_range() -> None:
    # 1 % of 50 m is 0.5 m, so 0 m, 0.2 m and 0.5 m are the same.
    assert DISTANCE.scores([0, 0.2, 0.5, 1]) == pytest.approx((2 / 7, 2 / 7, 2 / 7, 1 / 7))


def test_where_all_benefits_are_zero_nobody_is_better() -> None:
    assert BATTERY.scores([0, 0]) == (0.5, 0.5)


def test_a_range_must_go_upwards() -> None:
    with pytest.raises(ValueError, match="range"):
        Criterion("battery", CriterionKind.BENEFIT, (100, 0))


def test_availability_falls_with_each_task_and_never_to_nothing() -> None:
    values = [availability(tasks) for tasks in range(200)]
    assert values[0] == 100
    assert all(a > b > 0 for a, b in pairwise(values))


def test_distributive_synthesis_by_hand() -> None:
    ranking = rank(
        CRITERIA,
        WEIGHTS,
        [
            Candidate("pioneer_1", {"battery": 80, "distance": 10}),
            Candidate("pioneer_2", {"battery": 20, "distance": 5}),
        ],
    )
    # battery 0.8 and 0.2 with weight 0.75, distance 1/3 and 2/3 with weight 0.25
    first, second = ranking.ranked
    assert [place.robot for place in ranking.ranked] == ["pioneer_1", "pioneer_2"]
    assert first.score == pytest.approx(0.75 * 0.8 + 0.25 / 3)
    assert second.score == pytest.approx(0.75 * 0.2 + 0.25 * 2 / 3)
    assert list(first.raw) == [80, 10]
    assert first.scores == pytest.approx((0.8, 1 / 3))
    assert ranking.best == "pioneer_1"


def test_the_choice_of_a_leader() -> None:
    """The whole of the worked example "Analytic hierarchy process, leader example" (Wikipedia): Dick 0.493, Tom 0.358,
    Harry 0.149. Each criterion compares the candidates in pairs; those priorities are its raw values here."""
    criteria = ("experience", "education", "charisma", "age")
    weights = weigh(
        criteria,
        {
            ("experience", "education"): 4,
            ("experience", "charisma"): 3,
            ("experience", "age"): 7,
            ("charisma", "education"): 3,
            ("education", "age"): 3,
            ("charisma", "age"): 5,
        },
    )
    people = ("Tom", "Dick", "Harry")
    compared = {
        "experience": (1 / 4, 4, 9),
        "education": (3, 1 / 5, 1 / 7),
        "charisma": (5, 9, 4),
        "age": (1 / 3, 5, 9),
    }
    priorities = {
        name: weigh(people, dict(zip(combinations(people, 2), ratios, strict=True)))
        for name, ratios in compared.items()
    }
    ranking = rank(
        [Criterion(name, CriterionKind.BENEFIT, (0, 1)) for name in criteria],
        weights,
        [Candidate(person, {name: priorities[name].of(person) for name in criteria}) for person in people],
    )
    assert [(place.robot, round(place.score, 3)) for place in ranking.ranked] == [
        ("Dick", 0.493),
        ("Tom", 0.358),
        ("Harry", 0.149),
    ]


def test_ideal_synthesis_by_hand() -> None:
    ranking = rank(
        CRITERIA,
        WEIGHTS,
        [
            Candidate("pioneer_1", {"battery": 80, "distance": 10}),
            Candidate("pioneer_2", {"battery": 20, "distance": 5}),
        ],
        synthesis=Synthesis.IDEAL,
    )
    # battery 1 and 0.25, distance 0.5 and 1: 0.875 and 0.4375
    assert [place.score for place in ranking.ranked] == pytest.approx([2 / 3, 1 / 3])


def test_a_further_candidate_may_reverse_the_distributive_order_but_not_the_ideal_one() -> None:
    """Rank reversal (V. Belton and T. Gear, Omega 11, 1983): why there are two syntheses."""
    names = ("one", "two", "three")
    criteria = tuple(Criterion(name, CriterionKind.BENEFIT, (0, 10)) for name in names)
    weights = weigh(names, dict.fromkeys((("one", "two"), ("one", "three"), ("two", "three")), 1.0))
    a = Candidate("a", {"one": 1, "two": 9, "three": 8})
    b = Candidate("b", {"one": 9, "two": 1, "three": 9})
    c = Candidate("c", {"one": 1, "two": 1, "three": 1})
    copy = Candidate("d", {"one": 9, "two": 1, "three": 9})
    before = rank(criteria, weights, [a, b, c])
    after = rank(criteria, weights, [a, b, c, copy])
    assert before.best == "b"
    assert after.best == "a"
    ideal = [rank(criteria, weights, some, synthesis=Synthesis.IDEAL).best for some in ([a, b, c], [a, b, c, copy])]
    assert ideal == ["b", "b"]


@pytest.mark.parametrize(
    ("candidate", "reason"),
    [
        (Candidate("r", {"battery": 50}), "distance is not known"),
        (
            Candidate("r", {"battery": 50}, {"distance": "Bad_NoCommunication"}),
            "distance is not known: Bad_NoCommunication",
        ),
        (Candidate("r", {"battery": math.nan, "distance": 1}), "battery is nan"),
        (Candidate("r", {"battery": -1, "distance": 1}), "battery is -1 %, and a benefit is never below 0"),
        (Candidate("r", {"battery": math.inf}), "battery is inf; distance is not known"),
    ],
)
def test_a_candidate_that_cannot_be_compared_is_left_out_with_the_reason(candidate: Candidate, reason: str) -> None:
    before = Excluded("sawyer", "has not the capacity mobile")
    ranking = rank(CRITERIA, WEIGHTS, [candidate, Candidate("good", {"battery": 1, "distance": 1})], excluded=[before])
    assert [place.robot for place in ranking.ranked] == ["good"]
    assert ranking.excluded == (before, Excluded("r", reason))
    assert ranking.without("r")


def test_without_candidates_there_is_no_best() -> None:
    ranking = rank(CRITERIA, WEIGHTS, [])
    assert ranking.best is None
    assert ranking.ranked == ()


def test_equal_robots_stand_in_the_order_of_their_names() -> None:
    values = {"battery": 50.0, "distance": 5.0}
    ranking = rank(CRITERIA, WEIGHTS, [Candidate(name, values) for name in ("zeta", "alpha", "mid")])
    assert [place.robot for place in ranking.ranked] == ["alpha", "mid", "zeta"]


values = st.fixed_dictionaries({"battery": st.floats(0, 100), "distance": st.floats(0, 50)})


@given(st.lists(values, min_size=1, max_size=20), st.sampled_from(Synthesis))
def test_scores_are_shares_of_one_in_falling_order(raw: list[dict[str, float]], synthesis: Synthesis) -> None:
    candidates = [Candidate(f"r{n:02}", value) for n, value in enumerate(raw)]
    ranking = rank(CRITERIA, WEIGHTS, candidates, synthesis=synthesis)
    scores = [place.score for place in ranking.ranked]
    assert len(scores) == len(raw)
    assert sum(scores) == pytest.approx(1)
    assert scores == sorted(scores, reverse=True)
    assert all(score >= 0 for score in scores)


@given(values, values)
def test_who_is_better_in_everything_is_never_behind(one: dict[str, float], gain: dict[str, float]) -> None:
    better = {"battery": one["battery"] + gain["battery"], "distance": max(one["distance"] - gain["distance"], 0)}
    for synthesis in Synthesis:
        ranking = rank(CRITERIA, WEIGHTS, [Candidate("b", one), Candidate("a", better)], synthesis=synthesis)
        by_robot = {place.robot: place.score for place in ranking.ranked}
        assert by_robot["a"] >= by_robot["b"] - 1e-12
