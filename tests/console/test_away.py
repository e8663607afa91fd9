"""While the server is away nothing on a page is shown as of now. Fleet, Robot, Map, Alarms, Address space, PubSub and
Drive have tests of their own beside what else is tried with their fleets.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console import browsing
from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask
from tests.console.test_resilience import with_criteria
from tests.contract.skilled import ENDLESS_WORK

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
WAIT_MS: Final = 30_000
"""A console waits up to 10 s before it tries again."""
NOT_CURRENT: Final = "What is shown is not current."
AS_OF_NOW: Final = re.compile(
    r"^(Good|Idle|Busy|Ready|Active|Open|Running|Paused|Waiting|Fits|\d+ problems?|It fits the fleet\.)$"
)
"""What is said of a state while it is known."""
PARALLEL: Final = f"""\
  - parallel:
      - {{task: slow, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 600}}
      - {{task: other, skill: work, robot: middle, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 600}}
"""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """One with criteria, by which robots are ranked."""
    with fleet_of(tmp_path_factory.mktemp("fleet"), with_criteria) as running:
        yield running


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["502", "503"]


def nothing_is_of_now(*pages: Page) -> None:
    """Each says once that it is not current, and of no state that it is so."""
    for page in pages:
        banner = page.get_by_role("status").filter(has_text="No link to Hall 1.")
        expect(banner).to_contain_text(NOT_CURRENT, timeout=WAIT_MS)
        expect(page.get_by_role("main").get_by_text(AS_OF_NOW)).to_have_count(0)


def kept(page: Page, name: str) -> None:
    assert browsing.pictures(page, name) == []


def tab_count(page: Page, tab: str) -> Locator:
    return page.get_by_role("tab", name=re.compile(tab)).locator(".count")


def test_scenarios_and_runs(open_page: Open, fleet: Fleet) -> None:
    fleet.plant.scenario("held_up", PARALLEL)
    fleet.plant.scenario("broken", "  - {task: a}\n")
    library = open_page("engineer", "#/hall/scenarios")
    rows = library.get_by_role("table", name="Library").locator("tbody tr")
    expect(rows.filter(has_text="held_up")).to_contain_text("Fits")
    expect(rows.filter(has_text="broken")).to_contain_text("3 problems")
    none = open_page("engineer", "#/hall/scenarios?q=nothing-like-this")
    expect(none.get_by_text("No scenario matches.")).to_be_visible()
    no_runs = open_page("engineer", "#/hall/scenarios?tab=runs")
    expect(no_runs.get_by_text("No run yet.")).to_be_visible()
    editor = open_page("engineer", "#/hall/scenarios/edit/held_up")
    expect(editor.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
    fleet.server.end()
    nothing_is_of_now(library, none, no_runs, editor)
    for page in (none, no_runs):
        expect(page.get_by_role("main")).to_contain_text(NOT_CURRENT)
    expect(rows.filter(has_text="held_up")).to_contain_text("Not current")
    expect(rows.filter(has_text="broken")).to_contain_text("Not current")
    expect(library.get_by_role("button", name="New scenario")).to_have_attribute("title", NOT_CURRENT)
    rows.filter(has_text="held_up").get_by_role("button", name="Actions for held_up").click()
    for item in ("Start…", "Duplicate", "Delete…"):
        expect(library.get_by_role("menuitem", name=item)).to_have_attribute("title", NOT_CURRENT)
    library.keyboard.press("Escape")
    expect(editor.get_by_role("region", name="Problems")).to_contain_text("the text is not checked")
    for button in ("Dry run…", "Start…", "Store"):
        expect(editor.get_by_role("button", name=button)).to_have_attribute("title", NOT_CURRENT)
    kept(library, "scenarios-away")
    kept(no_runs, "runs-none-away")
    kept(editor, "editor-away")
    fleet.server = fleet.plant.server_process()
    expect(rows.filter(has_text="held_up")).to_contain_text("Fits", timeout=WAIT_MS)

    ask(library, "scenario.run", scenario="held_up")
    library.goto(f"{library.url.partition('#')[0]}#/hall/scenarios?tab=runs")
    runs = library.get_by_role("table", name="Runs").locator("tbody tr")
    expect(runs.filter(has_text="held_up").get_by_text("Running", exact=True)).to_be_visible()
    expect(tab_count(library, "Runs")).to_have_text("1")
    runs.filter(has_text="held_up").get_by_role("link").click()
    place = library.url.partition("?")[0].partition("#")[2]
    library.go_back()
    views = [open_page("operator", f"#{place}{query}") for query in ("", "?as=graph", "?as=gantt")]
    steps, graph, gantt = views
    for step in ("slow", "other"):
        expect(steps.get_by_role("list", name="Steps").get_by_role("listitem").filter(has_text=step)).to_contain_text(
            "Running"
        )
    expect(graph.locator(".svelte-flow__node").filter(has_text="slow")).to_contain_text("Running")
    bars = gantt.get_by_role("region", name="Gantt chart").get_by_role("listitem").filter(has_text="slow")
    expect(bars).to_contain_text("· under way")
    fleet.server.end()
    nothing_is_of_now(library, *views)
    expect(runs.filter(has_text="held_up")).to_contain_text("Was Running")
    expect(tab_count(library, "Runs")).to_have_class(re.compile(r"\bwas\b"))
    for page in views:
        expect(page.locator("header").get_by_text("Was Running", exact=True)).to_be_visible()
        expect(page.get_by_role("button", name="Pause")).to_have_attribute("title", NOT_CURRENT)
    expect(steps.get_by_role("list", name="Steps").get_by_text("Was Running")).to_have_count(2)
    expect(graph.locator(".svelte-flow__node").filter(has_text="slow")).to_contain_text("Was Running")
    expect(graph.get_by_role("list", name="The same as a list")).to_contain_text("Was Running")
    expect(bars).to_contain_text("Was under way")
    # How long it goes on nobody knows.
    lasted = gantt.get_by_text("Duration", exact=True).locator("xpath=following-sibling::dd")
    said = lasted.inner_text()
    gantt.wait_for_timeout(2_100)  # two ticks of the page's clock
    expect(lasted).to_have_text(said)
    kept(library, "runs-away")
    kept(steps, "run-steps-away")
    kept(gantt, "run-gantt-away")
    fleet.server = fleet.plant.server_process()
    expect(steps.locator("header").get_by_text("Running", exact=True)).to_be_visible(timeout=WAIT_MS)
    steps.get_by_role("button", name="Abort…").click()
    steps.get_by_role("dialog").get_by_label("Reason").fill("it is enough")
    steps.keyboard.press("Enter")
    expect(steps.locator("header").get_by_text("Aborted")).to_be_visible(timeout=WAIT_MS)


def test_a_decision(open_page: Open, fleet: Fleet) -> None:
    none = open_page("operator", "#/hall/resilience")
    expect(none.get_by_text("No decision is open.")).to_be_visible()
    ask(none, "scenario.run", scenario="long")
    none.get_by_label("Robot that fails").select_option("left")
    none.get_by_role("button", name="Which robot would take over?").click()
    forecast = none.get_by_role("region", name="What if a robot fails?").get_by_role("status")
    expect(forecast).to_contain_text("a:")
    ask(none, "fault.raise", robot="left", reason="the welding tip is worn")
    page = none
    expect(page.get_by_text("Open", exact=True)).to_be_visible()
    run = open_page("operator", "#/hall/scenarios?tab=runs")
    run.get_by_role("table", name="Runs").get_by_role("link", name="long").first.click()
    waits = run.get_by_text("left has failed, and a person decides who takes over")
    expect(waits).to_be_visible()
    fleet.server.end()
    nothing_is_of_now(page, run)
    expect(page.get_by_text("Was Open", exact=True)).to_be_visible()
    expect(page.get_by_role("link", name="a, instead of left")).to_contain_text("Was Open")
    expect(forecast).to_have_class(re.compile(r"\bold\b"))
    expect(waits.locator("xpath=..")).to_have_class(re.compile(r"\bwas\b"))
    for button in ("Abort the run…", "Choose right", "Choose middle", "Which robot would take over?", "Change…"):
        expect(page.get_by_role("button", name=button)).to_have_attribute("title", "The server is not reachable.")
    expect(page.get_by_role("slider", name="battery or load")).to_be_disabled()
    kept(page, "resilience-away")
    kept(run, "run-decides-away")
    fleet.server = fleet.plant.server_process()
    expect(page.get_by_text("Open", exact=True)).to_be_visible(timeout=WAIT_MS)
    page.get_by_role("button", name="Choose right").click()
    expect(page.get_by_text("No decision is open.")).to_be_visible()
    fleet.server.end()
    nothing_is_of_now(page)
    expect(page.get_by_role("main")).to_contain_text(NOT_CURRENT)
    kept(page, "resilience-none-away")
    fleet.server = fleet.plant.server_process()
    expect(page.get_by_role("main")).not_to_contain_text(NOT_CURRENT, timeout=WAIT_MS)
