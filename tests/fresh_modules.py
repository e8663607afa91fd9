"""A test that failed leaves nothing to what comes after it in its module, and to itself if it is run again.

Its module's fixtures, as a fleet in which it has raised a fault, are made anew then.
"""

from __future__ import annotations

from typing import Any, Final

import pytest

__all__ = ["FreshModules"]

_HAS_FAILED: Final = pytest.StashKey[bool]()


class FreshModules:
    """In each process that runs tests."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> None:
        """A step of a test has ended: its setup, the test itself, or its teardown."""
        if call.when == "setup":
            item.stash[_HAS_FAILED] = False
        if call.excinfo is not None and not call.excinfo.errisinstance(pytest.skip.Exception):
            item.stash[_HAS_FAILED] = True

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        """What is the test's own has ended."""
        if not item.stash.get(_HAS_FAILED, False):
            return
        of_test: Any = item
        for definitions in of_test._fixtureinfo.name2fixturedefs.values():
            for one in definitions:
                # Those of plugins, as the loops of asyncio, know no node, and are no state of ours.
                if one.node is not None and one.scope in {"class", "module", "package"}:
                    one.finish(of_test._request)
