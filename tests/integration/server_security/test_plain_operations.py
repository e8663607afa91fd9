"""Requests for items, histories and notifications get the answers that asyncua's decoder would lead to."""

from __future__ import annotations

import random
from collections import OrderedDict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from asyncua.common.utils import Buffer

from tests.integration.server_security.both_ways import Paths, targets_of
from tests.integration.server_security.harness import Identities, binary, door, ua
from tests.integration.server_security.test_limits import create_subscription
from tests.integration.server_security.test_mutations import mutated
from tests.integration.server_security.test_plans import COUNT

pytestmark = pytest.mark.asyncio(loop_scope="module")

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def _items(rng: random.Random, targets: list[Any], subscription: int) -> Any:
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = subscription
    request.Parameters.TimestampsToReturn = rng.choice((0, 1, 2, 2, 3, 4))
    for _ in range(rng.choice((0, 1, 1, 5))):
        target = ua.ReadValueId(rng.choice(targets), rng.choice((13, 13, 13, rng.randrange(28))))
        target.IndexRange = rng.choice((None, None, None, "1:2", "x"))
        wanted = rng.choice((None, None, None, ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, 1, 0.5)))
        interval, size = rng.choice((0.0, 100.0, -1.0)), rng.choice((0, 1, 7))
        parameters = ua.MonitoringParameters(rng.randrange(9), interval, wanted, size, rng.random() < 0.5)
        mode = rng.choice(tuple(ua.MonitoringMode))
        request.Parameters.ItemsToCreate.append(ua.MonitoredItemCreateRequest(target, mode, parameters))
    return request


async def test_items_are_created_alike_however_they_are_decoded(tmp_path: Path, identities: Identities) -> None:
    rng = random.Random(21)
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        paths, targets = Paths(hardened, client), targets_of(hardened)
        made = (await create_subscription(client, RequestedPublishingInterval=1_000)).SubscriptionId
        subscription: Any = hardened.server.iserver.subscription_service.subscriptions[made]
        items = subscription.items

        def left() -> Any:
            names = ("id", "node_id", "mode", "client_handle", "discard_oldest", "queue_size")
            found = [[getattr(item, name) for name in names] for item in items]
            items.remove_all()
            subscription._pending.clear()
            items._last_id = 0
            return found

        seen: set[bytes] = set()
        for _ in range(COUNT):
            body, start = paths.encoded(_items(rng, targets, made))
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            with paths.without_plan("CreateMonitoredItems"):
                expected = await paths.answer(body), left()
            assert (await paths.answer(body), left()) == expected
            seen.add(expected[0])
        assert len(seen) > COUNT // 5


def _history(rng: random.Random, targets: list[Any]) -> Any:
    request = ua.HistoryReadRequest()
    details = ua.ReadRawModifiedDetails(False, NOW, NOW, rng.randrange(5), rng.random() < 0.5)
    interval, kinds = (
        rng.choice((0.0, 60_000.0)),
        [ua.NodeId(number) for number in rng.choice(((), (2342,), (2342, 7)))],
    )
    averages = ua.ReadProcessedDetails(NOW, NOW, interval, kinds, ua.AggregateConfiguration())
    at_times = ua.ReadAtTimeDetails([NOW] * rng.randrange(3), False)
    others = ua.ReadAnnotationDataDetails([NOW]), ua.ReadEventDetails()
    request.Parameters.HistoryReadDetails = rng.choice((details, details, at_times, averages, *others))
    request.Parameters.TimestampsToReturn = rng.choice((0, 1, 2, 3))
    request.Parameters.ReleaseContinuationPoints = rng.random() < 0.1
    for _ in range(rng.choice((0, 1, 3))):
        node = ua.HistoryReadValueId(rng.choice(targets), rng.choice((None, None, "1")))
        node.ContinuationPoint = rng.choice((None, None, b"", b"x" * 48))
        request.Parameters.NodesToRead.append(node)
    return request


async def test_histories_are_read_alike_however_they_are_asked_for(tmp_path: Path, identities: Identities) -> None:
    rng = random.Random(22)
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        paths, targets = Paths(hardened, client), targets_of(hardened)
        seen: set[bytes] = set()
        for _ in range(COUNT):
            body, start = paths.encoded(_history(rng, targets))
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            with paths.without_plan("HistoryRead"):
                expected = await paths.answer(body)
            assert await paths.answer(body) == expected
            seen.add(expected)
        assert len(seen) > 5


async def test_publish_requests_are_answered_alike_however_they_are_decoded(
    tmp_path: Path, identities: Identities
) -> None:
    rng = random.Random(23)
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        paths = Paths(hardened, client)
        made = (await create_subscription(client, RequestedPublishingInterval=60_000)).SubscriptionId
        subscription: Any = hardened.server.iserver.subscription_service.subscriptions[made]
        subscription._first = False

        async def answered(body: bytes) -> tuple[str, int]:
            """What a Publish request gets at once, and what is kept after it."""
            subscription._sent = OrderedDict({number: bytes(number) for number in range(3, 12)})
            subscription.kept_bytes = sum(range(3, 12))
            subscription.session.late[made] = None
            data = await paths.answer(body)
            if data[2:4] != ua.ObjectIds.PublishResponse_Encoding_DefaultBinary.to_bytes(2, "little"):
                return data.hex(), subscription.kept_bytes
            response = binary.struct_from_binary(ua.PublishResponse, Buffer(data))
            assert binary.struct_to_binary(response) == data
            response.Parameters.NotificationMessage.PublishTime = NOW
            return repr(response), subscription.kept_bytes

        seen: set[str] = set()
        for _ in range(COUNT):
            request = ua.PublishRequest()
            request.Parameters.SubscriptionAcknowledgements = rng.choice((None, [], [])) or [
                ua.SubscriptionAcknowledgement(rng.choice((made, made, made + 1)), rng.randrange(14))
                for _ in range(rng.choice((0, 1, 1, 5)))
            ]
            body, start = paths.encoded(request)
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            with paths.without_plan("Publish"):
                expected = await answered(body)
            assert await answered(body) == expected
            seen.add(expected[0])
        assert len(seen) > COUNT // 5
