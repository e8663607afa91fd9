"""Everything that people may get wrong, given to a real server: one reason each, nothing started, and it stays up."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest
from asyncua.client.client import Client

from tests.integration.scenarios.conftest import ENGINEER, Plant, call, texts, value
from tests.integration.server_model.harness import ua

HEAD: Final = "version: 1\nname: wrong\nsteps:\n"
WAIT: Final = f"{HEAD}  - {{wait: 1}}\n"
NOTHING: Final = texts()


def numbers(*values: float) -> Any:
    return ua.Variant(list(values), ua.VariantType.Double, None, True)


SCENARIOS: Final[dict[str, tuple[str, str]]] = {
    "too long": (WAIT + "#" * 300_000, "a scenario has at most 262144"),
    "nested deeply": (f"{HEAD}  - {'[' * 5000}", "4: nested deeper than 24 levels"),
    "nested JSON": ('{"a":' * 5000, "1: nested deeper than 24 levels"),
    "aliases": ("a: &a [x, x]\nb: &b [*a, *a]\n", "1: anchors (&) and aliases (*) are not used"),
    "tags": (f"{HEAD}  - !!python/object/apply:os.system [ls]\n", "4: tags (!) are not used"),
    "merge keys": ("version: 1\n<<: {name: a}\n", "2: anchors (&), tags (!) and merge keys (<<)"),
    "control characters": ("version: 1\nname: a\0\n", "control characters are not allowed"),
    "half of a surrogate": ('version: 1\nname: "\\ud800"\n', "invalid Unicode character escape code"),
    "two documents": (f"{WAIT}---\na: 1\n", "5: a second document (---) begins here"),
    "cut off": ('{"version": 1,', "is not YAML"),
    "twice": (f"version: 1\n{WAIT}", "2:version: `version` is written twice, first in line 1"),
    "too many repetitions": (
        f"{HEAD}  - {{repeat: [{{repeat: [{{wait: 1}}], times: 1000000}}], times: 1000000}}\n",
        "would repeat 1000000000000 times in all",
    ),
    "no pause": (f"{HEAD}  - {{repeat: [{{wait: 0.001}}], times: 1000000}}\n", "would turn without a pause"),
    "no number of seconds": (f"{HEAD}  - {{wait: 1e999}}\n", "`wait` must be a number of seconds above 0"),
    "a circle": (
        f"{HEAD}  - {{task: a, skill: work, robot: left, after: [b]}}\n  - {{task: b, skill: work, robot: left}}\n",
        "5: tasks wait for each other: a after b after a",
    ),
    "a unit of another kind": (
        f"{HEAD}  - {{task: a, skill: work, robot: left, arguments: {{seconds: 3 kg}}}}\n",
        "4: task 'a': seconds: kg measures mass, and s measures time",
    ),
    "arguments that are none": (
        f"{HEAD}  - {{task: a, skill: work, robot: left, arguments: {{work: [1], speed: 2}}}}\n",
        "an argument is a number, a text, true, false",
    ),
    "what is never reached": (f"{HEAD}  - {{end: done}}\n  - {{wait: 1}}\n", "5: is never reached"),
    "a power": (f"{HEAD}  - {{if: 9 ** 9 ** 9 > 1, then: [{{wait: 1}}]}}\n", "no binop here"),
}


@pytest.fixture
async def clients(plant: Plant) -> Any:
    """An operator and an engineer, at one server for all that is wrong."""
    async with plant.server() as server, server.client() as operator, server.client(ENGINEER) as engineer:
        yield operator, engineer
        listed = await call(operator, "Scenarios", "List")
        assert (listed.status, listed.outputs) == (0, [[], [], []]), "it is still there"
        assert await operator.get_node("ns=2;s=Fleet.Scenarios.Runs").get_children() == [], "nothing was started"


async def test_scenarios_that_cannot_be_read_or_run(clients: tuple[Client, Client]) -> None:
    operator, _ = clients
    for what, (text, said) in SCENARIOS.items():
        if len(text) < 262_144:
            valid, problems, _ = (await call(operator, "Scenarios", "Validate", text)).outputs
            assert not valid, what
            assert any(said in problem for problem in problems), (what, problems)
            assert all("\n" not in problem and len(problem) < 1000 for problem in problems), what
        refused = await call(operator, "Scenarios", "Run", text, NOTHING, NOTHING)
        assert refused.status == 2, what
        assert said in refused.message, (what, refused.message)
    many = await call(operator, "Scenarios", "Validate", HEAD + "  - x\n" * 5000)
    assert (len(many.outputs[1]), many.outputs[1][-1]) == (501, "and 4500 problems more")


async def test_arguments_of_methods_that_mean_nothing(clients: tuple[Client, Client]) -> None:
    operator, engineer = clients
    no_text, no_texts = ua.Variant(None, ua.VariantType.String), texts(["a", "b"])
    for owner, name, arguments, status, said in (
        ("Scenarios", "Run", ("nowhere", NOTHING, NOTHING), 1, "there is no scenario 'nowhere'"),
        ("Scenarios", "Run", (no_text, NOTHING, NOTHING), 1, "'' is no name of a scenario"),
        ("Scenarios", "Run", (WAIT, no_texts, NOTHING), 2, "2 names were given with 0 values"),
        ("Scenarios", "Run", (WAIT, texts(["a", "a"]), no_texts), 2, "a name was given twice"),
        ("Scenarios", "Run", (WAIT, texts(["a"] * 1001), NOTHING), 2, "at most 1000 items"),
        ("Scenarios", "Run", (WAIT, texts(["speed"]), texts(["1"])), 2, "there is no parameter 'speed'"),
        ("Scenarios", "Abort", ("x" * 100_000, "y"), 1, "there is no run 'xxx"),
        ("Scenarios", "Answer", ("nowhere", "a", "perhaps"), 1, "there is no run 'nowhere' under way"),
        ("Resilience", "Confirm", ("a\nb", "left"), 1, "there is no open decision 'a\\nb'"),
        ("Resilience", "WhatIf", ("nobody",), 1, "there is no robot 'nobody'"),
        ("Faults", "RaiseFault", ("nobody", "x"), 1, "there is no robot 'nobody'"),
        ("Faults", "ClearFault", ("",), 1, "there is no robot ''"),
    ):
        called = await call(operator, owner, name, *arguments)
        assert (called.status, said in called.message) == (status, True), (name, called)
        assert len(called.message) < 1000
    with pytest.raises(ua.UaStatusCodeError, match="BadInvalidArgument"):
        await call(operator, "Scenarios", "Run", 3, NOTHING, NOTHING)
    with pytest.raises(ua.UaStatusCodeError, match="BadArgumentsMissing"):
        await call(operator, "Scenarios", "Run", WAIT)
    for pairs, values, said in (
        (["a/b"], numbers(2), "'a' is not among 'availability'"),
        (["a/b", "a / b"], numbers(1, 1), "a / b was given twice"),
        (["availability"], numbers(1), "'availability' is no pair of criteria; write them as one/other"),
        (["availability/availability"], numbers(math.nan), "is nan; a judgement is a number from 1/9 to 9"),
        (["availability/availability"], numbers(-1), "is -1; a judgement is a number from 1/9 to 9"),
        (["x" * 100_000], numbers(1), "is no pair of criteria"),
        (["a/b"], numbers(), "1 pairs were given with 0 values"),
    ):
        called = await call(engineer, "Resilience", "SetJudgements", texts(pairs), values)
        assert (called.status, said in called.message) == (2, True), called
    for mode, limit_s, on_limit in (
        *(("auto", 0.0, ""), ("operator", 1.0, "worst")),
        *(("operator", limit_s, "") for limit_s in (-1.0, math.nan, math.inf, 1e300)),
    ):
        called = await call(engineer, "Resilience", "SetMode", mode, limit_s, on_limit)
        assert (called.status, "modes are operator, automatic, abort" in called.message) == (2, True), called
    assert await value(engineer, "Resilience.Mode") == "operator"
    assert (await call(operator, "Faults", "RaiseFault", "left", "a\n\nb" * 10_000)).status == 0
    reason = await value(operator, "Faults.left.robot.Reason")
    assert (len(reason), reason[:7]) == (200, "a ba ba")
