"""A client is back on another session, and takes its subscriptions over while the old one times out."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.integration.server_security.harness import Door, send, ua
from tests.integration.server_security.test_limits import create_subscription

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_what_is_taken_over_while_its_session_ends_stays(hardened: Door) -> None:
    registry: Any = hardened.server.iserver.subscription_service
    async with hardened.connected() as old, hardened.connected() as new:
        ids = [(await create_subscription(old)).SubscriptionId for _ in range(40)]
        session = registry.find(ids[0]).session
        request = ua.TransferSubscriptionsRequest()
        request.Parameters.SubscriptionIds = ids[-5:]
        session.last_seen -= session.timeout_s + 1
        ending = asyncio.ensure_future(session.link._services.session.end_overdue())
        answer = await send(new, request, ua.TransferSubscriptionsResponse)
        await ending
        taken = [
            one for one, result in zip(ids[-5:], answer.Parameters.Results, strict=True) if result.StatusCode.is_good()
        ]
        assert [one for one in taken if registry.find(one) is None] == []
    assert [one for held in registry._held.values() for one in held if registry.find(one) is None] == []
