"""The console's page with 1,000 robots of 10 values at 1 Hz, in a real Chromium.

The stream is what a real console told of a real fleet, recorded once into build/benchmarks, and played to the real
page. So server, bridges and console take none of the machine from the browser. Times are CPU of the page's main
thread, which other programs of the machine lengthen less than times by the clock.

    python -m benchmarks.console_page heap [MINUTES]     the heap of a page that is open for 30 minutes
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, Final

from playwright.sync_api import Browser, expect

from benchmarks._console_page import Heap, empty, frames, opened, part, receiving, scripts_kb, traced, work_of
from benchmarks._console_recording import WANTED, recorded
from benchmarks._quiet import expect_quiet
from benchmarks.harness import FEWEST_ROUNDS, Figure, Unavailable, at_most, merge_results, shown, within
from tests import system
from tests.console.browsing import chromium
from tests.console.conftest import USERS
from tests.system import Processes

PLACES: Final = {
    "Fleet, cards": "#/hall/fleet",
    "Fleet, rows": "#/hall/fleet?view=rows",
    "Fleet, rows by age in groups": "#/hall/fleet?view=rows&sort=updated&group=state",
    "Robot": "#/hall/robot/robot0001",
}
_ALL: Final[dict[str, dict[str, Any]]] = {"counts": {}, "robots": {}}
FEEDS: Final = dict.fromkeys(PLACES, _ALL) | {"Robot": WANTED | dict.fromkeys(("alarms", "robots"), WANTED["robot"])}
"""What each of them wants of the console."""
SCROLLED: Final = ("Fleet, cards", "Fleet, rows")
UPDATE_MS: Final = 8.0
TASK_MS: Final = 50.0
USABLE_S: Final = 1.5
SCRIPT_KB: Final = 250.0
FRAMES: Final = 1.1
"""Of the 95th percentile of an empty page's."""
HEAP: Final = 1.05
TRACED_S: Final = 10.0
FRAMES_S: Final = 5.0
SCROLLED_PX: Final = 40
"""With each frame: all 1,000 robots pass in about ten seconds."""
SETTLE_MS: Final = 3000
VISIT_MS: Final = 4000
HEAP_FROM_MIN: Final = 10
HEAP_UNTIL_MIN: Final = 30


@contextmanager
def playing() -> Generator[str]:
    """The URL of a console that plays the recording."""
    for part_of_system in ("chromium", "npm"):
        if reason := system.missing(part_of_system):
            raise Unavailable(reason)
    expect_quiet()
    recorded()
    with Processes() as processes:
        child = processes.start(sys.executable, "-m", "benchmarks._console_recording", "play")
        yield child.wait_for("http://", 60).strip()


def usable_s(browser: Browser, url: str, role: str = "operator") -> tuple[float, float]:
    """Seconds from the click on "Log in" to the first robot's card; and kB of scripts until then."""
    user, password = USERS[role]
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    context.set_default_timeout(60_000)
    try:
        page = context.new_page()
        page.goto(url)
        page.get_by_label("User").fill(user)
        page.get_by_label("Password").fill(password)
        began = time.perf_counter()
        page.get_by_role("button", name="Log in").click()
        page.get_by_role("article").first.wait_for()
        return time.perf_counter() - began, scripts_kb(page)
    finally:
        context.close()


def page_figures(browser: Browser, url: str, name: str, rounds: int) -> list[Figure]:
    updates, longest, ours, theirs = list[float](), list[float](), list[float](), list[float]()
    received, scrolled = list[float](), list[float]()
    for _ in range(rounds):
        with opened(browser, url, PLACES[name]) as page:
            page.wait_for_timeout(SETTLE_MS)
            work = work_of(traced(browser, page, TRACED_S))
            updates += work.updates_ms
            longest.append(work.longest_ms)
            ours.append(part(frames(page, FRAMES_S), 95))
            if name in SCROLLED:
                scrolled.append(part(frames(page, FRAMES_S, SCROLLED_PX), 95))
        with receiving(browser, url, FEEDS[name]) as page:
            page.wait_for_timeout(SETTLE_MS)
            received += work_of(traced(browser, page, TRACED_S)).updates_ms
        with empty(browser) as page:
            theirs.append(part(frames(page, FRAMES_S), 95))
    empty_ms = statistics.median(theirs)
    during = {"while nobody touches it": ours, "while it is scrolled": scrolled}
    return [
        within(f"{name}, main thread for an update, p95", part(updates, 95), "ms", UPDATE_MS),
        shown(
            f"{name}, main thread for an update, p50", part(updates, 50), "ms",
            reference="an empty page that is told the same", reference_value=part(received, 50),
        ),
        within(f"{name}, the longest task", statistics.median(longest), "ms", TASK_MS),
        *(
            at_most(
                f"{name}, between frames {when}, p95", statistics.median(found), "ms",
                reference="an empty page", reference_value=empty_ms, goal=FRAMES,
            )
            for when, found in during.items() if found
        ),
    ]  # fmt: skip


def figures(rounds: int = FEWEST_ROUNDS, names: tuple[str, ...] = tuple(PLACES)) -> list[Figure]:
    rounds = max(rounds, FEWEST_ROUNDS)
    with playing() as url, chromium(whole=True) as browser:
        found = [one for name in names for one in page_figures(browser, url, name, rounds)]
        first = [usable_s(browser, url) for _ in range(rounds)]
    usable, script = statistics.median(one[0] for one in first), first[0][1]
    return [
        *found,
        within("first page usable after login", usable, "s", USABLE_S),
        within("script of the first page, compressed", script, "kB", SCRIPT_KB),
    ]


def heap_figures(minutes: float = HEAP_UNTIL_MIN) -> list[Figure]:
    """The heap of a page of all robots, which is scrolled and left for a robot and come back to all the time.

    Often, so that at the first collection the browser has compiled what it will compile: that is in its heap too.
    """
    first_at = HEAP_FROM_MIN * minutes / HEAP_UNTIL_MIN
    heaps, kept, nodes = list[float](), list[float](), list[int]()
    with playing() as url, chromium(whole=True) as browser, opened(browser, url, PLACES["Fleet, cards"]) as page:
        heap, began = Heap(page), time.monotonic()
        for until in (first_at, minutes):
            while time.monotonic() - began < until * 60:
                page.mouse.move(700, 400)
                page.mouse.wheel(0, 5000)
                page.wait_for_timeout(VISIT_MS)
                page.get_by_role("article").get_by_role("link").first.click()
                expect(page.get_by_role("table", name="Data")).to_be_visible()
                page.wait_for_timeout(VISIT_MS)
                page.go_back()
                expect(page.get_by_role("article").first).to_be_visible()
            page.wait_for_timeout(SETTLE_MS)
            heaps.append(heap.used_mb())
            kept.append(heap.kept_mb())
            nodes.append(heap.nodes())
            print(f"minute {until:g}: {heaps[-1]:.2f} MB", file=sys.stderr, flush=True)
    reference = f"at minute {first_at:g}"
    return [
        at_most(
            f"heap without compiled code at minute {minutes:g}", kept[1], "MB",
            reference=reference, reference_value=kept[0], goal=HEAP,
        ),
        shown(f"heap at minute {minutes:g}", heaps[1], "MB", reference=reference, reference_value=heaps[0]),
        shown(f"nodes at minute {minutes:g}", nodes[1], "nodes", reference=reference, reference_value=nodes[0]),
    ]  # fmt: skip


def main() -> None:
    from benchmarks.__main__ import RESULTS, print_table

    what, *options = sys.argv[1:]
    try:
        if what == "heap":
            found = heap_figures(float(options[0]) if options else HEAP_UNTIL_MIN)
            merge_results(RESULTS, "console_heap", found)
        else:
            found = figures(names=(what, *options))
    except Unavailable as reason:
        sys.exit(f"console_page: {reason}")
    print_table({"console": found})


if __name__ == "__main__":
    main()
