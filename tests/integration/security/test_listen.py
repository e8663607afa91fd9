"""`ua-fleet pubsub listen` beside a secured publisher: with its key files, with one key, and without any."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.integration.cli.conftest import command
from tests.standard_space import quick_start
from tests.system import Child, Processes, clean_environment, free_tcp_port
from ua_fleet.config import load
from ua_fleet.config.security import all_groups, envelope_of
from ua_fleet.counters import Counters
from ua_fleet.keys.files import FileKeySource
from ua_fleet.pubsub import Publisher, PubSubTiming, make_field
from ua_fleet.server.app import run_server
from ua_fleet.server.mutual_trust import introduce_bridge
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.security import SecurityPolicy

TOPIC = Topic(2, 2, 1001)
GROUP = "t-2"
FLEET = """\
version: 1
pubsub: {{security: sign_and_encrypt, url: '{url}', keys: {{source: files}}}}
bridges: {{floor: {{kind: ros2, space: 2, status_id: 1}}}}
"""


@pytest.fixture
def keys(tmp_path: Path, udp_url: str) -> KeyFolder:
    """The key files of a fleet whose file is beside them."""
    (tmp_path / "fleet.yaml").write_text(FLEET.format(url=udp_url))
    folder = KeyFolder(tmp_path / "keys")
    for group_id in all_groups(load(tmp_path / "fleet.yaml", {})):
        folder.write(KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time()))
    return folder


@asynccontextmanager
async def publishing(keys: KeyFolder, url: str) -> AsyncGenerator[Callable[[float], Any]]:
    """A publisher of space 2 with the keys of the files, whose values a test sends."""
    config = load(keys.path.parent / "fleet.yaml", {})
    counters, loop = Counters(), asyncio.get_running_loop()
    envelope = envelope_of(config, TOPIC.space, counters, keys.path.parent / "state-of-floor")
    source = FileKeySource(keys.path, SecurityPolicy.AES256_CTR)
    publisher = Publisher(TOPIC.space, PubSubTiming(), counters, Codec())
    transport = UdpTransport(url, "lo")
    await transport.start(lambda _datagram, _sender: None)
    fields = (make_field("value", BuiltinType.DOUBLE),)

    async def publish(value: float) -> None:
        now, ticks = loop.time(), ticks_from_unix_ns(time.time_ns())
        envelope.install(GROUP, await source.fetch(GROUP, 0, 4), now)
        sent = publisher.announce(TOPIC, name="level", fields=fields, wall_ticks=ticks, now=now)
        sent += publisher.publish(TOPIC, (value,), timestamp=ticks, status=0, now=now)
        for plain in sent:
            for datagram in envelope.seal(plain, now):
                transport.send(datagram)

    try:
        yield publish
    finally:
        await transport.close()


async def publish_until(publish: Callable[[float], Any], child: Child, text: str) -> dict[str, Any]:
    """Publish until the listener prints a line with this text."""
    async with asyncio.timeout(60):
        for number in range(10_000):
            await publish(float(number))
            await asyncio.sleep(0.05)
            for line in list(child.lines):
                if text in line:
                    shown: dict[str, Any] = json.loads(line)
                    return shown
    raise AssertionError


def listening(processes: Processes, *options: str) -> Child:
    return processes.start(*command("pubsub", "listen", "--json", *options), env=clean_environment())


async def test_with_key_files_that_change(keys: KeyFolder, udp_url: str, processes: Processes) -> None:
    child = listening(processes, "-c", str(keys.path.parent / "fleet.yaml"))
    async with publishing(keys, udp_url) as publish:
        shown = await publish_until(publish, child, '"event": "data"')
        assert shown["topic"] == TOPIC.name
        assert shown["security"] == {"mode": "SignAndEncrypt", "token_id": 1, "verified": True}
        keys.write(keys.read(GROUP).rotated(time.time(), 2.0, 1))
        shown = await publish_until(publish, child, '"token_id": 2')
        assert (shown["event"], shown["security"]["verified"]) == ("data", True)
    assert child.end(2) == 130
    assert not any("Traceback" in line or '"refused"' in line for line in child.lines)
    drops = json.loads(child.lines[-1])["drops"]
    assert drops.pop("no_metadata", 0) <= 1, "it may have begun to listen between the metadata and the value"
    assert drops == {}


async def test_with_one_key_and_without(keys: KeyFolder, udp_url: str, processes: Processes) -> None:
    key = keys.read(GROUP).keys[0].key_data.hex()
    keyed = listening(processes, "--url", udp_url, "--key", key)
    blind = listening(processes, "--url", udp_url, "--count", "3")
    async with publishing(keys, udp_url) as publish:
        shown = await publish_until(publish, keyed, '"event": "data"')
        assert shown["security"] == {"mode": "SignAndEncrypt", "token_id": 1, "verified": True}
        shown = await publish_until(publish, blind, '"event"')
        assert (shown["event"], shown["publisher_id"], shown["security"]["verified"]) == ("secured", 2, None)
        async with asyncio.timeout(60):
            while blind.process.poll() is None:
                await publish(0.0)
                await asyncio.sleep(0.05)
    assert blind.end() == 0
    assert {json.loads(line)["event"] for line in blind.lines if '"event"' in line} == {"secured"}
    keyed.end(2)
    assert not any(key in line for line in (*keyed.lines, *blind.lines))


SERVED = """\
version: 1
server: {{port: {port}, trust_all_clients: true}}
pubsub: {{security: sign_and_encrypt, url: '{url}'}}
bridges: {{floor: {{kind: ros2, space: 2, status_id: 1}}}}
robots:
  rover: {{bridge: floor, data: {{goal: {{id: 5, type: Double, origin: server, initial: 0.25}}}}}}
"""


async def test_with_the_key_service(tmp_path: Path, udp_url: str, processes: Processes) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(SERVED.format(url=udp_url, port=free_tcp_port()))
    config = load(path, {})
    await introduce_bridge(config, tmp_path, "floor")
    ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    with quick_start():
        serving = asyncio.ensure_future(run_server(config, tmp_path, ready=ready.set_result))
        starting: set[asyncio.Future[Any]] = {serving, ready}
        await asyncio.wait(starting, timeout=30, return_when=asyncio.FIRST_COMPLETED)
    try:
        child = listening(processes, "-c", str(path), "--as-bridge", "floor")
        blind = listening(processes, "-c", str(path), "--count", "1", "--timeout", "60")
        await asyncio.to_thread(child.wait_for, '"event": "data"')
        async with asyncio.timeout(60):
            while blind.process.poll() is None:
                await asyncio.sleep(0.05)
        assert (child.end(), blind.end()) == (130, 0), child.lines
    finally:
        serving.cancel()
        await asyncio.wait([serving])
    shown = [json.loads(line) for line in child.lines if line.startswith('{"event"')]
    assert all(line["security"]["verified"] for line in shown), child.lines
    assert any(line["event"] == "data" and line["fields"] == {"goal": 0.25} for line in shown), child.lines
    assert any("--as-bridge NAME" in line for line in blind.lines)
    assert any('"event": "secured"' in line for line in blind.lines)
