"""Responses that are made of bytes have the bytes that asyncua makes of the same response."""

from __future__ import annotations

import importlib
import random
from datetime import UTC, datetime, timedelta
from typing import Any

from ua_fleet.endpoint.answers import ArrayResponse, EncodedResponse
from ua_fleet.endpoint.history import refused
from ua_fleet.endpoint.notifications import (
    changes_of,
    encode_codes,
    encode_message,
    events_of,
    publish_response,
    status_change,
)
from ua_fleet.endpoint.subscription_services import encode_item_result

ua: Any = importlib.import_module("asyncua.ua")
binary: Any = importlib.import_module("asyncua.ua.ua_binary")

ROUNDS = 300
NOW = datetime(2026, 1, 1, tzinfo=UTC)
HANDLE = 77
TIME = slice(4, 12)


def _codes(rng: random.Random) -> list[int]:
    return [rng.choice((0, 0x8028_0000, 0x807A_0000)) for _ in range(rng.choice((0, 1, 5)))]


def _value(rng: random.Random) -> Any:
    content = rng.choice((1.5, "x", [1, 2, 3], None))
    return ua.DataValue(ua.Variant(content), ua.StatusCode(rng.choice((0, 5))), NOW, rng.choice((None, NOW)))


def _notifications(rng: random.Random) -> tuple[list[Any], list[bytes]]:
    """As asyncua has them, and as bytes."""
    changes = [ua.MonitoredItemNotification(rng.randrange(9), _value(rng)) for _ in range(rng.randrange(4))]
    fields = [ua.Variant(rng.choice((1, "x", None))) for _ in range(rng.randrange(4))]
    events = [ua.EventFieldList(rng.randrange(9), fields) for _ in range(rng.randrange(3))]
    code = rng.choice(_codes(rng) or [0])
    whole = [
        (ua.DataChangeNotification(changes), changes_of([binary.struct_to_binary(each) for each in changes])),
        (ua.EventNotificationList(events), events_of([binary.struct_to_binary(each) for each in events])),
        (ua.StatusChangeNotification(ua.StatusCode(code)), status_change(code)),
    ]
    chosen = rng.sample(whole, rng.randrange(4))
    return [structure for structure, _ in chosen], [data for _, data in chosen]


def _same(response: Any, expected: Any) -> None:
    expected.ResponseHeader.RequestHandle = HANDLE
    data, other = bytearray(response.encode(HANDLE)), bytearray(binary.struct_to_binary(expected))
    data[TIME] = other[TIME] = bytes(8)
    assert data == other, expected


def test_publish_responses_and_what_is_sent_again_have_asyncuas_bytes() -> None:
    rng = random.Random(1)
    for _ in range(ROUNDS):
        structures, notifications = _notifications(rng)
        sequence, told_at = rng.choice((1, 2**32 - 1)), NOW + timedelta(microseconds=rng.randrange(10**9))
        message = ua.NotificationMessage(sequence, told_at, structures)
        data = encode_message(sequence, told_at, notifications)
        codes, kept, more = _codes(rng), rng.sample(range(2**32), rng.randrange(5)), rng.random() < 0.5
        results = [ua.StatusCode(code) for code in codes]
        expected = ua.PublishResponse(Parameters=ua.PublishResult(9, kept, more, message, results))
        _same(publish_response(9, data, encode_codes(codes), kept, more=more), expected)
        _same(EncodedResponse(ua.RepublishResponse, data), ua.RepublishResponse(NotificationMessage=message))


def test_results_of_new_items_have_asyncuas_bytes() -> None:
    rng = random.Random(2)
    for _ in range(ROUNDS):
        answer = ArrayResponse(ua.CreateMonitoredItemsResponse, 1_000_000)
        results: list[Any] = []
        for code in _codes(rng):
            found = ua.EventFilterResult([ua.StatusCode(each) for each in _codes(rng)], [], ua.ContentFilterResult())
            filter_result = rng.choice((None, found))
            given = rng.randrange(2**32), rng.random(), rng.randrange(2**32)
            answer.add_small(encode_item_result(code, *given, filter_result))
            result = ua.MonitoredItemCreateResult(ua.StatusCode(code), *given)
            if filter_result is not None:
                result.FilterResult = filter_result
            results.append(result)
        _same(answer, ua.CreateMonitoredItemsResponse(Results=results))


def test_a_refused_history_has_asyncuas_bytes() -> None:
    for code in (0, 0x8034_0000):
        assert refused(code) == binary.struct_to_binary(ua.HistoryReadResult(ua.StatusCode(code)))
