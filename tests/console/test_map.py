"""The map: where robots are, places, panned and zoomed by pointer and keys, and old positions that look old."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
PLACE: Final = "#/hall/map"
HOSTILE: Final = "<img src=x onerror=alert(1)>" + "long " * 30
NUMBER: Final = {"type": "Double", "unit": "m"}
STANDS: Final = {
    "id": 1310,
    "origin": "server",
    "fields": {
        "x": {**NUMBER, "initial": 2},
        "y": {**NUMBER, "initial": 1},
        "yaw": {"type": "Double", "unit": "rad", "initial": 0.5},
    },
}
SILENT: Final = {"id": 1311, "fields": {"x": NUMBER, "y": NUMBER}}
DRAWN: Final = "g.robot"


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """The fleet, whose robot `left` says where it is, and `middle` has not yet."""

    def change(raw: dict[str, Any]) -> None:
        raw["robots"]["left"]["data"]["pose"] = STANDS
        raw["robots"]["middle"]["data"] = {"pose": SILENT}
        distance = {"x": "pose.x", "y": "pose.y", "places": {"gate": [0, 0], HOSTILE: [6, 3]}, "argument": "work"}
        raw["resilience"]["criteria"] = {"distance": {"kind": "cost", "range": [0, 20], "distance": distance}}

    with fleet_of(tmp_path_factory.mktemp("fleet"), lambda plant: plant.declare(change)) as running:
        yield running


def entry(page: Page, name: str) -> Locator:
    return page.get_by_role("region", name="Positions").get_by_role("listitem").filter(has_text=name)


def drawn_at(page: Page) -> tuple[float, float]:
    box = page.locator(f"{DRAWN} .body").first.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def settled(page: Page, look: Callable[[], float], wanted: float, within: float) -> None:
    """Wait until what is looked at is as wanted: what a pointer did is painted a frame later, or some."""
    seen = look()
    for _ in range(500):
        if abs(seen - wanted) < within:
            return
        page.wait_for_timeout(20)
        seen = look()
    raise AssertionError(f"{seen:g} is not {wanted:g}, by less than {within:g}")


def expect_drawn_at(page: Page, x: float, y: float) -> tuple[float, float]:
    settled(page, lambda: math.dist(drawn_at(page), (x, y)), 0, 2)
    return drawn_at(page)


def places_apart(page: Page) -> float:
    places = page.locator("g.place path")
    first, second = places.nth(0).bounding_box(), places.nth(1).bounding_box()
    assert first is not None
    assert second is not None
    return math.dist((first["x"], first["y"]), (second["x"], second["y"]))


def test_robots_and_places_are_shown_and_move(open_page: Open, picture: Picture) -> None:
    page = open_page("operator", PLACE)
    left = entry(page, "left")
    expect(left).to_contain_text("x 2.00 m, y 1.00 m")
    expect(left).to_contain_text("heading 29°")
    expect(left.get_by_role("link", name="Open left")).to_have_attribute("href", "#/hall/robot/left")
    expect(entry(page, "gate")).to_contain_text("x 0.00 m, y 0.00 m")
    expect(entry(page, "<img src=x")).to_contain_text("x 6.00 m, y 3.00 m")
    expect(page.get_by_text("2 robots report no position")).to_be_visible()
    picture(page, "map")
    before = drawn_at(page)
    ask(page, "node.write", node="ns=2;s=1310.x", value="4")
    expect(left).to_contain_text("x 4.00 m")
    after = drawn_at(page)
    assert after[0] > before[0] + 20, (before, after)
    assert abs(after[1] - before[1]) < 1
    ask(page, "node.write", node="ns=2;s=1310.x", value="2")
    expect(left).to_contain_text("x 2.00 m")
    page.locator(DRAWN).first.click()
    expect(left.get_by_role("button", name="left")).to_have_attribute("aria-pressed", "true")
    page.reload()
    expect(entry(page, "left").get_by_role("button", name="left")).to_have_attribute("aria-pressed", "true")


def test_the_plane_is_moved_by_pointer_and_keys(open_page: Open) -> None:
    page = open_page("observer", PLACE)
    plane = page.get_by_role("application", name="Map")
    expect(plane).to_be_visible()
    first = drawn_at(page)
    expect(page.get_by_role("button", name="Show all")).to_have_attribute("aria-disabled", "true")
    page.mouse.move(first[0] + 80, first[1] + 80)
    page.mouse.down()
    page.mouse.move(first[0] + 120, first[1] + 110, steps=4)
    page.mouse.up()
    dragged = expect_drawn_at(page, first[0] + 40, first[1] + 30)
    page.mouse.move(*dragged)
    before = places_apart(page)
    page.mouse.wheel(0, -200)
    settled(page, lambda: places_apart(page) / before, math.exp(0.5), 0.05)
    assert math.dist(drawn_at(page), dragged) < 2, "what is under the pointer stays there"
    plane.focus()
    page.keyboard.press("ArrowRight")
    expect_drawn_at(page, dragged[0] - 60, dragged[1])
    page.keyboard.press("0")
    expect_drawn_at(page, *first)
    page.keyboard.press("+")
    page.get_by_role("button", name="Zoom out").click()
    page.get_by_role("button", name="Show all").click()
    expect_drawn_at(page, *first)


def test_it_is_pinched(open_page: Open) -> None:
    page = open_page("observer", PLACE)
    expect(page.locator(DRAWN)).to_have_count(1)
    before = places_apart(page)
    session: Any = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        touches = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})

    touch("touchStart", (500, 400))
    touch("touchStart", (500, 400), (600, 400))
    for step in range(1, 6):
        touch("touchMove", (500 - 10 * step, 400), (600 + 10 * step, 400))
    touch("touchEnd")
    settled(page, lambda: places_apart(page) / before, 2, 0.2)


def test_an_old_position_looks_old(fleet: Fleet, open_page: Open, picture: Picture) -> None:
    page = open_page("observer", PLACE)
    expect(page.locator(f"{DRAWN}.was")).to_have_count(0)
    fleet.server.end()
    expect(page.get_by_text("What is shown is not current.")).to_be_visible()
    expect(page.locator(f"{DRAWN}.was")).to_have_count(1)
    expect(entry(page, "left")).to_contain_text("was at x 2.00 m")
    picture(page, "map-away")
    fleet.server = fleet.plant.server_process()
    expect(page.get_by_text("What is shown is not current.")).to_be_hidden(timeout=30_000)
    expect(entry(page, "left")).not_to_contain_text("was at")


@pytest.fixture
def expected_complaints() -> list[str]:
    return ["503", "502"]
