"""A Chromium for tests: how it is started, what is looked at in it, and pictures of it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, sync_playwright

from tests import computing, system

PICTURES: Final = system.ROOT / "build" / "pictures"
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
            computing.note_helpers()
            browser.close()


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
        page.evaluate(_AXE.read_text(encoding="utf-8"))
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
    page.set_viewport_size({"width": width, "height": _HEIGHTS[width]})
    page.emulate_media(color_scheme="dark" if theme == "dark" else "light", reduced_motion="reduce")
    page.locator(f"html[data-theme={theme}]").wait_for()


def pictures(page: Page, name: str) -> list[str]:
    """Keep pictures of a page in both themes and all widths, in build/pictures; what is wrong with any of them."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    wrong: list[str] = []
    for width in (*WIDTHS, WIDEST) if name in WIDEST_PICTURES.values() else WIDTHS:
        for theme in THEMES:
            show(page, theme, width)
            page.wait_for_timeout(100)
            page.screenshot(path=PICTURES / f"{name}-{width}-{theme}.png")
            if width != WIDEST:  # whose elements are the same
                found = axe_violations(page, "" if theme == THEMES[0] else _OF_COLOURS)
                wrong += [f"{theme}, {width} px: {one}" for one in found]
            elif theme == THEMES[0]:
                wrong += [f"{width} px: {one}" for one in stretched(page)]
            beyond: list[int] = page.evaluate(_BEYOND)
            for pixels, how in zip(beyond, ("wider", "higher"), strict=True):
                if pixels > 0:
                    wrong.append(f"{theme}, {width} px: the page is {pixels} px {how} than the window")
    show(page, "light", 1280)
    return wrong
