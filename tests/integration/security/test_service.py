"""Bridges that pull their keys from the server."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from tests.integration.peer import Peer
from tests.integration.security.conftest import COUNTER_ONE, ONE, TWO, Site, heard, holes
from tests.integration.server_model.harness import OBSERVER, reader, serving
from tests.integration.server_model.harness import until as until_read
from tests.system import ROS1_PYTHON, Child
from tests.waiting import until
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.endpoint.certificates import trust_bridge
from ua_fleet.wire.security import read_security


async def trust(site: Site, *names: str) -> None:
    """What `ua-fleet cert create --bridge` and `cert trust --bridge` do."""
    for name in names:
        identity = ClientIdentity.of_bridge(site.folder / site.config.state_dir_of(name), "Fleet", name)
        await identity.ensure()
        trust_bridge(site.folder / site.config.server.state_dir, name, identity.certificate)


def say(child: Child, text: str) -> list[str]:
    return [line for line in child.lines if text in line]


@pytest.mark.parametrize(
    "python", [sys.executable, pytest.param(ROS1_PYTHON, marks=pytest.mark.needs("ros1"), id="beside rospy")]
)
async def test_a_bridge_waits_for_the_key_service_and_says_nothing_meanwhile(secured: Site, python: str | Path) -> None:
    secured.write_fleet(keys={"source": "service"})
    await trust(secured, "one")
    one = secured.bridge("one", wait=False, python=python)
    async with Peer.at(secured.url, space=TWO) as listener:
        await until(lambda: say(one, "the key source is not reachable"))
        await asyncio.sleep(1.0)
        assert len(say(one, "the key source is not reachable")) == 1
        assert not say(one, "ready")
        assert listener.datagrams == []
        async with serving(secured.folder, secured.config) as running, running.client(OBSERVER) as client:
            await until(lambda: say(one, "ready"))
            counter = reader(client, f"ns=2;i={COUNTER_ONE.id}")
            await until_read(counter, lambda data: data.StatusCode.name == "Good")
            await until(lambda: say(one, "the key source is reachable again"))
        assert len(say(one, "the key source is reachable again")) == 1
    assert one.end() == 0
    assert not say(one, "Traceback")


async def test_bridges_go_on_without_the_service_as_long_as_keys_last(secured: Site) -> None:
    # Keys for 22 s: the service is away for two changes of keys, and as long as a busy machine takes to start it.
    secured.write_fleet(keys={"source": "service", "lifetime_s": 2.0, "future_keys": 12})
    await trust(secured, "one", "two")
    async with serving(secured.folder, secured.config):
        # The server runs in this loop, so nothing here may block.
        one, two = secured.bridge("one", wait=False), secured.bridge("two", wait=False)
        await until(lambda: heard(two, COUNTER_ONE))
    async with Peer.at(secured.url, space=TWO) as listener:
        await until(lambda: say(one, "the key source is not reachable") and say(two, "the key source is not reachable"))

        def tokens() -> set[int]:
            sent = map(read_security, listener.datagrams)
            return {datagram.token_id for datagram in sent if datagram.publisher_id == ONE and datagram.token_id}

        await until(lambda: len(tokens()) >= 3)
        async with serving(secured.folder, secured.config):
            await until(lambda: say(one, "the key source is reachable again"))
            before = max(tokens())
            await until(lambda: max(tokens()) >= before + 2)
            # Here and not at the end: while this server ends, the bridges may say once more that it is not reachable.
            assert len(say(one, "the key source is not reachable")) == 1
    assert holes(heard(two, COUNTER_ONE)) == []


async def test_a_bridge_that_nobody_trusts_says_what_to_run(secured: Site) -> None:
    secured.write_fleet(keys={"source": "service"})
    async with serving(secured.folder, secured.config):
        one = secured.bridge("one", wait=False)
        await until(lambda: say(one, "the key source is not reachable"))
        (line,) = say(one, "the key source is not reachable")
        certificate = secured.folder / secured.config.state_dir_of("one") / "bridge.der"
        assert f"ua-fleet cert trust --bridge one {certificate}" in line
        trust_bridge(secured.folder / secured.config.server.state_dir, "one", Path(certificate))
        await until(lambda: say(one, "ready"))
