"""What keeps the server from starting, and how it ends."""

from __future__ import annotations

import asyncio
import gc
import socket
import threading
import weakref
from pathlib import Path

import pytest
from asyncua.server.address_space import AddressSpace

from tests.integration.server_model.harness import fleet_config, serving
from tests.standard_space import quick_start
from ua_fleet.errors import ConfigError, ServerStartError, TransportError
from ua_fleet.server.app import run_server


async def test_a_port_in_use_is_told_with_the_remedy(udp_url: str, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = int(taken.getsockname()[1])
        told = rf"127\.0\.0\.1:{port}: cannot listen .*set server\.port"
        with quick_start(), pytest.raises(ServerStartError, match=told) as caught:
            await run_server(fleet_config(udp_url, port), tmp_path)
    assert "\n" not in str(caught.value)


async def test_the_fleets_namespace_has_to_have_its_index(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port)
    fleet = config.fleet.model_copy(update={"namespace_uri": "http://opcfoundation.org/UA/"})
    with quick_start(), pytest.raises(ServerStartError, match="would have the index 0, not 2"):
        await run_server(config.model_copy(update={"fleet": fleet}), tmp_path)


async def test_missing_ids_are_told_before_anything_is_made(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    robots = {"rover": {"bridge": "mobile_side", "data": {"speed": {"type": "Double"}}}}
    with pytest.raises(ConfigError, match="run: ua-fleet config assign-ids"):
        await run_server(fleet_config(udp_url, tcp_port, robots=robots), tmp_path)
    assert list(tmp_path.iterdir()) == []


async def test_an_interface_that_is_not_there_is_told(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port)
    pubsub = config.pubsub.model_copy(update={"interface": "nosuch0"})
    with quick_start(), pytest.raises(TransportError, match="nosuch0"):
        await run_server(config.model_copy(update={"pubsub": pubsub}), tmp_path)


async def test_the_end_leaves_nothing(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    tasks = asyncio.all_tasks()
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, running.client():
        pass
    assert asyncio.all_tasks() == tasks
    with socket.socket() as again:
        again.bind(("127.0.0.1", tcp_port))
    assert [thread for thread in threading.enumerate() if not thread.daemon and "asyncua" in thread.name] == []


async def test_a_process_that_serves_again_keeps_nothing_of_the_server_before(
    udp_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: weakref.WeakSet[AddressSpace] = weakref.WeakSet()

    def make_space(space: AddressSpace) -> None:
        made.add(space)
        make(space)

    make = AddressSpace.__init__
    monkeypatch.setattr(AddressSpace, "__init__", make_space)
    for _ in range(2):
        async with serving(tmp_path, fleet_config(udp_url, 0), quick=False) as running, running.client():
            assert gc.get_freeze_count() > 0  # what is looked for below is out of sight now
            assert len(made) == 1
        assert gc.get_freeze_count() == 0
        gc.collect()
        assert not made
        gc.freeze()  # to look at all modules of tests again, at the next start and in later tests, takes long


async def test_the_endpoint_names_the_port_that_was_taken(udp_url: str, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, 0)) as running, running.client() as client:
        assert not running.url.endswith(":0/ua_fleet")
        assert (await client.get_namespace_array())[2] == "urn:ua-fleet:fleet"
