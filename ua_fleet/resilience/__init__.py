"""Who takes over when a robot fails: candidates ranked by the Analytic Hierarchy Process, and the choice among them.

    weights = weigh(names, judgements)                          # Saaty's pairwise comparisons -> weights, consistency
    ranking = rank(criteria, weights, candidates)               # every figure that led to each score stands in it
    decision = Decision(...)                                    # an open choice: re-ranked, confirmed, timed out

Pure: raw values and time are arguments.
"""

from ua_fleet.resilience.ahp import (
    HIGHEST_CONSISTENCY_RATIO,
    MOST_ELEMENTS,
    RANDOM_INDEX,
    Judgements,
    Weights,
    weigh,
)
from ua_fleet.resilience.criteria import Criterion, CriterionKind, Missing, availability
from ua_fleet.resilience.decision import (
    Aborted,
    Confirmation,
    Decision,
    DecisionEvent,
    DecisionMode,
    OnLimit,
    RankingChanged,
    ReplacementChosen,
)
from ua_fleet.resilience.ranking import Candidate, Excluded, Ranked, Ranking, Synthesis, rank

__all__ = [
    "HIGHEST_CONSISTENCY_RATIO",
    "MOST_ELEMENTS",
    "RANDOM_INDEX",
    "Aborted",
    "Candidate",
    "Confirmation",
    "Criterion",
    "CriterionKind",
    "Decision",
    "DecisionEvent",
    "DecisionMode",
    "Excluded",
    "Judgements",
    "Missing",
    "OnLimit",
    "Ranked",
    "Ranking",
    "RankingChanged",
    "ReplacementChosen",
    "Synthesis",
    "Weights",
    "availability",
    "rank",
    "weigh",
]
