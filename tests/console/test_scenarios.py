"""Scenarios: the library, runs that are followed, asked about and ended, and what a run would come to."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console import browsing
from tests.console.conftest import Fleet, fleet_of
from tests.console.scenario_pages import PLACE, chosen, lines, row, text_of
from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.carried_runs import mutual
from tests.integration.scenarios.conftest import Plant

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
HELLO = "<img onerror=alert(1)> \u202e " + "x" * 200
ORDERED = """\
  # first left, then two at once
  - {task: one, skill: work, robot: left, arguments: {seconds: "=seconds"}}
  - parallel:
      - {task: two, skill: work, robot: middle, arguments: {seconds: 0.4}}
      - {task: three, skill: work, capacity: weld, arguments: {seconds: 0.6}}
  - repeat:
      - {task: again, skill: work, robot: right, after: [one]}
    times: 2
  - if: one.seconds > 100
    then:
      - {end: failed, reason: too long}
"""


def that_carries(plant: Plant) -> None:
    """Bridges that hand runs to each other, and one of them can be left out soon."""

    def soon(raw: dict[str, Any]) -> None:
        raw["scenarios"] = {"adopt_after_s": 4}

    mutual(plant)
    plant.declare(soon)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), that_carries) as running:
        yield running


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["400"]


def test_texts_of_strangers_are_texts_and_an_observer_changes_nothing(
    fleet: Fleet, open_page: Open, picture: Picture
) -> None:
    text = f"version: 1\nname: strange\ndescription: {json.dumps(HELLO)}\nsteps:\n  - {{wait: 1}}\n  - {{task: a}}\n"
    (fleet.plant.folder / "scenarios" / "strange.yaml").write_text(text)
    page = open_page("observer", PLACE)
    expect(row(page, "strange")).to_contain_text("<img onerror=alert(1)>")
    expect(row(page, "strange")).to_contain_text("problem")
    picture(page, "library")
    expect(page.get_by_role("button", name="New scenario")).to_have_attribute("aria-disabled", "true")
    row(page, "strange").get_by_role("link").click()
    expect(text_of(page, "strange")).to_contain_text("<img onerror")
    text_of(page, "strange").click()
    page.keyboard.type("x")
    expect(page.get_by_text("Changed", exact=True)).to_have_count(0)
    expect(page.get_by_role("region", name="Problems").get_by_role("button").first).to_contain_text("Line 6:")


def test_the_library_says_which_scenarios_the_fleet_can_do(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    """As the server's Validate does, also for an observer, and as soon as the file is another one."""
    fleet.plant.scenario("lacking", "  - {task: a, skill: paint, robot: left}\n  - {task: b, skill: work, robot: up}\n")
    fleet.plant.scenario("fitting", "  - {task: a, skill: work, robot: left}\n")
    page = open_page("operator", PLACE)
    expect(row(page, "fitting")).to_contain_text("Fits")
    expect(row(page, "lacking")).to_contain_text("2 problems")
    picture(page, "library-problems")
    row(page, "lacking").get_by_role("button", name="Actions for lacking").click()
    expect(page.get_by_role("menuitem", name="Start…")).to_have_attribute("title", re.compile("It has problems"))
    page.keyboard.press("Escape")
    fleet.plant.scenario("lacking", "  - {task: a, skill: work, robot: left}\n")
    expect(row(page, "lacking")).to_contain_text("Fits")
    watcher = open_page("observer", PLACE)
    fleet.plant.scenario("fitting", "  - {task: a, skill: work, capacity: paint}\n")
    expect(row(watcher, "fitting")).to_contain_text("1 problem")
    row(watcher, "fitting").get_by_role("link").click()
    expect(watcher.get_by_text("Read-only: to change and store scenarios, the role Engineer is")).to_be_visible()


def test_a_scenario_is_duplicated_and_deleted(fleet: Fleet, open_page: Open) -> None:
    fleet.plant.scenario("old", "  # why\n  - {wait: 1}\n")
    page = open_page("engineer", PLACE)
    chosen(page, "old", "Duplicate")
    expect(text_of(page, "old_copy")).to_contain_text("# why")
    page.get_by_role("button", name="Store").click()
    expect(page.get_by_text("old_copy was stored.")).to_be_visible()
    page.get_by_role("link", name="Library").click()
    chosen(page, "old_copy", "Delete…")
    dialog = page.get_by_role("dialog", name="Delete old_copy")
    expect(dialog).to_contain_text("# why")
    dialog.get_by_role("button", name="Delete", exact=True).click()
    expect(page.get_by_text("old_copy was deleted.")).to_be_visible()
    expect(row(page, "old_copy")).to_have_count(0)


def _goes_down(page: Page, nodes: Locator, scale: str) -> None:
    """In a narrow window each step can be read, and what follows stands below."""
    graph = page.get_by_role("group", name="Graph")
    first, last = nodes.filter(has_text="one").first, nodes.filter(has_text="again").first
    expect(first).to_be_in_viewport(ratio=0.99)
    assert page.locator(".svelte-flow__viewport").evaluate(scale) >= 0.8
    assert graph.evaluate("one => one.scrollWidth - one.clientWidth") <= 0, "two beside each other have room"
    last.scroll_into_view_if_needed()
    expect(last).to_be_in_viewport(ratio=0.99)
    boxes = [one.bounding_box() for one in (first, last)]
    assert boxes[0] is not None
    assert boxes[1] is not None
    assert boxes[0]["y"] + boxes[0]["height"] < boxes[1]["y"]


def test_a_scenario_is_started_with_its_parameters_and_followed(
    fleet: Fleet, open_page: Open, picture: Picture
) -> None:
    head = "parameters:\n  seconds: {default: 0.5, unit: s, range: [0, 30], description: how long}\n"
    fleet.plant.scenario("ordered", ORDERED, head)
    page = open_page("operator", PLACE)
    expect(row(page, "ordered")).to_contain_text("Fits")
    chosen(page, "ordered", "Start…")
    dialog = page.get_by_role("dialog", name="Start ordered")
    expect(dialog).to_contain_text("how long")
    dialog.get_by_label("seconds").fill("300")
    dialog.get_by_role("button", name="Start").click()
    expect(dialog).to_contain_text("Give 0 to 30.")
    picture(page, "scenarios-start")
    dialog.get_by_label("seconds").fill("0.8")
    page.keyboard.press("Enter")
    expect(lines(page).filter(has_text="one").first).to_contain_text("left")
    expect(page.locator("header").get_by_text("Done")).to_be_visible()
    expect(lines(page).filter(has_text="again")).to_contain_text("time 2")
    expect(lines(page).filter(has_text="three")).to_contain_text("Done")
    picture(page, "run-steps")
    page.get_by_role("tab", name="Gantt chart").click()
    chart = page.get_by_role("region", name="Gantt chart")
    expect(chart.get_by_role("listitem")).to_have_count(4)
    expect(chart.get_by_role("listitem").filter(has_text="three")).to_contain_text("done")
    picture(page, "run-gantt")
    page.get_by_role("tab", name="Graph").click()
    listed = page.get_by_role("list", name="The same as a list")
    expect(listed.get_by_role("listitem").filter(has_text="again")).to_contain_text("after one time 1, Done, right")
    nodes = page.locator(".svelte-flow__node")
    expect(nodes).to_have_count(9)
    expect(nodes.filter(has_text="again")).to_contain_text("time 2")
    expect(page.locator(".svelte-flow__edge")).to_have_count(11)
    # In a window of another size it is whole again, until somebody looks at a part of it; where it could not be read
    # then, it goes down.
    browsing.show(page, "light", browsing.WIDEST)
    scale = "one => new DOMMatrix(getComputedStyle(one).transform).a"
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    wide = page.locator(".svelte-flow__viewport").evaluate(scale)
    assert wide >= 0.7
    picture(page, "run-graph")
    for narrower in browsing.WIDTHS:
        browsing.show(page, "light", narrower)
        _goes_down(page, nodes, scale)
    browsing.show(page, "light", browsing.WIDEST)
    page.wait_for_function(f"wide => ({scale})(document.querySelector('.svelte-flow__viewport')) === wide", arg=wide)
    page.get_by_role("button", name="Show all").click()
    page.get_by_role("group", name="Graph").focus()
    before = page.locator(".svelte-flow__viewport").evaluate("one => one.style.transform")
    page.keyboard.press("ArrowRight")
    expect(page.locator(".svelte-flow__viewport")).not_to_have_attribute("style", re.compile(re.escape(before)))
    browsing.show(page, "light", 1280)
    page.get_by_role("tab", name="Gantt chart").click()
    later = open_page("observer", page.url.partition("/#")[2].join(["#", ""]))
    past = later.get_by_role("region", name="Gantt chart").get_by_role("listitem")
    expect(past).to_have_count(4)
    expect(past.first).to_contain_text(re.compile(r"left · \d+:\d\d:\d\d.*\d+:\d\d:.* · done"))
    page.get_by_role("link", name="Runs").click()
    expect(row(page, "ordered", "Runs")).to_contain_text("5/5")
    picture(page, "runs")


def test_a_run_is_paused_resumed_and_aborted_with_a_reason(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    fleet.plant.scenario(
        "long", "  - {task: slow, skill: work, robot: left, arguments: {seconds: 6}}\n  - {wait: 60}\n"
    )
    page = open_page("operator", PLACE)
    chosen(page, "long", "Start…")
    page.get_by_role("dialog").get_by_role("button", name="Start").click()
    expect(lines(page).first).to_contain_text("Running")
    watcher = open_page("observer", page.url.partition("/#")[2].join(["#", ""]))
    expect(watcher.get_by_role("button", name="Abort…")).to_have_attribute(
        "title", "Your role does not allow this; required role: Operator."
    )
    page.get_by_role("button", name="Pause").click()
    expect(page.locator("header").get_by_text("Paused")).to_be_visible()
    page.get_by_role("button", name="Resume").click()
    expect(page.locator("header").get_by_text("Running")).to_be_visible()
    page.get_by_role("button", name="Abort…").click()
    dialog = page.get_by_role("dialog", name="Abort this run")
    dialog.get_by_role("button", name="Abort the run").click()
    expect(dialog).to_contain_text("Give a reason")
    dialog.get_by_label("Reason").fill("<b>enough</b>")
    page.keyboard.press("Enter")
    expect(page.locator("header").get_by_text("Aborted")).to_be_visible(timeout=20_000)
    expect(page.locator("dl")).to_contain_text("<b>enough</b>")
    expect(watcher.locator("header").get_by_text("Aborted")).to_be_visible()


def test_a_person_says_what_became_of_a_task_that_nobody_knows(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    work = f"{{task: lost, skill: work, robot: middle, arguments: {{work: {ENDLESS_WORK}}}, on_unknown: ask}}"
    fleet.plant.scenario("unknown", f"  - {work}\n")
    page = open_page("operator", PLACE)
    chosen(page, "unknown", "Start…")
    page.get_by_role("dialog").get_by_role("button", name="Start").click()
    expect(lines(page).first).to_contain_text("Running")
    fleet.plant.machines["middle"].forget()
    fleet.bridges["middle"].end(signal.SIGKILL)
    fleet.bridges["middle"] = fleet.plant.start_bridge("middle")
    question = page.get_by_role("region", name="Question about lost")
    expect(question).to_contain_text("Did middle do “lost”? Its outcome is unknown.", timeout=60_000)
    watcher = open_page("observer", page.url.partition("/#")[2].join(["#", ""]))
    expect(watcher.get_by_role("button", name="It was done")).to_have_attribute(
        "title", "Your role does not allow this; required role: Operator."
    )
    picture(page, "run-question")
    question.get_by_role("button", name="It was done").click()
    expect(page.locator("header").get_by_text("Done")).to_be_visible()
    expect(question).to_have_count(0)


HANDED = """\
  - {{task: first, skill: work, robot: left}}
  - {{task: lost, skill: work, robot: middle, arguments: {work}, on_unknown: ask}}
  - {{task: last, skill: work, robot: right}}
"""


def _started_as_carried(page: Page, name: str) -> Locator:
    """The list of the bridges of a run that these carry."""
    page.goto(f"{page.url.partition('#')[0]}{PLACE}")
    chosen(page, name, "Start…")
    dialog = page.get_by_role("dialog", name=f"Start {name}")
    dialog.get_by_label("Carried out by").select_option("carried")
    expect(dialog.get_by_text("The bridges can carry it.")).to_be_visible()
    dialog.get_by_role("button", name="Start").click()
    return page.get_by_role("list", name="Bridges that carry the run").get_by_role("listitem")


def test_the_server_says_why_bridges_cannot_carry_a_scenario(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    fleet.plant.scenario("told", "  - {task: one, skill: work, robot: left}\n  - {wait: , event: go}\n")
    page = open_page("operator", PLACE)
    chosen(page, "told", "Start…")
    dialog = page.get_by_role("dialog", name="Start told")
    expect(dialog).to_contain_text("The run stands still while the server is away.")
    dialog.get_by_label("Carried out by").select_option("carried")
    expect(dialog.get_by_role("status")).to_contain_text("The bridges cannot carry it.")
    expect(dialog.get_by_role("list", name="Problems").get_by_role("listitem")).to_have_count(1)
    expect(dialog.get_by_role("button", name="Start")).to_have_attribute("title", "The bridges cannot carry it.")
    picture(page, "scenarios-start-carried")
    page.keyboard.press("Enter")
    expect(dialog).to_be_visible()
    dialog.get_by_label("Carried out by").select_option("")
    expect(dialog.get_by_role("button", name="Start")).not_to_have_attribute("aria-disabled", "true")


def test_a_carried_run_is_followed_and_asks_people(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    """The question of a bridge is found among the alarms, and answered at the run."""
    fleet.plant.scenario("handed", HANDED.format(work=f"{{work: {ENDLESS_WORK}}}"))
    page = open_page("operator", PLACE)
    bridges = _started_as_carried(page, "handed")
    expect(bridges).to_have_count(3)
    expect(bridges.filter(has_text="middle_cell")).to_contain_text("Has the token")
    expect(bridges.filter(has_text="left_cell")).to_contain_text("Without the token")
    expect(lines(page).filter(has_text="first")).to_contain_text("Done")
    picture(page, "run-carried")
    fleet.plant.machines["middle"].forget()
    fleet.bridges["middle"].end(signal.SIGKILL)
    fleet.bridges["middle"] = fleet.plant.start_bridge("middle")
    expect(page.get_by_role("region", name="Question about lost")).to_be_visible()
    page.goto(f"{page.url.partition('#')[0]}#/hall/alarms?kind=dialog")
    # Who takes the task over may be asked beside it by then.
    asked = page.get_by_role("article").filter(has_text="lost: was lost")
    expect(asked).to_contain_text("Waits for a person")
    asked.get_by_role("link", name="Decide…").click()
    page.get_by_role("region", name="Question about lost").get_by_role("button", name="It was done").click()
    expect(page.locator("header").get_by_text("Done")).to_be_visible()
    expect(lines(page).filter(has_text="last")).to_contain_text("Done")
    expect(bridges.filter(has_text="Run over")).to_have_count(3)


def test_a_bridge_of_a_carried_run_that_is_off_is_left_out(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    """Another one goes on for it, and asks who does what was not done."""
    fleet.plant.scenario("left_out", HANDED.format(work="{seconds: 6}"))
    page = open_page("operator", PLACE)
    bridges = _started_as_carried(page, "left_out")
    expect(lines(page).filter(has_text="lost")).to_contain_text("Running")
    fleet.bridges["middle"].end(signal.SIGKILL)
    gone = bridges.filter(has_text="middle_cell")
    expect(gone).to_contain_text("It had the token when it was heard last.")
    watcher = open_page("observer", page.url.partition("/#")[2].join(["#", ""]))
    leave = "Leave it out…"
    expect(watcher.get_by_role("button", name=leave)).to_have_attribute(
        "title", "Your role does not allow this; required role: Operator."
    )
    picture(page, "run-carried-silent")
    gone.get_by_role("button", name=leave).click()
    dialog = page.get_by_role("dialog", name="Leave middle_cell out")
    expect(dialog.get_by_role("group").get_by_role("checkbox")).to_have_count(1)
    dialog.get_by_role("button", name="Leave it out").click()
    expect(dialog).to_contain_text("otherwise robots could be commanded twice")
    picture(page, "run-carried-adopt")
    dialog.get_by_label("middle_cell is off").check()
    dialog.get_by_role("button", name="Leave it out").click()
    expect(dialog).to_be_hidden()
    expect(bridges).to_have_count(2)
    page.get_by_role("link", name="Decide…").click()
    page.get_by_role("button", name="Choose right").click()
    expect(page.get_by_text("right takes over.")).to_be_visible()
    page.goto(watcher.url)
    expect(page.locator("header").get_by_text("Done")).to_be_visible()
    expect(lines(page).filter(has_text="lost")).to_contain_text("right")
    fleet.bridges["middle"] = fleet.plant.bridge("middle")


DRY = """\
  - {task: one, skill: work, robot: left, arguments: {seconds: "=seconds"}}
  - parallel:
      - {task: two, skill: work, robot: middle}
      - {task: three, skill: work, capacity: weld}
  - {wait: 90}
  - if: one.seconds > 100
    then:
      - {end: failed, reason: <b>too long</b>}
    else:
      - {repeat: [{task: again, skill: work, robot: right}, {wait: 0.5}], times: 2}
"""


def test_a_dry_run_shows_what_would_happen_over_time(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    head = "parameters:\n  seconds: {default: 0.5, unit: s, range: [0, 30], description: how long}\n"
    fleet.plant.scenario("rehearsed", DRY, head)
    page = open_page("operator", PLACE + "/edit/rehearsed")
    page.get_by_role("button", name="Dry run…").click()
    dialog = page.get_by_role("dialog", name="Dry run of rehearsed")
    expect(dialog.get_by_label("seconds", exact=True)).to_have_value("0.5")
    page.keyboard.press("Enter")
    result = dialog.get_by_role("region", name="What would happen").first
    expect(result).to_contain_text("It would be done")
    chart = dialog.get_by_role("tabpanel")
    expect(chart.get_by_role("listitem")).to_have_count(6)
    expect(chart.get_by_role("listitem").filter(has_text="three")).to_contain_text("at 0 s")
    expect(chart.get_by_role("listitem").filter(has_text="again")).to_contain_text("at 90.5 s")
    picture(page, "dry-run")
    dialog.get_by_role("tab", name="By step").focus()
    page.keyboard.press("ArrowRight")
    expect(chart.get_by_role("listitem").filter(has_text="right")).to_contain_text("again")
    page.keyboard.press("ArrowRight")
    table = dialog.get_by_role("table", name="Table")
    expect(table).to_contain_text("two: middle work(")
    expect(table).to_contain_text("90 s")
    picture(page, "dry-run-table")
    dialog.get_by_label("one.seconds").fill("300")
    page.keyboard.press("Enter")
    expect(result).to_contain_text("It would fail")
    expect(result).to_contain_text("<b>too long</b>")
    dialog.get_by_label("seconds", exact=True).fill("31")
    dialog.get_by_role("button", name="Rehearse").click()
    expect(dialog).to_contain_text("Give 0 to 30.")
    dialog.get_by_role("button", name="Add a value").click()
    dialog.get_by_label("Name").fill("no.such")
    dialog.get_by_label("Value").fill("1")
    dialog.get_by_label("seconds", exact=True).fill("1")
    page.keyboard.press("Enter")
    expect(result).to_contain_text("It would fail")
    dialog.get_by_role("tab", name="Table").click()
    table.get_by_role("row").filter(has_text="two: middle").click()
    expect(dialog).to_have_count(0)
    expect(text_of(page, "rehearsed")).to_be_focused()
    watcher = open_page("observer", PLACE + "/edit/rehearsed")
    expect(watcher.get_by_role("button", name="Dry run…")).to_have_attribute(
        "title", re.compile("required role: Operator")
    )
