"""Who chooses a replacement, and how an open decision ends."""

from __future__ import annotations

import pytest

from ua_fleet.errors import NoCandidate
from ua_fleet.resilience import (
    Aborted,
    Candidate,
    Confirmation,
    Criterion,
    CriterionKind,
    Decision,
    DecisionMode,
    Excluded,
    OnLimit,
    Ranking,
    RankingChanged,
    ReplacementChosen,
    rank,
    weigh,
)

BATTERY = Criterion("battery", CriterionKind.BENEFIT, (0, 100))


def ranking(**batteries: float) -> Ranking:
    candidates = [Candidate(robot, {"battery": value}) for robot, value in batteries.items()]
    left = [Excluded("sawyer", "lacks the capacity mobile")]
    return rank([BATTERY], weigh(("battery",), {}), candidates, excluded=left)


def decision(mode: DecisionMode, first: Ranking, on_limit: OnLimit = OnLimit.BEST) -> Decision:
    return Decision("d1", mode, first, limit_s=60, on_limit=on_limit, now=100)


def test_automatic_takes_the_best_at_once() -> None:
    made = decision(DecisionMode.AUTOMATIC, ranking(pioneer_1=40, pioneer_2=80))
    assert [type(event) for event in made.begin()] == [RankingChanged, ReplacementChosen]
    assert isinstance(made.outcome, ReplacementChosen)
    assert (made.outcome.robot, made.outcome.by) == ("pioneer_2", "automatic")
    assert made.next_deadline() is None


def test_automatic_without_a_candidate_ends_clearly() -> None:
    made = decision(DecisionMode.AUTOMATIC, ranking())
    assert made.begin()[-1] == Aborted("d1", "no robot is left that can take over")
    assert made.poll(1e9) == []


def test_abort_gives_up_at_once() -> None:
    made = decision(DecisionMode.ABORT, ranking(pioneer_1=40))
    assert made.begin()[-1] == Aborted("d1", "the mode is Abort")


def test_an_operator_may_take_another_than_the_best() -> None:
    made = decision(DecisionMode.OPERATOR, ranking(pioneer_1=40, pioneer_2=80))
    assert [type(event) for event in made.begin()] == [RankingChanged]
    what, (chosen,) = made.confirm("pioneer_1", "anna")
    assert what is Confirmation.TAKEN
    assert isinstance(chosen, ReplacementChosen)
    assert (chosen.robot, chosen.by) == ("pioneer_1", "anna")
    assert made.poll(1e9) == []


def test_of_two_operators_the_first_decides() -> None:
    made = decision(DecisionMode.OPERATOR, ranking(pioneer_1=40, pioneer_2=80))
    made.begin()
    made.confirm("pioneer_1", "anna")
    assert made.confirm("pioneer_1", "bert") == (Confirmation.REPEATED, [])
    with pytest.raises(NoCandidate, match="anna has chosen pioneer_1 before"):
        made.confirm("pioneer_2", "bert")
    assert isinstance(made.outcome, ReplacementChosen)
    assert made.outcome.by == "anna"


def test_only_candidates_can_be_chosen_and_the_reason_is_said() -> None:
    made = decision(DecisionMode.OPERATOR, ranking(pioneer_1=40))
    made.begin()
    with pytest.raises(NoCandidate, match="sawyer cannot take over: lacks the capacity mobile"):
        made.confirm("sawyer", "anna")
    with pytest.raises(NoCandidate, match="no such candidate"):
        made.confirm("hal", "anna")
    assert made.outcome is None


def test_a_changed_value_ranks_an_open_decision_again() -> None:
    made = decision(DecisionMode.OPERATOR, ranking(pioneer_1=40, pioneer_2=80))
    made.begin()
    assert made.rank_again(ranking(pioneer_1=40, pioneer_2=80)) == []
    changed = ranking(pioneer_1=90, pioneer_2=80)
    assert made.rank_again(changed) == [RankingChanged("d1", changed)]
    made.confirm("pioneer_1", "anna")
    assert made.rank_again(ranking(pioneer_2=80)) == []
    assert made.ranking == changed


@pytest.mark.parametrize("first", [ranking(pioneer_1=40, pioneer_2=80), ranking()])
def test_at_the_limit_the_best_of_then_is_taken(first: Ranking) -> None:
    made = decision(DecisionMode.OPERATOR, first)
    made.begin()
    assert made.next_deadline() == 160
    assert made.poll(159.9) == []
    made.rank_again(ranking(pioneer_1=90))
    (event,) = made.poll(160)
    assert isinstance(event, ReplacementChosen)
    assert (event.robot, event.by) == ("pioneer_1", "limit")


def test_at_the_limit_it_may_be_given_up() -> None:
    made = decision(DecisionMode.OPERATOR, ranking(pioneer_1=40), OnLimit.ABORT)
    made.begin()
    assert made.poll(160) == [Aborted("d1", "no operator chose in time")]
    with pytest.raises(NoCandidate, match="given up: no operator"):
        made.confirm("pioneer_1", "anna")
