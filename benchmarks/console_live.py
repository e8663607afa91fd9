"""A live fleet of 100 robots with 10 values at 1 Hz: value to paint in Chromium, and what five people cost the console.

Server, bridges, console and browser share the machine's cores here. A value is on its way from the time that the
server gives it until the page of its robot has painted it.
"""

from __future__ import annotations

import asyncio
import os
import random
import statistics
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final

from playwright.sync_api import Page, expect

from benchmarks._console_fleet import PEOPLE, PROBE, LiveFleet, live_fleet, robot_name
from benchmarks._console_page import opened, part
from benchmarks.console_page import USABLE_S, usable_s
from benchmarks.harness import FEWEST_ROUNDS, Figure, Unavailable, shown, within
from tests import system
from tests.console.browsing import chromium
from tests.console.conftest import FLEET
from tests.integration.console.harness import Console as Address
from ua_fleet.client import ClientIdentity, FleetClient

ROBOTS: Final = 100
PAINT_MS: Final = 150.0
CPU: Final = 40.0
WRITES: Final = 60
LOOKED_S: Final = 20.0
SETTLED_S: Final = 5.0
LOOKS: Final[list[dict[str, dict[str, Any]]]] = [
    {"robots": {}, "alarms": {}},
    {"robots": {}, "alarms": {}},
    {"robot": {"robot": robot_name(1)}, "alarms": {}},
    {"robot": {"robot": robot_name(2)}, "alarms": {}},
    {"robots": {}, "runs": {}, "health": {}, "alarms": {}},
]
"""What the pages of the five want."""
_PAINTED: Final = """([label]) => {
  window.painted = {};
  const cell = [...document.querySelectorAll('tr')]
    .find(row => row.querySelector('th')?.textContent.trim() === label).querySelector('td.value');
  new MutationObserver(() => {
    const text = cell.textContent.replace(/\\D/g, '');
    requestAnimationFrame(() => {
      const channel = new MessageChannel();
      channel.port1.onmessage = () => { window.painted[text] ??= Date.now(); };
      channel.port2.postMessage(null);  // after the frame is painted
    });
  }).observe(cell, { subtree: true, characterData: true, childList: true });
}"""


async def _write(endpoint: str, folder: Path, first: int, times: int) -> dict[str, float]:
    """Write one number after the other; the server's time of each, in ms since 1970."""
    (user, password), _ = PEOPLE["engineer"]
    identity = ClientIdentity(folder / "client")
    written: dict[str, float] = {}
    chance = random.Random(first)
    async with FleetClient.connect(endpoint, user=user, password=password, identity=identity) as client:
        for number in range(first, first + times):
            reading = await client.write(f"ns=2;i={PROBE}", str(number))
            assert reading.source_time is not None
            written[str(number)] = reading.source_time.timestamp() * 1000
            await asyncio.sleep(chance.uniform(0.2, 0.4))
    return written


def painted_ms(page: Page, running: LiveFleet, folder: Path, first: int) -> list[float]:
    """How long each of some values took from the server to the page."""
    expect(page.get_by_role("row", name="probe")).to_be_visible()
    page.evaluate(_PAINTED, ["probe"])
    with ThreadPoolExecutor(1) as elsewhere:  # this thread has the loop of Playwright
        written = elsewhere.submit(asyncio.run, _write(running.endpoint, folder, first, WRITES)).result()
    page.wait_for_timeout(1000)
    painted: dict[str, float] = page.evaluate("window.painted")
    return [painted[number] - at for number, at in written.items() if number in painted]


def cpu_s(pid: int) -> float:
    """CPU that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def _looked(running: LiveFleet, seconds: float) -> float:
    """CPU of the console in percent of a core while five people look."""
    address = Address(running.console.url)
    async with AsyncExitStack() as stack, asyncio.TaskGroup() as group:
        pages: list[asyncio.Task[None]] = []
        for number, wanted in enumerate(LOOKS):
            browser = await stack.enter_async_context(address.logged_in(PEOPLE[f"person{number}"][0], FLEET))
            live = await stack.enter_async_context(browser.live())
            for name, parameters in wanted.items():
                await live.want(name, name, FLEET, **parameters)

            async def follow(live: Any = live) -> None:
                while True:
                    await live.step()

            pages.append(group.create_task(follow()))
        await asyncio.sleep(SETTLED_S)
        pid = running.console.child.process.pid
        before, began = cpu_s(pid), time.monotonic()
        await asyncio.sleep(seconds)
        taken = 100 * (cpu_s(pid) - before) / (time.monotonic() - began)
        for page in pages:
            page.cancel()
    return taken


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    for needed in ("chromium", "npm"):
        if reason := system.missing(needed):
            raise Unavailable(reason)
    rounds = max(rounds, FEWEST_ROUNDS)
    with tempfile.TemporaryDirectory() as place, live_fleet(ROBOTS, folder := Path(place)) as running:
        with chromium(whole=True) as browser:
            usable = [usable_s(browser, running.console.url)[0] for _ in range(rounds)]
            took: list[float] = []
            with opened(browser, running.console.url, f"#/{FLEET}/robot/{robot_name(0)}") as page:
                for number in range(rounds):
                    took += painted_ms(page, running, folder, 1_000 * (number + 1))
        looked = statistics.median(asyncio.run(_looked(running, LOOKED_S)) for _ in range(rounds))
    p50 = statistics.median(took)
    lost = f"value at the server to paint, {len(took)} of {rounds * WRITES} values"
    return [
        within(f"{lost}, p50", p50, "ms", PAINT_MS),
        shown(f"{lost}, p95", part(took, 95), "ms", reference="the median", reference_value=p50),
        within(f"console's CPU, {len(LOOKS)} people look", looked, "% of a core", CPU),
        within("first page usable after login", statistics.median(usable), "s", USABLE_S),
    ]  # fmt: skip
