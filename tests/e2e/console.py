"""The web console of a demonstration, as somebody uses it who has read what the demonstration printed."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Sequence

from tests.integration.console.harness import Console
from tests.system import Child
from ua_fleet.console.page import page_missing
from ua_fleet.demo.site import USER

__all__ = ["check_console", "told_of_console"]

BROWSER = "browser:  "
NONE = "there is no web console: "


def told_of_console(lines: Sequence[str]) -> list[str]:
    """What was printed about the console."""
    return [line for line in lines if line.startswith((BROWSER, NONE))]


def check_console(child: Child, fleet: str, robots: Collection[str]) -> None:
    """Load the page, log in by HTTP, and see the robots of a fleet; or be told that there is no page."""
    last = child.wait_for("user operator, password ", 60)
    first, *others = told_of_console(child.lines)
    if problem := page_missing():
        assert (first, others) == (NONE + problem, [])
        return
    told = [at for at, line in enumerate(child.lines) if line.startswith(BROWSER) or " operator, password " in line]
    assert child.lines[told[0]] == first, "what a person looks for comes first"
    asyncio.run(_look(first.removeprefix(BROWSER).split()[0], fleet, last.rpartition(" ")[2], set(robots)))


async def _look(url: str, fleet: str, password: str, robots: set[str]) -> None:
    console = Console(url)
    async with console.browser() as stranger:
        page = await stranger.get("")
        assert (page.status_code, page.text[:15].lower()) == (200, "<!doctype html>")
        refused = await stranger.post("api/login", json={"fleet": fleet, "user": USER, "password": f"{password}x"})
        assert refused.status_code == 401, refused.text
    async with console.logged_in((USER, password), fleet) as browser, browser.live() as live:
        assert {"skill.start", "robots.hold"} <= set(browser.me["fleets"][fleet]["may"])
        await live.want("robots", "robots", fleet)
        await live.until(lambda: robots <= live.feeds.get("robots", {}).keys())
        assert live.feeds["robots"].keys() == robots
