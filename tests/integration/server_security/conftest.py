"""One hardened server for each module, and certificates made once in a run."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest
import pytest_asyncio

from tests import system
from tests.integration.server_security.harness import Door, Identities, Stock, door, stock


@pytest.fixture(scope="session")
def identities(tmp_path_factory: pytest.TempPathFactory) -> Identities:
    """Certificates of clients, good and bad."""
    return Identities(tmp_path_factory.mktemp("certificates"))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def hardened(tmp_path_factory: pytest.TempPathFactory, identities: Identities) -> AsyncGenerator[Door]:
    """A hardened server with the usual limits."""
    async with door(tmp_path_factory.mktemp("server"), identities) as running:
        yield running


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plain() -> AsyncGenerator[Stock]:
    """A stock asyncua server."""
    async with stock(system.free_tcp_port()) as running:
        yield running
