"""Clients that have much told and never fetch it: what waits for them is held by the server."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any

from tests.attacks.harness import Attacker, attacked, ua
from tests.attacks.publishers import Stranger, stranger
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

DOUBLE = int(BuiltinType.DOUBLE)
IMAGE = int(BuiltinType.BYTE_STRING)
IMAGES = [Topic(2, 2, 1200 + number) for number in range(20)]
IMAGE_BYTES = 60_000
ROBOTS = {
    "rover": {
        "bridge": "floor",
        "capacities": ["mobile"],
        "data": {f"image{topic.id}": {"id": topic.id, "type": "ByteString"} for topic in IMAGES},
    }
}


def subscription(client: Attacker, items: list[Any], interval_ms: float = 50.0) -> Any:
    """A subscription with items; what came of these."""
    request = ua.CreateSubscriptionRequest()
    request.Parameters = ua.CreateSubscriptionParameters(interval_ms, 60_000, 20_000, 0, True, 0)
    created = client.call(request, ua.CreateSubscriptionResponse)
    wanted = ua.CreateMonitoredItemsRequest()
    wanted.Parameters.SubscriptionId = created.Parameters.SubscriptionId
    wanted.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    wanted.Parameters.ItemsToCreate = items
    return client.call(wanted, ua.CreateMonitoredItemsResponse)


def item(node_id: Any, *, index_range: str | None = None, queue: int = 100) -> Any:
    """An item of a long queue."""
    target = ua.ReadValueId(node_id, ua.AttributeIds.Value, index_range)
    parameters = ua.MonitoringParameters(1, 0.0, None, queue, True)
    return ua.MonitoredItemCreateRequest(target, ua.MonitoringMode.Reporting, parameters)


def show(attacker: Stranger, number: int) -> None:
    """Say new images."""
    for topic in IMAGES:
        attacker.publish(topic, [IMAGE], [number.to_bytes(4, "little") * (IMAGE_BYTES // 4)], 1)
        time.sleep(0.002)


def announce(attacker: Stranger) -> None:
    """Say what the images are."""
    for topic in IMAGES:
        attacker.announce(topic, f"image{topic.id}", [make_field("data", IMAGE)], 1)


def test_an_observer_has_large_values_queued_in_all_its_sessions(tmp_path: Path) -> None:
    """Ten sessions with ten subscriptions each, which nobody asks for what they have to tell.

    The server grew by 2 GB, and kept the victim waiting for 3.8 s.
    """
    with attacked(tmp_path, robots=ROBOTS) as server, stranger(tmp_path) as robot:
        announce(robot)
        show(robot, 0)
        with server.harm("eva") as harm, contextlib.ExitStack() as stack:
            for _ in range(10):
                client = stack.enter_context(server.logged_in("olga"))
                for _ in range(10):
                    items = [item(ua.NodeId(topic.id, 2), index_range="0:59990") for topic in IMAGES]
                    results = subscription(client, items).Results
                    assert all(result.StatusCode.is_good() for result in results)
            over, number = time.monotonic() + 6, 0
            while time.monotonic() < over:
                number += 1
                show(robot, number)
        harm.check()


FIGURES = [Topic(2, 2, 2000 + number) for number in range(100)]
"""Each with ten fields."""
MANY = {
    f"r{number}": {
        "bridge": "floor",
        "capacities": ["mobile"],
        "data": {
            f"d{topic.id}": {"id": topic.id, "fields": {f"f{field}": {"type": "Double"} for field in range(10)}}
            for topic in FIGURES[10 * number : 10 * number + 10]
        },
    }
    for number in range(10)
}


def test_an_observer_watches_as_much_as_it_may(tmp_path: Path) -> None:
    """As many items as a user may have, with long queues that nobody empties: 104 MB, and 0.7 s for the victim."""
    nodes = [ua.NodeId(f"{topic.id}.f{field}", 2) for topic in FIGURES for field in range(10)]
    with attacked(tmp_path, robots=MANY) as server, stranger(tmp_path) as robot:
        for topic in FIGURES:
            robot.announce(topic, f"d{topic.id}", [make_field(f"f{field}", DOUBLE) for field in range(10)], 1)
        with server.harm("eva") as harm, contextlib.ExitStack() as stack:
            good = 0
            for _ in range(8):
                client = stack.enter_context(server.logged_in("olga"))
                results = subscription(client, [item(node) for node in nodes for _ in range(10)], 60_000).Results
                good += sum(result.StatusCode.is_good() for result in results)
            assert good == 60_000
            over, number = time.monotonic() + 8, 0.0
            while time.monotonic() < over:
                for topic in FIGURES:
                    number += 1.0
                    robot.publish(topic, [DOUBLE] * 10, [number] * 10, 1)
                    time.sleep(0.0005)
        harm.check()
