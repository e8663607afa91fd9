"""A Chromium for tests: how it is started, what is looked at in it, and pictures of it."""

from __future__ import annotations

import base64
import json
import os
import shutil
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, ViewportSize, sync_playwright

from tests import computing, system

PICTURES: Final = system.ROOT / "build" / "pictures"
_ARE_KEPT: Final = bool(os.environ.get("UA_FLEET_PICTURES"))
"""Whether pictures are made of all that is looked at (`make pictures`): it is a tenth of what a look computes."""
THEMES: Final = ("light", "dark")
WIDTHS: Final = (1280, 360)
WIDEST: Final = 3840
WIDEST_PICTURES: Final = {
    "login": "login",
    "fleet": "fleet-1000",
    "map": "map",
    "scenarios": "editor-blocks",
    "resilience": "resilience",
    "alarms": "alarms",
    "space": "space",
    "pubsub": "pubsub-bridges",
    "robot": "robot-chart",
    "drive": "drive",
}
"""Of each page, the picture that is also made at this width: one of them takes as long as four of the others."""
_HEIGHTS: Final = {WIDEST: 2160, 1280: 800, 360: 740}
_AXE: Final = system.ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"
_OPTIONS: Final = (
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
_BRIEF: Final = "--js-flags=--no-opt --no-maglev"
"""A page of a test is gone before what optimising its scripts takes is saved: a picture costs a fifth less so."""
_BEYOND: Final = """(() => {
  const all = document.documentElement;
  const framed = document.querySelector('main#main');
  return [all.scrollWidth - all.clientWidth, framed ? all.scrollHeight - all.clientHeight : 0];
})()"""
"""How much a page is wider and higher than the window. Only what is within the frame is scrolled downwards."""
_STRETCHED: Final = """([widest, longest]) => {
  const said = (one, px) => `${one.tagName.toLowerCase()} ${one.getAttribute('aria-label') || one.innerText || ''}`
    .slice(0, 60) + ` is ${Math.round(px)} px wide`;
  const seen = one => one.checkVisibility() && !one.closest('.unseen, .cm-editor, .panels + .time');
  const controls = [...document.querySelectorAll('button, select, input, textarea, progress')].filter(seen)
    .map(one => [one, one.getBoundingClientRect().width]).filter(([, px]) => px > widest);
  const texts = [...document.querySelectorAll('p, dd')].filter(seen).flatMap(one => {
    const range = document.createRange();
    range.selectNodeContents(one);
    const px = Math.max(0, ...[...range.getClientRects()].map(line => line.width));
    return px > longest ? [[one, px]] : [];
  });
  return [...controls, ...texts].map(([one, px]) => said(one, px));
}"""
"""Controls that are wider than anybody needs, and lines of text that are longer than anybody reads.

The slider of a chart is as wide as what it slides over.
"""
WIDEST_CONTROL_PX: Final = 1000
LONGEST_LINE_PX: Final = 1200
_MOST_TABS: Final = 80
_TAGS: Final = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice")
_RUN_AXE: Final = """async ([tags, of]) => {
  const others = axe.getRules(tags).filter(rule => of && !rule.tags.includes(of));
  const rules = Object.fromEntries(others.map(rule => [rule.ruleId, {enabled: false}]));
  const found = await axe.run(document, {runOnly: tags, rules, resultTypes: ['violations']});
  return found.violations.map(one => ({id: one.id, help: one.help, nodes: one.nodes.map(node =>
    node.html.slice(0, 200) + ' ' + node.any.concat(node.all, node.none).map(check => check.message).join('; '))}));
}"""
_OF_COLOURS: Final = "cat.color"
"""The tag of the rules that look at colours, of which alone a theme is another (`tests/architecture/test_web.py`)."""


def chromium_options(*options: str, whole: bool = False) -> dict[str, Any]:
    """How the system's Chromium is launched, by Playwright of either kind; `whole`: as a person has it."""
    sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()
    program = (shutil.which("chromium") if whole else None) or system.chromium()
    brief = () if whole else (_BRIEF,)
    return {"executable_path": program, "args": [*_OPTIONS, *brief, *sandbox, *options]}


@contextmanager
def chromium(*options: str, whole: bool = False) -> Generator[Browser]:
    """The system's Chromium, without a window; `whole`: all of it, for what is measured."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(**chromium_options(*options, whole=whole))
        try:
            yield browser
        finally:
            computing.note_browsers()
            browser.close()
    computing.note_browsers()  # none of these runs any more


class Windows:
    """Where pages are opened, each in a browser of its own: one without cookies and whatever else a page has stored.

    Such a browser is used by a test after the other, and has a renderer for all its pages, which an empty one keeps
    alive (`--renderer-process-limit=1`): a new one computes half as long again for a page, to compile its scripts.
    """

    def __init__(self, browser: Browser, timeout_ms: float) -> None:
        self._browser, self._timeout_ms = browser, timeout_ms
        self._empty: list[Page] = []
        """The one that stays, of each."""
        self._used = 0

    def open(self, cookies: Sequence[Any]) -> Page:
        """A page in one that no other page is in since `leave`."""
        if self._used == len(self._empty):
            context = self._browser.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
            context.set_default_timeout(self._timeout_ms)
            self._empty.append(context.new_page())
        context = self._empty[self._used].context
        self._used += 1
        if cookies:
            context.add_cookies(cookies)
        return context.new_page()

    def leave(self, url: str) -> None:
        """Close the pages, and have nothing kept that was stored or allowed there."""
        for empty in self._empty[: self._used]:
            context = empty.context
            for page in context.pages:
                if page != empty:
                    page.close()
            context.clear_cookies()
            context.clear_permissions()
            storage: Any = context.new_cdp_session(empty)
            storage.send("Storage.clearDataForOrigin", {"origin": url.rstrip("/"), "storageTypes": "all"})
            storage.detach()
        self._used = 0

    def close(self) -> None:
        """End all."""
        for empty in self._empty:
            empty.context.close()


class Complaints:
    """What a page complained about: exceptions, refused content, failed loads."""

    def __init__(self, page: Page) -> None:
        self._said: list[str] = []
        page.on("pageerror", lambda error: self._said.append(f"exception: {error}"))
        page.on("console", self._hear)

    def _hear(self, message: ConsoleMessage) -> None:
        # A browser says so of each answer that is no success; this one asks who is logged in.
        asks = message.location.get("url", "").endswith("/api/me") and "401" in message.text
        if message.type in ("error", "warning") and not asks:
            self._said.append(f"{message.type}: {message.text} ({message.location.get('url', '')})")

    def others_than(self, expected: Sequence[str]) -> list[str]:
        """All that have none of these texts in them."""
        return [one for one in self._said if not any(text in one for text in expected)]


def axe_violations(page: Page, of: str = "") -> list[str]:
    """What axe finds wrong with what is shown now: rule, and the elements; `of`: by the rules with this tag alone."""
    if not page.evaluate("typeof window.axe === 'object'"):
        # As a script, which a renderer compiles once for all its pages: `Page.evaluate` has it compiled for each.
        devtools: Any = page.context.new_cdp_session(page)
        devtools.send("Runtime.evaluate", {"expression": f"{_AXE.read_text(encoding='utf-8')};0"})
        devtools.detach()
    found: list[dict[str, Any]] = page.evaluate(_RUN_AXE, [_TAGS, of])
    return [f"{one['id']}: {one['help']}: {json.dumps(one['nodes'][:3])}" for one in found]


def tabbed_to(page: Page, wanted: Locator, *, back: bool = False) -> None:
    """Press Tab until it has the focus, as who has no mouse does; `back`: in the other direction."""
    focused, met = wanted.and_(page.locator(":focus")), list[str]()
    while len(met) < _MOST_TABS:
        page.keyboard.press("Shift+Tab" if back else "Tab")
        if focused.count():
            return
        met.append(
            page.evaluate("document.activeElement.getAttribute('aria-label') || document.activeElement.innerText")
        )
    raise AssertionError(f"Tab never came to {wanted}: {met}")


def stretched(page: Page) -> list[str]:
    """What a wide window stretches."""
    found: list[str] = page.evaluate(_STRETCHED, [WIDEST_CONTROL_PX, LONGEST_LINE_PX])
    return found


def show(page: Page, theme: str, width: int) -> None:
    """Have the page in a theme at a width, as a browser of a system with it would."""
    size: ViewportSize = {"width": width, "height": _HEIGHTS[width]}
    if page.viewport_size != size:
        page.set_viewport_size(size)
    page.emulate_media(color_scheme="dark" if theme == "dark" else "light", reduced_motion="reduce")
    page.locator(f"html[data-theme={theme}]").wait_for()


def _keep(devtools: Any, path: Path) -> None:
    """A picture of a page that stands still. `Page.screenshot` has it stand first and packs tighter, which is slow."""
    taken: dict[str, str] = devtools.send("Page.captureScreenshot", {"format": "png", "optimizeForSpeed": True})
    path.write_bytes(base64.b64decode(taken["data"]))


def pictures(page: Page, name: str) -> list[str]:
    """What is wrong with a page in either theme and any width.

    In build/pictures are pictures of it if they are asked for, and of where something is wrong.
    """
    PICTURES.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    devtools = page.context.new_cdp_session(page)
    for width in (*WIDTHS, WIDEST) if name in WIDEST_PICTURES.values() else WIDTHS:
        for theme in THEMES:
            show(page, theme, width)
            page.wait_for_timeout(100)
            if width != WIDEST:  # whose elements are the same
                found = axe_violations(page, "" if theme == THEMES[0] else _OF_COLOURS)
                wrong += [f"{theme}, {width} px: {one}" for one in found]
            elif theme == THEMES[0]:
                wrong += [f"{width} px: {one}" for one in stretched(page)]
            beyond: list[int] = page.evaluate(_BEYOND)
            for pixels, how in zip(beyond, ("wider", "higher"), strict=True):
                if pixels > 0:
                    wrong.append(f"{theme}, {width} px: the page is {pixels} px {how} than the window")
            if _ARE_KEPT or wrong:
                _keep(devtools, PICTURES / f"{name}-{width}-{theme}.png")
    devtools.detach()
    show(page, "light", 1280)
    return wrong
