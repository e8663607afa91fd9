"""A segment of a plan in one round as a scenario of its own, which the engine of scenarios runs."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from ua_fleet.carrying.fragments import FragmentInvalid, decode_step, encode_step
from ua_fleet.scenario.expression import Value
from ua_fleet.scenario.model import BranchPoint, Parameter, Scenario, Sequence
from ua_fleet.scenario.state import RunState

__all__ = ["decode_scenario", "segment_scenario", "way_taken"]


def segment_scenario(
    name: str,
    body: Sequence,
    rounds: tuple[int, ...] = (),
    values: Mapping[str, Value] | None = None,
    outside: Collection[str] = (),
) -> Scenario:
    """A segment in one round as the engine runs it. What is known already are its parameters, results by `task.result`.

    Its steps have the keys that they have in the whole scenario, with the numbers of the repetitions around them.

    Args:
        name: of the scenario.
        body: of the segment.
        rounds: the numbers of the repetitions around it.
        values: what is known.
        outside: the tasks of other branches that it hears of.
    """
    steps, scope = list(body.steps), rounds
    if steps and isinstance(point := steps[-1], BranchPoint) and point.is_loop:
        steps[-1], scope = replace(point, round=rounds[-1]), rounds[:-1]
    numbers = "".join(f"@{number}" for number in scope)
    return _scenario(name, replace(body, steps=tuple(steps)), numbers, frozenset(outside), values or {})


def _scenario(name: str, body: Sequence, scope: str, outside: frozenset[str], values: Mapping[str, Value]) -> Scenario:
    """With a text that says all that `decode_scenario` needs, since the engine keeps a run's text and nothing else."""
    content = {
        "name": name,
        "body": encode_step(body),
        "scope": scope,
        "outside": sorted(outside),
        "values": dict(values),
    }
    text = json.dumps(content, ensure_ascii=False)
    parameters = tuple([Parameter(each, value) for each, value in values.items()])
    return Scenario(name, body, "", parameters, text, scope, outside)


def decode_scenario(text: str) -> Scenario:
    """The scenario of the text of a segment; raises FragmentInvalid."""
    try:
        data: Any = json.loads(text)
        body, values = decode_step(data["body"]), dict(data["values"])
        if not isinstance(body, Sequence):
            raise FragmentInvalid("the body of a segment is no list of steps")
        outside = frozenset([str(task) for task in data["outside"]])
        return _scenario(str(data["name"]), body, str(data["scope"]), outside, values)
    except (KeyError, TypeError, ValueError) as error:
        raise FragmentInvalid(f"a segment of a plan cannot be read: {error!r}") from error


def way_taken(scenario: Scenario, state: RunState) -> bool:
    """The way that a segment has decided for which ends with a decision; True where it does not."""
    point = scenario.body.steps[-1] if scenario.body.steps else None
    if not isinstance(point, BranchPoint):
        return True
    key = point.key + scenario.scope
    if point.is_loop:
        return state.iterations.get(key, -1) >= point.round
    return state.branches.get(key, False)
