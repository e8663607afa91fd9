from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest
import pytest_asyncio

from tests.integration.key_service.harness import Cards, Desk, desk


@pytest.fixture(scope="session")
def cards(tmp_path_factory: pytest.TempPathFactory) -> Cards:
    return Cards(tmp_path_factory.mktemp("cards"))


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def running(tmp_path_factory: pytest.TempPathFactory, cards: Cards) -> AsyncGenerator[Desk]:
    """A server for the tests of one module."""
    async with desk(tmp_path_factory.mktemp("desk"), cards) as made:
        yield made
