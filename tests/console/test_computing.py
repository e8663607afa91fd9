"""What a browser computes is counted, though nobody waits for the processes that do so."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from tests.computing import computed, note_browsers
from tests.console import browsing

BUSY = "let n = 0; for (let i = 0; i < 15e7; i += 1) n = (n + i) % 1000003; n"
LEAST_S = 0.75
"""So many divisions take a page more."""


def test_pages_that_are_closed_and_one_that_is_not_are_counted(browser: Browser) -> None:
    note_browsers()
    before = computed()
    another = browser.browser_type.launch(**browsing.chromium_options())
    for is_closed in (True, False):
        context = another.new_context()
        assert context.new_page().evaluate(BUSY) >= 0
        if is_closed:
            context.close()
    note_browsers()
    noted = (computed() - before).children_s
    assert noted >= 2 * LEAST_S
    another.close()
    note_browsers()
    assert (computed() - before).children_s == pytest.approx(noted, abs=LEAST_S), "each was counted once"
