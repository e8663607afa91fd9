"""What is shown of the server's own PubSubConnection."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

from ua_fleet.counters import Counters
from ua_fleet.operation.pubsub.connections import MOST_STRANGERS, Resets, ServerConnection
from ua_fleet.pubsub import Publisher, PubSubTiming
from ua_fleet.pubsub.components import reader_group
from ua_fleet.wire import Codec


def test_so_many_strangers_have_a_reader_group_and_the_first_stay() -> None:
    received = Counter[int]()
    facts: Any = SimpleNamespace(
        publisher=Publisher(0, PubSubTiming(), Counters(), Codec()),
        subscriber=SimpleNamespace(received_messages=received),
        publishers={3: "line", 9000: "press"},
        problems=lambda: [""],
    )
    shown = ServerConnection(facts, Resets())
    for space in range(8000, 8100):
        received[space] += 1
    received[9000] += 1
    received[5] += 1
    expected = [3, *range(8000, 8000 + MOST_STRANGERS), 9000]
    assert [group for group in shown.groups() if group[0] == "R"] == [reader_group(space) for space in expected]
