"""The key service of a whole server, as `fleet.yaml` describes it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests import system
from tests.standard_space import quick_start
from tests.unit.server.key_service.fleet import fleet
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.client.key_source import ServiceKeySource
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.endpoint.certificates import trust_bridge
from ua_fleet.errors import KeySourceUnavailable, ServerStartError
from ua_fleet.server.app import run_server
from ua_fleet.server.key_service.files import GROUPS_FILE
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy


def config_of(udp_url: str, **pubsub: object) -> FleetConfig:
    bridges = {
        "arm": {"kind": "ros1", "space": 1, "status_id": 1},
        "rover": {"kind": "ros2", "space": 2, "status_id": 2},
    }
    config = fleet(**{"security": "sign_and_encrypt", "url": udp_url, **pubsub}).model_dump()
    config["bridges"] = bridges
    config["server"]["port"] = system.free_tcp_port()
    return FleetConfig.model_validate(config)


@asynccontextmanager
async def serving(folder: Path, config: FleetConfig) -> AsyncGenerator[str]:
    ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    with quick_start():
        task = asyncio.ensure_future(run_server(config, folder, ready=ready.set_result))
        waited: list[asyncio.Future[Any]] = [task, ready]
        await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED, timeout=30)
    try:
        if task.done():
            task.result()
        yield ready.result()
    finally:
        task.cancel()
        await asyncio.wait([task])


async def test_bridges_get_keys_and_keep_them_over_a_restart(udp_url: str, tmp_path: Path) -> None:
    config = config_of(udp_url)
    identity = ClientIdentity.of_bridge(tmp_path / config.state_dir_of("arm"), "Fleet", "arm")
    await identity.ensure()
    async with serving(tmp_path, config) as url:
        trust_bridge(tmp_path / "state", "arm", identity.certificate)
        async with ServiceKeySource(url, identity, "arm") as source:
            before = await source.fetch("c-1", 0, 5)
    assert (tmp_path / "state" / GROUPS_FILE).stat().st_mode & 0o777 == 0o600
    async with serving(tmp_path, config) as url, ServiceKeySource(url, identity, "arm") as source:
        assert (await source.fetch("c-1", 0, 5))[:3] == before[:3]


@pytest.mark.parametrize("pubsub", [{"security": "none"}, {"keys": {"source": "files"}}])
async def test_without_need_there_is_no_key_service(udp_url: str, tmp_path: Path, pubsub: dict[str, object]) -> None:
    config = config_of(udp_url, **pubsub)
    policy = SecurityPolicy.named(config.pubsub.keys.policy)
    for group in all_groups(config):
        KeyFolder(tmp_path / "keys").write(KeyFile.new(group, policy, 3600.0, time.time()))
    identity = ClientIdentity.of_bridge(tmp_path / "arm", "Fleet", "arm")
    await identity.ensure()
    async with serving(tmp_path, config) as url:
        trust_bridge(tmp_path / "state", "arm", identity.certificate)
        async with ServiceKeySource(url, identity, "arm") as source:
            with pytest.raises(KeySourceUnavailable, match=r"so it is no key service; set `pubsub\.security`"):
                await source.fetch("t-0", 0, 1)
    assert not (tmp_path / "state" / GROUPS_FILE).exists()


async def test_a_server_whose_keys_others_can_read_does_not_start(udp_url: str, tmp_path: Path) -> None:
    config = config_of(udp_url)
    async with serving(tmp_path, config):
        pass
    (tmp_path / "state" / GROUPS_FILE).chmod(0o644)
    with pytest.raises(ServerStartError, match="chmod 600"):
        await run_server(config, tmp_path)
