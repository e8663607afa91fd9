"""What clients give as results of a skill, and what they are refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

from ua_fleet.document import resolve_scalar
from ua_fleet.errors import SkillError
from ua_fleet.fleet.skills import ArgumentModel, SkillModel, argument_problem
from ua_fleet.values import BuiltinType, StatusCode

__all__ = ["OfferRefused", "read_results"]

_FLOATS: Final = (BuiltinType.FLOAT, BuiltinType.DOUBLE)


class OfferRefused(SkillError):
    """A client cannot do that with a request now."""

    ua_status: int = StatusCode.BAD_INVALID_STATE
    remedy = "See `ua-fleet skill offer --help`, and take a request that is open."


def read_results(skill: SkillModel, names: Sequence[str], texts: Sequence[str]) -> dict[str, Any]:
    """Results that were given as texts; raises OfferRefused with all that is wrong."""
    problems = list(_result_problems(skill, names, texts))
    if problems:
        raise OfferRefused("; ".join(problems))
    given = dict(zip(names, texts, strict=True))
    return {result.name: _typed(result, given[result.name]) for result in skill.results}


def _result_problems(skill: SkillModel, names: Sequence[str], texts: Sequence[str]) -> Iterator[str]:
    if len(names) != len(texts) or len(set(names)) != len(names):
        yield f"{len(names)} names of results, each once, need as many values; there are {len(texts)}"
        return
    known = {result.name: result for result in skill.results}
    yield from [f"{skill.name} has no result {name!r}" for name in names if name not in known]
    given = dict(zip(names, texts, strict=True))
    for name, result in known.items():
        if name not in given:
            yield f"the result {name!r} is missing"
        elif problem := argument_problem(replace(result, range=None), _typed(result, given[name])):
            yield problem


def _typed(result: ArgumentModel, text: str) -> Any:
    """A text as a value of a type, or as it stands where it is none."""
    if result.type == BuiltinType.STRING:
        return text
    value = resolve_scalar(text)
    if result.type in _FLOATS and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return text if value is None else value
