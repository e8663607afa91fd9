"""What a page costs in Chromium: work of its main thread by its trace, frames, script, and heap."""

from __future__ import annotations

import itertools
import json
import time
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

from playwright.sync_api import Browser, Page

from tests.console.conftest import FLEET, log_in

VIEWPORT: Final[Any] = {"width": 1280, "height": 800}
_CATEGORIES: Final = ["-*", "devtools.timeline", "disabled-by-default-devtools.timeline"]
_FRAMES: Final = """([seconds, pixels]) => new Promise(done => {
  const times = [];
  const list = document.querySelector('main .scroller');
  const until = performance.now() + seconds * 1000;
  const frame = now => {
    times.push(now);
    if (pixels) {
      const before = list.scrollTop;
      list.scrollTop += pixels;
      if (list.scrollTop === before) pixels = -pixels;  // from the end back
    }
    if (now < until) requestAnimationFrame(frame);
    else done(times.slice(1).map((time, at) => time - times[at]));
  };
  requestAnimationFrame(frame);
})"""
_RECEIVE: Final = """async want => {
  const { csrf } = await (await fetch('api/me')).json();
  const socket = new WebSocket(new URL('api/live', location).href.replace(/^http/, 'ws'));
  socket.onopen = () => {
    socket.send(JSON.stringify({ csrf }));
    socket.send(JSON.stringify({ want }));
  };
  socket.onmessage = event => {
    const seen = Number(/^{"n":(\\d+)/.exec(event.data)[1]);
    requestAnimationFrame(() => socket.send(JSON.stringify({ seen })));
  };
  setInterval(() => {}, 1000);
}"""
_SCRIPTS: Final = """() => performance.getEntriesByType('resource')
  .filter(one => new URL(one.name).pathname.endsWith('.js'))
  .reduce((sum, one) => sum + one.encodedBodySize, 0)"""


class Work(NamedTuple):
    """What the main thread did. An update is a message or a tick of the page's clock, with the frames that follow."""

    updates_ms: list[float]
    """CPU of the thread for each update: what other programs of the machine take is not in it."""
    longest_ms: float
    """CPU of the longest of all tasks."""


def part(values: list[float], percent: float) -> float:
    """A percentile."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))]


@contextmanager
def opened(browser: Browser, url: str, place: str = "", role: str = "operator") -> Generator[Page]:
    """A page of the console in a browser of its own, logged in."""
    context = browser.new_context(viewport=VIEWPORT)
    context.set_default_timeout(60_000)
    try:
        page = context.new_page()
        log_in(page, url, role)
        if place:
            page.goto(f"{url}{place}")
        yield page
    finally:
        context.close()


@contextmanager
def empty(browser: Browser) -> Generator[Page]:
    """A page with nothing in it."""
    context = browser.new_context(viewport=VIEWPORT)
    try:
        page = context.new_page()
        page.goto("data:text/html,<!doctype html><title>empty</title>")
        yield page
    finally:
        context.close()


@contextmanager
def receiving(browser: Browser, url: str, feeds: dict[str, dict[str, Any]]) -> Generator[Page]:
    """A page with nothing in it that is told these feeds: what messages and frames take of a browser by themselves."""
    with opened(browser, url) as page:
        page.goto(f"{url}nothing")  # the console says so in two words: a page from elsewhere may not connect to it
        want = {name: {"fleet": FLEET, "feed": name, "parameters": given} for name, given in feeds.items()}
        page.evaluate(_RECEIVE, want)
        yield page


def traced(browser: Browser, page: Page, seconds: float) -> list[dict[str, Any]]:
    """The trace of a page while nobody touches it."""
    browser.start_tracing(page=page, categories=_CATEGORIES)
    page.wait_for_timeout(seconds * 1000)
    events: list[dict[str, Any]] = json.loads(browser.stop_tracing())["traceEvents"]
    return events


def work_of(events: list[dict[str, Any]]) -> Work:
    """The work of the thread that receives the WebSocket's messages."""
    received = next(one for one in events if one["name"] == "WebSocketReceive")
    mine = [one for one in events if (one["pid"], one["tid"]) == (received["pid"], received["tid"])]
    fired = [one for one in mine if one["name"] == "TimerFire"]
    often = Counter(one["args"]["data"]["timerId"] for one in fired)
    begins = sorted(
        one["ts"]
        for one in mine
        if one["name"] == "WebSocketReceive" or (one in fired and often[one["args"]["data"]["timerId"]] > 2)
    )
    tasks = [one for one in mine if one["name"] == "RunTask" and "dur" in one]
    updates = [
        sum(one.get("tdur", 0) for one in tasks if this <= one["ts"] + one["dur"] < following) / 1000
        for this, following in itertools.pairwise(begins)
    ]
    return Work(updates, max(one.get("tdur", 0) for one in tasks) / 1000)


def frames(page: Page, seconds: float, scrolled_px: int = 0) -> list[float]:
    """Milliseconds between frames while nobody touches the page, or its list is scrolled so far with each of them."""
    found: list[float] = page.evaluate(_FRAMES, [seconds, scrolled_px])
    return found


def scripts_kb(page: Page) -> float:
    """What was loaded of scripts, compressed, in kB."""
    return float(page.evaluate(_SCRIPTS)) / 1000


class Heap:
    """The heap of a page."""

    def __init__(self, page: Page) -> None:
        self._session: Any = page.context.new_cdp_session(page)

    def used_mb(self) -> float:
        """What is left of it after all that can be collected is."""
        for _ in range(2):
            self._session.send("HeapProfiler.collectGarbage")
            time.sleep(0.2)
        return float(self._session.send("Runtime.getHeapUsage")["usedSize"]) / 1e6

    def kept_mb(self) -> float:
        """What the page itself keeps: without what the browser has compiled, which comes over hours and has a bound."""
        chunks: list[str] = []

        def take(part: dict[str, str]) -> None:
            chunks.append(part["chunk"])

        self._session.on("HeapProfiler.addHeapSnapshotChunk", take)
        self._session.send("HeapProfiler.takeHeapSnapshot", {"reportProgress": False})
        snapshot = json.loads("".join(chunks))
        form = snapshot["snapshot"]["meta"]
        width, names = len(form["node_fields"]), form["node_fields"]
        code = form["node_types"][names.index("type")].index("code")
        types = snapshot["nodes"][names.index("type") :: width]
        sizes = snapshot["nodes"][names.index("self_size") :: width]
        return float(sum(size for kind, size in zip(types, sizes, strict=True) if kind != code)) / 1e6

    def nodes(self) -> int:
        """Nodes of documents that are kept, in the document or not."""
        return int(self._session.send("Memory.getDOMCounters")["nodes"])
