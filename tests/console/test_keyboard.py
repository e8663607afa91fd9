"""Pages gone through by keys alone, from the navigation on: nothing here presses, points or puts a focus anywhere.

Fleet, the editor of scenarios, Resilience, Address space and PubSub have such tests of their own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Page, expect

from tests.console.browsing import tabbed_to
from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask
from tests.contract.skilled import ENDLESS_WORK

Open = Callable[..., Page]
LONG: Final = f"""\
  - {{task: slow, skill: work, robot: left, arguments: {{seconds: "=seconds", work: {ENDLESS_WORK}}}, timeout_s: 600}}
"""
HEAD: Final = "parameters:\n  seconds: {default: 0.5, unit: s, range: [0, 30], description: how long}\n"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """The fleet, whose robot `left` has a value to be written."""

    speed = {"id": 1301, "origin": "server", "type": "Double", "unit": "m/s", "range": [0, 2], "initial": 0.5}

    def change(raw: dict[str, Any]) -> None:
        raw["robots"]["left"]["data"]["speed_limit"] = speed

    with fleet_of(tmp_path_factory.mktemp("fleet"), lambda plant: plant.declare(change)) as running:
        running.plant.scenario("quick", "  - {wait: 0.1}\n")
        running.plant.scenario("slow_one", LONG, HEAD)
        yield running


def tab_to(page: Page, role: Any, name: str, *, back: bool = False) -> None:
    """The first one of that role and name, and nothing else with them."""
    tabbed_to(page, page.get_by_role(role, name=name, exact=True), back=back)


def at_page(page: Page, name: str) -> None:
    """Go to a page by the navigation."""
    tab_to(page, "link", name)
    page.keyboard.press("Enter")
    expect(page.get_by_role("main")).to_be_focused()


def test_alarms(open_page: Open) -> None:
    page = open_page("operator", "#/hall/fleet")
    ask(page, "fault.raise", robot="left", reason="the gripper does not close")
    at_page(page, "Alarms 1 alarm to acknowledge")
    left = page.get_by_role("article").filter(has_text="left")
    tab_to(page, "button", "Comment…")
    page.keyboard.press("Enter")
    page.keyboard.type("a new one is on its way")
    page.keyboard.press("Enter")
    expect(left).to_contain_text("a new one is on its way")
    expect(page.get_by_role("button", name="Comment…")).to_be_focused()
    tab_to(page, "button", "Acknowledge…", back=True)
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog").get_by_label("Comment")).to_be_focused()
    page.keyboard.type("I look at it")
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(left).to_contain_text("I look at it")
    # Its button is gone: the next key goes on from there, and not from the beginning of the page.
    expect(left.get_by_role("button", name="Acknowledge…")).to_have_count(0)
    page.keyboard.press("Tab")
    expect(left.get_by_role("button", name="Comment…")).to_be_focused()
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog").get_by_role("button", name="Clear the fault")).to_be_focused()
    page.keyboard.press("Escape")
    expect(left.get_by_role("button", name="Clear…")).to_be_focused()
    tab_to(page, "tab", "Alarms 1", back=True)
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tab", name="Events")).to_be_focused()
    expect(page.get_by_text("No event has arrived yet.")).to_be_visible()
    ask(page, "fault.clear", fault="left")
    ask(page, "fault.raise", robot="right", reason="the wheel is flat")
    ask(page, "fault.clear", fault="right")
    rows = page.get_by_role("table", name="Events").locator("tbody tr")
    expect(rows.filter(has_text="right").nth(1)).to_be_visible()
    tab_to(page, "button", "Stop")
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Continue")).to_have_attribute("aria-pressed", "true")
    page.keyboard.press("Tab")
    expect(rows.first).to_be_focused()
    page.keyboard.press("ArrowDown")
    expect(rows.nth(1)).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog").get_by_role("button", name="Close").last).to_be_visible()
    page.keyboard.press("Escape")
    expect(rows.nth(1)).to_be_focused()
    tab_to(page, "searchbox", "Search alarms and events", back=True)
    page.keyboard.type("flat")
    tab_to(page, "button", "Continue")
    page.keyboard.press("Space")
    expect(rows.filter(has_text="left")).to_have_count(0)
    expect(rows.first).to_contain_text("flat")


def test_a_scenario_is_found_started_followed_and_ended(open_page: Open) -> None:
    page = open_page("operator", "#/hall/fleet")
    at_page(page, "Scenarios")
    rows = page.get_by_role("table", name="Library").locator("tbody tr")
    tab_to(page, "searchbox", "Search scenarios")
    page.keyboard.type("slow")
    expect(rows).to_have_count(1)
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.press("Delete")
    expect(rows).to_have_count(2)
    tabbed_to(page, page.get_by_role("columnheader", name="Scenario").get_by_role("button"))
    page.keyboard.press("Enter")
    expect(rows.first).to_contain_text("slow_one")
    page.keyboard.press("Enter")
    expect(rows.first).to_contain_text("quick")
    tab_to(page, "link", "quick")
    page.keyboard.press("Shift+Tab")
    expect(rows.first).to_be_focused()
    page.keyboard.press("ArrowDown")
    expect(rows.nth(1)).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1, name="slow_one")).to_be_visible()
    tab_to(page, "link", "Library")
    page.keyboard.press("Enter")
    tab_to(page, "button", "Actions for slow_one")
    page.keyboard.press("Enter")
    expect(page.get_by_role("menuitem", name="Start…")).to_be_focused()
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog", name="Start slow_one")
    tab_to(page, "textbox", "seconds")
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("31")
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("Give 0 to 30.")
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("3")
    page.keyboard.press("Enter")
    head = page.get_by_role("main").locator("header")
    expect(head.get_by_text("Running", exact=True)).to_be_visible()
    expect(page.get_by_role("main")).to_be_focused()
    for press, state, then in (("Pause", "Paused", "Resume"), ("Resume", "Running", "Pause")):
        tab_to(page, "button", press)
        page.keyboard.press("Enter")
        expect(head.get_by_text(state, exact=True)).to_be_visible()
        # What has changed is the button itself, which is still where the keys go.
        expect(page.get_by_role("button", name=then)).to_be_focused()
    tab_to(page, "tab", "Steps")
    page.keyboard.press("ArrowRight")
    graph = page.get_by_role("group", name="Graph")
    expect(graph).to_be_visible()
    tab_to(page, "button", "Closer")
    page.keyboard.press("Enter")
    tab_to(page, "group", "Graph")
    expect(graph).to_be_focused()
    viewport = page.locator(".svelte-flow__viewport")
    before = viewport.evaluate("one => one.style.transform")
    page.keyboard.press("ArrowDown")
    expect(viewport).not_to_have_attribute("style", re.compile(re.escape(before)))
    page.keyboard.press("0")
    tab_to(page, "tab", "Graph", back=True)
    page.keyboard.press("End")
    expect(page.get_by_role("tab", name="Gantt chart")).to_be_focused()
    expect(page.get_by_role("region", name="Gantt chart")).to_be_visible()
    page.keyboard.press("Tab")
    expect(page.get_by_role("region", name="Gantt chart")).to_be_focused()
    tab_to(page, "button", "Abort…", back=True)
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog", name="Abort this run")
    expect(dialog).to_contain_text("Give a reason")
    page.keyboard.type("it is enough")
    page.keyboard.press("Enter")
    expect(head.get_by_text("Aborted", exact=True)).to_be_visible(timeout=20_000)
    tab_to(page, "link", "Runs", back=True)
    page.keyboard.press("Enter")
    expect(page.get_by_role("tab", name="Runs")).to_have_attribute("aria-selected", "true")
    runs = page.get_by_role("table", name="Runs").locator("tbody tr")
    tab_to(page, "link", "slow_one")
    page.keyboard.press("Shift+Tab")
    expect(runs.first).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_text("it is enough")).to_be_visible()


def test_a_robot_is_found_written_told_and_held(open_page: Open) -> None:
    page = open_page("operator", "#/hall/fleet")
    tab_to(page, "link", "left")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1, name="left")).to_be_visible()
    expect(page.get_by_role("main")).to_be_focused()
    tab_to(page, "button", "Draw speed_limit in the chart")
    page.keyboard.press("Space")
    chart = page.get_by_role("region", name="Chart")
    expect(chart).to_be_visible()
    expect(page.get_by_role("button", name="Draw speed_limit in the chart")).to_be_focused()
    tab_to(page, "button", "Write speed_limit")
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog").get_by_label("speed_limit", exact=True)).to_be_focused()
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("1.5")
    page.keyboard.press("Enter")
    expect(page.get_by_role("row", name="speed_limit")).to_contain_text("1.5")
    expect(page.get_by_role("button", name="Write speed_limit")).to_be_focused()
    expect(chart.get_by_role("list", name="Lines")).to_contain_text("1.5 m/s")
    tabbed_to(page, chart.get_by_role("slider", name="Time"), back=True)
    page.keyboard.press("Home")
    expect(chart.get_by_role("slider", name="Time")).to_have_attribute("aria-valuetext", re.compile("speed_limit —"))
    tab_to(page, "button", "Table", back=True)
    page.keyboard.press("Space")
    expect(chart.get_by_role("table")).to_be_visible()
    tab_to(page, "button", "Remove speed_limit from the chart", back=True)
    page.keyboard.press("Enter")
    expect(chart).to_have_count(0)

    work = page.get_by_role("region", name="work", exact=True)
    tab_to(page, "button", "Start…")
    page.keyboard.press("Enter")
    tab_to(page, "textbox", "work")
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type(ENDLESS_WORK)
    page.keyboard.press("Enter")
    expect(work).to_contain_text("Running")
    for press, state, then in (("Suspend", "Suspended", "Resume"), ("Resume", "Running", "Suspend")):
        tab_to(page, "button", press, back=True)
        page.keyboard.press("Enter")
        expect(work.locator("header").get_by_text(state, exact=True)).to_be_visible()
        expect(work.get_by_role("button", name=then)).to_be_focused()
    tab_to(page, "button", "Halt")
    page.keyboard.press("Enter")
    last = page.get_by_role("list", name="Last executions").get_by_role("listitem").first
    expect(last).to_contain_text("halted")

    for press in ("Hold…", "Release…"):
        tab_to(page, "button", press, back=True)
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_be_visible()
        if press == "Hold…":
            page.keyboard.type("new tyre")
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_role("button", name="Hold…")).to_be_focused()
    tabbed_to(page, page.get_by_role("main").get_by_role("link", name="Fleet"), back=True)
    page.keyboard.press("Enter")
    expect(page.get_by_role("article", name="left")).to_be_visible()


def test_a_button_that_goes_while_its_dialog_is_open(open_page: Open) -> None:
    page = open_page("operator", "#/hall/alarms")
    # A key may come before the browser tells the page that its dialog is closed.
    page.evaluate("""new MutationObserver(() => {
      if (document.querySelector('dialog[open]')) return;
      window.at_once ??= document.activeElement.closest('article') !== null;
    }).observe(document.body, {subtree: true, attributeFilter: ['open']})""")
    ask(page, "fault.raise", robot="left", reason="the gripper does not close")
    left = page.get_by_role("article").filter(has_text="left")
    left.get_by_role("button", name="Acknowledge…").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    other = open_page("engineer", "#/hall/alarms")
    other.get_by_role("article").filter(has_text="left").get_by_role("button", name="Acknowledge…").click()
    other.get_by_role("dialog").get_by_label("Comment").fill("somebody else looks at it")
    other.keyboard.press("Enter")
    expect(left).to_contain_text("somebody else looks at it")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.keyboard.press("Tab")
    expect(left.get_by_role("button", name="Comment…")).to_be_focused()
    assert page.evaluate("window.at_once") is True
    ask(page, "fault.clear", fault="left")
