"""Texts of 1 MB in the page: a value is cut and said, a scenario and a comment are refused, and the page lives."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import USERS, Console, Fleet, fleet_of
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
    plant.scenario("waits", "  - {wait: 600}\n")


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), with_a_large_text) as running:
        yield running


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["400", "413"]


FILTERS: Final = {
    "Search robots": ("#/hall/fleet", "No robot matches."),
    "Search scenarios": (PLACE, "No scenario matches."),
    "Search alarms and events": ("#/hall/alarms?show=events", "No event"),
    "PublisherId or UA topic": ("#/hall/pubsub?show=messages", ""),
}
"""By their names: where each stands, and what is said where nothing is like that. Others are the same part."""


def typed(field: Locator, text: str) -> None:
    """As a keyboard does it, at once."""
    field.focus()
    field.page.keyboard.insert_text(text)


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


@pytest.mark.parametrize("name", FILTERS)
def test_a_large_filter_is_cut_where_it_is_written(open_page: Open, name: str) -> None:
    """It stands in the page's address."""
    place, nothing = FILTERS[name]
    page = open_page("engineer", place)
    field = page.get_by_placeholder(name)
    typed(field, "f" * CHARACTERS)
    expect(field).to_have_value("f" * 256)
    if nothing:
        expect(page.get_by_role("main")).to_contain_text(nothing)
    page.keyboard.press("Enter")
    assert len(page.url) < 400
    page.reload()
    expect(page.get_by_role("navigation", name="Pages")).to_be_visible()
    _lives(page)


def test_a_large_node_id_is_refused(open_page: Open) -> None:
    page = open_page("engineer", "#/hall/space")
    typed(page.get_by_placeholder("NodeId or path"), "ns=2;s=" + "n" * CHARACTERS)
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert").first).to_contain_text("Bad")
    _lives(page)


def test_a_large_value_is_refused_and_said(open_page: Open) -> None:
    """It is larger than a request may be; what was written before stays."""
    page = open_page("engineer", "#/hall/robot/left")
    page.get_by_role("button", name="Write log").click()
    dialog = page.get_by_role("dialog")
    field = dialog.get_by_role("textbox")
    field.fill("")
    typed(field, "w" * (2 * CHARACTERS))
    dialog.get_by_role("button", name="Write", exact=True).click()
    expect(dialog.get_by_role("alert")).to_contain_text("1100000")
    page.keyboard.press("Escape")
    expect(page.get_by_role("table", name="Data").get_by_role("row").filter(has_text="log")).to_contain_text("<b>yyy")
    _lives(page)


def test_a_large_comment_on_an_alarm_is_cut_where_it_is_written(open_page: Open) -> None:
    page = open_page("operator", "#/hall/alarms")
    ask(page, "fault.raise", robot="left", reason="r" * 200)
    page.get_by_role("button", name="Comment…").first.click()
    dialog = page.get_by_role("dialog")
    typed(dialog.get_by_role("textbox"), "c" * CHARACTERS)
    dialog.get_by_role("button", name="Keep the comment").click()
    expect(dialog).to_have_count(0)
    alarm = page.get_by_role("main").get_by_role("article").filter(has_text="cccc")
    expect(alarm).to_have_count(1)
    assert len(alarm.inner_text()) < 2000
    ask(page, "fault.clear", fault="left.robot")
    _lives(page)


def test_a_large_reason_of_an_abort_is_cut_where_it_is_written(open_page: Open) -> None:
    page = open_page("operator", f"{PLACE}?tab=runs")
    ask(page, "scenario.run", scenario="waits")
    page.get_by_role("table", name="Runs").get_by_role("link", name="waits").first.click()
    page.get_by_role("button", name="Abort…").click()
    typed(page.get_by_role("dialog").get_by_label("Reason"), "a" * CHARACTERS)
    page.keyboard.press("Enter")
    expect(page.locator("header").get_by_text("Aborted")).to_be_visible()
    expect(page.locator("dl")).to_contain_text("a" * 150)
    assert len(page.locator("dl").inner_text()) < 2000
    _lives(page)


def test_a_large_line_is_typed_into_the_editor(open_page: Open) -> None:
    """Not pasted, and one line: it is refused where it is stored, checked no more, and can be undone."""
    page = open_page("engineer", PLACE)
    page.get_by_role("button", name="New scenario").click()
    text = text_of(page, "new_scenario")
    expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
    text.click()
    page.keyboard.press("Control+End")
    page.keyboard.insert_text("\n  # " + "z" * CHARACTERS)
    page.keyboard.press("Control+s")
    expect(page.get_by_role("alert").first).to_contain_text("300000 characters")
    page.keyboard.press("Control+z")
    expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
    _lives(page)


def test_a_large_password_is_refused(console: Console, open_page: Open) -> None:
    page = open_page("")
    page.get_by_label("User").fill("oscar")
    typed(page.get_by_label("Password"), "p" * CHARACTERS)
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert")).to_be_visible()
    user, password = USERS["operator"]
    page.get_by_label("User").fill(user)
    page.get_by_label("Password").fill(password)
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("navigation", name="Pages")).to_be_visible()
    _lives(page)
