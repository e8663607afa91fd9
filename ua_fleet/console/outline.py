"""A scenario's text as a tree of steps, for a graph and for the editor. Pure; the server's Validate is what decides."""

from __future__ import annotations

from typing import Any

from ua_fleet.console.shown import harmless_value, shown_value
from ua_fleet.scenario import read_scenario
from ua_fleet.scenario.model import BranchPoint, Condition, End, Parallel, Repeat, Sequence, Step, Task, Wait

__all__ = ["outline"]


def outline(text: str) -> dict[str, Any]:
    """The tree of a scenario, its parameters, and what is wrong with the text by itself, with its lines."""
    reading = read_scenario(text.encode("utf-8", "replace"))
    problems = [{"line": one.line, "message": harmless_value(one.message)} for one in reading.problems]
    scenario = reading.scenario
    return {
        "name": harmless_value(scenario.name),
        "description": harmless_value(scenario.description),
        "parameters": [
            {
                "name": one.name,
                "default": shown_value(one.default),
                "unit": harmless_value(one.unit or ""),
                "low": one.range[0] if one.range else None,
                "high": one.range[1] if one.range else None,
                "help": harmless_value(one.description),
            }
            for one in scenario.parameters
        ],
        "steps": [_step(one) for one in scenario.body.steps],
        "problems": problems,
    }


def _step(step: Step) -> dict[str, Any]:
    shown: dict[str, Any] = {"step": step.key, "line": step.line}
    match step:
        case Task():
            shown |= {
                "kind": "task",
                "name": step.name,
                "skill": step.skill,
                "robot": step.robot,
                "capacities": list(step.capacities),
                "after": list(step.after),
                "on_unknown": step.on_unknown.value,
                "retries": step.retries,
                "timeout_s": step.timeout_s,
            }
        case Sequence():
            shown |= {"kind": "sequence", "steps": [_step(one) for one in step.steps]}
        case Parallel():
            shown |= {"kind": "parallel", "steps": [_step(one) for one in step.branches]}
        case Condition():
            shown |= {
                "kind": "if",
                "when": harmless_value(step.when.text),
                "then": [_step(one) for one in step.then.steps],
                "else": [_step(one) for one in step.otherwise.steps],
            }
        case Repeat():
            shown |= {
                "kind": "repeat",
                "times": step.times,
                "while": harmless_value(step.while_.text) if step.while_ else None,
                "steps": [_step(one) for one in step.body.steps],
            }
        case Wait():
            shown |= {
                "kind": "wait",
                "for_s": step.for_s,
                "until": harmless_value(step.until.text) if step.until else None,
                "event": step.event,
                "timeout_s": step.timeout_s,
            }
        case BranchPoint():
            pass  # it comes of a split between bridges, and stands in no text
        case End():
            shown |= {"kind": "end", "outcome": step.outcome.value, "reason": harmless_value(step.reason)}
    return shown
