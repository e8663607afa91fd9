"""The schema of scenarios for editors says what the reader does, as far as a schema can."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from tests.unit.docs.pages import ROOT, Block, blocks
from tests.unit.scenario.test_read import BOX, HEAD, TASK
from ua_fleet.config.json_schema import schema_text
from ua_fleet.document import read_document
from ua_fleet.scenario.json_schema import scenario_schema
from ua_fleet.scenario.read import STEP_KEYS, read_scenario

COMMITTED = ROOT / "docs" / "schemas" / "scenario.schema.json"
EDITOR: Any = Draft202012Validator(scenario_schema())
PAGE = [block for block in blocks("yml") if block.page.name == "scenarios.md" and "steps:" in block.text]


def said(text: str) -> list[str]:
    """What an editor finds wrong with a file that is YAML as we read it."""
    document = read_document(text.encode(), "f.yaml")
    return [f"{error.json_path}: {error.message}"[:200] for error in EDITOR.iter_errors(document.data)]


def test_the_committed_schema_is_that_of_the_reader() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == schema_text(scenario_schema()), (
        "run: ua-fleet config schema --scenario -o docs/schemas/scenario.schema.json"
    )


def test_it_is_a_schema() -> None:
    Draft202012Validator.check_schema(scenario_schema())


def test_steps_have_the_keys_that_the_reader_knows() -> None:
    definitions = scenario_schema()["$defs"]
    for kind, keys in STEP_KEYS.items():
        assert set(definitions[kind]["properties"]) == {*keys, "description"}, kind


@pytest.mark.parametrize("block", [pytest.param(block, id=block.place) for block in PAGE])
def test_examples_of_the_documentation(block: Block) -> None:
    assert said(block.text) == []


def test_the_demonstrations() -> None:
    assert said(BOX) == []
    tasks = ROOT / "demo" / "ua_demo" / "talkrobots" / "nine_tasks.yaml"
    assert said(tasks.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "text",
    [
        f"name: s\nsteps: [{TASK}]",
        f"version: 2\nname: s\nsteps: [{TASK}]",
        f"version: 1\nsteps: [{TASK}]",
        f"version: 1\nname: 1a\nsteps: [{TASK}]",
        "version: 1\nname: s\n",
        f"version: 1\nname: s\nstep: []\nsteps: [{TASK}]",
        HEAD + "  - just text\n",
        HEAD + "  - {skill: k}\n",
        HEAD + "  - {task: a, end: done}\n",
        HEAD + "  - {task: a, robot: r}\n",
        HEAD + "  - {task: a, skill: k}\n",
        HEAD + "  - {task: a, robot: r, capacity: c, skill: k}\n",
        HEAD + "  - {task: a b, robot: r, skill: k}\n",
        HEAD + "  - {task: a, robot: r, skill: k, retries: -1}\n",
        HEAD + "  - {task: a, robot: r, skill: k, timeout_s: 0}\n",
        HEAD + "  - {task: a, robot: r, skill: k, on_unknown: rety}\n",
        HEAD + "  - {task: a, robot: r, skill: k, arguments: {x: [1]}}\n",
        HEAD + "  - {task: a, robot: r, skill: k, after: 3}\n",
        HEAD + "  - {task: a, robot: r, skill: k, timout_s: 3}\n",
        HEAD + f"  - parallel: [{TASK}]\n",
        HEAD + "  - if: a > 1\n",
        HEAD + f"  - repeat: {TASK}\n",
        HEAD + "  - {repeat: [], times: 2}\n",
        HEAD + "  - wait:\n",
        HEAD + "  - {wait: 2, event: E}\n",
        HEAD + "  - {wait: soon}\n",
        HEAD + "  - {end: maybe}\n",
        f"version: 1\nname: s\nparameters: [a]\nsteps: {TASK}",
        f"version: 1\nname: s\nparameters: {{a: {{range: [2]}}}}\nsteps: {TASK}",
        f"version: 1\nname: s\nparameters: {{a: {{default: [1]}}}}\nsteps: {TASK}",
    ],
)
def test_what_editors_and_the_reader_refuse(text: str) -> None:
    assert said(text)
    assert read_scenario(text.encode(), "F").problems


TASKS = st.fixed_dictionaries(
    {"task": st.sampled_from("abcde"), "skill": st.just("k")},
    optional={
        "robot": st.sampled_from(["r", None]),
        "capacity": st.just("grab"),
        "capacities": st.sampled_from(["a", ["a", "b"], [], None]),
        "after": st.sampled_from(["x", [], None]),
        "retries": st.integers(-1, 101) | st.none(),
        "timeout_s": st.floats(-1, 10) | st.none(),
        "arguments": st.dictionaries(st.text(max_size=3), st.integers() | st.booleans() | st.just("=a"), max_size=2),
        "on_unknown": st.sampled_from(["ask", "fail", None, "no"]),
    },
)
NUMBERS = st.sampled_from([None, 0, 1, 2.5])
CONDITIONS = st.sampled_from(["a > 1", True, 1])


def around(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    steps = inner | st.lists(inner, max_size=2) | st.none()
    return st.one_of(
        st.fixed_dictionaries({"sequence": steps}),
        st.fixed_dictionaries({"parallel": st.lists(steps, max_size=3)}),
        st.fixed_dictionaries({"if": CONDITIONS}, optional={"then": steps, "else": steps, "timeout_s": NUMBERS}),
        st.fixed_dictionaries({"repeat": steps}, optional={"times": NUMBERS, "while": CONDITIONS}),
        st.fixed_dictionaries(
            {"wait": NUMBERS}, optional={"until": CONDITIONS, "event": st.just("E"), "on_timeout": st.just("continue")}
        ),
        st.fixed_dictionaries({"end": st.sampled_from(["done", None])}, optional={"reason": st.just("x")}),
    )


@given(st.recursive(TASKS, around, max_leaves=4))
def test_whatever_the_reader_takes_editors_take(step: Any) -> None:
    data = {"version": 1, "name": "s", "steps": [step]}
    if not read_scenario(json.dumps(data).encode(), "F").problems:
        assert [error.message for error in EDITOR.iter_errors(data)] == []
