"""What a key stroke in the console's editor takes with a scenario of 500 tasks, in a real Chromium.

The text is written in the middle of the scenario, while the blocks beside it follow and the server checks what is
written; and a block in the middle is moved by keys. Server, console and browser share the machine's cores.
"""

from __future__ import annotations

import random
import statistics
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from playwright.sync_api import Browser, Page, expect

from benchmarks._console_page import opened, part
from benchmarks.harness import FEWEST_ROUNDS, Figure, Unavailable, shown, within
from tests import system
from tests.console.browsing import chromium
from tests.console.conftest import FLEET, Console, Fleet, console_of, fleet_of
from tests.integration.scenarios.conftest import ROBOTS

TASKS: Final = {"large": 500, "small": 5}
KEYS: Final = 60
"""In each round."""
PAUSE_MS: Final = (60, 250)
"""Between two keys, as of somebody who types. Within it blocks follow and the server may be asked."""
KEY_MS: Final = 50.0
_STROKES: Final = """() => {
  window.strokes = [];
  addEventListener('keydown', event => {
    if (event.key === 'Alt') return;  // held for the next one
    const began = event.timeStamp;
    requestAnimationFrame(() => {
      const channel = new MessageChannel();
      channel.port1.onmessage = () => window.strokes.push(performance.now() - began);
      channel.port2.postMessage(null);  // after the frame is painted
    });
  }, { capture: true });
}"""


def steps(tasks: int) -> str:
    """One task after the other, some side by side and some again."""
    lines: list[str] = []
    for number in range(tasks):
        task = f"{{task: t{number}, skill: work, robot: {ROBOTS[number % 3]}, arguments: {{seconds: 0.1}}}}"
        if number % 10 == 3:
            lines += ["  - parallel:", f"      - {task}"]
        elif number % 10 == 4:
            lines.append(f"      - {task}")
        else:
            lines.append(f"  - {task}  # task {number}")
    return "\n".join(lines) + "\n"


@contextmanager
def running() -> Generator[tuple[Fleet, Console]]:
    """A fleet with the scenarios, and its console."""
    for needed in ("chromium", "npm"):
        if reason := system.missing(needed):
            raise Unavailable(reason)
    with (
        tempfile.TemporaryDirectory() as folder,
        fleet_of(Path(folder)) as fleet,
        tempfile.TemporaryDirectory() as its,
        console_of(Path(its), {FLEET: fleet.endpoint}) as console,
    ):
        for name, tasks in TASKS.items():
            fleet.plant.scenario(name, steps(tasks))
        yield fleet, console


def strokes_ms(page: Page, chance: random.Random, keys: tuple[str, str]) -> list[float]:
    """From each key stroke until the next frame is painted; the second key takes back what the first one does."""
    page.evaluate(_STROKES)
    for number in range(KEYS):
        page.keyboard.press(keys[number % 2])
        page.wait_for_timeout(chance.uniform(*PAUSE_MS))
    found: list[float] = page.evaluate("window.strokes")
    return found


def written_in(browser: Browser, url: str, name: str, chance: random.Random) -> list[float]:
    """Key strokes in the argument of a task in the middle of a scenario."""
    with opened(browser, url, f"#/{FLEET}/scenarios/edit/{name}", "engineer") as page:
        expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
        text = page.get_by_role("textbox", name=f"Text of {name}")
        text.click()
        page.keyboard.press("Control+Home")
        for _ in range(min(TASKS[name] // 2, 40)):
            page.keyboard.press("PageDown" if TASKS[name] > 100 else "ArrowDown")
        page.keyboard.press("End")
        page.wait_for_timeout(1000)
        return strokes_ms(page, chance, ("x", "Backspace"))


def moved_in(browser: Browser, url: str, name: str, chance: random.Random) -> list[float]:
    """Key strokes by which a block in the middle of a scenario is moved and moved back."""
    with opened(browser, url, f"#/{FLEET}/scenarios/edit/{name}?view=blocks", "engineer") as page:
        expect(page.get_by_role("region", name="Problems")).to_contain_text("It fits the fleet.")
        block = page.get_by_role("treeitem").nth(TASKS[name] // 2)
        block.focus()
        task = block.inner_text().split()[0]
        expect(page.get_by_role("region", name=f"Fields of {task}")).to_be_visible()
        page.wait_for_timeout(1000)
        found = strokes_ms(page, chance, ("Alt+ArrowDown", "Alt+ArrowUp"))
        expect(page.get_by_role("treeitem").filter(has_text=task).first).to_be_focused()
        return found


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    chance, large, small, moved = random.Random(5), list[float](), list[float](), list[float]()
    with running() as (_, console), chromium(whole=True) as browser:
        for _ in range(max(rounds, FEWEST_ROUNDS)):
            large += written_in(browser, console.url, "large", chance)
            small += written_in(browser, console.url, "small", chance)
            moved += moved_in(browser, console.url, "large", chance)
    reference = f"with {TASKS['small']} tasks"
    return [
        within(f"key stroke to paint, {TASKS['large']} tasks, p95", part(large, 95), "ms", KEY_MS),
        shown(
            f"key stroke to paint, {TASKS['large']} tasks, the longest", max(large), "ms",
            reference=reference, reference_value=max(small),
        ),
        shown(
            f"key stroke to paint, {TASKS['large']} tasks, p50", statistics.median(large), "ms",
            reference=reference, reference_value=statistics.median(small),
        ),
        within(f"key stroke in the blocks to paint, {TASKS['large']} tasks, p95", part(moved, 95), "ms", KEY_MS),
    ]  # fmt: skip
