"""Scores, synthesis, and why a robot is not a candidate."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations, pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from ua_fleet.errors import JudgementsInvalid
from ua_fleet.resilience import (
    Candidate,
    Criterion,
    CriterionKind,
    Excluded,
    Missing,
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


STRICT = tuple(replace(criterion, missing=Missing.EXCLUDE) for criterion in CRITERIA)
UNUSABLE = pytest.mark.parametrize(
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


@UNUSABLE
def test_where_a_value_must_be_known_who_lacks_it_gives_way_with_the_reason(candidate: Candidate, reason: str) -> None:
    before = Excluded("sawyer", "lacks the capacity mobile")
    ranking = rank(STRICT, WEIGHTS, [candidate, Candidate("good", {"battery": 1, "distance": 1})], excluded=[before])
    assert [place.robot for place in ranking.ranked] == ["good"]
    assert ranking.excluded == (before, Excluded("r", reason))
    assert ranking.without("r")


@UNUSABLE
def test_else_it_counts_as_the_worst_and_says_so(candidate: Candidate, reason: str) -> None:
    ranking = rank(CRITERIA, WEIGHTS, [candidate, Candidate("good", {"battery": 1, "distance": 1})])
    places = {place.robot: place for place in ranking.ranked}
    assert not ranking.excluded
    assert places["good"].missing == ("", "")
    said = [text for text in places["r"].missing if text]
    counts = {"battery": "it counts as the worst, 0 %", "distance": "it counts as the worst, 50 m"}
    assert said == [f"{part}; {counts[part.split()[0]]}" for part in reason.split("; ")]
    for raw, text, worst in zip(places["r"].raw, places["r"].missing, (0, 50), strict=True):
        assert not text or raw == worst


def test_a_missing_value_is_never_better_than_a_known_one() -> None:
    below = Criterion("charge", CriterionKind.BENEFIT, (20, 100))
    above = Criterion("way", CriterionKind.COST, (0, 10))
    assert (below.stand_in([5, 30]), below.stand_in([50])) == (5, 20)
    assert (above.stand_in([25, 3]), above.stand_in([3])) == (25, 10)
    assert Criterion("odd", CriterionKind.BENEFIT, (-5, 5)).stand_in([]) == 0


@pytest.mark.parametrize("criterion", [BATTERY, DISTANCE])
@pytest.mark.parametrize("synthesis", Synthesis)
def test_a_neutral_value_is_worth_what_the_others_are_in_the_mean(criterion: Criterion, synthesis: Synthesis) -> None:
    criterion = replace(criterion, missing=Missing.NEUTRAL)
    candidates = [
        Candidate("a", {criterion.name: 30.0}),
        Candidate("b", {criterion.name: 10.0}),
        Candidate("c", {}),
    ]
    ranking = rank([criterion], weigh((criterion.name,), {}), candidates, synthesis=synthesis)
    places = {place.robot: place for place in ranking.ranked}
    assert places["c"].scores[0] == pytest.approx((places["a"].scores[0] + places["b"].scores[0]) / 2)
    assert [place.robot for place in ranking.ranked] == (
        ["a", "c", "b"] if criterion.name == "battery" else ["b", "c", "a"]
    )
    assert places["c"].missing[0].startswith(f"{criterion.name} is not known; it counts as neutral, ")


@pytest.mark.parametrize("criteria", [CRITERIA, STRICT])
def test_who_is_alone_needs_no_values(criteria: tuple[Criterion, ...]) -> None:
    ranking = rank(criteria, WEIGHTS, [Candidate("only", {}, {"battery": "it has none"})])
    assert ranking.best == "only"
    assert ranking.ranked[0].score == 1
    assert all(ranking.ranked[0].missing)
    assert not ranking.excluded


def test_where_nothing_is_known_who_has_less_to_do_goes_first() -> None:
    candidates = [
        Candidate("a", {}, tasks_ahead=2),
        Candidate("b", {}, tasks_ahead=0),
        Candidate("c", {}, tasks_ahead=0),
    ]
    for criteria, weights in ((CRITERIA, WEIGHTS), (STRICT, WEIGHTS), ((), WEIGHTS.among([]))):
        ranking = rank(criteria, weights, candidates)
        assert [place.robot for place in ranking.ranked] == ["b", "c", "a"]
        assert [place.score for place in ranking.ranked] == pytest.approx([1 / 3] * 3)


def test_weights_among_some_keep_their_proportions_and_never_contradict_each_other() -> None:
    """The judgements of a, b and c alone have a ratio above 0.1, all four below: there is a choice."""
    names = ("a", "b", "c", "d")
    judgements = {("a", "b"): 2.0, ("b", "c"): 2.0, ("a", "c"): 1.2, ("a", "d"): 1.4, ("b", "d"): 1.1, ("c", "d"): 0.9}
    weights = weigh(names, judgements)
    with pytest.raises(JudgementsInvalid, match="contradict"):
        weigh(names[:3], {pair: value for pair, value in judgements.items() if "d" not in pair})
    some = weights.among(["c", "a", "b"])
    assert some.names == ("a", "b", "c")
    assert sum(some.weights) == pytest.approx(1)
    assert some.of("a") / some.of("b") == pytest.approx(weights.of("a") / weights.of("b"))
    assert some.consistency_ratio == weights.consistency_ratio


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


@given(
    st.lists(
        st.fixed_dictionaries({}, optional={"battery": st.floats(0, 100), "distance": st.floats(0, 50)}),
        min_size=1,
        max_size=8,
    ),
    st.sampled_from(Missing),
    st.sampled_from(Synthesis),
)
def test_whatever_is_missing_somebody_is_best_and_each_is_ranked_or_has_a_reason(
    raw: list[dict[str, float]], missing: Missing, synthesis: Synthesis
) -> None:
    criteria = [replace(criterion, missing=missing) for criterion in CRITERIA]
    ranking = rank(criteria, WEIGHTS, [Candidate(f"r{n}", each) for n, each in enumerate(raw)], synthesis=synthesis)
    assert ranking.best is not None
    assert {place.robot for place in ranking.ranked} | {left.robot for left in ranking.excluded} == {
        f"r{n}" for n in range(len(raw))
    }
    assert all(math.isfinite(value) for place in ranking.ranked for value in (*place.raw, *place.scores, place.score))
    assert missing is Missing.EXCLUDE or not ranking.excluded
    for place in ranking.ranked:
        known = raw[int(place.robot[1:])]
        assert [not text for text in place.missing] == ["battery" in known, "distance" in known]


@given(
    st.lists(st.dictionaries(st.sampled_from(["battery", "distance"]), st.floats()), min_size=1, max_size=5),
    st.sampled_from(Missing),
    st.sampled_from(Synthesis),
    st.sampled_from([(0, 100), (-1e100, 1e100), (0, 1e-100), (-5e-324, 1e-99)]),
)
@example([{"battery": 1e308}, {"battery": 1e308}], Missing.WORST, Synthesis.DISTRIBUTIVE, (0, 100))
@example([{"battery": 50}, {"distance": -1e308}, {"distance": -1e308}], Missing.NEUTRAL, Synthesis.IDEAL, (0, 100))
def test_no_value_that_a_robot_says_stops_a_ranking(
    raw: list[dict[str, float]], missing: Missing, synthesis: Synthesis, span: tuple[float, float]
) -> None:
    criteria = [replace(criterion, missing=missing, range=span) for criterion in CRITERIA]
    ranking = rank(criteria, WEIGHTS, [Candidate(f"r{n}", each) for n, each in enumerate(raw)], synthesis=synthesis)
    assert ranking.best is not None
    assert all(math.isfinite(place.score) for place in ranking.ranked)


def test_a_value_far_outside_counts_as_missing() -> None:
    ranking = rank(
        CRITERIA[:1], weigh(["battery"], {}), [Candidate("a", {"battery": 1e9}), Candidate("b", {"battery": 5})]
    )
    assert ranking.best == "b"
    assert "far outside of 0 to 100" in ranking.ranked[1].missing[0]


@pytest.mark.parametrize("span", [(0, 1e101), (0, 1e-101)])
def test_a_range_is_one_that_can_be_computed_with(span: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="range"):
        Criterion("battery", CriterionKind.BENEFIT, span)
