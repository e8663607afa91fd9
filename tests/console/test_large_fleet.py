"""The Fleet page with 1,000 robots of a real server: only what can be seen is in the document."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Page, expect

from tests import system
from tests.console.conftest import FLEET, Console, console_of
from tests.integration.server_model.harness import OPERATOR
from tests.system import Processes
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

ROBOTS: Final = 1000
SERVER: Final = Path(system.__file__).parent / "integration" / "scenarios" / "server_process.py"


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """The console of a fleet whose robots nobody hears."""
    folder = tmp_path_factory.mktemp("large")
    raw = {
        "version": 1,
        "server": {"port": system.free_tcp_port(), "trust_all_clients": True},
        # A thousand robots that are missed at once would be another test.
        "pubsub": {
            "security": "none",
            "url": system.free_multicast_url(),
            "keep_alive_s": 600,
            "receive_timeout_s": 3600,
        },
        "bridges": {f"cell{number}": {"kind": "virtual", "space": 300 + number} for number in range(10)},
        "robots": {
            f"robot{number}": {"bridge": f"cell{number % 10}", "capacities": ["weld"]}
            for number in range(1, ROBOTS + 1)
        },
    }
    config = FleetConfig.model_validate(raw)
    (folder / "fleet.json").write_text(json.dumps(raw), encoding="utf-8")
    users = UserStore(folder / config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(parents=True)
    users.add(*OPERATOR, Role.OPERATOR)
    with Processes() as processes:
        endpoint = processes.fork(SERVER, folder / "fleet.json").wait_for("opc.tcp://", 60).strip()
        with console_of(tmp_path_factory.mktemp("console"), {FLEET: endpoint}) as running:
            yield running


def test_a_thousand_cards_scroll(page: Page, picture: Callable[[Page, str], None]) -> None:
    expect(page.get_by_role("button", name=f"All {ROBOTS}")).to_be_visible(timeout=30_000)
    cards = page.get_by_role("article")
    expect(cards.first).to_have_accessible_name("robot1")
    assert cards.count() < 100
    picture(page, "fleet-1000")
    expect(page.get_by_role("article", name="robot1", exact=True)).to_be_visible()
    page.mouse.move(700, 400)
    page.mouse.wheel(0, 1_000_000)
    expect(page.get_by_role("article", name="robot1000", exact=True)).to_be_in_viewport()
    assert cards.count() < 100
    page.get_by_role("searchbox").fill("cell7 robot99")
    expect(cards).to_have_count(1)
    expect(cards.last).to_have_accessible_name("robot997")


def test_a_thousand_rows_scroll_in_their_groups(open_page: Callable[..., Page]) -> None:
    page = open_page("operator", "#/hall/fleet?view=rows&group=bridge")
    table = page.get_by_role("table", name="Fleet")
    expect(table).to_have_attribute("aria-rowcount", str(1 + 10 + ROBOTS), timeout=30_000)
    assert table.get_by_role("row").count() < 100
    expect(table.get_by_role("rowheader", name="cell0 100")).to_be_visible()
    page.mouse.move(700, 400)
    page.mouse.wheel(0, 1_000_000)
    expect(table.get_by_role("button", name="Actions for robot999", exact=True)).to_be_in_viewport()
    assert table.get_by_role("row").count() < 100


def test_a_menu_stays_open_whose_button_was_scrolled_into_sight(page: Page) -> None:
    """A browser tells of that scrolling a frame later, when the menu is open. One that moves the button closes it."""
    robots = page.get_by_role("group", name="Fleet", exact=True)
    expect(page.get_by_role("button", name=f"All {ROBOTS}")).to_be_visible(timeout=30_000)
    expect(page.get_by_role("article").first).to_be_visible()
    robots.evaluate("list => { list.scrollTop = 40; list.querySelectorAll('article button')[8].click(); }")
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    expect(page.get_by_role("menuitem", name="Hold…")).to_be_visible()
    page.mouse.move(700, 400)
    page.mouse.wheel(0, 40)
    expect(page.get_by_role("menuitem")).to_have_count(0)
