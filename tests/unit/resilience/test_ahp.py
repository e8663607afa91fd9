"""Weights, against published examples, numpy's eigenvectors, and bad judgements."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.errors import JudgementsInvalid
from ua_fleet.resilience import RANDOM_INDEX, weigh

DRINKS = ("coffee", "wine", "tea", "beer", "soda", "milk", "water")
"""T. L. Saaty, Decision making with the analytic hierarchy process, Int. J. Services Sciences 1 (1), 2008, table 2:
relative consumption of drinks in the United States."""
DRINK_JUDGEMENTS = {
    ("coffee", "wine"): 9,
    ("coffee", "tea"): 5,
    ("coffee", "beer"): 2,
    ("coffee", "soda"): 1,
    ("coffee", "milk"): 1,
    ("coffee", "water"): 1 / 2,
    ("wine", "tea"): 1 / 3,
    ("wine", "beer"): 1 / 9,
    ("wine", "soda"): 1 / 9,
    ("wine", "milk"): 1 / 9,
    ("wine", "water"): 1 / 9,
    ("tea", "beer"): 1 / 3,
    ("tea", "soda"): 1 / 4,
    ("tea", "milk"): 1 / 3,
    ("tea", "water"): 1 / 9,
    ("beer", "soda"): 1 / 2,
    ("beer", "milk"): 1,
    ("beer", "water"): 1 / 3,
    ("soda", "milk"): 2,
    ("soda", "water"): 1 / 2,
    ("milk", "water"): 1 / 3,
}


def test_saatys_drinks() -> None:
    result = weigh(DRINKS, DRINK_JUDGEMENTS)
    published = {"coffee": 0.177, "wine": 0.019, "tea": 0.042, "beer": 0.116, "soda": 0.190, "milk": 0.129}
    assert {name: round(result.of(name), 3) for name in DRINKS} == {**published, "water": 0.327}
    assert round(result.consistency_ratio, 3) == 0.022


def test_the_criteria_for_choosing_a_leader() -> None:
    """The worked example of Wikipedia's article on the AHP, Leader example: weights 0.547, 0.127, 0.270, 0.056."""
    judgements = {
        ("experience", "education"): 4,
        ("experience", "charisma"): 3,
        ("experience", "age"): 7,
        ("charisma", "education"): 3,
        ("education", "age"): 3,
        ("charisma", "age"): 5,
    }
    result = weigh(("experience", "education", "charisma", "age"), judgements)
    assert result.weights == pytest.approx((0.547, 0.127, 0.270, 0.056), abs=1e-3)
    assert round(result.consistency_ratio, 3) == 0.044


def test_saatys_schools_are_refused() -> None:
    """His criteria for choosing a school (The Analytic Hierarchy Process, 1980, p. 26) contradict each other."""
    names: tuple[str, ...] = ("learning", "friends", "school life", "vocational", "college", "music")
    rows: list[list[float]] = [
        [4, 3, 1, 3, 4],
        [7, 3, 1 / 5, 1],
        [1 / 5, 1 / 5, 1 / 6],
        [1, 1 / 3],
        [3],
    ]
    judgements: dict[tuple[str, str], float] = dict(
        zip(combinations(names, 2), [value for row in rows for value in row], strict=True)
    )
    with pytest.raises(JudgementsInvalid) as caught:
        weigh(names, judgements)
    assert caught.value.consistency_ratio is not None
    assert caught.value.consistency_ratio > 0.2
    assert "'learning' to 'school life' is 3, and the others say 9.2" in str(caught.value)


def test_one_and_two_elements_are_always_consistent() -> None:
    assert weigh(("a",), {}).weights == (1.0,)
    result = weigh(("a", "b"), {("b", "a"): 9})
    assert result.weights == pytest.approx((0.1, 0.9))
    assert result.consistency_ratio == 0


def test_the_worst_judgement_is_named() -> None:
    names = ("battery", "distance", "availability", "payload")
    good = {"battery": 8, "distance": 4, "availability": 2, "payload": 1}
    judgements = {(a, b): good[a] / good[b] for a, b in combinations(names, 2)}
    judgements["distance", "payload"] = 1 / 9
    with pytest.raises(JudgementsInvalid) as caught:
        weigh(names, judgements)
    (problem,) = caught.value.problems
    assert "'payload' to 'distance' is 9" in problem
    assert "consistency ratio" in problem


A_B_C = ("a", "b", "c")


@pytest.mark.parametrize(
    ("names", "judgements", "said"),
    [
        (A_B_C, {("a", "b"): 2, ("a", "c"): 3}, ["'b' and 'c' are not compared"]),
        (A_B_C, {}, ["'a' and 'b' are not", "'a' and 'c' are not", "'b' and 'c' are not"]),
        (("a", "b"), {("a", "b"): 0}, ["'a' to 'b' is 0; a judgement is a number from 1/9 to 9"]),
        (("a", "b"), {("a", "b"): -3}, ["is -3"]),
        (("a", "b"), {("a", "b"): math.nan}, ["is nan"]),
        (("a", "b"), {("a", "b"): math.inf}, ["is inf"]),
        (("a", "b"), {("a", "b"): 12}, ["is 12; Saaty's scale"]),
        (("a", "b"), {("a", "b"): 3, ("b", "a"): 3}, ["'a' to 'b' is 3 and the other way 3; give one of them"]),
        (("a", "b"), {("a", "x"): 3}, ["'x' is not among 'a', 'b'"]),
        (("a", "b"), {("a", "a"): 2, ("a", "b"): 1}, ["anything is as important as itself"]),
        (("a", "a"), {("a", "a"): 1}, ["'a' is there twice"]),
        ((), {}, ["there are 0 elements"]),
        (tuple(f"c{n}" for n in range(16)), {}, ["there are 16 elements; 1 to 15"]),
    ],
)
def test_bad_judgements_are_refused_with_every_problem(
    names: tuple[str, ...], judgements: dict[tuple[str, str], float], said: list[str]
) -> None:
    with pytest.raises(JudgementsInvalid) as caught:
        weigh(names, judgements)
    assert len(caught.value.problems) == len(said)
    for problem, text in zip(caught.value.problems, said, strict=True):
        assert text in problem
        assert "\n" not in problem


def test_both_ways_may_be_given_where_they_are_reciprocal() -> None:
    result = weigh(("a", "b"), {("a", "b"): 3, ("b", "a"): 0.333})
    assert result.weights == pytest.approx((0.75, 0.25), abs=1e-3)


def _by_numpy(matrix: Any) -> tuple[float, tuple[float, ...]]:
    """The largest eigenvalue and its vector, by another method than ours."""
    eigenvalues: Any
    vectors: Any
    eigenvalues, vectors = np.linalg.eig(matrix)
    real: list[float] = eigenvalues.real.tolist()
    place = real.index(max(real))
    vector: list[float] = abs(vectors.real[:, place]).tolist()
    return real[place], tuple(value / sum(vector) for value in vector)


scale = st.sampled_from([*(1 / n for n in range(9, 1, -1)), *map(float, range(1, 10))])


@given(st.integers(min_value=1, max_value=9), st.lists(scale, min_size=36, max_size=36))
def test_weights_are_the_principal_eigenvector_or_the_judgements_are_inconsistent(
    count: int, values: list[float]
) -> None:
    names = tuple(f"c{n}" for n in range(count))
    judgements = dict(zip(combinations(names, 2), values, strict=False))
    matrix = np.ones((count, count))
    for (one, other), value in judgements.items():
        row, column = names.index(one), names.index(other)
        matrix[row, column], matrix[column, row] = value, 1 / value
    largest, expected = _by_numpy(matrix)
    ratio = (largest - count) / (count - 1) / RANDOM_INDEX[count - 1] if count > 2 else 0.0
    if ratio > 0.1 + 1e-9:
        with pytest.raises(JudgementsInvalid) as caught:
            weigh(names, judgements)
        assert caught.value.consistency_ratio == pytest.approx(ratio, abs=1e-6)
        return
    result = weigh(names, judgements)
    assert result.weights == pytest.approx(expected, abs=1e-6)
    assert result.consistency_ratio == pytest.approx(max(ratio, 0), abs=1e-6)


@given(st.lists(st.floats(min_value=1, max_value=9), min_size=2, max_size=8))
def test_consistent_judgements_give_their_own_weights_back(values: list[float]) -> None:
    names = tuple(f"c{n}" for n in range(len(values)))
    judgements = {
        (one, other): values[names.index(one)] / values[names.index(other)] for one, other in combinations(names, 2)
    }
    result = weigh(names, judgements)
    assert result.weights == pytest.approx(tuple(value / sum(values) for value in values), abs=1e-9)
    assert result.consistency_ratio == pytest.approx(0, abs=1e-9)
