"""Rankings as JSON."""

from __future__ import annotations

from typing import Any

from ua_fleet.client import RankingInfo
from ua_fleet.console.shown import harmless_value, shown_value

__all__ = ["shown_ranking"]


def shown_ranking(ranking: RankingInfo) -> dict[str, Any]:
    """Who could take a task over, the best first, and why; and who is no candidate."""
    return {
        "criteria": [
            {"name": harmless_value(name), "weight": shown_value(weight)}
            for name, weight in zip(ranking.criteria, ranking.weights, strict=False)
        ],
        "ratio": shown_value(ranking.consistency_ratio),
        "robots": [
            {
                "robot": one.robot,
                "score": shown_value(one.score),
                "values": [
                    {"raw": shown_value(raw), "score": shown_value(score), "missing": harmless_value(missing)}
                    for raw, score, missing in zip(one.raw, one.scores, one.missing, strict=False)
                ],
            }
            for one in ranking.ranked
        ],
        "excluded": [
            {"robot": harmless_value(robot), "reason": harmless_value(reason)} for robot, reason in ranking.excluded
        ],
    }
