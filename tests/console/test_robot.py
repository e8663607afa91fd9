"""The page of one robot: its data, its skills, its faults."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Locator, Page, Route, expect

from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
LEFT: Final = "#/hall/robot/left"
HOSTILE: Final = "<img src=x onerror=alert(1)>\u202e" + "long " * 40
NODES: Final = {
    "speed_limit": {"id": 1301, "type": "Double", "unit": "m/s", "range": [0, 2], "initial": 0.5},
    "route": {"id": 1302, "type": "String", "initial": "A, B"},
    "lamp": {"id": 1303, "type": "Boolean", "initial": False},
    "drive": {
        "id": 1304,
        "fields": {
            "current": {"type": "Double", "unit": "A", "initial": 1.25},
            "mode": {"type": "String", "initial": HOSTILE},
        },
    },
    "never": {"id": 1305, "type": "Double", "unit": "V"},
    "camera": {"id": 1307, "type": "ByteString"},
    "points": {"id": 1306, "type": "Double", "array": True, "unit": "m", "range": [0, 5]},
}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """The fleet, whose robot `left` has more data."""

    def change(raw: dict[str, Any]) -> None:
        raw["robots"]["left"]["data"] |= {name: {"origin": "server", **node} for name, node in NODES.items()}
        raw["robots"]["left"]["card"] = ["speed_limit"]

    with fleet_of(tmp_path_factory.mktemp("fleet"), lambda plant: plant.declare(change)) as running:
        yield running


def row(page: Page, name: str) -> Locator:
    return (
        page.get_by_role("table", name="Data")
        .get_by_role("row")
        .filter(has=page.get_by_role("rowheader", name=name, exact=True))
    )


def skill(page: Page, name: str = "work") -> Locator:
    return page.get_by_role("region", name=name, exact=True)


def _png(wide: int) -> bytes:
    """A picture of so many grey points beside each other."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", wide, 1, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(bytes(wide + 1)))
        + chunk(b"IEND", b"")
    )


def test_a_camera_s_newest_picture_is_shown(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    ask(page, "node.write", node="ns=2;i=1307", value=_png(40).hex())
    page.get_by_role("button", name="Picture of camera").click()
    shown = page.get_by_role("img", name="Picture of camera")
    expect(shown).to_have_js_property("naturalWidth", 40)
    picture(page, "robot-picture")
    for wide in (50, 60, 70):
        ask(page, "node.write", node="ns=2;i=1307", value=_png(wide).hex())
    expect(shown).to_have_js_property("naturalWidth", 70)
    ask(page, "node.write", node="ns=2;i=1307", value=b"no picture".hex())
    expect(page.get_by_text("It is no picture that a browser shows")).to_be_visible()


@pytest.mark.parametrize("expected_complaints", [["503"]])
def test_a_picture_that_cannot_be_read_anew_is_not_of_now(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    ask(page, "node.write", node="ns=2;i=1307", value=_png(40).hex())
    page.get_by_role("button", name="Picture of camera").click()
    shown = page.get_by_role("figure").filter(has=page.get_by_role("img", name="Picture of camera"))
    expect(shown.get_by_role("img")).to_have_js_property("naturalWidth", 40)
    expect(shown).not_to_contain_text("Not current")
    page.route("**/node.picture", lambda route: route.fulfill(status=503, json={"error": {"message": "not now"}}))
    ask(page, "node.write", node="ns=2;i=1307", value=_png(50).hex())
    expect(shown).to_contain_text("Not current")
    expect(shown.get_by_role("img")).to_have_js_property("naturalWidth", 40)
    picture(page, "robot-picture-old")
    page.unroute("**/node.picture")
    ask(page, "node.write", node="ns=2;i=1307", value=_png(60).hex())
    expect(shown.get_by_role("img")).to_have_js_property("naturalWidth", 60)
    expect(shown).not_to_contain_text("Not current")


def test_a_robot_s_data_stand_in_their_groups(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    expect(page.get_by_role("heading", level=1, name="left")).to_be_visible()
    expect(row(page, "speed_limit")).to_contain_text("0.5")
    expect(row(page, "speed_limit")).to_contain_text("m/s")
    expect(row(page, "speed_limit")).to_contain_text("Good")
    expect(row(page, "never")).to_contain_text("—")
    value = row(page, "speed_limit").locator("span.value")
    assert value.get_attribute("title") is None
    value.hover()
    expect(value).to_have_attribute("title", re.compile(r"^0.5 m/s\nGood\n.*\d\d:\d\d:\d\d"))
    expect(page.get_by_role("rowheader", name="drive", exact=True)).to_be_visible()
    expect(row(page, "current")).to_contain_text("1.25")
    expect(row(page, "mode")).to_contain_text("<img src=x onerror=alert(1)>")
    expect(page.get_by_role("main")).not_to_contain_text("\u202e")
    picture(page, "robot")


def test_a_value_is_written_within_its_range(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    row(page, "speed_limit").get_by_role("button", name="Write speed_limit").click()
    dialog = page.get_by_role("dialog", name="Write speed_limit")
    field = dialog.get_by_label("speed_limit", exact=True)
    expect(field).to_be_focused()
    field.fill("7")
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("Give 0 to 2.")
    picture(page, "robot-write")
    field.fill("1,5")
    page.keyboard.press("Enter")
    expect(dialog).to_be_hidden()
    expect(row(page, "speed_limit")).to_contain_text("1.5")


def test_the_card_of_a_robot_follows_the_value_that_is_marked(open_page: Open) -> None:
    """While nothing else of the robot changes."""
    page = open_page("operator", "#/hall/fleet")
    card = page.get_by_role("article", name="left")
    for speed in ("1.75", "0.25", "0.75"):
        ask(page, "node.write", node="ns=2;i=1301", value=speed)
        expect(card.get_by_role("definition")).to_have_text(f"{speed} m/s")
    expect(card).to_contain_text("Idle")


def test_an_array_is_written_element_by_element(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    row(page, "points").get_by_role("button", name="Write points").click()
    dialog = page.get_by_role("dialog", name="Write points")
    add = dialog.get_by_role("button", name="Add an element")
    add.click()
    expect(dialog.get_by_label("points, element 1")).to_be_focused()
    page.keyboard.type("1,5")
    add.click()
    page.keyboard.type("7")
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("Element 2: Give 0 to 5.")
    expect(dialog.get_by_label("points, element 2")).to_have_attribute("aria-invalid", "true")
    picture(page, "robot-write-array")
    dialog.get_by_role("button", name="As JSON").click()
    dialog.get_by_label("points", exact=True).fill("[1.5, 9, 3, 4]")
    dialog.get_by_role("button", name="As JSON").click()
    dialog.get_by_role("button", name="Remove element 2 of points").click()
    expect(dialog.get_by_label("points, element 2")).to_be_focused()
    page.keyboard.press("Enter")
    expect(dialog).to_be_hidden()
    expect(row(page, "points")).to_contain_text("[1.5, 3, 4]")


def test_numbers_are_drawn_and_told_as_a_table(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    for name in ("speed_limit", "current"):
        row(page, name).get_by_role("button", name=f"Draw {name} in the chart").click()
    chart = page.get_by_role("region", name="Chart")
    # Speed and current have an axis each.
    expect(chart.get_by_role("img", name=re.compile(r"^speed_limit is [\d.]+ m.s; least "))).to_be_visible()
    course = "drive.current is 1.25 A; least 1.25 A, greatest 1.25 A."
    expect(chart.get_by_role("img", name=course, exact=True)).to_be_visible()
    row(page, "speed_limit").get_by_role("button", name="Write speed_limit").click()
    page.get_by_role("dialog").get_by_label("speed_limit", exact=True).fill("1.75")
    page.keyboard.press("Enter")
    lines = chart.get_by_role("list", name="Lines")
    expect(lines).to_contain_text("1.75 m/s")
    chart.get_by_role("button", name="Table").click()
    expect(chart.get_by_role("table").get_by_role("row")).to_have_count(13)
    picture(page, "robot-chart")
    chart.get_by_role("button", name="Pause").click()
    expect(chart).to_contain_text("Paused at ")
    time = chart.get_by_role("slider", name="Time")
    time.press("Home")
    expect(time).to_have_attribute("aria-valuetext", re.compile("speed_limit —, drive.current —$"))
    time.press("End")
    expect(time).to_have_attribute("aria-valuetext", re.compile("speed_limit 1.75 m/s, drive.current 1.25 A$"))
    chart.get_by_role("button", name="Last 10 min").click()
    chart.get_by_role("button", name="Pause").click()
    page.reload()
    expect(lines.get_by_role("listitem")).to_have_count(2)
    for name in ("speed_limit", "drive.current"):
        chart.get_by_role("button", name=f"Remove {name} from the chart").click()
    expect(chart).to_have_count(0)


def test_a_skill_is_started_by_its_form_and_told_of(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    expect(skill(page)).to_contain_text("Ready")
    skill(page).get_by_role("button", name="Start…").click()
    expect(skill(page).get_by_label("work", exact=True)).to_have_value("weld")
    skill(page).get_by_label("seconds", exact=True).fill("61")
    skill(page).get_by_role("button", name="Start", exact=True).click()
    expect(skill(page)).to_contain_text("Give 0 to 60.")
    skill(page).get_by_label("seconds", exact=True).fill("0.1")
    skill(page).get_by_role("button", name="Start", exact=True).click()
    last = page.get_by_role("list", name="Last executions").get_by_role("listitem").first
    expect(last).to_contain_text("Done")
    expect(last).to_contain_text("weld")
    skill(page).get_by_label("work", exact=True).fill("fail")
    skill(page).get_by_role("button", name="Start", exact=True).click()
    expect(last).to_contain_text("Failed")
    expect(last).to_contain_text("the machine broke")
    expect(page.get_by_role("list", name="Last executions").get_by_role("listitem")).to_have_count(2)
    picture(page, "robot-skill")


@pytest.mark.parametrize("expected_complaints", [["ERR_CONNECTION_RESET"]])
def test_a_start_whose_answer_is_lost_is_carried_out_once(open_page: Open) -> None:
    page = open_page("operator", "#/hall/robot/right")

    def lose(route: Route) -> None:
        route.fetch()  # the console has it, and carries it out
        route.abort("connectionreset")

    page.route("**/skill.start", lose, times=1)
    skill(page).get_by_role("button", name="Start…").click()
    skill(page).get_by_label("seconds").fill("0.5")
    page.keyboard.press("Enter")
    said = skill(page).get_by_role("alert")
    expect(said).to_contain_text("this may have been carried out. Look at the robot, its state and its last executions")
    executions = page.get_by_role("list", name="Last executions").get_by_role("listitem")
    expect(executions).to_have_count(1)
    expect(executions).to_contain_text("Done")
    with page.expect_response("**/skill.start") as answered:
        skill(page).get_by_role("button", name="Start", exact=True).click()
    assert answered.value.headers["idempotent-replayed"] == "true"
    expect(page.get_by_role("status").filter(has_text="it was not done a second time")).to_be_visible()
    expect(executions).to_have_count(1)


def test_what_is_under_way_stands_goes_on_and_is_halted(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", "#/hall/robot/right")
    skill(page).get_by_role("button", name="Start…").click()
    skill(page).get_by_label("work", exact=True).fill("never ends")
    page.keyboard.press("Enter")
    expect(skill(page).get_by_role("progressbar")).to_have_attribute("value", "0.5")
    expect(page.get_by_role("main")).to_contain_text("Busy")
    skill(page).get_by_role("button", name="Suspend").click()
    expect(skill(page)).to_contain_text("Suspended")
    expect(skill(page)).to_contain_text("it stands")
    picture(page, "robot-suspended")
    skill(page).get_by_role("button", name="Resume").click()
    expect(skill(page).get_by_role("button", name="Suspend")).to_be_visible()
    skill(page).get_by_role("button", name="Halt").click()
    expect(page.get_by_role("list", name="Last executions").get_by_role("listitem").first).to_contain_text("halted")
    expect(skill(page).get_by_role("progressbar")).to_have_count(0)


def test_an_observer_looks_and_is_told_why_they_may_not_act(open_page: Open) -> None:
    page = open_page("observer", LEFT)
    expect(row(page, "speed_limit")).to_contain_text("Good")
    expect(page.get_by_role("button", name="Write speed_limit")).to_have_count(0)
    why = "Your role does not allow this; required role: Operator."
    for button in (skill(page).get_by_role("button", name="Start…"), page.get_by_role("button", name="Hold…")):
        expect(button).to_have_attribute("aria-disabled", "true")
        expect(button).to_have_attribute("title", why)


def test_a_robot_is_held_here_too(open_page: Open) -> None:
    page = open_page("operator", "#/hall/robot/middle")
    page.get_by_role("button", name="Hold…").click()
    page.keyboard.type("new tyre")
    page.keyboard.press("Enter")
    expect(page.get_by_role("main")).to_contain_text("Held by oscar: new tyre")
    page.get_by_role("button", name="Release…").click()
    page.get_by_role("dialog").get_by_role("button", name="Release", exact=True).click()
    expect(page.get_by_role("button", name="Hold…")).to_be_visible()


def test_a_silent_robot_has_a_fault_that_is_acknowledged(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page = open_page("operator", "#/hall/robot/middle")
    expect(skill(page)).to_contain_text("Ready")
    fleet.bridges["middle"].end()
    faults = page.get_by_role("list", name="Faults")
    expect(faults).to_contain_text("Active")
    expect(skill(page)).to_contain_text("Unknown")
    start = skill(page).get_by_role("button", name="Start…")
    expect(start).to_have_attribute("title", "The robot is not heard.")
    # That its bridge is not heard is an alarm, too.
    expect(page.get_by_role("link", name="Alarms 2 alarms to acknowledge")).to_be_visible()
    expect(page).to_have_title("(2) Robot · Hall 1")
    expect(page.get_by_role("status").filter(has_text=re.compile("^2 alarms to acknowledge$"))).to_have_count(1)
    picture(page, "robot-silent")
    faults.get_by_role("button", name="Acknowledge…").click()
    page.keyboard.type("I look")
    page.keyboard.press("Enter")
    expect(faults).to_contain_text("acknowledged by oscar · I look")
    expect(page.get_by_role("link", name="Alarms 1 alarm to acknowledge")).to_be_visible()
    expect(page).to_have_title("(1) Robot · Hall 1")
    fleet.bridges["middle"] = fleet.plant.start_bridge("middle")
    expect(skill(page)).to_contain_text("Ready", timeout=20_000)
    expect(faults).to_have_count(0)


def test_a_robot_that_there_is_not_is_said(open_page: Open, axe: Callable[[Page], None]) -> None:
    page = open_page("observer", "#/hall/robot/nobody")
    expect(page.get_by_role("alert")).to_contain_text("there is no robot 'nobody'")
    axe(page)
    page.get_by_role("main").get_by_role("link", name="Fleet").click()
    expect(page.get_by_role("article", name="left")).to_be_visible()
    page.get_by_role("article", name="left").get_by_role("link", name="left").click()
    expect(page.get_by_role("heading", level=1, name="left")).to_be_visible()


def test_a_server_that_is_away_leaves_what_was_and_heals(open_page: Open, fleet: Fleet, picture: Picture) -> None:
    page = open_page("operator", LEFT)
    expect(row(page, "speed_limit")).to_contain_text("Good")
    fleet.server.end()
    expect(row(page, "speed_limit")).to_contain_text("(not current)")
    expect(row(page, "speed_limit")).to_contain_text("Was Good")
    expect(skill(page)).to_contain_text(re.compile("Was (Ready|Halted)"))
    live = page.get_by_role("main").get_by_text(re.compile("^(Good|Idle|Ready|Halted|Running|Busy|Active)$"))
    expect(live).to_have_count(0)
    for button in (skill(page).get_by_role("button", name="Start…"), page.get_by_role("button", name="Hold…")):
        expect(button).to_have_attribute("title", "What is shown is not current.")
    picture(page, "robot-away")
    fleet.server = fleet.plant.server_process()
    expect(row(page, "speed_limit")).not_to_contain_text("(not current)", timeout=30_000)
    start = skill(page).get_by_role("button", name="Start…")
    expect(start).not_to_have_attribute("aria-disabled", "true", timeout=20_000)
