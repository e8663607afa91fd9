"""Every attribute of every node can be read, by two foreign clients: one node that cannot must not cost the others."""

from __future__ import annotations

import importlib
import json
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
from tests.interop.crawled import CrawledVariable, contradictions
from tests.interop.test_node_opcua import run_client
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")

CRAWLER = Path(__file__).parent / "crawl.cjs"
ATTRIBUTES = range(1, 28)
TOO_MANY = [ua.Variant(0, ua.VariantType.Byte)] * 40
"""Arguments that no Method takes: one that is there says so, and is not run."""
EXPECTED = {"Good", "BadAttributeIdInvalid", "BadNotReadable", "BadWaitingForInitialData", "BadNoCommunication"}


async def _make_things_happen(running: Running) -> None:
    """A source that has spoken, and a fault that nobody has commented: so its comment has no time."""
    running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
    running.peer.publish(SPEED, 0.25)
    async with running.client(ENGINEER) as client:
        faults: Any = client.get_node("ns=2;s=Fleet.Faults")
        await faults.call_method(ua.NodeId("Fleet.Faults.RaiseFault", 2), "rover", "the drill is blunt")


async def test_asyncua_finds_no_contradiction_in_any_node(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running:
        await _make_things_happen(running)
        async with running.client(OBSERVER) as client:
            protocol: Any = client.uaclient
            crawled = await _crawled(protocol)
            nodes = crawled.nodes
            assert len(nodes) > 5_500
            wanted = [
                ua.ReadValueId(node_id, ua.AttributeIds(attribute)) for node_id in nodes for attribute in ATTRIBUTES
            ]
            values: list[Any] = []
            for at in range(0, len(wanted), 1_000):
                values += await protocol.read(ua.ReadParameters(NodesToRead=wanted[at : at + 1_000]))
            # What others do is told by the diagnostics, but not to observers.
            assert {value.StatusCode.name for value in values} <= EXPECTED | {"BadUserAccessDenied"}
            of_node = [dict(zip(ATTRIBUTES, values[at : at + 27], strict=True)) for at in range(0, len(values), 27)]
            variables = [
                _variable(node_id, read) for node_id, read in zip(nodes, of_node, strict=True) if _has_value(read)
            ]
            assert len(variables) > 1_300
            assert contradictions(variables, crawled.supertypes) == []
            comments = [node for node in nodes if str(node.Identifier).endswith(".Comment.SourceTimestamp")]
            assert comments
            for node_id in comments:
                # A time that is not known is 0 on the wire (OPC 10000-6 5.2.2.5).
                assert (await client.get_node(node_id).read_value()).year == 1601
        async with running.client(ENGINEER) as client:
            protocol = client.uaclient
            executable = {
                node.to_string()
                for node, read in zip(nodes, of_node, strict=True)
                if read[21].Value is not None and read[21].Value.Value
            }
            of_instances = [pair for pair in crawled.methods if pair[1].to_string() in executable]
            assert len(of_instances) > 20
            calls = [ua.CallMethodRequest(owner, method, TOO_MANY) for owner, method in of_instances]
            codes = [result.StatusCode.name for result in await protocol.call(calls)]
            absent = [
                method.to_string()
                for (_, method), code in zip(of_instances, codes, strict=True)
                if code not in ("BadTooManyArguments", "BadUserAccessDenied")
            ]
            assert absent == []


def _has_value(read: dict[int, Any]) -> bool:
    return read[13].StatusCode.name == "Good" and read[13].Value is not None


def _variable(node_id: Any, read: dict[int, Any]) -> CrawledVariable:
    variant = read[13].Value
    is_array = isinstance(variant.Value, list)
    return CrawledVariable(
        node_id.to_string(),
        read[14].Value.Value.to_string(),
        int(read[15].Value.Value),
        int(variant.VariantType.value),
        (len(variant.Dimensions or []) or 1) if is_array else 0,
        variant.Value is None,
    )


class _Crawl:
    """What a client finds by browsing."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.supertypes: dict[str, str] = {}
        self.methods: list[tuple[Any, Any]] = []
        """Of Objects: the Object, and its Method."""


async def _crawled(protocol: Any) -> _Crawl:
    crawl = _Crawl()
    seen = {ua.NodeId(84)}
    waiting = list(seen)
    classes: dict[Any, Any] = {}
    components: list[tuple[Any, Any]] = []
    while waiting:
        batch, waiting = waiting[:200], waiting[200:]
        parameters = ua.BrowseParameters()
        parameters.NodesToBrowse = [
            ua.BrowseDescription(NodeId=node_id, BrowseDirection=ua.BrowseDirection.Both, ResultMask=63)
            for node_id in batch
        ]
        results: list[Any] = await protocol.browse(parameters)
        sources = list(batch)
        while results:
            for source, result in zip(sources, results, strict=True):
                for reference in result.References:
                    node_id = ua.NodeId(reference.NodeId.Identifier, reference.NodeId.NamespaceIndex)
                    classes[node_id] = reference.NodeClass
                    if reference.ReferenceTypeId == ua.NodeId(45) and not reference.IsForward:
                        crawl.supertypes[source.to_string()] = node_id.to_string()
                    if reference.NodeClass == ua.NodeClass.Method and reference.IsForward:
                        components.append((source, node_id))
                    if node_id not in seen:
                        seen.add(node_id)
                        waiting.append(node_id)
            left = [
                (source, result) for source, result in zip(sources, results, strict=True) if result.ContinuationPoint
            ]
            sources = [source for source, _ in left]
            points: list[bytes] = [result.ContinuationPoint for _, result in left]
            following = ua.BrowseNextParameters(ReleaseContinuationPoints=False, ContinuationPoints=points)
            results = await protocol.browse_next(following) if points else []
    crawl.nodes = list(seen)
    # Methods below ObjectTypes are declarations, and so are those of Objects below these.
    below = await _reachable(protocol)
    crawl.methods = [(owner, method) for owner, method in components if owner in below]
    return crawl


async def _reachable(protocol: Any) -> set[Any]:
    """Objects of the instances: those below Objects."""
    seen: set[Any] = {ua.NodeId(85)}
    waiting: list[Any] = list(seen)
    while waiting:
        parameters = ua.BrowseParameters()
        parameters.NodesToBrowse = [
            ua.BrowseDescription(
                NodeId=node_id,
                BrowseDirection=ua.BrowseDirection.Forward,
                ReferenceTypeId=ua.NodeId(33),
                IncludeSubtypes=True,
                NodeClassMask=1,
            )
            for node_id in waiting
        ]
        waiting = []
        for result in await protocol.browse(parameters):
            for reference in result.References:
                node_id = ua.NodeId(reference.NodeId.Identifier, reference.NodeId.NamespaceIndex)
                if node_id not in seen:
                    seen.add(node_id)
                    waiting.append(node_id)
    return seen


@pytest.mark.needs("node")
async def test_node_opcua_finds_no_contradiction_in_any_node(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running:
        await _make_things_happen(running)
        code, output, errors = await run_client(running.url, *ENGINEER, tmp_path / "pki", script=CRAWLER, timeout_s=200)
        assert code == 0, errors
        report: dict[str, Any] = json.loads(output.splitlines()[-1])
        assert report["failed"] == []
        assert report["nodes"] > 5_500
        assert set(report["codes"]) <= EXPECTED
        variables = [CrawledVariable(*row) for row in report["variables"]]
        assert report["values"] > 1_300
        assert contradictions(variables, report["supertypes"]) == []
        assert report["methods"] > 20
        assert report["absent"] == []


@pytest.mark.parametrize(
    ("variable", "expected"),
    [
        (CrawledVariable("i=1", "i=290", -1, 11, 0, False), ""),
        (CrawledVariable("i=1", "i=290", -1, 11, 0, True), "Null and Good"),
        (CrawledVariable("i=1", "i=24", -1, 0, 0, True), ""),
        (CrawledVariable("i=1", "i=290", -1, 6, 0, False), "a value of another type"),
        (CrawledVariable("i=1", "i=290", -1, 11, 1, False), "a value of another rank"),
        (CrawledVariable("i=1", "i=290", 1, 11, 0, False), "a value of another rank"),
        (CrawledVariable("i=1", "i=290", 1, 11, 2, False), "a value of another rank"),
        (CrawledVariable("i=1", "i=290", -2, 11, 2, False), ""),
    ],
)
def test_a_contradiction_is_found(variable: CrawledVariable, expected: str) -> None:
    found = contradictions([variable], {"i=290": "i=11"})
    assert [line.rpartition(": ")[2] for line in found] == ([expected] if expected else [])
