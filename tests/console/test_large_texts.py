"""Texts of 1 MB in the page: a value is cut and said, a scenario and a comment are refused, and the page lives."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from playwright.sync_api import Page, expect

from tests.console.conftest import Fleet, fleet_of
from tests.console.scenario_pages import PLACE, text_of
from tests.console.test_alarms import ask
from tests.integration.scenarios.conftest import Plant

Open = Callable[..., Page]
CHARACTERS: Final = 1_000_000
PASTE: Final = """(editor, text) => {
  const clipboardData = new DataTransfer();
  clipboardData.setData('text/plain', text);
  editor.dispatchEvent(new ClipboardEvent('paste', { clipboardData, bubbles: true, cancelable: true }));
}"""
"""As who pastes it: a text that long is typed by nobody."""


def with_a_large_text(plant: Plant) -> None:
    path: Path = plant.folder / "fleet.json"
    raw: dict[str, Any] = json.loads(path.read_text())
    log = {"id": 1330, "type": "String", "origin": "server", "initial": "<b>" + "y" * (CHARACTERS - 3)}
    raw["robots"]["left"].setdefault("data", {})["log"] = log
    path.write_text(json.dumps(raw))


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), with_a_large_text) as running:
        yield running


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["400", "413"]


def _lives(page: Page) -> None:
    """What another page does is seen in this one."""
    page.goto(f"{page.url.partition('#')[0]}#/hall/fleet")
    card = page.get_by_role("article").filter(has=page.get_by_role("link", name="middle", exact=True))
    expect(card).to_be_visible()
    ask(page, "robots.hold", robot="middle", reason="a new tyre")
    expect(card).to_contain_text("a new tyre")
    ask(page, "robots.release", robot="middle")
    expect(card).not_to_contain_text("a new tyre")


def test_a_large_value_is_cut_and_said(open_page: Open) -> None:
    page = open_page("operator", "#/hall/robot/left")
    row = page.get_by_role("table", name="Data").get_by_role("row").filter(has_text="log")
    expect(row).to_contain_text(f"{CHARACTERS} characters, beginning <b>yyy")
    assert len(row.inner_text()) < 20_000
    assert row.locator("b").count() == 0
    box = row.bounding_box()
    assert box is not None
    assert box["height"] < 50
    _lives(page)


def test_a_large_scenario_is_refused_and_stays_in_the_editor(open_page: Open) -> None:
    page = open_page("engineer", PLACE)
    page.get_by_role("button", name="New scenario").click()
    text = text_of(page, "new_scenario")
    expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
    text.click()
    page.keyboard.press("Control+End")
    text.evaluate(PASTE, "\n".join(f"  # {'z' * 95}" for _ in range(CHARACTERS // 100)))
    page.keyboard.press("Control+s")
    refused = page.get_by_role("alert").first
    expect(refused).to_contain_text("300000 characters")
    page.keyboard.press("Control+z")
    expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
    _lives(page)


def test_a_large_comment_is_cut_where_it_is_written(open_page: Open) -> None:
    page = open_page("operator", "#/hall/fleet")
    page.get_by_role("button", name="Actions for right").click()
    page.get_by_role("menuitem", name="Hold").click()
    dialog = page.get_by_role("dialog")
    field = dialog.get_by_role("textbox")
    field.focus()
    page.keyboard.insert_text("c" * CHARACTERS)
    dialog.get_by_role("button", name="Hold").click()
    expect(dialog).to_have_count(0)
    expect(page.get_by_role("article").filter(has_text="cccc")).to_have_count(1)
    assert len(page.get_by_role("article").filter(has_text="cccc").inner_text()) < 2000
    ask(page, "robots.release", robot="right")
    _lives(page)
