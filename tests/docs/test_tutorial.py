"""The tutorial, from its fleet.yaml to the scenario, with a terminal and a browser."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Locator, Page, expect

from tests import system
from tests.console import browsing
from tests.docs.walkthrough import PASSWORD, Walk
from tests.unit.docs.pages import ROOT

PATIENCE_MS: Final = 60_000


class Reader:
    """What a reader does in the browser."""

    def __init__(self, page: Page, url: str) -> None:
        self._page, self._url = page, url

    def is_refused(self) -> None:
        self._page.goto(self._url)
        self._log_in()
        expect(self._page.get_by_role("alert")).to_contain_text("ua-fleet cert trust --last --show --gateway")

    def writes_the_speed_limit(self) -> None:
        page = self._page
        self._log_in()
        card = page.get_by_role("article", name="carrier")
        expect(card).to_contain_text("Idle")
        expect(card).to_contain_text("charge")
        card.get_by_role("link", name="carrier", exact=True).click()
        page.get_by_role("button", name="Write speed_limit").click()
        dialog = page.get_by_role("dialog", name="Write speed_limit")
        dialog.get_by_label("speed_limit", exact=True).fill("0.5")
        dialog.get_by_role("button", name="Write").click()
        expect(dialog).to_be_hidden()

    def sees_the_robot_offline(self) -> None:
        expect(self._page.locator("main")).to_contain_text("Offline")
        expect(self._page.get_by_role("link", name=re.compile("Alarms 1"))).to_be_visible()

    def has_it_drive(self) -> None:
        skill = self._skill("drive")
        skill.get_by_role("button", name="Start…").click()
        expect(skill.get_by_label("speed", exact=True)).to_have_value("1")
        skill.get_by_label("to", exact=True).fill("dock")
        skill.get_by_role("button", name="Start", exact=True).click()
        done = self._page.get_by_role("list", name="Last executions").get_by_role("listitem").filter(has_text="Done")
        expect(done).to_have_count(2)  # the terminal's was the first
        expect(done.first).to_contain_text("distance 2")

    def runs_the_scenario(self) -> None:
        page = self._page
        page.get_by_role("navigation", name="Pages").get_by_role("link", name="Scenarios").click()
        page.get_by_role("link", name="round_trip").click()
        expect(page.get_by_text("It fits the fleet.")).to_be_visible()
        page.get_by_role("button", name="Start…").click()
        page.get_by_role("dialog").get_by_role("button", name="Start").click()
        steps = page.get_by_role("list", name="Steps").get_by_role("listitem")
        expect(steps.filter(has=page.get_by_text("Done", exact=True))).to_have_count(2)

    def _log_in(self) -> None:
        self._page.get_by_label("User").fill("anna")
        self._page.get_by_label("Password").fill(PASSWORD)
        self._page.get_by_role("button", name="Log in").click()

    def _skill(self, name: str) -> Locator:
        return self._page.get_by_role("region", name=name, exact=True)


@pytest.mark.timeout(400)
@pytest.mark.needs("ros2", "chromium")
def test_a_reader_gets_to_the_end(
    folder: Path, environment: dict[str, str], processes: system.Processes, ros_domain: int
) -> None:
    asyncio.set_event_loop(None)  # Playwright's is its own
    listen = f"127.0.0.1:{system.free_tcp_port()}"
    instead = {
        "space: 2\n": f"space: {ros_domain}\n",
        "space=2)": f"space={ros_domain})",
        "ROS_DOMAIN_ID=2 ": f"ROS_DOMAIN_ID={ros_domain} ",
        "ua-fleet console\n": f"ua-fleet console --listen {listen} --fleet cell={environment['UA_FLEET_ENDPOINT']}\n",
    }
    expect.set_options(timeout=PATIENCE_MS)
    try:
        with browsing.chromium() as browser:
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.set_default_timeout(PATIENCE_MS)
            reader = Reader(page, f"http://{listen}/")
            steps = {
                "is refused": reader.is_refused,
                "writes the speed limit": reader.writes_the_speed_limit,
                "sees the robot offline": reader.sees_the_robot_offline,
                "has it drive": reader.has_it_drive,
                "runs the scenario": reader.runs_the_scenario,
            }
            Walk(folder, processes, environment, instead, steps).walk(ROOT / "docs" / "tutorial.md")
    finally:
        expect.set_options(timeout=5_000)
