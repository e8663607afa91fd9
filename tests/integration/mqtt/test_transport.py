"""The transport at real brokers: what passes, what is retained, and what becomes of it when the broker goes."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from random import Random
from typing import Any

import pytest
from structlog.testing import capture_logs

from tests.integration.mqtt.broker import Broker, mosquitto, nats
from tests.integration.mqtt.conftest import Subscribe
from tests.integration.mqtt.speaking import Speaking
from tests.unit.pubsub.security.securing import announcement, data
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.transport.mqtt.credentials import Credentials
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement

pytestmark = pytest.mark.needs("mosquitto")

STATUS = "opcua/uadp/status/1"


Speak = Callable[..., Awaitable[Speaking]]


@pytest.fixture
async def speak() -> AsyncIterator[Speak]:
    async with AsyncExitStack() as stack:

        async def started(url: str, space: int | None, *, wait: bool = True, **options: Any) -> Speaking:
            speaking = Speaking(url, space, **options)
            stack.push_async_callback(speaking.transport.close)
            await speaking.start(wait=wait)
            return speaking

        yield started


@pytest.mark.needs("nats")
async def test_messages_pass_and_announcements_are_there_for_who_comes_later(any_broker: Broker, speak: Speak) -> None:
    one, two = await speak(any_broker.url, 1), await speak(any_broker.url, 2)
    one.transport.send(announcement(1))
    one.transport.send(data("first", 1))
    await until(lambda: len(two.heard) == 2)
    # Each subscription of a nats-server is a consumer of its own, so that topics are not in order there.
    assert sorted(two.heard) == sorted([announcement(1), data("first", 1)])
    three = await speak(any_broker.url, 3)
    await until(lambda: announcement(1) in three.kept)
    assert data("first", 1) not in three.kept
    assert not three.heard


@pytest.mark.needs("nats")
async def test_a_broker_of_mqtt_3_1_1_is_used_and_that_is_said_once(tmp_path: Path, speak: Speak) -> None:
    broker = nats(tmp_path / "nats")
    broker.start()
    try:
        with capture_logs() as logs:
            one = await speak(broker.url, 1)
            broker.end()
            broker.start()
            await until(lambda: sum(line["event"].startswith("connected") for line in logs) == 2)
        assert sum("refuses MQTT 5" in line["event"] for line in logs) == 1
        assert [line["mqtt"] for line in logs if line["event"].startswith("connected")] == ["3.1.1", "3.1.1"]
        assert one.transport.is_own(("x", 0)), "who cannot keep its own messages out takes them for its own"
    finally:
        broker.end()


async def test_with_mqtt_5_its_own_messages_do_not_come_back(broker: Broker, speak: Speak) -> None:
    one, two = await speak(broker.url, 1), await speak(broker.url, 2)
    one.transport.send(data("a", 1))
    two.transport.send(data("b", 2))
    await until(lambda: one.heard and two.heard)
    assert (one.heard, two.heard) == ([data("b", 2)], [data("a", 1)])
    assert not one.transport.is_own(("x", 0))


async def test_a_broker_that_comes_later_gets_the_newest_and_what_it_retains(tmp_path: Path, speak: Speak) -> None:
    broker = mosquitto(tmp_path / "broker")
    one = await speak(broker.url, 1, wait=False)
    for number in range(10):
        one.transport.send(data(f"value {number}", 1))
    one.transport.send(announcement(1))
    assert one.transport.stats.problem
    broker.start()
    try:
        two = await speak(broker.url, 2)
        await until(lambda: announcement(1) in two.heard + two.kept)
        await until(lambda: not one.transport.stats.problem)
    finally:
        broker.end()


class Patient(Random):
    """Waits ten seconds before it connects again."""

    def uniform(self, a: float, b: float) -> float:
        del a, b
        return 50.0


async def test_a_broker_that_is_killed_and_started_again_knows_everything_again(
    broker: Broker, speak: Speak, subscribe: Subscribe
) -> None:
    # Who hears has to be back before who speaks: nothing waits at a broker for a process that is away.
    one, two = await speak(broker.url, 1, random=Patient()), await speak(broker.url, 2)
    one.transport.send(announcement(1))
    await until(lambda: announcement(1) in two.heard)
    broker.end(9)
    await until(lambda: one.transport.stats.problem and two.transport.stats.problem)
    one.transport.send(data("while it was away", 1))
    broker.start()
    await until(lambda: data("while it was away", 1) in two.heard)
    late = subscribe(broker, "opcua/uadp/metadata/#")
    late.wait_for(f"1 opcua/uadp/metadata/1/group-2/source-1001 {announcement(1).hex()}")
    assert one.transport.stats.problem == ""


async def test_a_second_process_of_the_same_name_is_noticed(broker: Broker, speak: Speak) -> None:
    one = await speak(broker.url, 1)
    await speak(broker.url, 1)
    await until(lambda: one.taken_over)
    assert one.taken_over


async def test_at_the_end_the_status_is_the_last_that_was_said_and_no_will(
    broker: Broker, speak: Speak, subscribe: Subscribe
) -> None:
    one = await speak(broker.url, 1)
    last = encode_announcement(StatusAnnouncement(1, 1, 7, False, PubSubState.DISABLED))
    one.transport.send(last)
    await one.transport.close()
    late = subscribe(broker, STATUS)
    late.wait_for(f"1 {STATUS} {last.hex()}")


async def test_a_user_and_a_password_from_a_file(tmp_path: Path, speak: Speak) -> None:
    folder = tmp_path / "broker"
    folder.mkdir()
    users = folder / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", users, "robot", "geheim"], check=True, capture_output=True)
    users.chmod(0o644)
    broker = mosquitto(folder, "allow_anonymous false", f"password_file {users}")
    broker.start()
    try:
        right = Credentials("robot", "geheim")
        one = await speak(broker.url, 1, credentials=right)
        assert "geheim" not in repr(right)
        with capture_logs() as logs:
            wrong = await speak(broker.url, 2, wait=False, credentials=Credentials("robot", "falsch"))
            await until(lambda: "refuses this user" in wrong.transport.stats.problem)
        assert "falsch" not in str(logs)
        assert one.transport.stats.problem == ""
    finally:
        broker.end()


async def test_what_the_brokers_rights_refuse_is_counted(tmp_path: Path, speak: Speak) -> None:
    folder = tmp_path / "broker"
    folder.mkdir()
    rights = folder / "acl"
    rights.write_text("topic read #\ntopic write opcua/#\n")
    broker = mosquitto(folder, "allow_anonymous true", f"acl_file {rights}")
    broker.start()
    try:
        one = await speak(broker.url, 1)
        one.transport.send(data("a", 1))
        await until(lambda: one.transport.stats.drops[Drop.BROKER_REFUSED] == 1)
        one.transport.send(announcement(1))
        await asyncio.sleep(0.3)
        assert one.transport.stats.drops[Drop.BROKER_REFUSED] == 1
    finally:
        broker.end()


async def test_a_broker_that_is_down_for_long_is_no_rival(broker: Broker, speak: Speak) -> None:
    one = await speak(broker.url, 1)
    for _ in range(3):  # it is started again and again, and each connection is short
        broker.end(9)
        await until(lambda: one.transport.stats.problem)
        broker.start()
        await until(lambda: not one.transport.stats.problem)
    broker.end(9)
    await until(lambda: "is there another process" in one.transport.stats.problem)
    told = one.taken_over
    assert told
    failed = one.transport.stats.problem
    await until(lambda: one.transport.stats.problem != failed, "an attempt that finds no broker")
    assert one.taken_over == told
