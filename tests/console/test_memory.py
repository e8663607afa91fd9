"""A page that is open for days: what was left gives its memory back."""

from __future__ import annotations

from typing import Any

from playwright.sync_api import Page, expect

VISITS = 4


def test_pages_that_were_left_are_let_go(page: Page) -> None:
    session: Any = page.context.new_cdp_session(page)

    def visit() -> int:
        """Go to a robot and back some times; the nodes that are kept then, in the document or not."""
        for _ in range(VISITS):
            page.get_by_role("link", name="left").click()
            expect(page.get_by_role("heading", name="left")).to_be_visible()
            page.go_back()
            expect(page.get_by_role("button", name="Actions for left")).to_be_visible()
        page.wait_for_timeout(1500)  # a feed lingers for a second
        session.send("HeapProfiler.collectGarbage")
        session.send("HeapProfiler.collectGarbage")
        counted: dict[str, int] = session.send("Memory.getDOMCounters")
        return counted["nodes"]

    visit()
    before = visit()
    shown = page.evaluate("document.querySelectorAll('*').length")
    # One that is left may be kept until the next one is.
    assert visit() - before < 2 * shown
    assert visit() - before < 2 * shown
