"""Alarms and events: what wants somebody, what is done about it, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import Fleet

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE = "#/hall/alarms"
REASON = "the gripper <img src=x onerror=alert(1)> does not close"
ASK = """async ([operation, parameters]) => {
  const {csrf} = await (await fetch('api/me')).json();
  const headers = {'Content-Type': 'application/json', 'X-CSRF': csrf};
  const answer = await fetch(`api/hall/${operation}`, {method: 'POST', headers, body: JSON.stringify(parameters)});
  return [answer.status, await answer.json()];
}"""


def ask(page: Page, operation: str, **parameters: Any) -> None:
    """Do what this page has no button for, as the same person."""
    status, answer = page.evaluate(ASK, [operation, parameters])
    assert status == 200, answer


def alarm(page: Page, robot: str) -> Locator:
    return page.get_by_role("article").filter(has_text=robot)


def events(page: Page) -> Locator:
    """The rows of the page's events, once it shows what there is: others may have done something by then."""
    rows = page.get_by_role("table", name="Events").locator("tbody tr")
    expect(page.get_by_text("No event has arrived yet.").or_(rows.first)).to_be_visible()
    return rows


def test_a_fault_is_seen_acknowledged_and_cleared(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    expect(page.get_by_text("There is no alarm.")).to_be_visible()
    picture(page, "alarms-none")
    ask(page, "fault.raise", robot="left", reason=REASON, capacities=["weld"])
    left = alarm(page, "left")
    expect(left).to_contain_text(REASON)
    expect(left).to_contain_text("Active")
    expect(left).to_contain_text("Concerns: weld")
    picture(page, "alarms")
    # It is found among all robots by its fault.
    fleet = open_page("observer", "#/hall/fleet")
    expect(fleet.get_by_role("article", name="left")).to_contain_text(REASON)
    fleet.get_by_role("button", name="With a fault 1").click()
    expect(fleet.get_by_role("article")).to_have_count(1)
    picture(fleet, "fleet-with-a-fault")
    observer = open_page("observer", PLACE)
    expect(alarm(observer, "left").get_by_role("button", name="Acknowledge…")).to_be_disabled()
    left.get_by_role("button", name="Acknowledge…").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text(REASON)
    dialog.get_by_label("Comment").fill("I look at it")
    page.keyboard.press("Enter")
    expect(dialog).to_be_hidden()
    expect(alarm(observer, "left")).to_contain_text("I look at it")
    expect(left.get_by_role("button", name="Acknowledge…")).to_have_count(0)
    left.get_by_role("button", name="Clear…").click()
    dialog.get_by_role("button", name="Clear the fault").click()
    expect(page.get_by_text("There is no alarm.")).to_be_visible()
    expect(observer.get_by_text("There is no alarm.")).to_be_visible()


def test_events_are_told_filtered_and_stopped(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", f"{PLACE}?show=events")
    rows = events(page)
    expect(page.get_by_text("since this page was opened").first).to_be_visible()  # this server keeps none
    ask(page, "fault.raise", robot="right", reason="the wheel is flat")
    expect(rows.filter(has_text="right").first).to_be_visible()
    assert page.get_by_label("Audit events").count() == 0, "no operator is given audit events"
    page.get_by_role("button", name="Stop").click()
    count = rows.count()
    ask(page, "fault.clear", fault="right")
    page.get_by_role("button", name="Continue").click()
    expect(rows).not_to_have_count(count)
    picture(page, "events")
    rows.first.click()
    expect(page.get_by_role("dialog")).to_contain_text("the wheel is flat")
    page.keyboard.press("Escape")
    page.get_by_role("searchbox", name="Search alarms and events").fill("no such thing")
    expect(page.get_by_text("No event matches.")).to_be_visible()


def test_engineers_are_told_audit_events(open_page: Open) -> None:
    page = open_page("engineer", f"{PLACE}?show=events&audit=only")
    rows = events(page)
    ask(page, "robots.hold", robot="left", reason="painted")
    ask(page, "robots.release", robot="left")
    told = rows.filter(has_text="AuditUpdateMethod").filter(has_text="Call of ns=2;s=Robots.left by erna")
    expect(told).to_have_count(2)


@pytest.mark.parametrize("expected_complaints", [["503", "502"]])
def test_while_the_server_is_away_no_alarm_is_shown_as_active(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page, other = open_page("operator", PLACE), open_page("operator", f"{PLACE}?q=nothing")
    ask(page, "fault.raise", robot="left", reason=REASON)
    left = alarm(page, "left")
    expect(left.get_by_text("Active", exact=True)).to_be_visible()
    expect(other.get_by_text("No alarm matches.")).to_be_visible()
    fleet.server.end()
    expect(left).to_contain_text("Was Active")
    expect(page.get_by_role("main").get_by_text("Active", exact=True)).to_have_count(0)
    expect(left.get_by_role("button", name="Acknowledge…")).to_have_attribute("title", "The server is not reachable.")
    expect(other.get_by_role("main")).to_contain_text("What is shown is not current.")
    picture(page, "alarms-away")
    fleet.server = fleet.plant.server_process()
    expect(left.get_by_text("Active", exact=True)).to_be_visible(timeout=30_000)
    left.get_by_role("button", name="Comment…").click()
    page.keyboard.type("a new tip is on its way")
    page.keyboard.press("Enter")
    expect(left).to_contain_text("a new tip is on its way")
    left.get_by_role("button", name="Acknowledge…").click()
    page.keyboard.press("Enter")
    expect(left.get_by_role("button", name="Acknowledge…")).to_have_count(0)
    ask(page, "fault.clear", fault="left")
    expect(left).to_have_count(0)
