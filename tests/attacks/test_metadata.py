"""Announcements of sources that never send anything: what is kept of them is bounded."""

from __future__ import annotations

import time
from pathlib import Path

from tests.attacks.harness import attacked
from tests.attacks.publishers import stranger
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

DOUBLE = int(BuiltinType.DOUBLE)
ANNOUNCED = 2_000


def test_large_announcements_of_many_sources(tmp_path: Path) -> None:
    """Metadata of 300 fields for 2,000 sources, in four versions."""
    fields = [make_field(f"field {number} {'x' * 90}", DOUBLE) for number in range(300)]
    with attacked(tmp_path, unknown_sources="create") as server, stranger(tmp_path) as attacker:
        with server.harm() as harm:
            for number in range(ANNOUNCED):
                topic = Topic(7 + number % 40, 2, 20_000 + number % 500)
                attacker.announce(topic, f"source {number}", fields, 1 + number)
                time.sleep(0.004)
        harm.check()
