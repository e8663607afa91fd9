"""Alarms of values, bridges and certificates in the browser: all states, what each role may do, by keyboard."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console import browsing
from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask
from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import Plant
from ua_fleet.endpoint.certificates import CertificateFiles, certificates_folder, create_certificate

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE: Final = "#/hall/alarms"
STEPS: Final = f"  - {{task: a, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 60}}\n"


def with_alarms(plant: Plant) -> None:
    """Two limits of what the machine `left` tells, a certificate that ends in five days, and a history of events."""

    def declare(raw: dict[str, Any]) -> None:
        raw["history"] = {}
        raw["robots"]["left"]["data"].update(
            temperature={
                "id": 1310,
                "type": "Double",
                "unit": "°C",
                "limits": {"high": 80, "high_high": 90, "hysteresis": 2, "confirm": True},
            },
            pressure={"id": 1312, "type": "Double", "unit": "bar", "limits": {"low": 1}},
        )

    plant.declare(declare)
    plant.scenario("long", STEPS)
    folder = certificates_folder(plant.folder / plant.config.server.state_dir) / "trusted"
    folder.mkdir(parents=True, exist_ok=True)
    files = CertificateFiles(folder / "plc.der", plant.folder / "plc.pem")
    create_certificate(files, application_uri="urn:plc", common_name="plc", days=5)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), with_alarms) as running:
        yield running


def alarm(page: Page, name: str) -> Locator:
    return page.get_by_role("article", name=name)


def tell(fleet: Fleet, **values: float) -> None:
    """Have the machine `left` tell these values."""
    fleet.plant.machines["left"].tell(**values)


def acknowledge(page: Page, shown: Locator) -> None:
    """Without a comment."""
    shown.get_by_role("button", name="Acknowledge…").click()
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog")).to_be_hidden()


def choose(page: Page, shown: Locator, item: str) -> None:
    """Take something of an alarm's menu, by keyboard."""
    shown.get_by_role("button", name=re.compile("^More for ")).focus()
    page.keyboard.press("Enter")
    wanted = page.get_by_role("menuitem", name=item)
    expect(page.get_by_role("menu")).to_be_visible()
    for _ in range(page.get_by_role("menuitem").count()):
        if wanted.and_(page.locator(":focus")).count():
            break
        page.keyboard.press("ArrowDown")
    expect(wanted).to_be_focused()
    page.keyboard.press("Enter")


def test_a_limit_is_acknowledged_and_confirmed_by_keyboard(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page, observer = open_page("operator", PLACE), open_page("observer", PLACE)
    expect(alarm(page, "certificate trusted.plc")).to_contain_text("expires on")
    tell(fleet, temperature=85)
    limit = alarm(page, "left temperature")
    expect(limit).to_contain_text("left.temperature: 85 °C is above 80 °C")
    expect(limit).to_contain_text("Active · High")
    tell(fleet, temperature=95)
    expect(limit).to_contain_text("Active · HighHigh")
    expect(limit).to_contain_text("High severity (700)")
    expect(limit.get_by_role("link", name="left")).to_have_attribute("href", "#/hall/robot/left")
    picture(page, "alarms-of-values")
    expect(alarm(observer, "left temperature").get_by_role("button", name="Acknowledge…")).to_have_attribute(
        "title", "Your role does not allow this; required role: Operator."
    )
    page.get_by_label("Kind").focus()
    browsing.tabbed_to(page, limit.get_by_role("button", name="Acknowledge…"))
    page.keyboard.press("Enter")
    page.keyboard.type("the fan <b>stands</b>")
    picture(page, "alarms-acknowledge")
    page.keyboard.press("Enter")
    expect(alarm(observer, "left temperature")).to_contain_text("oscar: the fan <b>stands</b>")
    expect(limit.get_by_role("button", name="Acknowledge…")).to_have_count(0)
    tell(fleet, temperature=20)
    expect(limit).to_contain_text("Over")
    expect(limit).to_contain_text("not confirmed")
    limit.get_by_role("button", name="Confirm…").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    expect(limit).to_have_count(0)
    expect(alarm(observer, "left temperature")).to_have_count(0)


def test_what_is_shelved_is_no_longer_counted(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    tell(fleet, pressure=0.5)
    limit = alarm(page, "left pressure")
    expect(limit).to_contain_text("is below 1 bar")
    waiting = page.get_by_role("navigation", name="Pages").get_by_role("link", name="Alarms")
    before = waiting.inner_text()
    choose(page, limit, "Shelve…")
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_label("For")).to_be_focused()
    expect(dialog.get_by_label("For").locator("option:checked")).to_have_text("1 h")
    picture(page, "alarms-shelve")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Shelve", exact=True).click()
    expect(limit).to_have_count(0)
    expect(page.get_by_role("main").get_by_role("status")).to_contain_text("1 put aside")
    expect(waiting).not_to_have_text(before)
    page.get_by_label("State").select_option("shelved")
    expect(limit).to_contain_text("Shelved until")
    picture(page, "alarms-shelved")
    page.reload()
    expect(limit).to_contain_text("Shelved until")
    limit.get_by_role("button", name="Unshelve").click()
    expect(page.get_by_text("No alarm matches.")).to_be_visible()
    page.get_by_label("State").select_option("")
    expect(limit).to_be_visible()
    choose(page, limit, "Shelve…")
    dialog.get_by_label("For").select_option("Until it is over, at most 7 days")
    dialog.get_by_role("button", name="Shelve", exact=True).click()
    page.get_by_label("State").select_option("shelved")
    expect(limit).to_contain_text("Shelved until it is over")
    tell(fleet, pressure=2)
    expect(limit).to_have_count(0)


def test_an_engineer_suppresses_and_disables(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page, operator = open_page("engineer", f"{PLACE}?state=all"), open_page("operator", f"{PLACE}?state=all")
    tell(fleet, pressure=0.5)
    limit, theirs = alarm(page, "left pressure"), alarm(operator, "left pressure")
    choose(operator, theirs, "Suppress…")
    expect(operator.get_by_role("status").filter(has_text="required role: Engineer")).to_be_visible()
    expect(operator.get_by_role("dialog")).to_have_count(0)
    operator.keyboard.press("Escape")
    choose(page, limit, "Suppress…")
    expect(page.get_by_role("dialog")).to_contain_text("It stays so until somebody unsuppresses it.")
    page.get_by_role("dialog").get_by_role("button", name="Suppress", exact=True).click()
    expect(theirs).to_contain_text("Suppressed")
    acknowledge(page, limit)
    tell(fleet, pressure=2)  # no longer retained, and listed all the same
    choose(page, limit, "Disable…")
    page.get_by_role("dialog").get_by_role("button", name="Disable", exact=True).click()
    expect(theirs).to_contain_text("Disabled")
    page.goto(page.url.partition("#")[0] + PLACE + "?state=disabled")
    page.reload()
    expect(limit).to_contain_text("Disabled")
    picture(page, "alarms-disabled")
    limit.get_by_role("button", name="Enable").click()
    expect(limit).to_have_count(0)
    page.get_by_label("State").select_option("suppressed")
    choose(page, limit, "Unsuppress")
    expect(limit).to_have_count(0)
    expect(theirs).to_have_count(0)


def test_an_alarm_that_is_inactive_is_disabled_and_enabled(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    """Nothing tells of it: it is found among the inactive ones, and is there again once it is enabled."""
    page, operator = open_page("engineer", f"{PLACE}?state=inactive"), open_page("operator", f"{PLACE}?state=inactive")
    tell(fleet, pressure=2, temperature=20)
    limit, theirs = alarm(page, "left pressure"), alarm(operator, "left pressure")
    expect(limit).to_contain_text("Inactive")
    expect(limit.get_by_role("button", name="Comment…")).to_have_count(0)
    picture(page, "alarms-inactive")
    page.get_by_role("searchbox", name="Search alarms and events").fill("PRESS left")
    expect(page.get_by_role("article")).to_have_count(1)
    choose(operator, theirs, "Disable…")
    expect(operator.get_by_role("status").filter(has_text="required role: Engineer")).to_be_visible()
    operator.keyboard.press("Escape")
    choose(page, limit, "Disable…")
    page.get_by_role("dialog").get_by_role("button", name="Disable", exact=True).click()
    expect(limit).to_have_count(0)
    expect(theirs).to_have_count(0)
    page.get_by_label("State").select_option("disabled")
    expect(limit).to_contain_text("Disabled")
    limit.get_by_role("button", name="Enable").click()
    expect(limit).to_have_count(0)
    page.get_by_label("State").select_option("inactive")
    expect(limit).to_contain_text("Inactive")
    expect(theirs).to_contain_text("Inactive")
    tell(fleet, pressure=0.5)
    expect(limit).to_have_count(0)
    expect(theirs).to_have_count(0)
    page.get_by_label("State").select_option("")
    acknowledge(page, limit)
    tell(fleet, pressure=2)
    expect(limit).to_have_count(0)


def test_events_begin_in_the_history_and_each_is_there_once(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    tell(fleet, pressure=0.5)
    shown = alarm(page, "left pressure")
    expect(shown).to_be_visible()
    choose(page, shown, "Its events")
    expect(page.get_by_role("tab", name="Events")).to_have_attribute("aria-selected", "true")
    rows = page.get_by_role("table", name="Events").locator("tbody tr")
    active, over = "left.pressure: 0.5 bar is below 1 bar", "left.pressure: within its limits"
    # Of before this page was opened: this one, and those of the tests before.
    expect(rows.first).to_contain_text(f"Active · Unacknowledged: {active}")
    before = rows.filter(has_text=over).count()
    expect(page.get_by_role("main").get_by_role("status").filter(has_text="events · since")).to_be_visible()
    tell(fleet, pressure=2)
    expect(rows.first).to_contain_text(f"Inactive · Unacknowledged: {over}")
    expect(rows.filter(has_text=over)).to_have_count(before + 1)
    picture(page, "alarms-its-events")
    told = rows.all_inner_texts()
    page.reload()
    expect(rows.first).to_contain_text(over)
    # What came live is in the history now; it is shown as it was.
    expect(rows).to_have_count(len(told))
    assert rows.all_inner_texts() == told
    engineer = open_page("engineer", f"{PLACE}?show=events&audit=only")
    audit = engineer.get_by_role("table", name="Events").locator("tbody tr")
    expect(audit.filter(has_text="AuditUpdateMethod").first).to_be_visible()
    page.get_by_role("tab", name="Alarms").click()
    acknowledge(page, shown)
    expect(shown).to_have_count(0)


def test_a_robot_s_page_has_the_alarms_of_its_values(open_page: Open, fleet: Fleet) -> None:
    page, other = open_page("operator", "#/hall/robot/left"), open_page("operator", "#/hall/robot/middle")
    expect(other.get_by_role("heading", name="middle")).to_be_visible()
    tell(fleet, pressure=0.5)
    limit = page.get_by_role("list", name="Faults").get_by_role("listitem")
    expect(limit).to_contain_text("left.pressure: 0.5 bar is below 1 bar")
    expect(limit.get_by_role("button", name="Clear…")).to_have_count(0)
    expect(other.get_by_role("list", name="Faults")).to_have_count(0)
    acknowledge(page, limit)
    tell(fleet, pressure=2)
    expect(page.get_by_role("list", name="Faults")).to_have_count(0)


def test_bridges_that_are_away_and_decisions_are_there(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    ask(page, "scenario.run", scenario="long")
    ask(page, "fault.raise", robot="left", reason="the welding tip is worn")
    decision = page.get_by_role("article").filter(has_text="who takes over from left?")
    expect(decision).to_contain_text("Waits for a person")
    fleet.bridges["middle"].end()
    bridge = alarm(page, "middle_cell")
    expect(bridge).to_contain_text("Active")
    expect(bridge.get_by_role("link", name="middle_cell")).to_have_attribute("href", "#/hall/pubsub")
    picture(page, "alarms-all-kinds")
    page.get_by_label("Kind").select_option("Decision")
    expect(page.get_by_role("article")).to_have_count(1)
    decision.get_by_role("link", name="Decide…").click()
    expect(page.get_by_role("heading", name="a, instead of left")).to_be_visible()
