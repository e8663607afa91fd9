"""The web console of a demonstration, as somebody uses it who has read what the demonstration printed."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Sequence

from ua_demo.site import USER
from websockets.exceptions import ConnectionClosed

from tests.integration.console.driving import drive
from tests.integration.console.harness import Browser, Console
from tests.system import Child
from ua_fleet.console.page import page_missing

__all__ = ["check_console", "told_of_console"]

DRIVE_S = 2.0
BROWSER = "browser:  "
NONE = "there is no web console: "


def told_of_console(lines: Sequence[str]) -> list[str]:
    """What was printed about the console."""
    return [line for line in lines if line.startswith((BROWSER, NONE))]


def check_console(child: Child, fleet: str, robots: Collection[str], drives: tuple[str, str] | None = None) -> None:
    """Load the page, log in by HTTP, see the robots, drive one of them; or be told that there is no page.

    `drives` has its name, and the NodeId of where it is.
    """
    last = child.wait_for("user operator, password ", 60)
    first, *others = told_of_console(child.lines)
    if problem := page_missing():
        assert (first, others) == (NONE + problem, [])
        return
    told = [at for at, line in enumerate(child.lines) if line.startswith(BROWSER) or " operator, password " in line]
    assert child.lines[told[0]] == first, "what a person looks for comes first"
    asyncio.run(_look(first.removeprefix(BROWSER).split()[0], fleet, last.rpartition(" ")[2], set(robots), drives))


async def _look(url: str, fleet: str, password: str, robots: set[str], drives: tuple[str, str] | None) -> None:
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
        if drives is not None:
            await _drive(browser, fleet, drives)


async def _drive(browser: Browser, fleet: str, drives: tuple[str, str]) -> None:
    """Drive a robot, and see in its own words that it has moved and stands."""
    robot, node = drives
    orientation = node.replace("position.x", "orientation.z")
    async with browser.live() as live:
        await live.want("where", "nodes", fleet, nodes=[node, orientation])
        await live.until(lambda: live.feeds.get("where", {}).keys() == {node, orientation})

        def shown(which: str) -> float:
            return float(live.feeds["where"][which]["v"])

        before = fast = 0.0
        ahead = 1.0
        for is_last in (False, False, True):
            before = shown(node)
            # It looks along x, or back after it was at the worker.
            ahead = -1.0 if abs(shown(orientation)) > 0.5 else 1.0
            try:
                fast = await _forwards_and_stand(browser, robot, fleet)
                break
            except ConnectionClosed as closed:
                # Where this process waits for a core for 300 ms, nobody drives, and the robot has to stand.
                if is_last or "no setpoint was fresh" not in str(closed):
                    raise
        await live.until(lambda: (before - shown(node)) * ahead > fast * DRIVE_S / 3)


async def _forwards_and_stand(browser: Browser, robot: str, fleet: str) -> float:
    """Drive for a while, stop and let go; how fast it went."""
    async with drive(browser, robot, fleet=fleet) as page:
        assert page.held, page.over
        fast = float(page.held["axes"][0]["speed"])
        until_at = asyncio.get_running_loop().time() + DRIVE_S
        await page.until(lambda: asyncio.get_running_loop().time() > until_at, (-fast, 0.0))
        await page.until(lambda: page.state["output"] == [0.0, 0.0])
        await page.say(release=True)
        assert await page.closed() == 1000
        return fast
