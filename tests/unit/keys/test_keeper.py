from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable
from functools import partial
from random import Random

import pytest
import structlog.testing

from ua_fleet.errors import KeySourceUnavailable, KeysRefused
from ua_fleet.keys.keeper import PERIOD_S, KeysKept, keep_keys
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.wire.security import SecurityPolicy

POLICY = SecurityPolicy.AES256_CTR
LIFETIME_S = 100.0


def keys(token_id: int = 1, count: int = 1) -> GroupKeys:
    data = tuple(bytes([token_id + i]) * POLICY.key_data_bytes for i in range(count))
    return GroupKeys(POLICY, token_id, data, LIFETIME_S, LIFETIME_S)


class World:
    """An envelope, a source and a clock, with a script of what happens when."""

    def __init__(self, *groups: str, refresh_s: float = math.inf) -> None:
        self.now = 1000.0
        self.groups = list(groups)
        self.wanted = set(groups)
        self.installed: list[tuple[float, str, int]] = []
        self.asked: list[tuple[float, str]] = []
        self.gives: dict[str, GroupKeys | Exception] = {}
        self.script: list[tuple[float, Callable[[], None]]] = []
        self.kept = KeysKept()
        self.never_content = False
        self.problem = ""
        self._refresh_s = refresh_s
        self.generation = 0

    @property
    def refresh_s(self) -> float:
        return self._refresh_s

    def groups_wanted(self) -> list[str]:
        return self.groups

    def keys_wanted(self, now: float) -> set[str]:
        assert now == self.now
        return self.wanted

    def install(self, group_id: str, keys: GroupKeys, now: float) -> None:
        assert now == self.now
        self.installed.append((self.now - 1000.0, group_id, keys.first_token_id))
        if not self.never_content:
            self.wanted.discard(group_id)

    async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
        assert (starting_token_id, count) == (0, 5)
        self.asked.append((self.now - 1000.0, group_id))
        await asyncio.sleep(0)  # others have their turn meanwhile
        given = self.gives.get(group_id, keys())
        if isinstance(given, Exception):
            raise given
        return given

    def at(self, seconds: float, do: Callable[[], None]) -> None:
        self.script.append((1000.0 + seconds, do))

    async def run(self, seconds: float) -> None:
        """Keep keys for a while of the world's own time."""

        async def sleep(length: float) -> None:
            await asyncio.sleep(0)
            self.now += length
            for when, do in [item for item in self.script if item[0] <= self.now]:
                self.script.remove((when, do))
                do()
            if self.now >= end:
                raise asyncio.CancelledError

        end = self.now + seconds
        with pytest.raises(asyncio.CancelledError):
            await keep_keys(self, self, self.kept, count=5, random=Random(1), clock=lambda: self.now, sleep=sleep)


def times(world: World) -> list[float]:
    return [at for at, _ in world.asked]


async def test_what_is_wanted_is_fetched_once() -> None:
    world = World("t-0", "t-2")
    await world.run(60)
    assert world.asked == [(0.0, "t-0"), (0.0, "t-2")]
    assert world.installed == [(0.0, "t-0", 1), (0.0, "t-2", 1)]
    assert world.kept.groups == {"t-0", "t-2"}
    assert world.kept.problem() == ""


async def test_what_is_wanted_later_is_fetched_within_a_period() -> None:
    world = World("t-2")
    world.at(50.1, lambda: world.wanted.add("t-2"))  # half of the lifetime, or an unknown token
    world.at(60.1, lambda: world.groups.append("t-7"))
    world.at(60.1, lambda: world.wanted.add("t-7"))
    await world.run(70)
    assert world.installed == [(0.0, "t-2", 1), (50.25, "t-2", 1), (60.25, "t-7", 1)]


async def test_a_source_is_looked_at_as_often_as_it_says() -> None:
    world = World("t-2", refresh_s=0.5)
    world.at(3.3, lambda: world.gives.update({"t-2": keys(1, 2)}))
    world.at(6.3, lambda: world.gives.update({"t-2": keys(2)}))
    await world.run(10)
    assert times(world) == [number * 0.5 for number in range(20)]
    assert [(token, at) for at, _, token in world.installed] == [(1, 0.0), (1, 3.5), (2, 6.5)]


async def test_all_groups_are_asked_for_when_keys_have_changed_before_their_time() -> None:
    world = World("t-0", "t-2")

    def invalidate() -> None:
        world.generation += 1
        world.gives = {"t-2": keys(7)}

    world.at(5.1, invalidate)
    await world.run(10)
    assert world.asked == [(0.0, "t-0"), (0.0, "t-2"), (5.25, "t-0"), (5.25, "t-2")]
    assert world.installed == [(0.0, "t-0", 1), (0.0, "t-2", 1), (5.25, "t-2", 7)]


@pytest.mark.parametrize(("groups", "longest"), [({"t-9"}, [8.0, 16.0, 30.0]), (set[str](), [5.0])])
async def test_a_source_that_is_away_is_asked_ever_more_rarely_and_told_of_twice(
    groups: set[str], longest: list[float]
) -> None:
    world = World("t-0", "t-2")
    world.kept.groups = groups  # with no key at all a process stands still, and asks more often
    world.gives = dict.fromkeys(("t-0", "t-2"), KeySourceUnavailable("opc.tcp://a:1: connection refused"))
    world.at(200, world.gives.clear)
    with structlog.testing.capture_logs() as log:
        await world.run(240)
    waits = [b - a for a, b in zip(times(world), times(world)[1:], strict=False) if b < 200]
    limits = [0.5, 1, 2, 4, *longest, *[longest[-1]] * 50]
    assert len(waits) > 8
    for wait, limit in zip(waits, limits, strict=False):
        assert limit / 2 <= wait <= limit + PERIOD_S
    assert len({round(wait % 1, 6) for wait in waits[6:]}) > 1
    told = [(entry["log_level"], entry["event"]) for entry in log if "source" in entry["event"]]
    assert told == [
        ("warning", "the key source is not reachable; known keys stay in use"),
        ("info", "the key source is reachable again"),
    ]
    assert log[0]["reason"] == "opc.tcp://a:1: connection refused"
    assert {group_id for _, group_id, _ in world.installed} == {"t-0", "t-2"}
    assert min(at for at, *_ in world.installed) <= 201 + longest[-1]


async def test_a_source_is_asked_again_within_a_quarter_of_a_lifetime_however_long_it_was_away() -> None:
    world = World("t-2", refresh_s=1.0)
    world.gives = {"t-2": keys()._replace(key_lifetime_s=12.0)}
    world.at(10, lambda: world.gives.update({"t-2": KeySourceUnavailable("no route")}))
    await world.run(200)
    asked = [at for at in times(world) if at >= 10]
    waits = [b - a for a, b in itertools.pairwise(asked)]
    assert 1.5 <= max(waits) <= 3.0 + PERIOD_S
    assert max(asked) > 195


async def test_while_the_source_is_away_the_status_says_so() -> None:
    world = World("t-2")
    world.gives = {"t-2": KeySourceUnavailable("no route")}
    await world.run(5)
    assert world.kept.problem() == "the key source is not reachable: no route"
    assert world.kept.groups == set()
    world.gives.clear()
    await world.run(10)
    assert world.kept.problem() == ""


async def test_a_refused_group_disturbs_no_other_and_is_told_once() -> None:
    world = World("t-0", "t-2")
    world.gives = {"t-0": KeysRefused("t-0", "Bad_UserAccessDenied")}
    world.at(100, world.gives.clear)
    with structlog.testing.capture_logs() as log:
        await world.run(140)
    assert world.installed[0] == (0.0, "t-2", 1)
    assert [entry["event"] for entry in log] == ["no keys", "keys", "keys are there again", "keys"]
    assert log[0]["group"] == "t-0"
    assert log[0]["reason"] == "no keys of t-0: Bad_UserAccessDenied"
    assert 5 < len([group_id for _, group_id in world.asked if group_id == "t-0"]) < 20


async def test_a_refused_group_of_a_source_that_is_cheap_to_ask_is_there_soon() -> None:
    world = World("t-2", refresh_s=0.5)
    world.gives = {"t-2": KeysRefused("t-2", "no file")}
    world.at(50, world.gives.clear)
    await world.run(60)
    assert world.installed[0][0] <= 51


async def test_tokens_that_nobody_has_do_not_make_us_ask_all_the_time() -> None:
    world = World("t-2")
    world.never_content = True
    await world.run(100)
    assert 5 <= len(world.asked) <= 10, "each time it waits twice as long, up to a minute"


async def test_many_groups_that_somebody_made_up_do_not_fill_the_log() -> None:
    world = World(*(f"t-{space}" for space in range(1000)))
    world.gives = {group_id: KeysRefused(group_id, "no file") for group_id in world.groups}
    world.at(4, lambda: world.groups.__setitem__(slice(None), ["t-1"]))
    world.at(4, lambda: world.wanted.intersection_update({"t-1"}))
    with structlog.testing.capture_logs() as log:
        await world.run(5)
    assert len(log) == 64
    assert world.kept.refused.keys() == {"t-1"}
    assert world.kept.problem() == "no keys of t-1: no file"


async def test_ever_new_groups_that_somebody_made_up_do_not_fill_the_log() -> None:
    world = World()

    def replace(first: int) -> None:
        world.groups[:] = [f"t-{first + i}" for i in range(40)]
        world.wanted = set(world.groups)
        world.gives = {group_id: KeysRefused(group_id, "no file") for group_id in world.groups}

    for second in range(3700):
        world.at(second, partial(replace, 300 + 17 * second))
    with structlog.testing.capture_logs() as log:
        await world.run(3500)
        assert len(log) == 64
        await world.run(200)
    assert len(log) == 128, "an hour later it is said again"


async def test_it_ends_when_the_source_swallows_that_it_is_cancelled() -> None:
    begun = asyncio.Event()

    class Swallows(World):
        async def fetch(self, group_id: str, starting_token_id: int, count: int) -> GroupKeys:
            del starting_token_id, count
            begun.set()
            try:
                await asyncio.get_running_loop().create_future()
            except asyncio.CancelledError:
                raise KeySourceUnavailable(f"{group_id}: connection refused") from None
            raise AssertionError

    world = Swallows("t-2")
    keeping = asyncio.ensure_future(keep_keys(world, world, world.kept, count=5, clock=lambda: world.now))
    await begun.wait()
    keeping.cancel()
    await asyncio.wait([keeping], timeout=5)
    assert keeping.cancelled()


async def test_why_something_was_not_sent_is_told_once() -> None:
    world = World("t-2")
    for seconds, problem in ((1.0, "no key of t-2"), (2.0, ""), (3.0, "no key of t-2"), (4.0, "nonces are used up")):
        world.at(seconds, partial(setattr, world, "problem", problem))
    with structlog.testing.capture_logs() as log:
        await world.run(6)
    assert [entry["reason"] for entry in log if entry["event"] == "not sent"] == ["no key of t-2", "nonces are used up"]


async def test_groups_that_somebody_made_up_come_after_those_that_matter() -> None:
    world = World("t-300", "t-0", *(f"c-{space}" for space in range(100, 200)))
    limit = KeySourceUnavailable("Bad_ServerTooBusy")
    world.gives = {"c-100": KeysRefused("c-100", "no such group"), "c-101": limit}
    world.never_content = True
    with structlog.testing.capture_logs() as log:
        await world.run(300)
    asked = [group_id for _, group_id in world.asked]
    assert min(asked.count("t-300"), asked.count("t-0")) > 10
    assert asked[:4] == ["t-300", "t-0", "c-100", "c-101"]
    assert "c-102" not in asked
    assert len([entry for entry in log if "key source" in entry["event"]]) == 1
    assert {group_id for _, group_id, _ in world.installed} == {"t-300", "t-0"}


async def test_no_log_line_has_a_key() -> None:
    world = World("t-2", refresh_s=1.0)
    world.at(2, lambda: world.gives.update({"t-2": keys(0x5E, 3)}))
    with structlog.testing.capture_logs() as log:
        await world.run(5)
    assert log[-1] == {
        "event": "keys", "log_level": "info", "group": "t-2", "first_token": 0x5E, "count": 3
    }  # fmt: skip
    assert "5e5e" not in repr(log)
    assert "^^^" not in repr(log)


async def test_waiting_for_the_first_keys() -> None:
    kept = KeysKept()
    waiting = asyncio.ensure_future(kept.wait_for(["t-0", "t-2"]))
    for group_id in ("t-7", "t-2", "t-0"):
        kept.round_over()
        await asyncio.sleep(0)
        assert not waiting.done()
        kept.arrived(group_id)
    await asyncio.sleep(0)
    assert not waiting.done(), "the others are asked for first"
    kept.round_over()
    await asyncio.wait_for(waiting, 5)
    await kept.wait_for(["t-0"])


async def test_who_waits_for_its_own_key_begins_with_all_that_the_source_gives() -> None:
    world = World("t-0", "t-1", "t-2", "t-3")
    world.gives |= {"t-1": KeysRefused("t-1", "not yours"), "t-3": KeySourceUnavailable("away")}
    waiting = asyncio.ensure_future(world.kept.wait_for(["t-0"]))
    had: list[set[str]] = []
    waiting.add_done_callback(lambda _: had.append(set(world.kept.groups)))
    await world.run(2)
    assert had == [{"t-0", "t-2"}], "what is refused or away is not waited for"
