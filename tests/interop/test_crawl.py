"""Every attribute of every node can be read, by two foreign clients: one node that cannot must not cost the others."""

from __future__ import annotations

import importlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import (
    ENGINEER,
    OBSERVER,
    SPEED,
    Running,
    fleet_config,
    serving,
)
from tests.interop.test_node_opcua import run_client
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")

CRAWLER = Path(__file__).parent / "crawl.cjs"
EXPECTED = {"Good", "BadAttributeIdInvalid", "BadNotReadable", "BadWaitingForInitialData", "BadNoCommunication"}


async def _make_things_happen(running: Running) -> None:
    """A source that has spoken, and a fault that nobody has commented: so its comment has no time."""
    running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
    running.peer.publish(SPEED, 0.25)
    async with running.client(ENGINEER) as client:
        faults: Any = client.get_node("ns=2;s=Fleet.Faults")
        await faults.call_method(ua.NodeId("Fleet.Faults.RaiseFault", 2), "rover", "the drill is blunt")


async def test_asyncua_reads_every_attribute_of_every_node(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running:
        await _make_things_happen(running)
        async with running.client(OBSERVER) as client:
            protocol: Any = client.uaclient
            nodes = await _crawled(protocol)
            assert len(nodes) > 6_000
            wanted = [ua.ReadValueId(node_id, attribute) for node_id in nodes for attribute in range(1, 28)]
            codes: Counter[str] = Counter()
            for at in range(0, len(wanted), 5_000):
                results = await protocol.read(ua.ReadParameters(NodesToRead=wanted[at : at + 5_000]))
                codes.update(result.StatusCode.name for result in results)
            assert set(codes) <= EXPECTED
            comments = [node for node in nodes if str(node.Identifier).endswith(".Comment.SourceTimestamp")]
            assert comments
            for node_id in comments:
                # A time that is not known is 0 on the wire (OPC 10000-6 5.2.2.5).
                assert (await client.get_node(node_id).read_value()).year == 1601


async def _crawled(protocol: Any) -> list[Any]:
    seen = {ua.NodeId(84)}
    waiting = list(seen)
    while waiting:
        batch, waiting = waiting[:200], waiting[200:]
        parameters = ua.BrowseParameters()
        parameters.NodesToBrowse = [
            ua.BrowseDescription(NodeId=node_id, BrowseDirection=ua.BrowseDirection.Both, ResultMask=63)
            for node_id in batch
        ]
        results: list[Any] = await protocol.browse(parameters)
        while results:
            for result in results:
                for reference in result.References:
                    node_id = ua.NodeId(reference.NodeId.Identifier, reference.NodeId.NamespaceIndex)
                    if node_id not in seen:
                        seen.add(node_id)
                        waiting.append(node_id)
            points: list[bytes] = [result.ContinuationPoint for result in results if result.ContinuationPoint]
            following = ua.BrowseNextParameters(ReleaseContinuationPoints=False, ContinuationPoints=points)
            results = await protocol.browse_next(following) if points else []
    return list(seen)


@pytest.mark.needs("node")
async def test_node_opcua_reads_every_attribute_of_every_node(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running:
        await _make_things_happen(running)
        code, output, errors = await run_client(running.url, *OBSERVER, tmp_path / "pki", script=CRAWLER, timeout_s=100)
        assert code == 0, errors
        report: dict[str, Any] = json.loads(output.splitlines()[-1])
        assert report["failed"] == []
        assert report["nodes"] > 6_000
        assert set(report["codes"]) <= EXPECTED
