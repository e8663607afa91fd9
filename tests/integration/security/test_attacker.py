"""Somebody without keys in the network of a secured server and its bridges."""

from __future__ import annotations

import asyncio
import json
import secrets
import shutil
import time
from collections.abc import Callable
from typing import Any

from asyncua.client.client import Client

from tests.integration.peer import Peer
from tests.integration.security.conftest import COUNTER_ONE, ONE, POLICY, STATUS_TWO, Site, heard, holes
from tests.integration.server_model.harness import OBSERVER, reader, serving
from tests.integration.server_model.harness import until as until_read
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.security import MessageKey, SecurityMode, payload_offset, read_security

FORGED = -4711
STRANGER = Topic(ONE, 2, 77)
FIELDS = (make_field("data", BuiltinType.INT64, properties={"RosType": "std_msgs/Int64"}),)
OTHERS = (make_field("forged", BuiltinType.STRING),)


def name_of(data: Any) -> str:
    return str(data.StatusCode.name)


async def drops(client: Client, cause: Drop) -> int:
    """What the server has dropped for a cause."""
    return int((await reader(client, f"ns=2;s=Fleet.Traffic.Drops.{cause.value}")()).Value.Value)


class Watch:
    """Looks at a node all the time."""

    def __init__(self, read: Callable[[], Any]) -> None:
        self._read = read
        self.seen: list[Any] = []
        self._task = asyncio.ensure_future(self._look())

    async def _look(self) -> None:
        while True:
            self.seen.append(await self._read())
            await asyncio.sleep(0.02)

    async def end(self) -> list[Any]:
        self._task.cancel()
        await asyncio.wait([self._task])
        return self.seen


async def test_nothing_of_an_attacker_is_taken(secured: Site) -> None:
    secured.bridge("one")
    two = secured.bridge("two")
    async with serving(secured.folder, secured.config) as running, running.client(OBSERVER) as client:
        counter = reader(client, f"ns=2;i={COUNTER_ONE.id}")
        await until_read(counter, lambda data: name_of(data) == "Good")
        await until(lambda: heard(two, COUNTER_ONE))
        async with Peer.at(secured.url, space=ONE) as attacker, secured.peer(space=0) as honest:
            await honest.until(lambda: honest.good(COUNTER_ONE))
            watch = Watch(counter)
            await until(lambda: len(attacker.datagrams) > 200)
            captured = list(attacker.datagrams)

            # As bridge one, without keys.
            attacker.announce(COUNTER_ONE, OTHERS)
            attacker.announce(STRANGER, FIELDS)
            for _ in range(20):
                attacker.publish(STRANGER, FORGED)
            attacker.lose(COUNTER_ONE)

            def plain_ones() -> list[bytes]:
                return [heard for heard in attacker.datagrams if read_security(heard).mode == SecurityMode.NONE]

            await until(lambda: len(plain_ones()) > 20)
            plain = plain_ones()

            # With keys of one's own, under the token that is in use.
            key = MessageKey(POLICY, secrets.token_bytes(POLICY.key_data_bytes))
            for datagram in plain[:20]:
                for mode in (SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT):
                    attacker.send(key.protect(datagram, payload_offset(datagram), 1, secrets.token_bytes(8), mode))
                sealed = key.protect(datagram, payload_offset(datagram), 99, secrets.token_bytes(8), mode)
                attacker.send(sealed)

            # What was heard before, and what was changed on the way.
            for datagram in captured:
                attacker.send(datagram)
                attacker.send(datagram[:-1] + bytes([datagram[-1] ^ 1]))

            causes = (Drop.NOT_SECURED, Drop.BAD_SIGNATURE, Drop.UNKNOWN_TOKEN, Drop.REPLAYED)
            for cause in causes:
                await until_read(lambda: drops(client, cause), lambda count: count > 0)  # noqa: B023 - awaited
            status = await honest.status(STATUS_TWO)
            assert all(status[f"Drops.{cause.value}"] > 0 for cause in causes), status

            known = heard(two, COUNTER_ONE)[-1]
            await until(lambda: heard(two, COUNTER_ONE)[-1] > known + 100)
            seen = await watch.end()
        assert {name_of(data) for data in seen} == {"Good"}
        numbers = [data.Value.Value for data in seen]
        assert sorted(numbers) == numbers
        assert FORGED not in numbers
        assert holes(heard(two, COUNTER_ONE)) == []
        assert not any(str(FORGED) in line or STRANGER.name in line for line in two.lines)
        assert name_of(await reader(client, f"ns=2;i={STRANGER.id}")()) == "BadNodeIdUnknown"


async def test_a_bridge_with_a_wrong_key_is_shown_as_such_until_it_has_the_right_one(secured: Site) -> None:
    right = secured.keys.path_of("t-300").read_bytes()
    other = KeyFolder(secured.folder / "other")
    shutil.copytree(secured.keys.path, other.path)
    other.path.chmod(0o700)
    other.write(KeyFile.new("t-300", POLICY, 3600.0, time.time()))
    raw = json.loads((secured.folder / "fleet.json").read_text())
    raw["pubsub"]["keys"]["folder"] = "other"
    (secured.folder / "wrong.json").write_text(json.dumps(raw))

    secured.bridge("one", fleet="wrong.json")
    secured.bridge("two")
    async with serving(secured.folder, secured.config) as running, running.client(OBSERVER) as client:
        one, two = (reader(client, f"ns=2;i={number}") for number in (1, 2))
        await until_read(two, lambda data: name_of(data) == "Good")
        await until_read(one, lambda data: name_of(data) == "BadSecurityChecksFailed")
        await until_read(lambda: drops(client, Drop.BAD_SIGNATURE), lambda count: count > 0)
        path = other.path_of("t-300")
        fresh = path.with_suffix(".new")
        fresh.touch(mode=0o600)
        fresh.write_bytes(right)
        fresh.replace(path)
        await until_read(one, lambda data: name_of(data) == "Good")
        assert name_of(await two()) == "Good"
