"""ConditionRefresh of more conditions than the queue of an item takes, and of a client that does not fetch them."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import OBSERVER, ROBOTS, fleet_config, serving, ua
from tests.waiting import until
from ua_fleet.operation.alarms.service import AlarmService

ALARMS = 250
TYPES, REFRESH, REFRESH2 = (ua.NodeId(one, 0) for one in (2782, 3875, 12912))
START, END = ua.NodeId(ua.ObjectIds.RefreshStartEventType, 0), ua.NodeId(ua.ObjectIds.RefreshEndEventType, 0)


class Heard:
    """What a subscription is told: the types of events, and whose they are."""

    def __init__(self) -> None:
        self.types: list[Any] = []
        self.sources: list[str] = []

    def event_notification(self, event: Any) -> None:
        self.types.append(event.EventType)
        if event.EventType not in (START, END):
            self.sources.append(event.SourceName)

    def is_over(self, times: int = 1) -> bool:
        return self.types.count(END) == times


@asynccontextmanager
async def in_alarm(
    folder: Path, udp_url: str, tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> AsyncGenerator[tuple[Any, list[str]]]:
    """A client of a server with so many active alarms, and the names of what is in alarm."""
    services: list[AlarmService] = []
    made = AlarmService.__init__

    def kept(self: AlarmService, *arguments: Any, **named: Any) -> None:
        made(self, *arguments, **named)
        services.append(self)

    monkeypatch.setattr(AlarmService, "__init__", kept)
    rover = ROBOTS["rover"]
    more = {f"t{n}": {"id": 10_000 + n, "type": "Double", "limits": {"high": 80}} for n in range(ALARMS)}
    config = fleet_config(udp_url, tcp_port, robots={"rover": {**rover, "data": {**rover["data"], **more}}})
    async with serving(folder, config) as running, running.client(OBSERVER) as client:
        found = [one for one in services[-1].conditions.values() if one.definition.id.startswith("rover.t")]
        for condition in found:
            services[-1].take(condition, 95.0, 0)

        await until(lambda: all(one.state.event_id for one in found))
        yield client, sorted(one.definition.source_name for one in found)


async def test_all_are_told_whatever_the_length_of_the_queue(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with in_alarm(tmp_path, udp_url, tcp_port, monkeypatch) as (client, names):
        types = client.get_node(TYPES)
        for size in (10, 0):
            heard = Heard()
            subscription = await client.create_subscription(50, heard)
            item = await subscription.subscribe_events(client.nodes.server, queuesize=size)
            number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
            of_item = ua.Variant(item, ua.VariantType.UInt32)
            for times, arguments in ((1, (REFRESH, number)), (2, (REFRESH2, number, of_item))):
                heard.sources.clear()
                await types.call_method(*arguments)
                await until(partial(heard.is_over, times))
                told = Counter(name for name in heard.sources if name.startswith("rover.t"))
                assert told == Counter(names), f"a queue of {size}"
                assert (heard.types.count(START), heard.types[-1]) == (times, END)
            await subscription.delete()


async def test_one_that_is_not_fetched_is_in_progress(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with in_alarm(tmp_path, udp_url, tcp_port, monkeypatch) as (client, names):
        types, heard, other = client.get_node(TYPES), Heard(), Heard()
        slow = await client.create_subscription(60_000, heard)
        await slow.subscribe_events(client.nodes.server, queuesize=10)
        number = ua.Variant(slow.subscription_id, ua.VariantType.UInt32)
        await types.call_method(REFRESH, number)
        with pytest.raises(ua.UaStatusCodeError, match="BadRefreshInProgress"):
            await types.call_method(REFRESH, number)
        quick = await client.create_subscription(50, other)
        await quick.subscribe_events(client.nodes.server)
        await types.call_method(REFRESH, ua.Variant(quick.subscription_id, ua.VariantType.UInt32))
        await until(other.is_over)
        assert len(heard.types) <= 10, "each subscription for itself"
        changed = ua.ModifySubscriptionParameters()
        changed.SubscriptionId, changed.RequestedPublishingInterval = slow.subscription_id, 50.0
        changed.RequestedLifetimeCount, changed.RequestedMaxKeepAliveCount = 10_000, 10
        changed.MaxNotificationsPerPublish = 0
        await client.uaclient.modify_subscription(changed)
        await until(heard.is_over)
        assert Counter(name for name in heard.sources if name.startswith("rover.t")) == Counter(names)
        await types.call_method(REFRESH, number)
        await slow.delete()
        await asyncio.sleep(0)
        with pytest.raises(ua.UaStatusCodeError, match="BadSubscriptionIdInvalid"):
            await types.call_method(REFRESH, number)
