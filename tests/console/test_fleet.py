"""The Fleet page with three robots."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import Fleet

Open = Callable[..., Page]


def card(page: Page, robot: str) -> Locator:
    return page.get_by_role("article", name=robot)


def rows(page: Page) -> Locator:
    """Those below the heads of the columns."""
    return page.get_by_role("table", name="Fleet").locator("tbody tr")


def chosen(page: Page, robot: str, action: str) -> None:
    card(page, robot).get_by_role("button", name=f"Actions for {robot}").click()
    page.get_by_role("menuitem", name=action).click()


def test_each_robot_has_a_card(page: Page, picture: Callable[[Page, str], None]) -> None:
    for robot in ("left", "middle", "right"):
        expect(card(page, robot)).to_contain_text("Idle")
        expect(card(page, robot)).to_contain_text("weld")
    expect(page.get_by_role("button", name="All 3")).to_have_attribute("aria-pressed", "true")
    picture(page, "fleet-cards")


def test_an_age_tells_its_time_to_who_points_at_it(page: Page) -> None:
    """And to nobody else: a title that changes is a style of its own each second."""
    age = card(page, "left").locator("time").first
    expect(age).to_be_visible()
    assert age.get_attribute("title") is None
    age.hover()
    expect(age).to_have_attribute("title", re.compile(r"\d\d:\d\d:\d\d\.\d{3}$"))
    page.mouse.move(0, 0)
    expect(age).not_to_have_attribute("title", re.compile(""))


def test_a_robot_is_held_with_a_reason_and_released(
    page: Page, open_page: Open, picture: Callable[[Page, str], None]
) -> None:
    expect(card(page, "left")).to_contain_text("Idle")
    chosen(page, "left", "Hold…")
    dialog = page.get_by_role("dialog", name="Hold left")
    expect(dialog.get_by_label("Reason")).to_be_focused()
    picture(page, "fleet-hold")
    page.keyboard.type("battery is changed")
    page.keyboard.press("Enter")
    expect(dialog).to_be_hidden()
    expect(page.get_by_role("status").filter(has_text="left is held.")).to_be_visible()
    other = open_page("engineer")
    expect(card(other, "left")).to_contain_text("Held")
    other.get_by_role("button", name="Held 1").click()
    expect(other.get_by_role("article")).to_have_count(1)
    picture(other, "fleet-held")
    chosen(other, "left", "Release…")
    dialog = other.get_by_role("dialog", name="Release left")
    expect(dialog).to_contain_text("Held by oscar")
    dialog.get_by_role("button", name="Release", exact=True).click()
    expect(card(page, "left")).not_to_contain_text("Held")
    expect(other.get_by_text("No robot matches.")).to_be_visible()


def test_an_observer_may_not_hold_and_is_told_why(open_page: Open) -> None:
    page = open_page("observer")
    card(page, "left").get_by_role("button", name="Actions for left").click()
    hold = page.get_by_role("menuitem", name="Hold…")
    expect(hold).to_have_attribute("aria-disabled", "true")
    expect(hold).to_have_attribute("title", "Your role does not allow this; required role: Operator.")
    hold.click(force=True)
    expect(page.get_by_role("dialog")).to_have_count(0)
    # A finger does not hover: who presses is told too, of a menu as of a button.
    told = page.get_by_role("status").filter(has_text="required role: Operator")
    expect(told).to_be_visible()
    told.get_by_role("button", name="Close").click()
    expect(told).to_have_count(0)
    page.goto(page.url.partition("#")[0] + "#/hall/robot/left")
    page.get_by_role("button", name="Hold…").click(force=True)
    expect(told).to_be_visible()
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_what_is_shown_stands_in_the_address(page: Page, open_page: Open, picture: Callable[[Page, str], None]) -> None:
    page.get_by_role("searchbox", name="Search robots").fill("I")
    expect(page.get_by_role("article")).to_have_count(2)
    page.get_by_role("button", name="Rows").click()
    page.get_by_label("Group by").select_option("Grouped by capacity")
    page.get_by_role("columnheader", name="Robot").get_by_role("button").click()
    expect(rows(page)).to_have_count(3)
    expect(page.get_by_role("columnheader", name="Robot")).to_have_attribute("aria-sort", "descending")
    picture(page, "fleet-rows")
    place = page.url.partition("#")[2]
    assert place == "/hall/fleet?q=I&view=rows&group=capacity&down=1"
    again = open_page("operator", f"#{place}")
    expect(again.get_by_role("searchbox", name="Search robots")).to_have_value("I")
    expect(rows(again)).to_have_text([re.compile("^weld 2"), re.compile("^right"), re.compile("^middle")])
    again.get_by_role("button", name="2 of 3: show all").click()
    expect(rows(again)).to_have_count(4)


def test_the_keyboard_suffices(open_page: Open) -> None:
    page = open_page("operator", "#/hall/fleet")
    expect(card(page, "left")).to_be_visible()
    met: list[str] = []
    for _ in range(40):
        page.keyboard.press("Tab")
        name = page.evaluate("document.activeElement.getAttribute('aria-label') || document.activeElement.textContent")
        if name.strip() == "Actions for right":
            break
        met.append(name.strip())
    else:
        pytest.fail(f"Tab never came to the last robot: {met}")
    assert met[0] == "Skip to the page"
    page.keyboard.press("Enter")
    expect(page.get_by_role("menuitem").first).to_be_focused()
    page.keyboard.press("End")
    expect(page.get_by_role("menuitem", name="Hold…")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog").get_by_label("Reason")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_role("button", name="Actions for right")).to_be_focused()


def test_a_robot_whose_bridge_goes_is_offline(page: Page, fleet: Fleet, picture: Callable[[Page, str], None]) -> None:
    expect(card(page, "middle")).to_contain_text("Idle")
    fleet.bridges["middle"].end()
    expect(card(page, "middle")).to_contain_text("Offline")
    picture(page, "fleet-offline")
    fleet.bridges["middle"] = fleet.plant.start_bridge("middle")
    expect(card(page, "middle")).to_contain_text("Idle", timeout=20_000)
