# pyright: reportPrivateUsage=false, reportUnknownMemberType=false
"""Conditions as a client follows them: refreshes, what was lost in a storm, and what a refresh does not tell."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import aclosing
from datetime import datetime
from types import SimpleNamespace
from typing import Any

import pytest
from asyncua import ua
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.client import ConditionInfo, ConditionsKnown, conditions
from ua_fleet.errors import NotConnected

TYPES = 3
LEVEL = ua.NodeId(ua.Int32(ObjectIds.ExclusiveLevelAlarmType))
START, END, REQUIRED = conditions._FRAMES
NOTHING = dict.fromkeys((*conditions._STANDARD, *conditions._OWN))


def frame(kind: ua.NodeId) -> SimpleNamespace:
    return SimpleNamespace(**{**NOTHING, "EventType": kind})


def told(name: str, **fields: Any) -> SimpleNamespace:
    known = {"EventType": LEVEL, "ConditionName": name, "Retain": True, "Time": datetime(2030, 1, 1)}  # noqa: DTZ001
    return SimpleNamespace(**{**NOTHING, **known, **fields}, NodeId=ua.NodeId.from_string(f"ns=2;s=Alarms.{name}"))


class Batches:
    """Has a list of alarms that are put aside, and their members."""

    def __init__(self, *put_aside: str) -> None:
        self.put_aside = put_aside
        self.reads = 0

    async def browse(self, _node_ids: list[ua.NodeId], *, classes: int) -> list[list[ua.ReferenceDescription]]:
        assert classes == ua.NodeClass.Object
        return [[self.declared(name) for name in ("speed", *self.put_aside)]]

    def declared(self, name: str) -> ua.ReferenceDescription:
        node = ua.NodeId.from_string(f"ns=2;s=Alarms.{name}")
        return ua.ReferenceDescription(NodeId=node, BrowseName=ua.QualifiedName(name, 2), TypeDefinition=LEVEL)

    async def read(self, node_ids: list[ua.NodeId]) -> list[ua.DataValue]:
        self.reads += len(node_ids)
        if node_ids[0].Identifier == "Fleet.Alarms.PutAside":
            return [ua.DataValue(ua.Variant(list(self.put_aside), ua.VariantType.String, is_array=True))]
        return [self.member(str(one.Identifier)) for one in node_ids]

    def member(self, path: str) -> ua.DataValue:
        name = path.split(".")[1]
        values: dict[str, Any] = {
            "EventType": LEVEL,
            "ConditionName": name,
            "Retain": False,
            "EnabledState.Id": False,
        }
        return ua.DataValue(ua.Variant(values.get(path.partition(f"{name}.")[2])))


class Watched:
    """A subscription whose events the test makes, and the refreshes that it asks for."""

    def __init__(self, *put_aside: str) -> None:
        self.batches = Batches(*put_aside)
        client: Any = None
        batches: Any = self.batches
        self.watch = conditions._Watch(client, batches, "opc.tcp://x", TYPES)
        self.refreshes = 0

    async def refresh(self) -> None:
        self.refreshes += 1
        self.watch._is_refreshing = True

    def say(self, *events: SimpleNamespace) -> None:
        for event in events:
            self.watch.events.put(event)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    watched = Watched("broken", "also_told")
    monkeypatch.setattr(watched.watch, "_refresh", watched.refresh)
    monkeypatch.setattr(conditions, "_STORM", 5)
    monkeypatch.setattr(conditions, "_CALM_S", 0.05)
    return watched


async def some(told: AsyncGenerator[ConditionInfo | ConditionsKnown], count: int) -> list[Any]:
    async with asyncio.timeout(20):
        return [await anext(told) for _ in range(count)]


async def test_a_refresh_ends_with_all_that_is_there(watched: Watched) -> None:
    async with aclosing(watched.watch.told()) as events:
        watched.say(frame(START), told("a"), told("also_told"), frame(END))
        first, second, aside, known = await some(events, 4)
    assert [first.name, second.name, aside.name] == ["a", "also_told", "broken"]
    assert (aside.enabled, aside.retain, aside.is_shown, aside.is_put_aside) == (False, False, True, True)
    names = {f"ns=2;s=Alarms.{name}" for name in ("a", "also_told", "broken")}
    assert known == ConditionsKnown(frozenset(names), is_whole=True)


async def test_what_is_declared_says_what_is_put_aside() -> None:
    batches: Any = Batches(*[f"off_{number}" for number in range(conditions._MOST_READ + 1)])
    found = await conditions.declared_alarms(batches, "opc.tcp://x")
    assert [one.name for one in found if not one.is_put_aside] == ["speed"]
    assert len(found) == conditions._MOST_READ + 2, "more than a refresh is followed by"


async def test_a_refresh_whose_beginning_was_lost_is_not_whole(watched: Watched) -> None:
    async with aclosing(watched.watch.told()) as events:
        watched.say(told("late"), frame(END))
        *_, known = await some(events, 4)
    assert not known.is_whole
    assert "ns=2;s=Alarms.late" in known.node_ids


async def test_a_storm_is_followed_by_one_refresh_and_that_by_none(watched: Watched) -> None:
    async with aclosing(watched.watch.told()) as events:
        watched.say(*[told(str(number)) for number in range(9)])
        await some(events, 9)
        following = asyncio.ensure_future(some(events, 9 + 3))
        async with asyncio.timeout(20):
            while not watched.refreshes:
                await asyncio.sleep(0.01)
        watched.say(frame(START), *[told(str(number)) for number in range(9)], frame(END))
        await following
        waiting = asyncio.ensure_future(anext(events))
        await asyncio.sleep(0.2)  # four times as long as it would take
        assert watched.refreshes == 1
        waiting.cancel()
        await asyncio.wait([waiting])


async def test_a_server_that_asks_for_a_refresh_gets_it(watched: Watched) -> None:
    async with aclosing(watched.watch.told()) as events:
        watched.say(frame(REQUIRED), told("a"))
        await some(events, 1)
    assert watched.refreshes == 1


async def test_a_refresh_that_goes_on_is_followed_by_the_one_that_was_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[object] = []

    async def call(_client: object, wanted: object) -> None:
        calls.append(wanted)
        if len(calls) == 1:
            raise ua.uaerrors.BadRefreshInProgress

    watched = Watched()
    monkeypatch.setattr(conditions, "call", call)
    async with aclosing(watched.watch.told()) as events:
        watched.say(frame(START), told("a"), frame(REQUIRED), told("b"), frame(END))
        assert len(await some(events, 3)) == 3
        watched.say(frame(START), told("a"), frame(END), told("c"))
        assert len(await some(events, 3)) == 3
    assert len(calls) == 2


async def test_a_lost_connection_is_told(watched: Watched) -> None:
    watched.watch.events.lose()
    with pytest.raises(NotConnected):
        await anext(watched.watch.told())
