"""The nine tasks in the web console: a person starts them, sees a robot break and decides, all in Chromium.

Its pictures of the moment of the decision are those with which the README opens (`make picture`).
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import FloatRect, Locator, Page, expect

from tests.console import browsing
from tests.e2e.talkrobots import demonstration
from tests.e2e.test_talkrobots import check_course
from tests.system import Processes

SPEED: Final = "5"
FAULT: Final = "the drive does not turn"
PICTURE: Final = "console"
SHOWN: Final[FloatRect] = {"x": 0, "y": 0, "width": 1280, "height": 600}
"""What of the page has something in it."""


def _log_in(page: Page, url: str, password: str) -> None:
    page.goto(url)
    page.get_by_label("User").fill("operator")
    page.get_by_label("Password").fill(password)
    page.get_by_role("button", name="Log in").click()


def _go(page: Page, name: str) -> None:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name=name).click()


def _card(page: Page, robot: str) -> Locator:
    return page.get_by_role("article").filter(has=page.get_by_role("link", name=robot, exact=True))


def _take_pictures(page: Page) -> None:
    for theme in browsing.THEMES:
        browsing.show(page, theme, 1280)
        page.wait_for_timeout(100)
        page.screenshot(path=browsing.PICTURES / f"{PICTURE}-{theme}.png", clip=SHOWN)
    browsing.show(page, "light", 1280)


def _start(page: Page) -> None:
    _go(page, "Scenarios")
    page.get_by_role("button", name="Actions for nine_tasks").click()
    page.get_by_role("menuitem", name="Start…").click()
    page.get_by_role("dialog", name="Start nine_tasks").get_by_role("button", name="Start").click()
    expect(page.get_by_role("list", name="Steps").get_by_role("listitem").filter(has_text="fetch")).to_contain_text(
        "ridgeback"
    )


def _decide(page: Page) -> None:
    """Have the way count least, and take the robot that is the best by that."""
    _go(page, "Resilience")
    expect(page.get_by_role("heading", name="approach, instead of ridgeback")).to_be_visible()
    ranked = page.get_by_role("region", name="Ranking").locator("tbody th")
    expect(ranked).to_have_text(["pioneer_1", "pioneer_2"])
    kept = page.get_by_text("The ranking above still follows the comparison before this one.")
    for pair, key, said, contradicts in (
        ("battery or distance", "Home", "battery counts 9 times as much as distance", True),
        ("distance or availability", "End", "availability counts 9 times as much as distance", False),
    ):
        slider = page.get_by_role("slider", name=pair)
        slider.focus()
        page.keyboard.press(key)
        expect(slider).to_have_attribute("aria-valuetext", said)
        expect(kept).to_have_count(int(contradicts))
    expect(ranked).to_have_text(["pioneer_2", "pioneer_1"])
    page.get_by_role("button", name="Keep for this decision").click()
    expect(page.get_by_role("status").filter(has_text="The comparison holds for this decision.")).to_be_visible()
    expect(ranked).to_have_text(["pioneer_2", "pioneer_1"])
    page.get_by_role("button", name="Choose pioneer_2").click()
    expect(page.get_by_role("link", name="pioneer_2, chosen by operator")).to_be_visible()


@pytest.mark.timeout(300)
@pytest.mark.needs("ros1", "ros2", "ur", "chromium")
def test_a_person_runs_the_nine_tasks_and_decides_in_the_page(processes: Processes, tmp_path: Path) -> None:
    asyncio.set_event_loop(None)  # Playwright's is its own
    browsing.PICTURES.mkdir(parents=True, exist_ok=True)
    with (
        demonstration(processes, tmp_path, "--speed", SPEED, "--wait") as started,
        browsing.chromium() as browser,
    ):
        url = started.printed("browser:")
        started.child.wait_for("ready: run nine_tasks", 120)
        password = started.child.wait_for("user operator, password ", 60).rpartition(" ")[2]
        page = browser.new_page(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
        complaints = browsing.Complaints(page)
        page.set_default_timeout(60_000)
        _log_in(page, url, password)
        _start(page)
        run = page.url

        _go(page, "Fleet")
        expect(_card(page, "ridgeback")).to_contain_text(FAULT, timeout=120_000)
        expect(page.get_by_role("link", name="1 open decision")).to_be_visible()
        _take_pictures(page)
        _go(page, "Alarms")
        expect(page.get_by_text(FAULT, exact=True)).to_be_visible()
        _decide(page)

        page.goto(run)
        steps = page.get_by_role("list", name="Steps").get_by_role("listitem")
        expect(steps.filter(has_text="approach")).to_contain_text("pioneer_2")
        expect(page.locator("header").get_by_text("Done")).to_be_visible(timeout=120_000)
        expect(steps.filter(has=page.get_by_text("Done", exact=True))).to_have_count(9)
        expect(steps.filter(has_text="pick_right")).to_contain_text("Not done")
        page.screenshot(path=browsing.PICTURES / "talkrobots-run.png")
        report = started.finish(60)
        assert complaints.others_than([]) == []
    check_course(report)
    assert report["fault"]["replacement"] == "pioneer_2"
