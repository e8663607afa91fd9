"""Unknown sources that are never the same: each new layout makes nodes anew."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from tests.attacks.harness import attacked
from tests.attacks.publishers import stranger
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

DOUBLE = int(BuiltinType.DOUBLE)
SECONDS = 8


@pytest.mark.parametrize("sources", [1, 50])
def test_ever_new_layouts(tmp_path: Path, sources: int) -> None:
    """Of one source, and of many: 300 fields with names that were never there before.

    A minute of it took 23 s of computing time, 123 MB, a line of the log each, and kept the victim waiting for 1.1 s.
    """
    with attacked(tmp_path, unknown_sources="create") as server, stranger(tmp_path) as attacker:
        number, over = 0, time.monotonic() + SECONDS
        with server.harm() as harm:
            while number <= 60 or time.monotonic() < over:
                number += 1
                topic = Topic(7, 2, 40_000 + number % sources)
                names = [f"v{number}-{field:03}-{'x' * 90}" for field in range(300)]
                attacker.announce(topic, f"layout {number}", [make_field(name, DOUBLE) for name in names], number)
                attacker.publish(topic, [DOUBLE] * 300, [1.5] * 300, number)
                time.sleep(0.05)
        harm.check(growth_mb=50)
        end = time.monotonic() + 60
        while len(lines := [line for line in server.log.splitlines() if "ua_7_2_4" in line]) < sources:
            assert time.monotonic() < end, lines  # a busy server says it later
            time.sleep(0.05)
        assert len(lines) <= sources + 4
