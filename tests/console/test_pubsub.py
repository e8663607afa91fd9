"""PubSub: bridges and what they lost, causes with their meanings, and messages byte by byte for engineers."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import Fleet

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE = "#/hall/pubsub"


def messages(page: Page) -> Locator:
    return page.get_by_role("table", name="Messages").locator("tbody tr[aria-rowindex]")


def test_bridges_and_drops(open_page: Open, picture: Picture) -> None:
    page = open_page("observer", PLACE)
    left = page.get_by_role("article", name="left")
    expect(left).to_contain_text("Connected")
    expect(left).to_contain_text("space 300")
    expect(page.get_by_role("article", name="Server")).to_contain_text("/s)")
    picture(page, "pubsub-bridges")
    page.get_by_role("tab", name="Bridges").focus()
    page.keyboard.press("ArrowRight")
    row = page.get_by_role("row").filter(has_text="repeated")
    expect(row).to_contain_text("no loss")
    expect(row).to_contain_text("Server")
    picture(page, "pubsub-drops")
    page.keyboard.press("ArrowRight")
    expect(page.get_by_text("Messages are for engineers.")).to_be_visible()
    picture(page, "pubsub-observer")


def test_a_message_is_taken_apart(open_page: Open, picture: Picture) -> None:
    page = open_page("engineer", f"{PLACE}?show=messages")
    expect(page.get_by_text("No message is chosen.")).to_be_visible()
    frame = messages(page).filter(has_text="key frame").filter(has_text="ua_300_2_").first
    expect(frame).to_be_visible()
    page.get_by_role("button", name="Stop").click()
    frame.focus()
    page.keyboard.press("Enter")
    message = page.get_by_role("region", name="Message", exact=True)
    expect(message.get_by_role("heading", name="key frame")).to_be_visible()
    names = message.get_by_role("listbox", name="Names of the bytes")
    expect(names.get_by_role("option", name="UADPFlags")).to_be_visible()
    publisher = names.get_by_role("option", name="PublisherId 300")
    publisher.hover()
    marked = message.locator(".hex .marked")
    expect(marked).to_have_text(["2c", "01"])
    message.locator(".hex [data-at='0']").hover()
    expect(names.locator(".marked")).to_contain_text("UADPFlags")
    names.focus()
    page.mouse.move(0, 0)
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    expect(names.get_by_role("option", selected=True)).to_contain_text("PublisherId")
    expect(marked).to_have_text(["2c", "01"])
    picture(page, "pubsub-message")
    page.get_by_label("Source").fill("no such publisher")
    page.keyboard.press("Tab")
    page.get_by_role("button", name="Continue").click()
    expect(page.get_by_text("No message has passed yet.")).to_be_visible()


def test_a_bridge_that_ends_and_a_server_that_goes(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    page = open_page("engineer", PLACE)
    expect(page.get_by_role("article", name="right")).to_contain_text("Connected")
    fleet.bridges.pop("right").end()
    expect(page.get_by_role("article", name="right")).to_contain_text("Offline")
    picture(page, "pubsub-offline")
    page.get_by_role("tab", name="Messages").click()
    expect(messages(page).first).to_be_visible()
    fleet.server.end()
    expect(page.get_by_text("What is shown is not current.")).to_be_visible()
    expect(messages(page).first).to_be_visible()
    picture(page, "pubsub-away")
    fleet.server = fleet.plant.server_process()
    expect(page.get_by_text("What is shown is not current.")).to_be_hidden(timeout=30_000)
    messages(page).filter(has_text="key frame").first.click()
    expect(page.get_by_role("listbox", name="Names of the bytes")).to_be_visible()


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["503", "502"]
