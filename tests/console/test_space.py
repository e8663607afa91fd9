"""The address space: browsed by mouse and keyboard, looked at, written and watched."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import Fleet

Open = Callable[..., Page]
PLACE = "#/hall/space"
GO_ON = "ns=2;i=1300"
"""Of the robot left; clients write it."""


def item(page: Page, name: str) -> Locator:
    return page.get_by_role("treeitem").filter(has_text=name)


def test_a_node_is_found_by_the_keyboard_and_its_id_copied(
    open_page: Open, picture: Callable[[Page, str], None]
) -> None:
    page = open_page("observer", PLACE)
    robots = item(page, "Robots").first
    expect(robots).to_have_attribute("aria-expanded", "false")
    robots.click()
    for name in ("G00", "left", "State"):
        page.keyboard.press("ArrowRight")
        found = item(page, name).first
        expect(found).to_be_visible()
        while name not in (page.evaluate("document.activeElement.textContent") or ""):
            page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    node = page.get_by_role("region", name="Node", exact=True)
    expect(node.get_by_label("NodeId", exact=True)).to_have_value("ns=2;s=Robots.left.State")
    expect(node.get_by_role("row", name="NodeClass")).to_contain_text("Variable")
    expect(node.get_by_text("You may not write this node.").first).to_be_visible()
    expect(node.locator("dl")).to_contain_text("Idle")
    expect(node.get_by_role("button", name="Write")).to_have_count(0)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    node.get_by_role("button", name="Copy the NodeId").click()
    expect(page.get_by_text("ns=2;s=Robots.left.State was copied.")).to_be_visible()
    assert page.evaluate("navigator.clipboard.readText()") == "ns=2;s=Robots.left.State"
    node.get_by_role("button", name="Watch").click()
    watched = page.get_by_role("region", name="Watched values").first
    expect(watched.get_by_role("row", name="State")).to_contain_text("Good")
    picture(page, "space")
    page.reload()
    expect(watched.get_by_role("row")).to_have_count(2)
    watched.get_by_role("button", name="Stop watching").click()
    expect(watched).to_be_hidden()


def test_what_is_not_there_is_said(open_page: Open, picture: Callable[[Page, str], None]) -> None:
    page = open_page("observer", PLACE)
    expect(page.get_by_text("No node is chosen.")).to_be_visible()
    page.get_by_label("NodeId or path").fill("ns=2;s=Nothing.Here")
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert")).to_contain_text("there is no node ns=2;s=Nothing.Here")
    picture(page, "space-not-there")


def test_a_value_is_written_and_looks_old_while_the_server_is_away(
    fleet: Fleet, open_page: Open, picture: Callable[[Page, str], None]
) -> None:
    page = open_page("operator", f'{PLACE}?node={GO_ON}&watch=["{GO_ON}"]')
    node = page.get_by_role("region", name="Node", exact=True)
    row = page.get_by_role("region", name="Watched values").first.get_by_role("row", name=GO_ON)
    for wrong in ("many", "2.5"):
        node.get_by_label("New value").fill(wrong)
        page.keyboard.press("Enter")
        expect(node.get_by_label("New value")).to_have_attribute("aria-invalid", "true")
    node.get_by_label("New value").fill("7")
    node.get_by_role("button", name="Write").click()
    expect(row).to_contain_text("7")
    expect(row.get_by_role("cell", name="Good", exact=True)).to_be_visible()
    fleet.server.end()
    expect(row).to_contain_text("Was Good")
    expect(page.get_by_role("main").get_by_text("Good", exact=True)).to_have_count(0)
    expect(node.get_by_role("button", name="Write")).to_have_attribute("aria-disabled", "true")
    picture(page, "space-away")
    fleet.server = fleet.plant.server_process()
    expect(row.get_by_role("cell", name="Good", exact=True)).to_be_visible(timeout=30_000)


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["404", "400", "502", "503"]
