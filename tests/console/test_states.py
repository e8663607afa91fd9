"""Pages before anything has come, and where the server refuses what they ask: they say so, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Page, Route, WebSocketRoute, expect

Open = Callable[..., Page]
Axe = Callable[[Page], None]
Picture = Callable[[Page, str], None]
PAGES: Final = {
    "fleet": ("fleet", "This fleet has no robots."),
    "map": ("map", "No robot reports a position."),
    "scenarios": ("scenarios", "There are no scenarios."),
    "runs": ("scenarios?tab=runs", "No run yet."),
    "run": ("scenarios/run/0b7ca3a6-0000-4000-8000-000000000000", "There is no run"),
    "robot": ("robot/left", "This robot has no data."),
    "drive": ("drive/left", "Nobody drives this robot by hand."),
    "resilience": ("resilience", "No decision is open."),
    "decision": ("resilience/1", "No decision is open."),
    "alarms": ("alarms", "There is no alarm."),
    "events": ("alarms?show=events", "No event has arrived yet."),
    "pubsub": ("pubsub", "This fleet has no bridges."),
    "drops": ("pubsub?show=drops", "Nothing was dropped."),
    "messages": ("pubsub?show=messages", "No message has passed yet."),
}
"""Where each is, and what it says where there is nothing."""
PICTURES: Final = ("robot", "resilience")
"""The pages at which `picture` looks, too."""
REFUSED: Final = "the session <b>was</b> closed"


def _told(page: Page, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Have what the console says of its feeds changed on the way; all else is as it says it."""

    def passed(route: WebSocketRoute) -> None:
        console = route.connect_to_server()

        def hear(text: str | bytes) -> None:
            message = json.loads(text)
            if "feeds" in message:
                message["feeds"] = change(message["feeds"])
            route.send(json.dumps(message))

        console.on_message(hear)

    page.route_web_socket(re.compile("/api/live$"), passed)


def _pages(open_page: Open, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Iterator[tuple[str, str, Page]]:
    """Each page in turn with its name and what it says where there is nothing, while `change` is told of the feeds."""
    page = open_page("engineer", "#/hall/nothing")
    _told(page, change)
    page.reload()
    for name, (place, empty) in PAGES.items():
        page.goto(f"{page.url.partition('#')[0]}#/hall/{place}")
        yield name, empty, page


def test_what_has_not_come_yet_is_awaited(open_page: Open, axe: Axe, picture: Picture) -> None:
    for name, empty, page in _pages(open_page, lambda feeds: {}):
        main = page.get_by_role("main")
        expect(main.get_by_role("status").filter(has_text="Loading…").first).to_be_visible()
        expect(page.get_by_text(re.compile("^(Connecting to|No link)"))).to_have_count(0)
        expect(main.get_by_text(empty)).to_have_count(0)
        expect(main.get_by_role("alert")).to_have_count(0)
        assert not main.get_by_role("tab").filter(has_text=re.compile(r"\d")).count(), "a number that nobody told"
        axe(page)
        if name in PICTURES:
            picture(page, f"loading-{name}")


def test_what_is_refused_is_said_as_the_server_says_it(open_page: Open, axe: Axe, picture: Picture) -> None:
    refused = {"error": {"message": REFUSED, "status": "BadSessionClosed"}}
    for name, empty, page in _pages(open_page, lambda feeds: dict.fromkeys(feeds, refused)):
        main = page.get_by_role("main")
        expect(main.get_by_role("alert").first).to_contain_text(f"{REFUSED}\u00a0BadSessionClosed")
        expect(main.get_by_text("Loading…")).to_have_count(0)
        expect(main.get_by_text(empty)).to_have_count(0)
        assert not main.get_by_role("tab").filter(has_text=re.compile(r"\d")).count(), "a number that nobody told"
        axe(page)
        if name in PICTURES:
            picture(page, f"refused-{name}")


def test_nodes_that_have_not_come_yet_are_awaited(open_page: Open, picture: Picture) -> None:
    """The address space is asked for by requests."""
    page = open_page("engineer", "#/hall/nothing")
    waiting = list[Route]()

    def keep(route: Route) -> None:
        waiting.append(route)

    page.route(re.compile(r"/api/hall/node\."), keep)
    page.goto(f"{page.url.partition('#')[0]}#/hall/space?node=i=2256")
    main = page.get_by_role("main")
    expect(main.get_by_role("status").filter(has_text="Loading…")).to_have_count(2)
    picture(page, "loading-space")
    for route in waiting:
        route.fulfill(status=503, json={"error": {"message": REFUSED}})
    expect(main.get_by_role("alert").filter(has_text=REFUSED)).to_have_count(2)
    expect(main.get_by_text("Loading…")).to_have_count(0)
    picture(page, "refused-space")


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["503"]


def test_a_history_that_a_role_may_not_read_is_said_beside_the_events(
    open_page: Open, axe: Axe, picture: Picture
) -> None:
    """What the server says of it is changed on the way: of ours, all roles may read the events that they are told."""
    note = {"state": "refused", "since": None, "most": 500, "reason": "the server refuses <b>it</b>"}

    def change(feeds: dict[str, Any]) -> dict[str, Any]:
        for one in feeds.values():
            for told in ("set", "part"):
                if "history" in one.get(told, {}):
                    one[told]["history"] = dict(note)
        return feeds

    page = open_page("operator", "#/hall/nothing")
    _told(page, change)
    page.goto(f"{page.url.partition('#')[0]}#/hall/alarms?show=events")
    page.reload()
    said = page.get_by_role("main").get_by_role("alert")
    expect(said).to_contain_text("Your role does not allow you to read the events of the last hour")
    expect(said).to_contain_text("<b>it</b>")
    expect(page.get_by_text("No event has arrived yet.")).to_be_visible()
    picture(page, "events-history-refused")
    note["state"] = "loading"
    page.reload()
    expect(page.get_by_role("main").get_by_text("Loading…")).to_be_visible()
    expect(page.get_by_role("main").get_by_role("status").filter(has_text="earlier events are loading")).to_be_visible()
    expect(page.get_by_text("No event has arrived yet.")).to_have_count(0)
    axe(page)
    note["state"] = "failed"
    page.reload()
    expect(said).to_contain_text("The events of the last hour are missing: the server refuses")
