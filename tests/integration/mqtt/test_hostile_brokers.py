"""Brokers that do what none should: memory stays bounded, every drop has its cause, and the process goes on."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest

from tests.integration.mqtt.hostile_broker import FIRST, Behaviour, hostile, publish, publish_acknowledged
from tests.integration.mqtt.speaking import Speaking
from tests.unit.pubsub.security.securing import action, announcement, data
from tests.waiting import until
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import PubSubTiming, Subscriber
from ua_fleet.transport.mqtt import transport
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.wire import Codec


async def test_a_broker_that_accepts_and_never_answers_is_tried_again() -> None:
    async with hostile(Behaviour.MUTE) as (broker, url):
        speaking = Speaking(url, 1, most_waiting_bytes=100_000, answer_timeout_s=0.2)
        await speaking.start(wait=False)
        for number in range(2_000):
            speaking.transport.send(data(f"value {number}", 1, writer_id=1001 + number % 10))
        await until(lambda: broker.connections >= 2)
        assert speaking.transport.stats.problem
        await until(lambda: speaking.transport.stats.drops[Drop.BROKER_AWAY] > 1_000)
        await speaking.transport.close()
    assert broker.received == []


async def test_a_broker_that_acknowledges_nothing_is_left_and_the_values_go_again() -> None:
    async with hostile(Behaviour.FORGETFUL) as (broker, url):
        speaking = Speaking(url, 1, answer_timeout_s=0.3)
        await speaking.start()
        speaking.transport.send(data("a", 1))
        await until(lambda: broker.connections >= 2 and len(broker.received) >= 2)
        await speaking.transport.close()
    assert set(broker.received) == {("ua_1_2_1001", data("a", 1))}


async def test_what_a_busy_broker_refuses_to_deliver_is_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "_REFUSED_AGAIN_S", 0.05)
    async with hostile(Behaviour.BUSY) as (broker, url):
        speaking = Speaking(url, 1)
        await speaking.start()
        wanted = TopicTree().filters(1)
        assert [name for name, _ in broker.subscriptions] == wanted
        await until(lambda: len(broker.subscriptions) == len(wanted) + FIRST)
        again = wanted[1:]
        assert [name for name, _ in broker.subscriptions[len(wanted) :]] == [*again, *again[: FIRST - len(again)]]
        assert broker.connections == 1
        await speaking.transport.close()


@pytest.mark.parametrize(("qos", "of_data"), [(0, 0), (1, 1), (2, 2)])
async def test_data_that_may_be_lost_is_subscribed_to_as_such(qos: int, of_data: int) -> None:
    async with hostile(Behaviour.RUBBISH) as (broker, url):
        speaking = Speaking(url, 1, qos=qos)
        await speaking.start()
        await speaking.transport.close()
    wanted = dict(broker.subscriptions)
    assert (wanted["+"], wanted["opcua/uadp/data/+/+"]) == (of_data, of_data)
    assert wanted["opcua/uadp/action-request/1/+"] == wanted["opcua/uadp/+/+"] == max(qos, 1)


async def test_a_broker_that_closes_at_each_publish_does_not_make_a_busy_loop() -> None:
    async with hostile(Behaviour.CLOSING) as (broker, url):
        speaking = Speaking(url, 1)
        await speaking.start()
        speaking.transport.send(data("a", 1))
        await until(lambda: broker.connections >= 3)
        before, began = broker.connections, asyncio.get_running_loop().time()
        await until(lambda: broker.connections >= before + 2)
        assert asyncio.get_running_loop().time() - began > 0.2
        await speaking.transport.close()
        assert speaking.transport.stats.problem


async def test_what_is_delivered_twice_and_out_of_order_is_taken_once() -> None:
    counters = Counters()
    subscriber = Subscriber(2, PubSubTiming(), counters, Codec())
    async with hostile(Behaviour.TWICE) as (_, url):
        one, two = Speaking(url, 1), Speaking(url, 2)
        await one.start()
        await two.start()
        one.transport.send(announcement(1))
        for number in range(5):
            one.transport.send(data(f"value {number}", 1))
        await until(lambda: len(two.heard) >= 17)
        await one.transport.close()
        await two.transport.close()
    for datagram in two.heard:
        subscriber.receive(datagram, 0.0)
    assert counters.malformed == {}


async def test_retained_rubbish_and_hostile_topics_are_dropped_with_their_cause() -> None:
    retained = [
        publish(b"ua_1_2_1001", data("old", 1), retain=True),
        publish(b"ua_1_2_1001", b"rubbish", retain=True),
        publish(b"ua_2_2_1001", data("another's", 1), retain=True),
        publish(b"opcua/uadp/action-request/2/actions-2", action(publisher_id=2), retain=True),
        publish(b"opcua/uadp/metadata/1/g/w", announcement(1), retain=True),
        publish(b"opcua/uadp/metadata/7/g/w", announcement(1), retain=True),
        publish(b"$SYS/broker/version", b"hostile 1.0", retain=True),
        publish(b"x" * 60_000, b"long", retain=True),
        publish(b"ua_1_2_1001", b"\x00" * 1_000_000),
        publish(b"ua_1_2_1001", b""),
        publish(b"ua_1_2_1001", data("fresh", 1)),
    ]
    counters = Counters()
    subscriber = Subscriber(2, PubSubTiming(), counters, Codec())
    async with hostile(Behaviour.RUBBISH, retained) as (_, url):
        two = Speaking(url, 2)
        await two.start()
        await until(lambda: data("fresh", 1) in two.heard)
        await until(lambda: two.transport.stats.drops[Drop.NOT_ITS_TOPIC] == 4)
        for datagram in two.kept:
            subscriber.receive(datagram, 0.0, is_fresh=False)
        for datagram in two.heard:
            subscriber.receive(datagram, 0.0)
        await two.transport.close()
    assert announcement(1) in two.kept
    assert counters.drops[Drop.RETAINED] == 3
    assert counters.drops[Drop.MALFORMED] == 1


async def test_bytes_that_are_no_mqtt_end_the_connection_and_it_is_tried_again() -> None:
    async with hostile(Behaviour.GARBAGE) as (broker, url):
        speaking = Speaking(url, 1)
        await speaking.start(wait=False)
        await until(lambda: broker.connections >= 3)
        await speaking.transport.close()


async def test_a_topic_with_a_nul_or_a_wildcard_ends_that_connection_alone() -> None:
    for topic in (b"ua_1_2_1001\x00", b"ua_1_2_#", b"\xff\xfe"):
        async with hostile(Behaviour.RUBBISH, [publish(topic, data("a", 1))]) as (broker, url):
            speaking = Speaking(url, 2)
            await speaking.start(wait=False)
            await until(lambda: broker.connections >= 1)
            await asyncio.sleep(0.3)
            assert speaking.heard == []
            await speaking.transport.close()


async def test_a_connection_that_breaks_as_the_process_ends_leaves_no_mistake_behind() -> None:
    said: list[dict[str, Any]] = []
    asked = asyncio.Event()

    async def break_off(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(4096)
        asked.set()
        writer.transport.abort()

    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: said.append(context))
    server = await asyncio.start_server(break_off, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    try:
        for turns in [*range(12)] * 4:  # of the event loop, between the one and the other
            asked.clear()
            speaker = Speaking(f"mqtt://127.0.0.1:{port}", 1)
            await speaker.start(wait=False)
            await asked.wait()
            for _ in range(turns):
                await asyncio.sleep(0)
            await speaker.transport.close()
            del speaker
            gc.collect()
    finally:
        loop.set_exception_handler(None)
        server.close()
        await server.wait_closed()
    assert not said


async def test_what_comes_at_once_is_acknowledged_before_it_is_taken_and_taken_in_its_order() -> None:
    """A broker has a few messages in flight, and sends no more while it waits for what is slow to take them."""
    values = [data(f"value {number}", 1) for number in range(20)]
    mistaken = values[6]
    at_once = b"".join(publish_acknowledged(b"ua_1_2_1001", value, number) for number, value in enumerate(values, 1))
    async with hostile(Behaviour.RUBBISH, [at_once]) as (broker, url):
        speaking = Speaking(url, 2)
        taken: list[tuple[bytes, int]] = []

        def take(datagram: bytes, _sender: tuple[str, int]) -> None:
            taken.append((datagram, broker.unread_bytes))
            if datagram == mistaken:
                raise ZeroDivisionError

        await speaking.transport.start(take)
        await until(lambda: len(taken) == len(values), "all of them")
        assert [datagram for datagram, _ in taken] == values
        puback = 4
        assert taken[0][1] <= puback, "nothing waits for the others to be read"
        assert taken[1][1] == len(values) * puback, "all acknowledgements are on their way"
        assert speaking.transport.stats.malformed["mistake"] == 1
        assert speaking.transport.stats.received == len(values)
        await speaking.transport.close()
