"""Steps of a scenario as JSON, with the keys that they have there: what a bridge gets of a plan.

The text of a scenario would be read anew with other keys; these steps are the ones that the server has validated, with
their timeouts, so that facts and execution ids of a bridge are about the same steps.
"""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.errors import ScenarioError
from ua_fleet.scenario.expression import Expression, parse_expression
from ua_fleet.scenario.model import (
    Argument,
    BranchPoint,
    Condition,
    End,
    EndOutcome,
    OnTimeout,
    OnUnknown,
    Parallel,
    Repeat,
    Sequence,
    Step,
    Task,
    Wait,
)

__all__ = ["MOST_DEPTH", "FragmentInvalid", "decode_step", "encode_step"]

MOST_DEPTH: Final = 60
"""Steps within each other that are read."""


class FragmentInvalid(ScenarioError):
    """What should be steps is none."""

    remedy = "Run the same version of ua-fleet in the server and in the bridge."


def encode_step(step: Step) -> dict[str, Any]:
    """A step as JSON has it; what has its default is left out."""
    match step:
        case Task():
            return _encode_task(step)
        case Sequence(steps=steps):
            content: dict[str, Any] = {"kind": "sequence", "steps": [encode_step(each) for each in steps]}
        case Parallel(branches=branches):
            content = {"kind": "parallel", "branches": [encode_step(each) for each in branches]}
        case Condition():
            content = {
                "kind": "if",
                "when": step.when.text,
                "then": encode_step(step.then),
                "else": encode_step(step.otherwise),
                "timeout_s": step.timeout_s,
            }
        case Repeat():
            content = {
                "kind": "repeat",
                "body": encode_step(step.body),
                "times": step.times,
                "while": _text(step.while_),
                "timeout_s": step.timeout_s,
            }
        case Wait():
            content = {
                "kind": "wait",
                "until": _text(step.until),
                "for_s": step.for_s,
                "timeout_s": step.timeout_s,
                "on_timeout": step.on_timeout.value,
            }
        case End(outcome=outcome, reason=reason):
            content = {"kind": "end", "outcome": outcome.value, "reason": reason}
        case BranchPoint():
            content = {
                "kind": "branch",
                "condition": _text(step.condition),
                "timeout_s": step.timeout_s,
                "is_loop": step.is_loop or None,
                "times": step.times,
                "round": step.round or None,
            }
    return {"key": step.key, "line": step.line} | {name: value for name, value in content.items() if value is not None}


def _encode_task(task: Task) -> dict[str, Any]:
    arguments = {
        name: {"=": value.text} if isinstance(value, Expression) else value for name, value in task.arguments.items()
    }
    content: dict[str, Any] = {
        "kind": "task",
        "key": task.key,
        "line": task.line,
        "name": task.name,
        "skill": task.skill,
        "robot": task.robot,
        "capacities": list(task.capacities),
        "arguments": arguments,
        "quantities": {name: list(quantity) for name, quantity in task.quantities.items()},
        "timeout_s": task.timeout_s,
        "retries": task.retries,
        "on_unknown": task.on_unknown.value,
        "after": list(task.after),
    }
    return {name: value for name, value in content.items() if value or name in ("key", "line")}


def _text(expression: Expression | None) -> str | None:
    return None if expression is None else expression.text


def decode_step(data: Any) -> Step:
    """The step that JSON has.

    Raises:
        FragmentInvalid: it is none, or is of another version.
    """
    try:
        return _decode(data, 0)
    except (KeyError, TypeError, ValueError, AttributeError, ScenarioError) as error:
        raise FragmentInvalid(f"a part of a plan has a step that cannot be read: {error!r}") from error


def _decode(data: Any, depth: int) -> Step:
    if depth > MOST_DEPTH:
        raise FragmentInvalid(f"steps within each other deeper than {MOST_DEPTH}")
    key, line, kind = str(data["key"]), int(data["line"]), data["kind"]
    match kind:
        case "task":
            return _decode_task(data, key, line)
        case "sequence":
            return Sequence(key, line, tuple([_decode(each, depth + 1) for each in data["steps"]]))
        case "parallel":
            return Parallel(key, line, tuple([_sequence(each, depth) for each in data["branches"]]))
        case "if":
            when = parse_expression(data["when"])
            then, otherwise = _sequence(data["then"], depth), _sequence(data["else"], depth)
            return Condition(key, line, when, then, otherwise, float(data["timeout_s"]))
        case "repeat":
            body, times = _sequence(data["body"], depth), data.get("times")
            return Repeat(key, line, body, times, _expression(data.get("while")), float(data["timeout_s"]))
        case "wait":
            until, on_timeout = _expression(data.get("until")), OnTimeout(data["on_timeout"])
            return Wait(key, line, until, None, data.get("for_s"), data.get("timeout_s"), on_timeout)
        case "end":
            return End(key, line, EndOutcome(data["outcome"]), str(data["reason"]))
        case "branch":
            condition, is_loop, times = _expression(data.get("condition")), bool(data.get("is_loop")), data.get("times")
            if condition is None and (not is_loop or times is None):
                raise FragmentInvalid("a decision has neither a condition nor a number")
            return BranchPoint(
                key, line, condition, float(data["timeout_s"]), is_loop, times, int(data.get("round", 0))
            )
        case _:
            raise FragmentInvalid(f"there is no kind of steps {kind!r}")


def _decode_task(data: Any, key: str, line: int) -> Task:
    given: dict[str, Any] = data.get("arguments", {})
    arguments: dict[str, Argument] = {
        name: value if isinstance(value, bool | int | float | str) else parse_expression(str(value["="]))
        for name, value in given.items()
    }
    return Task(
        key=key,
        line=line,
        name=str(data["name"]),
        skill=str(data["skill"]),
        robot=data.get("robot"),
        capacities=tuple(data.get("capacities", ())),
        arguments=arguments,
        quantities={name: (float(number), str(unit)) for name, (number, unit) in data.get("quantities", {}).items()},
        timeout_s=data.get("timeout_s"),
        retries=int(data.get("retries", 0)),
        on_unknown=OnUnknown(data.get("on_unknown", OnUnknown.ASK)),
        after=tuple(data.get("after", ())),
    )


def _sequence(data: Any, depth: int) -> Sequence:
    step = _decode(data, depth + 1)
    if not isinstance(step, Sequence):
        raise FragmentInvalid("a step stands where a list of steps is wanted")
    return step


def _expression(text: Any) -> Expression | None:
    return None if text is None else parse_expression(text)
