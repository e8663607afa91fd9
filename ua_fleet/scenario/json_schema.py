"""The JSON Schema (2020-12) of scenarios' files, for editors: the shapes that `read_scenario` takes.

It knows no fleet: whether there is such a robot, skill or argument, `ua-fleet scenario validate` says.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final

from ua_fleet.scenario.model import EndOutcome, OnTimeout, OnUnknown
from ua_fleet.scenario.read import MOST_REPEATS, MOST_RETRIES, MOST_SECONDS, VERSION

__all__ = ["scenario_schema"]

Schema = dict[str, Any]

_NAME: Final = "^[A-Za-z_][A-Za-z0-9_]{0,63}$"
_STEPS: Final[Schema] = {"$ref": "#/$defs/Steps"}
_VALUE: Final[Schema] = {"type": ["number", "string", "boolean"]}
_NO_VALUE: Final[Schema] = {"type": "null"}


def _said(text: str, **shape: Any) -> Schema:
    return {"description": text, **shape}


def _text(text: str, **more: Any) -> Schema:
    return _said(text, type=["string", "null"], minLength=1, **more)


def _choice(text: str, choices: type[StrEnum], default: StrEnum) -> Schema:
    return _said(text, enum=[*(one.value for one in choices), None], default=default.value)


def _seconds(text: str) -> Schema:
    return _said(text, type=["number", "null"], exclusiveMinimum=0, maximum=MOST_SECONDS)


def _whole(text: str, least: int, most: int, **more: Any) -> Schema:
    return _said(text, type=["integer", "null"], minimum=least, maximum=most, **more)


def _names(text: str) -> Schema:
    name: Schema = {"type": "string", "minLength": 1}
    return _said(text, anyOf=[name, {"type": "array", "items": name}, _NO_VALUE])


def _expression(text: str, example: str) -> Schema:
    return _said(text, type=["string", "boolean", "number"], examples=[example])


def _step(text: str, properties: Schema, *needed: str, **rules: Any) -> Schema:
    """A step. Its first key tells the kind."""
    everywhere = {"description": _text("Text for people.")}
    return {
        "description": text,
        "type": "object",
        "required": list(needed),
        "properties": {**properties, **everywhere},
        "additionalProperties": False,
        **rules,
    }


def _present(key: str) -> Schema:
    return {"required": [key], "properties": {key: {"not": _NO_VALUE}}}


def _some(key: str) -> Schema:
    """Steps that are not none."""
    return {"required": [key], "properties": {key: {"not": {"enum": [None, []]}}}}


_STEP_SHAPES: Final[dict[str, Schema]] = {
    "task": _step(
        "One skill on one robot, or on whichever robot has the capacities.",
        {
            "task": _said(
                "Name of the task, by which conditions and `after` refer to it.", type="string", pattern=_NAME
            ),
            "skill": _said("Name of the skill.", type="string", minLength=1),
            "robot": _text("The robot that does it. Give either `robot` or `capacity`."),
            "capacity": _said("A capacity that a robot needs for it.", type="string", minLength=1),
            "capacities": _names("Capacities that a robot needs for it."),
            "arguments": _said(
                "Arguments by name: a value, a number with its unit (`20 deg`), or `=` and an expression.",
                type=["object", "null"],
                additionalProperties=_VALUE,
            ),
            "timeout_s": _seconds("An execution that takes longer has failed; the skill's own if left out."),
            "retries": _whole("How often it is tried again when it has failed.", 0, MOST_RETRIES, default=0),
            "on_unknown": _choice("What to do when it is unknown whether it was done.", OnUnknown, OnUnknown.ASK),
            "after": _names("Tasks that must have been done before, also those of other branches."),
        },
        "task",
        "skill",
        oneOf=[
            _present("robot"),
            {"anyOf": [{"required": ["capacity"]}, _some("capacities")]},
        ],
    ),
    "sequence": _step("Steps one after the other.", {"sequence": _STEPS}, "sequence"),
    "parallel": _step(
        "Branches side by side; it ends when all have ended, and has failed if one has.",
        {"parallel": _said("A step, or a list of steps, for each branch.", type="array", minItems=2, items=_STEPS)},
        "parallel",
    ),
    "if": _step(
        "One of two ways.",
        {
            "if": _expression("Over parameters, results of tasks and values of robots.", "temperature > 20"),
            "then": _STEPS,
            "else": _STEPS,
            "timeout_s": _seconds("How long a value that is not known is waited for; 10 if left out."),
        },
        "if",
        anyOf=[_some("then"), _some("else")],
    ),
    "repeat": _step(
        "Repeats steps: a number of times, or while a condition holds, or both.",
        {
            "repeat": _STEPS,
            "times": _whole("How often.", 1, MOST_REPEATS),
            "while": _expression("It is repeated while this holds.", "battery > 20"),
            "timeout_s": _seconds("How long a value that is not known is waited for; 10 if left out."),
        },
        "repeat",
        allOf=[_some("repeat")],
        anyOf=[_present("times"), {"required": ["while"]}],
    ),
    "wait": _step(
        "Until a condition holds, an event happens, or some time is over.",
        {
            "wait": _seconds("For this number of seconds; without a value until `until` or `event`."),
            "until": _expression("Until this holds.", "temperature < 40"),
            "event": _text("Until this event is sent to the run."),
            "timeout_s": _seconds("Longest wait."),
            "on_timeout": _choice("What to do when it does not come in time.", OnTimeout, OnTimeout.FAIL),
        },
        "wait",
        oneOf=[_present("wait"), {"required": ["until"]}, {"required": ["event"]}],
    ),
    "end": _step(
        "The run ends here.",
        {"end": _choice("How it ends.", EndOutcome, EndOutcome.DONE), "reason": _text("Text for people: why.")},
        "end",
    ),
}


def scenario_schema() -> Schema:
    """The schema."""
    kinds = list(_STEP_SHAPES)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "scenario",
        "description": "A scenario: skills of several robots in order, side by side, and on conditions.",
        "type": "object",
        "required": ["version", "name", "steps"],
        "additionalProperties": False,
        "properties": {
            "version": _said("Version of this format.", const=VERSION),
            "name": _said("Name of the scenario.", type="string", pattern="^[A-Za-z][A-Za-z0-9_-]{0,63}$"),
            "description": _text("Text for people."),
            "parameters": _said(
                "Values that are given when a run starts, by name.",
                type=["object", "null"],
                patternProperties={_NAME: {"$ref": "#/$defs/Parameter"}},
                additionalProperties=False,
            ),
            "steps": {"allOf": [_STEPS, {"not": {"enum": [None, [], {}]}}]},
        },
        "$defs": {
            "Steps": _said(
                "Steps one after the other; a single one needs no list.",
                anyOf=[{"$ref": "#/$defs/Step"}, {"type": "array", "items": {"$ref": "#/$defs/Step"}}, _NO_VALUE],
            ),
            "Step": {
                "type": "object",
                "oneOf": [{"required": [kind]} for kind in kinds],
                "allOf": [{"if": {"required": [kind]}, "then": {"$ref": f"#/$defs/{kind}"}} for kind in kinds],
            },
            **_STEP_SHAPES,
            "Parameter": _said(
                "A parameter: its default value, or keys.",
                anyOf=[
                    {"type": ["number", "string", "boolean", "null"]},
                    {
                        "type": "object",
                        "additionalProperties": False,
                        "properties": {
                            "default": {**_VALUE, "type": [*_VALUE["type"], "null"]},
                            "unit": _text("Unit, e.g. `deg`."),
                            "range": _said(
                                "Least and greatest value.",
                                type=["array", "null"],
                                items={"type": "number"},
                                minItems=2,
                                maxItems=2,
                            ),
                            "description": _text("Text for people."),
                        },
                    },
                ],
            ),
        },
    }
