"""Who takes over: a robot fails in a run, and it is decided in the browser."""

from __future__ import annotations

import json
import re
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console import browsing
from tests.console.conftest import Console, Fleet, fleet_of
from tests.console.test_alarms import ask
from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import ROBOTS, Plant

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE: Final = "#/hall/resilience"
STEPS: Final = f"  - {{task: a, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 60}}\n"

LOG_OUT: Final = """async () => {
  const {csrf} = await (await fetch('api/me')).json();
  const headers = {'Content-Type': 'application/json', 'X-CSRF': csrf};
  await fetch('api/logout', {method: 'POST', headers, body: '{}'});
}"""


def with_criteria(plant: Plant) -> None:
    """Two criteria by which the robots differ: `middle` has less battery and less to carry than `right`."""
    path = plant.folder / "fleet.json"
    raw: dict[str, Any] = json.loads(path.read_text())
    for number, robot in enumerate(ROBOTS):
        raw["robots"][robot].setdefault("data", {}).update(
            battery={"id": 1310 + number, "type": "Double", "origin": "server", "initial": 30.0 + 20 * number},
            load={"id": 1320 + number, "type": "Double", "origin": "server", "initial": 1.0 + 4 * number, "unit": "kg"},
        )
    raw["resilience"] |= {
        "criteria": {
            "battery": {"kind": "benefit", "range": [0, 100], "value": "battery", "unit": "%"},
            "load": {"kind": "cost", "range": [0, 10], "value": "load"},
        },
        "judgements": {"battery": {"load": 1}},
    }
    path.write_text(json.dumps(raw))
    plant.scenario("long", STEPS)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), with_criteria) as running:
        yield running


def ranked(page: Page) -> Locator:
    return page.get_by_role("region", name="Ranking").locator("tbody th")


def width(shown: Locator) -> float:
    box = shown.bounding_box()
    assert box is not None
    return box["width"]


def _find_it_from_the_run(page: Page) -> None:
    """A run that waits leads to its decision, tells for how long it has been under way, and is counted."""
    other = page.context.new_page()
    other.goto(page.url.partition("#")[0] + "#/hall/scenarios")
    other.get_by_role("tab", name=re.compile("^Runs.*1$")).click()
    other.get_by_role("link", name="long").click()
    expect(other.get_by_text("left has failed, and a person decides who takes over")).to_be_visible()
    expect(other.get_by_text("Duration").locator("..")).not_to_contain_text("ms")
    assert browsing.pictures(other, "scenarios-run-decides") == []
    other.get_by_role("link", name="Decide…").click()
    expect(other.get_by_role("heading", name="a, instead of left")).to_be_visible()
    other.close()


def _look_at_the_attempt(page: Page) -> None:
    """It was made while this page looked at the run: whoever decides then finds it beside the second one."""
    page.get_by_role("link", name=re.compile("^Run 20")).click()
    page.get_by_role("tab", name="Gantt chart").click()
    expect(page.get_by_role("region", name="Gantt chart").get_by_role("listitem")).to_contain_text("left")
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Resilience").click()
    expect(page.get_by_role("heading", name="a, instead of left")).to_be_visible()


def _see_how_long_it_waits(page: Page) -> None:
    left = page.get_by_role("main").get_by_role("timer")
    expect(left.first).to_have_text(re.compile(r"^[89] min( \d+ s)? left to decide, until .* by the server's clock\.$"))
    before = left.first.inner_text()
    expect(left.first).not_to_have_text(before)
    expect(left.last).to_have_text(re.compile(r"^[89] min( \d+ s)? left$"))


def _see_it_on_a_narrow_page(page: Page) -> None:
    browsing.show(page, "light", 360)
    choose = page.get_by_role("button", name="Choose right")
    choose.scroll_into_view_if_needed()
    expect(choose).to_be_in_viewport(ratio=1)
    narrow = page.get_by_role("table", name="Scores")
    assert narrow.evaluate("one => one.scrollWidth - one.parentElement.clientWidth") <= 0, "it is to be scrolled"
    expect(narrow.get_by_role("row").nth(1).get_by_role("cell", name="worth").first).to_contain_text("battery")
    expect(narrow.get_by_role("columnheader", name="battery")).to_be_visible()
    browsing.show(page, "light", 1280)


def _leave_and_come_back(page: Page) -> None:
    """What was tried is there again, in the same window alone, until it is reset or the decision is made."""
    said = "You try a comparison. Only you see it."
    slider = page.get_by_role("slider", name="battery or load")
    expect(page.get_by_role("status").filter(has_text=said)).to_be_visible()
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Fleet").click()
    expect(page.get_by_role("article", name="left")).to_be_visible()
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Resilience").click()
    expect(slider).to_have_attribute("aria-valuetext", "battery counts 9 times as much as load")
    expect(ranked(page)).to_have_text(["right", "middle"])
    expect(page.get_by_role("status").filter(has_text=said)).to_be_visible()
    other = page.context.new_page()
    other.goto(page.url)
    expect(other.get_by_role("slider")).to_have_attribute("aria-valuetext", "Both count the same")
    other.close()


def test_a_person_weighs_criteria_and_chooses_who_takes_over(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    expect(page.get_by_text("No decision is open.")).to_be_visible()
    picture(page, "resilience-none")
    ask(page, "scenario.run", scenario="long")
    assert width(page.get_by_label("Robot that fails")) > 120, "the name of a robot is cut"
    page.get_by_label("Robot that fails").select_option("left")
    page.get_by_role("button", name="Which robot would take over?").click()
    expect(page.get_by_role("region", name="What if a robot fails?").get_by_role("listitem")).to_contain_text("a:")
    ask(page, "fault.raise", robot="left", reason="the welding tip is worn")
    expect(page.get_by_role("heading", name="a, instead of left")).to_be_visible()
    expect(ranked(page)).to_have_text(["middle", "right"])
    # One unit is the criterion's own, the other one that of the robots' values.
    best = page.get_by_role("region", name="Ranking").locator("tbody tr").first
    expect(best).to_contain_text(re.compile(r"50\s+%\s*worth .*5\s+kg\s*worth ", re.DOTALL))
    others = page.get_by_role("region", name="Ranking").locator("dl")
    expect(others.locator("dt")).to_have_text(["left"])
    expect(others.locator("dd")).to_contain_text("the welding tip is worn")
    observer = open_page("observer", PLACE)
    expect(observer.get_by_role("button", name="Choose right")).to_be_disabled()
    _see_how_long_it_waits(observer)

    _look_at_the_attempt(page)
    slider = page.get_by_role("slider", name="battery or load")
    expect(slider).to_have_attribute("aria-valuetext", "Both count the same")
    slider.focus()
    for _ in range(8):
        page.keyboard.press("ArrowLeft")
    expect(slider).to_have_attribute("aria-valuetext", "battery counts 9 times as much as load")
    expect(ranked(page)).to_have_text(["right", "middle"])
    expect(ranked(observer)).to_have_text(["middle", "right"])  # what is tried is nobody else's
    picture(page, "resilience")
    _leave_and_come_back(page)
    _see_it_on_a_narrow_page(page)
    _find_it_from_the_run(page)
    page.get_by_role("button", name="Keep for this decision").click()
    expect(ranked(observer)).to_have_text(["right", "middle"])
    page.get_by_role("button", name="Choose right").click()
    expect(page.get_by_role("status").filter(has_text="right takes over.")).to_be_visible()
    expect(page.get_by_role("link", name="right, chosen by oscar")).to_be_visible()
    page.get_by_role("link", name="right, chosen by oscar").click()
    expect(page.get_by_role("heading", name="a, instead of left")).to_be_visible()
    expect(page.get_by_role("slider")).to_have_count(0)
    expect(page.get_by_role("main").get_by_role("timer")).to_have_count(0)
    assert page.evaluate("sessionStorage.getItem('ua-fleet.tried')") is None, "it is kept though it is over"
    picture(page, "resilience-taken")
    page.get_by_role("link", name=re.compile("^Run 20")).click()
    expect(page.get_by_role("list", name="Steps")).to_contain_text("right")
    page.get_by_role("tab", name="Gantt chart").click()
    attempts = page.get_by_role("region", name="Gantt chart").get_by_role("listitem")
    expect(attempts).to_contain_text(re.compile("left · .*right · ", re.DOTALL))
    picture(page, "run-gantt-attempts")
    page.go_back()
    expect(page.get_by_role("heading", name="a, instead of left")).to_be_visible()


def test_a_person_ends_the_run_in_place_of_choosing(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    ask(page, "fault.raise", robot="left", reason="the welding tip is worn")
    ask(page, "scenario.run", scenario="long")
    page.get_by_role("button", name="Abort the run…").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("button", name="Abort the run", exact=True).click()
    expect(dialog.get_by_label("Reason")).to_be_focused()
    dialog.get_by_label("Reason").fill("<b>enough</b>")
    picture(page, "resilience-abort")
    page.keyboard.press("Enter")
    expect(page.get_by_role("status").filter(has_text="The run is aborted.")).to_be_visible()
    expect(page.get_by_text("No decision is open.")).to_be_visible()


def open_decisions(page: Page) -> Locator:
    return page.get_by_role("link", name="a, instead of left").filter(has_text="open")


def mistakes_of(console: Console) -> dict[str, int]:
    with urllib.request.urlopen(f"{console.url}healthz") as answer:
        counted: dict[str, int] = json.loads(answer.read())["mistakes"]
        return counted


def test_the_run_that_is_ended_is_the_one_that_was_asked_for(open_page: Open, console: Console) -> None:
    """Another robot fails meanwhile; then a candidate of the decision that is left."""
    page = open_page("operator", PLACE)
    ask(page, "fault.raise", robot="left", reason="the welding tip is worn")
    ask(page, "scenario.run", scenario="long")
    expect(open_decisions(page)).to_have_count(1)
    first = page.get_by_role("link", name=re.compile("^Run 20")).inner_text()
    page.get_by_role("button", name="Abort the run…").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_role("heading")).to_have_text(f"Abort {first.lower()}")
    dialog.get_by_label("Reason").fill("the part of the first run is broken")
    ask(page, "scenario.run", scenario="long")
    expect(page.locator("main li a").filter(has_text="open")).to_have_count(2)
    expect(page.locator("main li a").first).not_to_have_attribute("aria-current", "true")
    expect(dialog.get_by_role("heading")).to_have_text(f"Abort {first.lower()}")
    sent: list[str] = []
    page.on("request", lambda one: sent.append(one.url.rpartition("/")[2]))
    dialog.locator("form").evaluate("form => { form.requestSubmit(); form.requestSubmit(); }")  # Enter, twice
    expect(dialog).to_be_hidden()
    assert sent.count("run.abort") == 1
    expect(open_decisions(page)).to_have_count(1)
    expect(page.get_by_role("link", name=re.compile("^Run 20"))).not_to_have_text(first)

    ask(page, "fault.raise", robot="middle", reason="worn too")
    expect(ranked(page)).to_have_text(["right"])
    ask(page, "fault.clear", fault="middle")
    expect(ranked(page)).to_have_text(["middle", "right"])
    expect(page.get_by_role("button", name="Choose right")).to_be_enabled()
    assert mistakes_of(console) == {}
    page.get_by_role("button", name="Abort the run…").click()
    dialog.get_by_label("Reason").fill("enough")
    page.keyboard.press("Enter")
    expect(page.get_by_text("No decision is open.")).to_be_visible()


TRIED: Final = "sessionStorage.getItem('ua-fleet.tried')"


def wait_until(page: Page, is_so: Callable[[], bool], what: str) -> None:
    """Wait for what no locator sees; the policy of the page forbids Playwright's own way."""
    for _ in range(1200):
        if is_so():
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"not within 60 s: {what}")


def test_what_was_tried_last_is_not_asked_of_the_decision_that_is_opened_next(open_page: Open) -> None:
    page = open_page("operator", PLACE)
    ask(page, "fault.raise", robot="left", reason="the welding tip is worn")
    for number in (1, 2):
        ask(page, "scenario.run", scenario="long")
        expect(open_decisions(page)).to_have_count(number)
    links = open_decisions(page)
    links.first.click()
    slider = page.get_by_role("slider", name="battery or load")
    slider.focus()
    asked: list[str] = []
    page.on("request", lambda sent: asked.append(sent.post_data or ""))
    opened = links.last.get_attribute("href")
    assert opened is not None
    slider.evaluate(
        """async (slider, href) => {
          slider.value = Number(slider.value) + (Number(slider.value) > 0 ? -1 : 1);
          slider.dispatchEvent(new Event('input', {bubbles: true}));
          slider.dispatchEvent(new Event('change', {bubbles: true}));
          location.hash = href.slice(href.indexOf('#'));
        }""",
        opened,
    )
    expect(links.last).to_have_attribute("aria-current", "true")
    expect(page.get_by_role("slider")).to_have_attribute("aria-valuetext", "Both count the same")
    wait_until(page, lambda: "battery/load" in str(page.evaluate(TRIED)), "it was tried")
    page.wait_for_timeout(1000)
    assert [one for one in asked if "battery/load" in one] == []
    for _ in range(2):
        page.get_by_role("button", name="Abort the run…").click()
        page.get_by_role("dialog").get_by_label("Reason").fill("enough")
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_be_hidden()
        page.get_by_role("navigation", name="Pages").get_by_role("link", name="Resilience").click()
    expect(page.get_by_text("No decision is open.")).to_be_visible()


def test_what_was_tried_is_gone_with_the_login(open_page: Open, console: Console) -> None:
    page = open_page("operator", PLACE)
    ask(page, "fault.raise", robot="left", reason="the welding tip is worn")
    ask(page, "scenario.run", scenario="long")
    slider = page.get_by_role("slider", name="battery or load")
    slider.focus()
    page.keyboard.press("ArrowLeft")
    expect(slider).to_have_attribute("aria-valuetext", "battery counts 2 times as much as load")
    page.get_by_role("button", name="Reset").click()
    expect(slider).to_have_attribute("aria-valuetext", "Both count the same")
    wait_until(page, lambda: page.evaluate(TRIED) is None, "nothing that was tried is kept")
    slider.focus()
    page.keyboard.press("ArrowLeft")
    wait_until(page, lambda: page.evaluate(TRIED) is not None, "it was tried")
    page.reload()
    expect(slider).to_have_attribute("aria-valuetext", "battery counts 2 times as much as load")
    # As another browser of the same login would log it out.
    page.evaluate(LOG_OUT)
    del console.states["operator"]
    expect(page.get_by_role("button", name="Log in")).to_be_visible()
    wait_until(page, lambda: page.evaluate(TRIED) is None, "nothing that was tried is kept")
    ended = open_page("engineer", PLACE)
    ended.get_by_role("button", name="Abort the run…").click()
    ended.get_by_role("dialog").get_by_label("Reason").fill("enough")
    ended.keyboard.press("Enter")
    expect(ended.get_by_text("No decision is open.")).to_be_visible()


def test_an_engineer_says_who_decides(open_page: Open) -> None:
    page = open_page("engineer", PLACE)
    who = page.get_by_role("region", name="Who decides")
    expect(who).to_contain_text("A person chooses. After 10 min")
    who.get_by_role("button", name="Change…").click()
    page.get_by_role("dialog").get_by_label("Who decides").select_option("The server takes the best.")
    page.keyboard.press("Enter")
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    expect(who).to_contain_text("The server takes the best.")
    other = open_page("operator", PLACE)
    expect(other.get_by_role("button", name="Change…")).to_be_disabled()
