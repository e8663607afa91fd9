"""The quality files of the bridges: every rule is answered, and what is `done` has tests that exist."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import Any, cast

import pytest
import yaml

from tests.architecture.statements import statements
from tests.contract.conftest import DRIVERS
from tests.system import ROOT

PAGE = ROOT / "docs" / "adding-a-bridge.md"
BRIDGES = sorted(path.parent for path in (ROOT / "bridges" / "ua_bridges").glob("*/config.py"))
RULES = re.findall(r"^\| `(\w+)` \| ", PAGE.read_text(encoding="utf-8").partition("| rule |")[2], re.MULTILINE)
"""The page that explains the rules is the list of them."""
ANSWERS = ("done", "todo", "exempt")


def load(folder: Path) -> dict[str, Any]:
    """The rules of a bridge with their answers."""
    file = folder / "quality.yaml"
    assert file.is_file(), f"{file.relative_to(ROOT)} is missing; see {PAGE.name}"
    document = yaml.safe_load(file.read_text(encoding="utf-8"))
    assert isinstance(document, dict)
    return cast("dict[str, Any]", document)


@cache
def names_of_tests(file: Path) -> frozenset[str]:
    """The names of the tests in a file."""
    return frozenset(
        node.name
        for node in statements(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_")
    )


def missing_test(reference: str) -> str:
    """Why `path::test`, or `path` for all tests of a file, names no test; empty where it does."""
    name, _, test = reference.partition("::")
    file = ROOT / name
    if not name.startswith("tests/") or not file.is_file():
        return f"there is no {name}"
    there = names_of_tests(file)
    return "" if (test in there if test else there) else f"{name} has no {test or 'tests'}"


def problem_of(answer: object) -> str:
    """What is wrong with the answer to a rule; empty where nothing is."""
    if not isinstance(answer, dict) or len(cast("dict[object, object]", answer)) != 1:
        return f"answer it with one of {', '.join(ANSWERS)}"
    ((kind, content),) = cast("dict[object, object]", answer).items()
    if kind not in ANSWERS:
        return f"answer it with one of {', '.join(ANSWERS)}"
    if kind != "done":
        is_told = isinstance(content, str) and len(content) >= 20
        return "" if is_told else "say what is missing, or why it does not apply"
    if not isinstance(content, list) or not content:
        return "name the tests that prove it"
    return "; ".join(filter(None, (missing_test(str(test)) for test in cast("list[object]", content))))


def problems(quality: dict[str, Any]) -> list[str]:
    """What is wrong with a bridge's answers."""
    found = [f"unknown rule {rule}" for rule in quality if rule not in RULES]
    return found + [f"{rule}: {problem}" for rule in RULES if (problem := problem_of(quality.get(rule)))]


@pytest.mark.parametrize("folder", [pytest.param(folder, id=folder.name) for folder in BRIDGES])
def test_every_rule_is_answered(folder: Path) -> None:
    assert problems(load(folder)) == []


@pytest.mark.parametrize("folder", [pytest.param(folder, id=folder.name) for folder in BRIDGES])
def test_rules_that_nobody_is_exempt_from(folder: Path) -> None:
    quality = load(folder)
    assert "done" in quality["contract_suite"]
    assert folder.name in DRIVERS
    for rule in ("drops_counted", "clean_stop", "healing_bridge", "secured"):
        assert "exempt" not in quality[rule]


def test_bridges_and_rules_are_found() -> None:
    assert {folder.name for folder in BRIDGES} >= {"ros1", "ros2"}
    assert len(RULES) == len(set(RULES)) > 20
    assert RULES[0] == "contract_suite"


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (None, "answer it with one of"),
        ({"perhaps": "one day"}, "answer it with one of"),
        ({"done": []}, "name the tests"),
        ({"done": "tests/x.py"}, "name the tests"),
        ({"done": ["tests/contract/no_such_file.py"]}, "there is no tests/contract/no_such_file.py"),
        ({"done": ["tests/contract/test_driver.py::test_none"]}, "has no test_none"),
        ({"done": ["tests/contract/harness.py"]}, "has no tests"),
        ({"done": ["docs/ros.md"]}, "there is no docs/ros.md"),
        ({"todo": ""}, "say what is missing"),
        ({"exempt": True}, "say what is missing"),
    ],
)
def test_mistakes_are_seen(answer: object, problem: str) -> None:
    quality = {**load(BRIDGES[0]), "latched": answer}
    (found,) = problems(quality)
    assert found.startswith("latched: ")
    assert problem in found
