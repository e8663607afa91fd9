"""Who sets a timer asks `is_nearer` and leaves the deadline alone otherwise: it must never have come nearer then."""

from __future__ import annotations

from random import Random

import pytest

from tests.unit.pubsub.publishing import TOPIC, WALL, Reading, Writing
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.metadata import with_max_age
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

FIELDS = (make_field("level", BuiltinType.DOUBLE), make_field("name", BuiltinType.STRING))
TOPICS = [TOPIC, Topic(1, 2, 1002), Topic(1, 3, 1003)]


@pytest.mark.parametrize("seed", range(40))
def test_no_deadline_comes_nearer_unsaid(seed: int) -> None:
    random, writing, reading = Random(seed), Writing(), Reading()
    steps, unsaid = 0, 0
    for _ in range(150):
        topic = random.choice(TOPICS)
        what = random.choice(["publish", "publish", "publish", "announce", "age", "poll", "lose", "wait"])
        datagrams: list[bytes] = []
        if what == "announce" or writing.publisher.metadata(topic) is None:
            datagrams = writing.announce(topic)
        elif what == "publish":
            datagrams = writing.publish(random.random(), topic=topic, timestamp=WALL + round(writing.now * 1e7))
        elif what == "age":
            datagrams = writing.announce(topic, fields=with_max_age(FIELDS, random.choice([0.2, 1.0, None])))
        elif what == "poll":
            datagrams = writing.publisher.poll(writing.now, is_round=True)
        elif what == "lose":
            datagrams = writing.publisher.source_lost(topic, timestamp=WALL, now=writing.now)
        else:
            writing.now += random.choice([0.01, 0.3, 4.0])
            reading.run_until(writing.now)
        for datagram in datagrams:
            if random.random() < 0.2:
                continue  # lost on the way
            before = reading.subscriber.next_deadline()
            reading.subscriber.receive(datagram, writing.now)
            after = reading.subscriber.next_deadline()
            steps += 1
            if not reading.subscriber.is_nearer:
                unsaid += 1
                assert after is None or (before is not None and after >= before)
    assert 0 < unsaid < steps
