"""What a browser computes is counted, though nobody waits for the processes that do so."""

from __future__ import annotations

from tests.computing import computed
from tests.console import browsing

BUSY = "let n = 0; for (let i = 0; i < 15e7; i += 1) n = (n + i) % 1000003; n"
LEAST_S = 0.75
"""So many divisions take a page more."""


def test_pages_that_are_closed_and_one_that_is_not_are_counted() -> None:
    before = computed()
    with browsing.chromium() as browser:
        for is_closed in (True, False):
            context = browser.new_context()
            assert context.new_page().evaluate(BUSY) >= 0
            if is_closed:
                context.close()
    assert (computed() - before).children_s >= 2 * LEAST_S
