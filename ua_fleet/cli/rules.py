"""The loop rule that a process runs with."""

from __future__ import annotations

from collections.abc import Callable

from ua_fleet.cli.output import message
from ua_fleet.topics import LoopVerdict, Side, loop_verdict

__all__ = ["rule_for"]


def _forward_all(side: Side, _origin: int, _own_space: int, _own_publication: bool) -> LoopVerdict:
    return LoopVerdict.TO_SPACE if side is Side.PUBSUB else LoopVerdict.TO_PUBSUB


def rule_for(without_loop_rule: bool) -> Callable[[Side, int, int, bool], LoopVerdict]:
    """`loop_verdict`, or for a test a rule that forwards everything, which is said."""
    if not without_loop_rule:
        return loop_verdict
    message("the loop rule is OFF: messages go round for ever; this is for tests only")
    return _forward_all
