"""A request that is served from its bytes gets the answer that asyncua's decoder and encoder would lead to."""

from __future__ import annotations

import asyncio
import gc
import json
import random
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from tests.integration.server_security.both_ways import Paths, targets_of
from tests.integration.server_security.harness import Door, Identities, door, ua
from tests.integration.server_security.test_mutations import mutated
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.methods import MethodServices
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, NodeBuilder
from ua_fleet.values import QualifiedName

pytestmark = pytest.mark.asyncio(loop_scope="module")

COUNT = 150


def _read(rng: random.Random, targets: list[Any]) -> Any:
    request = ua.ReadRequest()
    request.Parameters.MaxAge = rng.choice((0.0, 0.0, 500.0, -1.0, float("nan")))
    request.Parameters.TimestampsToReturn = rng.choice((0, 1, 2, 2, 3, 4))
    for _ in range(rng.choice((0, 1, 1, 5, 20))):
        wanted = ua.ReadValueId(rng.choice(targets), rng.choice((13, 13, 13, rng.randrange(28))))
        wanted.IndexRange = rng.choice((None, None, None, "", "1:3", "9", "x", "100"))
        if rng.random() < 0.1:
            wanted.DataEncoding = rng.choice((ua.QualifiedName("Default Binary", 0), ua.QualifiedName("", 0)))
        request.Parameters.NodesToRead.append(wanted)
    return request


def _browse(rng: random.Random, targets: list[Any]) -> Any:
    request = ua.BrowseRequest()
    request.Parameters.RequestedMaxReferencesPerNode = rng.choice((0, 0, 1_000, 2))
    types = [ua.NodeId(), ua.NodeId(33), ua.NodeId(35), ua.NodeId(47), ua.NodeId(84), ua.NodeId(4_444)]
    for _ in range(rng.choice((0, 1, 1, 4))):
        wanted = ua.BrowseDescription(
            rng.choice(targets), rng.choice((0, 0, 1, 2, 3)), rng.choice(types), rng.random() < 0.7
        )
        wanted.NodeClassMask, wanted.ResultMask = rng.choice((0, 0, 1, 2, 4, 255)), rng.choice((63, 63, 0, 9, 255))
        request.Parameters.NodesToBrowse.append(wanted)
    return request


@pytest.mark.parametrize("user", ["olga", "oscar"])
async def test_reads_are_answered_alike_by_both_ways(tmp_path: Path, identities: Identities, user: str) -> None:
    rng = random.Random(17)
    async with door(tmp_path, identities) as hardened, hardened.connected(user) as client:
        paths, targets = Paths(hardened, client), targets_of(hardened)
        seen: set[bytes] = set()
        for _ in range(COUNT):
            body, start = paths.encoded(_read(rng, targets))
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            seen.add(await paths.compare("Read", body))
        assert len(seen) > COUNT // 5


async def test_browses_are_answered_alike_by_both_ways(tmp_path: Path, identities: Identities) -> None:
    rng = random.Random(18)
    # Continuation points are random: there are none here, but where a wish of two references leaves a rest.
    async with door(tmp_path, identities) as hardened, hardened.connected("olga") as client:
        paths, targets = Paths(hardened, client), targets_of(hardened)
        seen: set[bytes] = set()
        for _ in range(COUNT):
            request = _browse(rng, targets)
            if request.Parameters.RequestedMaxReferencesPerNode == 2:
                request.Parameters.RequestedMaxReferencesPerNode = 0
            body, start = paths.encoded(request)
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
                if int.from_bytes(body[start + 14 : start + 18], "little") not in (0, 1_000):
                    continue
            seen.add(await paths.compare("Browse", body))
        assert len(seen) > COUNT // 5


async def test_what_has_changed_is_read_and_browsed_as_it_is_now(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        space, nodes = hardened.server.iserver.aspace, hardened.nodes
        node, folder = client.get_node(nodes.value), client.get_node(nodes.folder)
        for value in (2.5, 3.5):
            await node.write_value(value)
            assert [await node.read_value() for _ in range(2)] == [value, value]
        before = await folder.get_children()
        assert await folder.get_children() == before
        index = nodes.folder.NamespaceIndex
        await hardened.server.get_node(nodes.folder).add_variable(ua.NodeId("late", index), "late", 1)
        late = client.get_node(ua.NodeId("late", index))
        assert len(await folder.get_children()) == len(before) + 1
        assert [await late.read_value() for _ in range(2)] == [1, 1]
        NodeBuilder(space).remove(late.nodeid)
        assert await folder.get_children() == before
        with pytest.raises(ua.UaStatusCodeError, match="BadNodeIdUnknown"):
            await late.read_value()
        held = space[nodes.value].attributes[ua.AttributeIds.AccessLevel]
        held.value = ua.DataValue(ua.Variant(0, ua.VariantType.Byte))
        with pytest.raises(ua.UaStatusCodeError, match="BadNotReadable"):
            await node.read_value()


OLD = datetime(2020, 1, 1, tzinfo=UTC)
"""Before it: the times that requests have; after it: those of now."""


def _value(rng: random.Random) -> Any:
    """A DataValue as clients may write it."""
    content, kind = rng.choice(
        (
            (rng.random(), ua.VariantType.Double),
            (rng.random(), ua.VariantType.Double),
            (rng.randrange(100), ua.VariantType.Int32),
            ("\u00e4" * rng.randrange(4), ua.VariantType.String),
            (b"ab", ua.VariantType.ByteString),
            ([rng.randrange(9) for _ in range(rng.choice((1, 2, 10)))], ua.VariantType.Int32),
            ([1.5, 2.5], ua.VariantType.Double),
            (None, ua.VariantType.Null),
        )
    )
    times = [rng.choice((None, None, ua.win_epoch_to_datetime(130_000_000_000_000_000))) for _ in range(2)]
    finer = [rng.choice((None, None, None, 7, 65_000)) for _ in range(2)]
    code = rng.choice(
        (None, ua.StatusCode(0), ua.StatusCode(0), ua.StatusCode(0x4000_0000), ua.StatusCode(0x0080_0000))
    )
    return ua.DataValue(ua.Variant(content, kind), code, *times, *finer)


def _write(rng: random.Random, targets: list[Any]) -> Any:
    request = ua.WriteRequest()
    for _ in range(rng.choice((0, 1, 1, 5, 12))):
        attribute = rng.choice((13, 13, 13, 13, rng.randrange(28)))
        index_range = rng.choice((None, None, None, None, "", "1", "1:2", "x"))
        request.Parameters.NodesToWrite.append(ua.WriteValue(rng.choice(targets), attribute, index_range, _value(rng)))
    return request


class Written:
    """What writes leave behind: values, and lines of the audit log since the last look."""

    def __init__(self, hardened: Door, watched: list[Any]) -> None:
        self._space, self._watched = hardened.server.iserver.aspace, watched
        self._log, self._read = hardened.state_dir / "audit.log", 0
        self()

    def __call__(self) -> Any:
        values = [self._space[node].attributes[ua.AttributeIds.Value].value for node in self._watched]
        lines = [json.loads(line) for line in self._log.read_text().splitlines()[self._read :]]
        self._read += len(lines)
        told = [
            {key: line.get(key) for key in ("event", "node", "object", "method", "value", "status")} for line in lines
        ]
        return [_timeless(value) for value in values], [line for line in told if line["status"] == "Good"]


def _timeless(value: Any) -> str:
    """A value with `now` in place of what is no time of a request's."""
    times = [
        time if time is not None and time < OLD else "now" for time in (value.SourceTimestamp, value.ServerTimestamp)
    ]
    return repr((value.Value, value.StatusCode, *times, value.SourcePicoseconds, value.ServerPicoseconds))


@pytest.mark.parametrize("user", ["olga", "oscar"])
async def test_writes_are_answered_and_done_alike_by_both_ways(
    tmp_path: Path, identities: Identities, user: str
) -> None:
    rng = random.Random(19)
    async with door(tmp_path, identities) as hardened, hardened.connected(user) as client:
        nodes, server = hardened.nodes, hardened.server
        written = [nodes.value, nodes.plain, nodes.array, nodes.text]
        for node in written:
            await server.get_node(node).set_writable()
        paths, targets = Paths(hardened, client), targets_of(hardened) + written * 6
        left = Written(hardened, written)
        seen: set[bytes] = set()
        for _ in range(COUNT):
            body, start = paths.encoded(_write(rng, targets))
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            seen.add(await paths.compare("Write", body, left))
        assert len(seen) > (COUNT // 5 if user == "oscar" else 5)


async def test_nothing_of_a_request_is_written_whose_end_is_no_valid_encoding(
    tmp_path: Path, identities: Identities
) -> None:
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        paths, node = Paths(hardened, client), client.get_node(hardened.nodes.value)
        await node.write_value(1.5)
        request = ua.WriteRequest()
        one = ua.WriteValue(hardened.nodes.value, 13, None, ua.DataValue(ua.Variant(2.5, ua.VariantType.Double)))
        request.Parameters.NodesToWrite = [one, one]
        body, _ = paths.encoded(request)
        await paths.compare("Write", body[:-1])
        assert await node.read_value() == 1.5


async def test_a_write_to_what_has_changed_since_is_done_as_it_is_now(tmp_path: Path, identities: Identities) -> None:
    async with (
        door(tmp_path, identities) as hardened,
        hardened.connected("oscar") as client,
        hardened.connected("eva") as engineer,
    ):
        space, nodes = hardened.server.iserver.aspace, hardened.nodes
        node = client.get_node(nodes.value)
        for value in (2.5, 3.5):
            await node.write_value(value)
        told: asyncio.Queue[Any] = asyncio.Queue()

        class Handler:
            def datachange_notification(self, _node: Any, value: Any, _data: Any) -> None:
                told.put_nowait(value)

            def event_notification(self, event: Any) -> None:
                told.put_nowait(event)

        values = await client.create_subscription(10, Handler())
        await values.subscribe_data_change(node)
        await node.write_value(4.5)
        assert [await asyncio.wait_for(told.get(), 30) for _ in range(2)] == [3.5, 4.5]
        await values.delete()
        events = await engineer.create_subscription(10, Handler())
        await events.subscribe_events(evtypes=ua.NodeId(ua.ObjectIds.AuditWriteUpdateEventType))
        await node.write_value(5.5)
        event = await asyncio.wait_for(told.get(), 30)
        assert (event.OldValue, event.NewValue) == (4.5, 5.5)
        held = space[nodes.value].attributes[ua.AttributeIds.AccessLevel]
        held.value = ua.DataValue(ua.Variant(1, ua.VariantType.Byte))
        with pytest.raises(ua.UaStatusCodeError, match="BadNotWritable"):
            await node.write_value(6.5)
        NodeBuilder(space).remove(nodes.value)
        with pytest.raises(ua.UaStatusCodeError, match="BadNodeIdUnknown"):
            await node.write_value(6.5)


def _call(rng: random.Random, hardened: Door) -> Any:
    objects, methods = ua.NodeId(ua.ObjectIds.ObjectsFolder), hardened.nodes.methods
    named = [method for name, method in methods.items() if name != "sleeps"]
    request = ua.CallRequest()
    calls: list[Any] = []
    for _ in range(rng.choice((0, 1, 1, 1, 4))):
        owner = rng.choice((objects, objects, objects, objects, ua.NodeId(ua.ObjectIds.Server), ua.NodeId("x", 2)))
        method = rng.choice((*named, methods["add"], methods["add"], hardened.nodes.value, ua.NodeId("y", 2)))
        kind = rng.choice((ua.VariantType.Int64, ua.VariantType.Int64, ua.VariantType.Int32))
        arguments = [ua.Variant(rng.randrange(100), kind) for _ in range(rng.choice((0, 2, 2, 2, 3)))]
        if arguments and rng.random() < 0.2:
            arguments[0] = rng.choice((ua.Variant([1], kind), ua.Variant("x"), ua.Variant()))
        calls.append(ua.CallMethodRequest(owner, method, arguments))
    request.Parameters = ua.CallParameters(calls)
    return request


@pytest.mark.parametrize("user", ["olga", "oscar"])
async def test_calls_are_answered_and_done_alike_by_both_ways(
    tmp_path: Path, identities: Identities, user: str
) -> None:
    rng = random.Random(20)
    async with door(tmp_path, identities) as hardened, hardened.connected(user) as client:
        paths, called = Paths(hardened, client), hardened.nodes.called
        written = Written(hardened, [])

        def left() -> Any:
            taken = list(called)
            called.clear()
            return taken, written()

        seen: set[bytes] = set()
        for _ in range(COUNT):
            body, start = paths.encoded(_call(rng, hardened))
            if rng.random() < 0.3:
                body = mutated(rng, bytearray(body), start)
            seen.add(await paths.compare("Call", body, left))
        assert len(seen) > (COUNT // 5 if user == "oscar" else 5)


async def test_a_call_of_what_has_changed_since_is_done_as_it_is_now(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        space, nodes, server = hardened.server.iserver.aspace, hardened.nodes, hardened.server
        objects, add = client.nodes.objects, nodes.methods["add"]
        assert [await objects.call_method(add, number, 1) for number in (1, 2, 3)] == [2, 3, 4]
        inputs: Any = await server.get_node(add).get_child("0:InputArguments")
        held: Any = space[inputs.nodeid].attributes[ua.AttributeIds.Value]
        before = held.value
        held.value = ua.DataValue(ua.Variant(before.Value.Value[:1]))
        with pytest.raises(ua.UaStatusCodeError, match="BadTooManyArguments"):
            await objects.call_method(add, 1, 1)
        held.value = before
        space[add].call = None
        with pytest.raises(ua.UaStatusCodeError, match="BadNotImplemented"):
            await objects.call_method(add, 1, 1)
        owner: Any = space[objects.nodeid]
        owner.references[:] = [each for each in owner.references if each.NodeId != add]
        with pytest.raises(ua.UaStatusCodeError, match="BadMethodInvalid"):
            await objects.call_method(add, 1, 1)
        NodeBuilder(space).remove(add)
        with pytest.raises(ua.UaStatusCodeError, match="BadMethodInvalid"):
            await objects.call_method(add, 1, 1)


def share(hardened: Door, name: str, count: int) -> list[Any]:
    """New Objects that all have one Method, as skills have Halt."""
    builder, index = NodeBuilder(hardened.server.iserver.aspace), hardened.nodes.folder.NamespaceIndex
    owners: list[Any] = [raw_id(f"{name}{number}", index) for number in range(count)]
    for number, owner in enumerate(owners):
        builder.add_object(owner, QualifiedName(index, f"{name}{number}"), hardened.nodes.folder, raw_id(58))
        builder.add_reference(owner, HAS_COMPONENT, hardened.nodes.methods["who"])
    return owners


async def test_calls_on_many_objects_keep_nothing_of_all_that_share_their_method(
    tmp_path: Path, identities: Identities
) -> None:
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        method: Any = hardened.server.iserver.aspace[hardened.nodes.methods["who"]]
        for owner in share(hardened, "early", 20):
            assert await client.get_node(owner).call_method(method.nodeid) == "oscar"
        lists: list[Any] = [each for each in gc.get_referrers(method.references[0]) if type(each) is list]
        assert [each for each in lists if each is not method.references] == []


async def test_a_method_that_is_known_stays_known_when_further_objects_share_it(
    tmp_path: Path, identities: Identities
) -> None:
    real = MethodServices.find
    async with door(tmp_path, identities) as hardened, hardened.connected("oscar") as client:
        (early,), who = share(hardened, "early", 1), hardened.nodes.methods["who"]
        references = hardened.server.iserver.aspace[early].references

        async def finds() -> int:
            """How often the Method is looked for in three calls."""
            with mock.patch.object(MethodServices, "find", autospec=True, side_effect=real) as find:
                assert [await client.get_node(early).call_method(who) for _ in range(3)] == ["oscar"] * 3
            return find.call_count

        assert await finds() > 0
        share(hardened, "late", 3)
        assert await finds() == 0
        references.insert(0, references.pop())  # the reference to it has another place
        assert [await finds() > 0, await finds()] == [True, 0]
