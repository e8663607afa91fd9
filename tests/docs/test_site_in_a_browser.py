"""The site in Chromium, opened as files: search, themes with their pictures, and no page wider than a telephone."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, Route, expect

from tests.console import browsing

pytestmark = pytest.mark.needs("chromium")

PHONE = 360
# Of a picture, 0 to 255: the mean of its pixels.
_BRIGHTNESS = """async data => {
    const image = new Image();
    image.src = "data:image/png;base64," + data;
    await image.decode();
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const pixels = context.getImageData(0, 0, image.width, image.height).data;
    return pixels.reduce((sum, one) => sum + one, 0) / pixels.length;
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing.chromium() as started:
        yield started


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    with browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light") as context:
        page = context.new_page()
        missing: list[str] = []
        page.on("requestfailed", lambda request: missing.append(f"{request.url}: {request.failure}"))
        yield page
        # What a page still waits for when the next one is opened is given up.
        missing = [what for what in missing if "ERR_ABORTED" not in what]
        assert missing == [], "the site asks for what it has not, or from elsewhere"


def test_a_page_is_found_by_a_word(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    page.keyboard.press("Control+k")
    page.keyboard.type("MessageReceiveTimeout")
    found = page.locator("a[href*='.html']", has_text=re.compile("MessageReceiveTimeout"))
    expect(found.first).to_be_visible(timeout=30_000)


def test_a_reader_chooses_the_theme_and_pictures_follow(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    picture = page.locator("article img[src*='system.svg']")

    def brightness() -> float:
        return float(page.evaluate(_BRIGHTNESS, base64.b64encode(picture.screenshot()).decode()))

    assert brightness() > 200
    page.get_by_title("press for light").click()
    page.get_by_title("press for dark").click()
    expect(page.locator("body")).to_have_attribute("data-md-color-scheme", "slate")
    assert brightness() < 130


def test_no_page_is_wider_than_a_telephone(page: Page, site: Path) -> None:
    page.set_viewport_size({"width": PHONE, "height": 740})
    index, asked = site / "search.js", set[str]()

    def give_up(route: Route) -> None:
        asked.add(route.request.url)
        route.abort("aborted")

    # All words of the site: to read them is half of what a page computes, and no page is wider by it.
    page.route(f"**/{index.name}", give_up)
    wide: dict[str, int] = {}
    # The page for what is not found is a web server's: its paths begin at the root.
    for file in sorted(set(site.glob("*.html")) - {site / "404.html"}):
        page.goto(file.as_uri())
        width = page.evaluate("document.documentElement.scrollWidth")
        if width > PHONE:
            wide[file.name] = width
    assert wide == {}
    assert index.exists()
    assert asked == {index.as_uri()}


def test_the_next_page_is_reached(page: Page, site: Path) -> None:
    page.goto((site / "tutorial.html").as_uri())
    page.locator("a.md-footer__link--next").click()
    expect(page).to_have_title(re.compile("nine tasks", re.IGNORECASE))
