"""Bridges with key files over a real network: data, restarts and new keys."""

from __future__ import annotations

import signal
import time

from tests.integration.peer import Peer
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, STATUS_ONE, STATUS_TWO, Site, heard, holes
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.wire.security import SecurityMode, read_security

REFUSED = (Drop.NOT_SECURED, Drop.BAD_SIGNATURE, Drop.REPLAYED, Drop.UNKNOWN_TOKEN, Drop.SECURED, Drop.MALFORMED)


async def no_drops(peer: Peer) -> None:
    """Nothing was refused by anybody, and everything that was to be sent was sent."""
    for topic in (STATUS_ONE, STATUS_TWO):
        status = await peer.status(topic)
        refused = {cause.value: status[f"Drops.{cause.value}"] for cause in (*REFUSED, Drop.NO_KEY)}
        assert not any(refused.values()), (topic.name, refused)
    assert not any(peer.counters.drops[cause] for cause in REFUSED), peer.counters.drops


async def test_data_goes_both_ways_signed_and_encrypted(secured: Site) -> None:
    one, two = secured.bridge("one"), secured.bridge("two")
    async with secured.peer() as peer:
        await peer.until(lambda: len(peer.good(COUNTER_ONE)) > 50 and len(peer.good(COUNTER_TWO)) > 50)
        await until(lambda: len(heard(one, COUNTER_TWO)) > 50 and len(heard(two, COUNTER_ONE)) > 50)
        assert holes(heard(one, COUNTER_TWO)) == holes(heard(two, COUNTER_ONE)) == []
        sent = [read_security(datagram) for datagram in peer.datagrams]
        assert {datagram.mode for datagram in sent if not datagram.is_discovery} == {SecurityMode.SIGN_AND_ENCRYPT}
        await no_drops(peer)
    assert (one.end(), two.end()) == (0, 0)


async def test_traffic_goes_on_after_a_bridge_was_killed(secured: Site) -> None:
    one, two = secured.bridge("one"), secured.bridge("two")
    async with secured.peer() as peer:
        for _ in range(3):
            before = len(heard(two, COUNTER_ONE))
            await until(lambda: len(heard(two, COUNTER_ONE)) > before + 20)  # noqa: B023 - ends in this round
            one.end(signal.SIGKILL)
            last = heard(two, COUNTER_ONE)[-1]
            one = secured.bridge("one")
            await until(lambda: heard(two, COUNTER_ONE)[-1] > last + 20)  # noqa: B023
            known = peer.good(COUNTER_ONE)[-1]
            await peer.until(lambda: peer.good(COUNTER_ONE)[-1] > known)  # noqa: B023
        await no_drops(peer)
        nonces = [(found.token_id, found.publisher_id, found.nonce) for found in map(read_security, peer.datagrams)]
        secure = [nonce for nonce in nonces if nonce[2]]
        assert len(set(secure)) == len(secure) > 100


async def test_traffic_goes_on_after_the_reader_was_killed(secured: Site) -> None:
    secured.bridge("one")
    two = secured.bridge("two")
    await until(lambda: len(heard(two, COUNTER_ONE)) > 20)
    two.end(signal.SIGKILL)
    two = secured.bridge("two")
    await until(lambda: len(heard(two, COUNTER_ONE)) > 20)


async def test_nothing_is_lost_while_keys_change(secured: Site) -> None:
    one, two = secured.bridge("one"), secured.bridge("two")
    async with secured.peer() as peer:
        await peer.until(lambda: peer.good(COUNTER_ONE))
        await until(lambda: heard(two, COUNTER_ONE))
        for token in (2, 3):
            secured.rotate("t-300", 2.0)
            await peer.until(
                lambda: any(
                    found.token_id == token and found.publisher_id == 300  # noqa: B023
                    for found in map(read_security, peer.datagrams[-50:])
                )
            )
            count = len(peer.good(COUNTER_ONE))
            await peer.until(lambda: len(peer.good(COUNTER_ONE)) > count + 50)  # noqa: B023
        tokens = [found.token_id for found in map(read_security, peer.datagrams) if found.publisher_id == 300]
        used = [token for token in tokens if token]
        assert sorted(used) == used
        assert set(used) == {1, 2, 3}
        last = peer.good(COUNTER_ONE)[-1][0]
        await until(lambda: heard(two, COUNTER_ONE)[-1] >= last)
        assert holes(heard(two, COUNTER_ONE)) == []
        assert holes([values[0] for values in peer.good(COUNTER_ONE)]) == []
        await no_drops(peer)
    said = "\n".join(one.lines + two.lines)
    assert "first_token" in said
    for group_id in secured.keys.groups():
        for key in secured.keys.read(group_id).keys:
            for part in (key.key_data[:8], key.key_data[32:40], key.key_data[-4:]):
                assert part.hex() not in said
                assert repr(part)[2:-1] not in said


async def test_a_leaked_key_is_worth_nothing_a_second_later(secured: Site) -> None:
    secured.bridge("one")
    two = secured.bridge("two")
    async with secured.peer() as peer:
        await peer.until(lambda: peer.good(COUNTER_ONE))
        await until(lambda: heard(two, COUNTER_ONE))
        secured.keys.write(secured.keys.read("t-300").replaced(time.time()))
        await peer.until(
            lambda: any(f.token_id == 2 and f.publisher_id == 300 for f in map(read_security, peer.datagrams[-50:]))
        )
        known = heard(two, COUNTER_ONE)[-1]
        await until(lambda: heard(two, COUNTER_ONE)[-1] > known + 50)
