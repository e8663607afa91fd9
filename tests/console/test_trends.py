"""Lines of numbers begin in the server's history, with the gaps that it knows of."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import quote

import pytest
from playwright.sync_api import Page, expect

from tests.console.conftest import Fleet, fleet_of
from tests.console.test_alarms import ask
from tests.integration.scenarios.conftest import Plant

Open = Callable[..., Page]
Picture = Callable[[Page, str], None]
LOAD, WEIGHT, ALIVE = "ns=2;i=1310", "ns=2;i=1311", "ns=2;i=1312"


def with_history(plant: Plant) -> None:
    """`left` has a number that is kept, one that is not, and one that its bridge tells."""

    def declare(raw: dict[str, Any]) -> None:
        raw["history"] = {}
        raw["robots"]["left"].setdefault("data", {}).update(
            load={"id": 1310, "type": "Double", "unit": "kg", "origin": "server", "initial": 1.0},
            weight={"id": 1311, "type": "Double", "unit": "kg", "origin": "server", "initial": 1.0, "history": False},
            alive={"id": 1312, "type": "Double"},
        )

    plant.declare(declare)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet"), with_history) as running:
        yield running


def chart(*nodes: str) -> str:
    return f"#/hall/robot/left?chart={quote(json.dumps(nodes))}"


def test_a_line_begins_before_the_page_was_opened(open_page: Open, picture: Picture) -> None:
    writer = open_page("operator", "#/hall/fleet")
    for value in ("10", "50", "30"):
        for node in (LOAD, WEIGHT):
            ask(writer, "node.write", node=node, value=value)
        time.sleep(1.1)  # so that no two of them fall into one pixel
    page = open_page("operator", chart(LOAD))
    line = page.get_by_role("img", name=re.compile("^load is "))
    expect(line).to_have_attribute("aria-label", re.compile(r"30 kg; least (1|10) kg, greatest 50 kg"))
    picture(page, "robot-chart-from-history")
    # What is not kept begins with the page, as before.
    page.goto(page.url.partition("#")[0] + chart(WEIGHT))
    page.reload()
    expect(page.get_by_role("img", name=re.compile("^weight is 30 kg"))).to_have_attribute(
        "aria-label", re.compile("least 30 kg, greatest 30 kg")
    )


def test_what_was_not_good_is_a_gap_and_so_is_an_outage(open_page: Open, fleet: Fleet) -> None:
    watcher = open_page("operator", chart(ALIVE))
    expect(watcher.get_by_role("img", name=re.compile("^alive is 1"))).to_be_visible()
    fleet.bridges["left"].end()
    expect(watcher.get_by_role("row", name=re.compile("^alive"))).to_contain_text("Bad")
    time.sleep(6)  # longer than a row of the table
    fleet.bridges["left"] = fleet.plant.bridge("left")
    expect(watcher.get_by_role("img", name=re.compile("^alive is 1"))).to_be_visible()
    page = open_page("operator", chart(ALIVE))
    expect(page.get_by_role("img", name=re.compile("^alive is 1"))).to_be_visible()
    page.get_by_role("button", name="Table").click()
    cells = page.get_by_role("region", name="Chart").locator("tbody td")
    expect(cells.filter(has_text="—").first).to_be_visible()
    expect(cells.filter(has_text=re.compile("^1$")).first).to_be_visible()
