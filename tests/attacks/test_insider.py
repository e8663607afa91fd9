"""A member of the fleet's network, with keys or without, against bridges that are processes and talk over UDP."""

from __future__ import annotations

import asyncio
from pathlib import Path
from struct import Struct

import pytest

from tests.integration.peer import Peer
from tests.integration.security.conftest import COUNTER_ONE, ONE, POLICY, STATUS_TWO, TWO, Site, heard, holes
from tests.system import Child, Processes
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec, split
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage
from ua_fleet.wire.security import MessageKey, SecurityMode, payload_offset, read_security

NUMBER = Struct("<I")
JUMP = 1 << 30
LARGE = Topic(0, 2, 500)
FIELDS = (make_field("number", BuiltinType.INT64), make_field("image", BuiltinType.BYTE_STRING))
IMAGE_BYTES = 60_000


@pytest.fixture
def site(tmp_path: Path, udp_url: str, processes: Processes) -> Site:
    return Site(tmp_path, udp_url, processes)


async def goes_on(bridge: Child, count: int = 100) -> None:
    """Another bridge is heard, without a hole since now."""
    seen = len(heard(bridge, COUNTER_ONE))
    await until(lambda: len(heard(bridge, COUNTER_ONE)) > seen + count)
    assert holes(heard(bridge, COUNTER_ONE)[seen:]) == []


async def test_who_has_the_key_does_not_silence_another_with_one_message(site: Site) -> None:
    """Numbers far ahead, in the name of bridge one: each of its own messages was `replayed` until the key changed."""
    site.bridge("one")
    two = site.bridge("two")
    await until(lambda: heard(two, COUNTER_ONE))
    stolen = site.keys.read(f"t-{ONE}").keys[0]
    key = MessageKey(POLICY, stolen.key_data)

    def of_one(datagrams: list[bytes]) -> list[bytes]:
        taken = [read_security(datagram) for datagram in datagrams]
        return [each.datagram for each in taken if each.publisher_id == ONE and each.token_id == stolen.token_id]

    async with Peer.at(site.url, space=TWO) as insider, site.peer() as honest:
        await until(lambda: of_one(insider.datagrams))
        for jump in (JUMP, JUMP // 2, 1 << 16):
            last = read_security(of_one(insider.datagrams)[-1])
            plain = key.unprotect(last)
            number = NUMBER.unpack(last.nonce[4:])[0]
            forged = last.nonce[:4] + NUMBER.pack(number + jump)
            mode = SecurityMode.SIGN_AND_ENCRYPT
            insider.send(key.protect(plain, payload_offset(plain), stolen.token_id, forged, mode))
            await goes_on(two)
        # The forged ones were taken as what they say they are, and none of the honest ones was refused.
        status = await honest.status(STATUS_TWO)
        assert status[f"Drops.{Drop.REPLAYED.value}"] == 0


async def test_chunks_without_a_key_destroy_no_large_message(site: Site) -> None:
    """680 of them in a publisher's name, between the chunks of its own: 17 of 20 large messages were lost."""
    site.write_fleet(max_datagram_bytes=1_400)
    two = site.bridge("two")
    message = NetworkMessage(
        publisher_id=LARGE.space,
        writer_group_id=LARGE.ns,
        messages=(DataSetMessage(LARGE.id, types=(int(BuiltinType.BYTE_STRING),), values=(bytes(IMAGE_BYTES),)),),
    )
    plain = Codec().encode(message)
    async with site.peer(LARGE.space) as honest, Peer.at(site.url, space=LARGE.space) as attacker:
        honest.announce(LARGE, FIELDS)
        sent = 0
        for number in range(20):
            forged = split(plain, 1_200, number)[:34]
            for chunk in forged[:17]:
                attacker.send(chunk)
            honest.publish(LARGE, number, bytes(IMAGE_BYTES))
            for chunk in forged[17:]:
                attacker.send(chunk)
            sent += len(forged)
            await asyncio.sleep(0.05)
        assert sent == 680
        assert sum(len(datagram) > 1_000 for datagram in honest.datagrams) > 20 * IMAGE_BYTES // 1_400
        await until(lambda: heard(two, LARGE)[-1:] == [19])
        assert heard(two, LARGE) == list(range(20))
        status = await honest.status(STATUS_TWO)
        assert status[f"Drops.{Drop.NOT_SECURED.value}"] >= 680
        assert status[f"Drops.{Drop.CHUNK_LOST.value}"] == 0
