"""The pages that are made from the code are those that it makes now."""

from __future__ import annotations

from types import ModuleType

import pytest

from tests.unit.docs.pages import ROOT
from ua_fleet.cli import reference as command_line
from ua_fleet.config.reference import put_between
from ua_fleet.server import nodeset_reference as nodeset


@pytest.mark.parametrize(("module", "name"), [(command_line, "command-line.md"), (nodeset, "nodeset.md")])
def test_page_is_current(module: ModuleType, name: str) -> None:
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    made = put_between(text, module.BEGIN, module.END, module.reference())
    assert made == text, f"run: python -m {module.__name__} docs/{name}"


def test_each_method_tells_its_arguments_and_its_role() -> None:
    text = (ROOT / "docs" / "nodeset.md").read_text(encoding="utf-8")
    _, _, register = text.partition("### Fleet/RegisterRobot\n")
    assert register.startswith("\nRole: engineer\n")
    assert "| in | `Definition` | String |" in register
    _, _, listing = text.partition("### Fleet/Scenarios/List\n")
    assert listing.startswith("\nRole: observer\n")


def test_types_of_events_stand_apart() -> None:
    objects, _, events = nodeset.types().partition("## Event types")
    assert "### SkillType" in objects
    assert "### FaultAlarmType" in events


def test_a_text_of_the_help_is_no_heading() -> None:
    titles = [line for line in command_line.reference().splitlines() if line.startswith("#")]
    assert titles
    assert [title for title in titles if not title.startswith(("## ", "### "))] == []
