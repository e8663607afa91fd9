"""PubSub messages in the console: what the server has sent and received, opened, for engineers alone."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest_asyncio

from tests.integration.console.conftest import FLEET
from tests.integration.console.harness import ENGINEER, OPERATOR, Console, console_at
from tests.integration.peer import Peer
from tests.integration.server_model.harness import SPACE, SPEED, Running, fleet_config, serving
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.keys.files import FileKeySource
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.values import BuiltinType
from ua_fleet.wire.security import SecurityPolicy

POLICY = SecurityPolicy.AES256_CTR
SPEED_FIELDS = (make_field("speed", BuiltinType.DOUBLE),)


def secured(config: FleetConfig) -> FleetConfig:
    """The same fleet, with messages signed and encrypted by keys of files."""
    raw: dict[str, Any] = config.model_dump(mode="json", exclude_unset=True)
    raw["pubsub"] |= {"security": "sign_and_encrypt", "keys": {"source": "files"}}
    return load_content(json.dumps(raw).encode(), "fleet.json", {}, allow_missing_ids=True)


@pytest_asyncio.fixture
async def site(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[tuple[Running, Peer, Console]]:
    """A secured server, its bridge's side with the keys, and a console; `running.peer` has no keys."""
    config = secured(fleet_config(udp_url, tcp_port, robots=FLEET))
    keys = KeyFolder(tmp_path / "keys")
    for group_id in all_groups(config):
        keys.write(KeyFile.new(group_id, POLICY, 3600.0, time.time()))
    source = FileKeySource(keys.path, POLICY)
    async with (
        serving(tmp_path, config) as running,
        Peer.secured(config, SPACE, tmp_path, source) as peer,
        console_at(tmp_path, {"hall": running.url}) as console,
    ):
        yield running, peer, console


async def test_messages_are_opened_and_what_was_not_let_in_is_not(site: tuple[Running, Peer, Console]) -> None:
    running, peer, console = site
    async with console.logged_in(ENGINEER) as browser, browser.live() as live:
        await live.want("all", "messages")
        await live.want("speed", "messages", source=SPEED.name)
        await live.until(lambda: {"all", "speed"} <= live.feeds.keys())
        peer.announce(SPEED, SPEED_FIELDS)
        peer.publish(SPEED, 1.25)
        running.peer.announce(SPEED, SPEED_FIELDS)
        running.peer.publish(SPEED, 6.5)

        def found(name: str, **expected: Any) -> list[dict[str, Any]]:
            entries = [one for key, one in live.feeds[name].items() if key != "lost"]
            return [one for one in entries if all(one[part] == value for part, value in expected.items())]

        await live.until(lambda: found("speed", open=True, kind="key frame"))
        await live.until(lambda: found("all", open=False, kind="key frame") and found("all", sent=True))
        assert all(one["writers"] == [SPEED.id] for one in found("speed"))
        (entry, *_) = found("speed", open=True, kind="key frame")
        assert (entry["security"], entry["publisher"], entry["group"]) == ("SignAndEncrypt", str(SPACE), 2)
        told = (await browser.ask("messages.dissect", data=entry["data"])).json()["result"]
        assert told["error"] == ""
        assert "1.25" in [span["text"] for span in told["spans"]]
        refused = found("all", open=False, kind="key frame")[0]
        assert (refused["dropped"], refused["security"]) == (["not_secured"], "None")
        whole = b"".join(base64.b64decode(one["data"]) for one in found("all"))
        for file in (running.folder / "keys").iterdir():
            for key in KeyFolder(file.parent).read(file.stem).keys:
                assert not any(key.key_data[at : at + 8] in whole for at in range(len(key.key_data) - 8))
        log = [json.loads(line) for line in (running.folder / "state" / "audit.log").read_text().splitlines()]
        looked = [(line["user"], line["source"]) for line in log if line["event"] == "recent_messages"]
        assert sorted(looked) == [(ENGINEER[0], ""), (ENGINEER[0], SPEED.name)]
        assert not [line for line in log if "RecentMessages" in json.dumps(line)]


async def test_nobody_else_may_look(server: Running, console: Console) -> None:
    async with console.logged_in(OPERATOR) as browser, browser.live() as live:
        await live.want("all", "messages")
        await live.until(lambda: live.errors.get("all"))
        assert live.errors["all"]["status"] == "BadUserAccessDenied"
        assert "all" not in live.feeds
    async with console.logged_in(ENGINEER) as browser:
        for data in ("no base64!", "A" * 20_000):
            assert (await browser.ask("messages.dissect", data=data)).status_code == 400
        long = await browser.ask("messages.dissect", data=base64.b64encode(b"\xff" * 8192).decode())
        assert long.status_code == 200
        assert len(long.json()["result"]["spans"]) < 5
        assert "messages.dissect" in browser.me["fleets"]["hall"]["may"]


async def test_health_says_what_causes_mean(server: Running, console: Console) -> None:
    async with console.logged_in(OPERATOR) as browser, browser.live() as live:
        await live.want("health", "health")
        await live.until(lambda: "health" in live.feeds)
        causes = live.feeds["health"]["causes"]
        assert causes["replayed"] == {
            "text": "A nonce that was used before or is too old for the replay window.",
            "loss": True,
        }
        assert not causes["repeated"]["loss"]
