"""Whatever a robot, a scenario or a user may say: on no page is it markup, and on each it can be read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from playwright.sync_api import Page, expect

from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask
from tests.integration.scenarios.conftest import Plant

Open = Callable[..., Page]
SAID: Final = "<img src=x onerror=alert(1)><script>alert(2)</script>"
PLACES: Final = {
    "fleet": "a reason",
    "fleet?view=rows": "a fault",
    "robot/left": "a robot",
    "map": "a place",
    "scenarios": "a scenario",
    "scenarios/edit/strange": "a scenario",
    "resilience": "a fault",
    "alarms": "a fault",
    "space?node=ns%3D2%3Bi%3D1330": "a value",
}
"""What of it is to be read there."""
MARKUP: Final = r"""() => [...document.querySelectorAll('[onerror], img, script:not([src]), iframe, object')]
  .map(one => one.outerHTML).filter(one => !/^<img src="(blob:|\.\/logo)/.test(one))"""


def said(what: str) -> str:
    return f"{what} {SAID}"


def _hostile(plant: Plant) -> None:
    def change(raw: dict[str, Any]) -> None:
        left = raw["robots"]["left"]
        left["description"] = said("a robot")
        left["skills"]["work"]["description"] = said("a skill")
        left.setdefault("data", {})["mood"] = {
            "id": 1330,
            "type": "String",
            "origin": "server",
            "initial": said("a value"),
            "description": said("a datum"),
        }
        pose = {"x": {"type": "Double", "initial": 2}, "y": {"type": "Double", "initial": 1}}
        left["data"]["pose"] = {"id": 1331, "origin": "server", "fields": pose}
        distance = {"x": "pose.x", "y": "pose.y", "places": {said("a place"): [6, 3]}, "argument": "work"}
        raw["resilience"]["criteria"] = {"distance": {"kind": "cost", "range": [0, 20], "distance": distance}}

    plant.declare(change)
    text = f"version: 1\nname: strange\ndescription: '{said('a scenario')}'\nsteps:\n"
    step = "  - {task: a, skill: work, robot: left}\n"
    (plant.folder / "scenarios").mkdir(exist_ok=True)
    (plant.folder / "scenarios" / "strange.yaml").write_text(text + step)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), _hostile) as running:
        yield running


def test_nothing_that_is_said_is_markup(open_page: Open) -> None:
    page = open_page("engineer", "#/hall/fleet")
    opened: list[str] = []
    page.on("dialog", lambda dialog: opened.append(dialog.message))
    expect(page.get_by_role("article")).to_have_count(3)
    ask(page, "robots.hold", robot="left", reason=said("a reason"))
    ask(page, "fault.raise", robot="left", reason=said("a fault"))
    ask(page, "robots.release", robot="left")
    ask(page, "scenario.run", scenario="strange")
    ask(page, "robots.hold", robot="middle", reason=said("a reason"))
    for place, what in PLACES.items():
        page.goto(f"{page.url.partition('#')[0]}#/hall/{place}")
        expect(page.locator("body")).to_contain_text(f"{what} <img src=x onerror=alert(1)>")
        assert page.evaluate(MARKUP) == [], place
    assert opened == []
