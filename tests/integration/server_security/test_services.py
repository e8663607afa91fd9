"""Read, Write, Browse, Call and GetEndpoints answer with the codes that OPC 10000-4 has, seen by asyncua's client."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua.client.client import Client as AsyncuaClient

from tests.integration.server_security.harness import Client, Door, send, ua

pytestmark = pytest.mark.asyncio(loop_scope="module")

INT32, STRING, BYTES, BYTE = (ua.VariantType[name] for name in ("Int32", "String", "ByteString", "Byte"))


async def write(client: Client, node_id: Any, value: Any, index_range: str | None = None) -> str:
    """The name of the StatusCode of a write."""
    given = value if isinstance(value, ua.DataValue) else ua.DataValue(value)
    request = ua.WriteRequest()
    request.Parameters.NodesToWrite = [ua.WriteValue(node_id, ua.AttributeIds.Value, index_range, given)]
    return str((await send(client, request, ua.WriteResponse)).Results[0].name)


async def read(client: Client, node_id: Any, attribute: Any = 13, encoding: Any = None) -> Any:
    """The DataValue of an attribute."""
    request = ua.ReadRequest()
    wanted = ua.ReadValueId(node_id, ua.AttributeIds(attribute))
    if encoding is not None:
        wanted.DataEncoding = encoding
    request.Parameters.NodesToRead = [wanted]
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    return (await send(client, request, ua.ReadResponse)).Results[0]


async def variable(door: Door, name: str, value: Any, kind: Any = None) -> Any:
    """The NodeId of a Variable that clients may write."""
    node = await door.server.nodes.objects.add_variable(ua.NodeId(name, 2), "it", value, kind)
    await node.set_writable()
    return node.nodeid


@pytest.mark.parametrize(
    ("value", "kind", "index_range", "part", "expected"),
    [
        ([0, 1, 2, 3], INT32, "1:2", [8, 9], [0, 8, 9, 3]),
        ([0, 1, 2, 3], INT32, "3", [8], [0, 1, 2, 8]),
        ([0, 1, 2, 3], INT32, "3", 8, "BadTypeMismatch"),
        ([0, 1, 2, 3], INT32, "3", ua.Variant(["8"], STRING), "BadTypeMismatch"),
        ([0, 1, 2, 3], INT32, "1:2", [8], "BadIndexRangeDataMismatch"),
        ([0, 1, 2, 3], INT32, "1:2", [7, 8, 9], "BadIndexRangeDataMismatch"),
        ([0, 1, 2, 3], INT32, "3:4", [8, 9], "BadIndexRangeNoData"),
        ([0, 1, 2, 3], INT32, "4", [8], "BadIndexRangeNoData"),
        ([0, 1, 2, 3], INT32, "2:1", [8, 9], "BadIndexRangeInvalid"),
        ([0, 1, 2, 3], INT32, "-1:1", [8, 9], "BadIndexRangeInvalid"),
        ([0, 1, 2, 3], INT32, "0,0", [8], "BadIndexRangeNoData"),
        ([[1, 2, 3], [4, 5, 6]], INT32, "0:1,1:2", [[7, 8], [9, 10]], [[1, 7, 8], [4, 9, 10]]),
        ([[1, 2, 3], [4, 5, 6]], INT32, "1,0:2", [[7, 8, 9]], [[1, 2, 3], [7, 8, 9]]),
        ([[1, 2, 3], [4, 5, 6]], INT32, "0:2,1", [[7], [8], [9]], "BadIndexRangeNoData"),
        ([[1, 2, 3], [4, 5, 6]], INT32, "0:1,1", [[7, 8], [9, 10]], "BadIndexRangeDataMismatch"),
        ([[1, 2, 3], [4, 5, 6]], INT32, "0:1", [7, 8], "BadTypeMismatch"),
        ([[1, 2, 3], [4, 5, 6]], INT32, "1", [[7, 8]], "BadIndexRangeDataMismatch"),
        ([[1, 2, 3], [4, 5, 6]], INT32, "1", [[7, 8, 9]], [[1, 2, 3], [7, 8, 9]]),
        ("abcdef", STRING, "1:2", "XY", "aXYdef"),
        ("abcdef", STRING, "5", "X", "abcdeX"),
        ("abcdef", STRING, "5:6", "XY", "BadIndexRangeNoData"),
        ("abcdef", STRING, "1:2", "X", "BadIndexRangeDataMismatch"),
        ("abcdef", STRING, "1:2", ua.Variant(b"XY", BYTES), "BadTypeMismatch"),
        (b"abcdef", BYTES, "1:2", b"XY", b"aXYdef"),
        (["abc", "def"], STRING, "0:1,1", ["X", "Y"], ["aXc", "dYf"]),
        (5, INT32, "0", 6, "BadIndexRangeNoData"),
        ([1, 2, 3], BYTE, "1:2", ua.Variant(b"\x08\x09", BYTES), [1, 8, 9]),
        ([1, 2, 3], BYTE, "", ua.Variant(b"\x08\x09", BYTES), [8, 9]),
    ],
)
async def test_a_part_is_written(
    value: Any, kind: Any, index_range: str, part: Any, expected: Any, hardened: Door
) -> None:
    """A write with an IndexRange replaces that part alone (OPC 10000-4 5.11.4 and 7.27)."""
    node_id = await variable(hardened, f"part {value!r} {index_range} {part!r}", value, kind)
    given = part if isinstance(part, ua.Variant) else ua.Variant(part, kind)
    async with hardened.connected() as client:
        code = await write(client, node_id, given, index_range)
        after = (await read(client, node_id)).Value.Value
        if isinstance(expected, str) and expected.startswith("Bad"):
            assert (code, after) == (expected, value)
        else:
            assert (code, after) == ("Good", expected)


async def test_what_comes_with_a_value_is_written_too(hardened: Door) -> None:
    """StatusCode and times of a write are the node's; they were dropped, and the write was Good."""
    node_id = await variable(hardened, "timed", 1.5)
    source, server = datetime(2020, 1, 2, tzinfo=UTC), datetime(2020, 1, 3, tzinfo=UTC)
    local_override = ua.StatusCode(0x0096_0000)
    given = ua.DataValue(ua.Variant(2.5), local_override, source, server)
    async with hardened.connected() as client:
        assert await write(client, node_id, given) == "Good"
        after = await read(client, node_id)
        assert (after.Value.Value, after.StatusCode.name) == (2.5, "GoodLocalOverride")
        assert (after.SourceTimestamp, after.ServerTimestamp) == (source, server)
        before = datetime.now(UTC)
        assert await write(client, node_id, ua.Variant(3.5)) == "Good"
        after = await read(client, node_id)
        assert after.StatusCode.name == "Good"
        assert before <= after.SourceTimestamp <= datetime.now(UTC)


async def test_only_a_structure_has_an_encoding(hardened: Door) -> None:
    async def code(identifier: Any, name: str, attribute: int = 13, namespace: int = 0) -> str:
        value = await read(client, identifier, attribute, ua.QualifiedName(name, namespace))
        return str(value.StatusCode.name)

    structure, scalar = ua.NodeId(ua.ObjectIds.Server_ServerStatus), ua.NodeId("value", 2)
    async with hardened.connected() as client:
        assert await code(structure, "Default Binary") == "Good"
        assert await code(structure, "Default XML") == "BadDataEncodingUnsupported"
        assert await code(structure, "Default Binary", namespace=1) == "BadDataEncodingUnsupported"
        assert await code(structure, "Default Binary", attribute=4) == "BadDataEncodingInvalid"
        assert await code(scalar, "Default Binary") == "BadDataEncodingInvalid"
        assert await code(scalar, "Invalid") == "BadDataEncodingInvalid"
        assert await code(scalar, "") == "Good"


async def browse(client: Client, *nodes: Any, most: int = 0, **options: Any) -> list[Any]:
    """The results of a Browse."""
    request = ua.BrowseRequest()
    request.Parameters.RequestedMaxReferencesPerNode = most
    defaults = {"BrowseDirection": ua.BrowseDirection.Forward, "IncludeSubtypes": True, "ResultMask": 63}
    request.Parameters.NodesToBrowse = [ua.BrowseDescription(NodeId=node, **(defaults | options)) for node in nodes]
    return list((await send(client, request, ua.BrowseResponse)).Results)


async def test_what_is_no_reference_type_is_refused(hardened: Door) -> None:
    objects = ua.NodeId(ua.ObjectIds.ObjectsFolder)
    async with hardened.connected() as client:
        for wrong in (ua.NodeId("nowhere", 2), objects, ua.NodeId(ua.ObjectIds.FolderType)):
            (result,) = await browse(client, objects, ReferenceTypeId=wrong)
            assert result.StatusCode.name == "BadReferenceTypeIdInvalid"
        (result,) = await browse(client, objects, ReferenceTypeId=ua.NodeId(ua.ObjectIds.Organizes))
        assert result.StatusCode.name == "Good"
        assert result.References


async def test_a_client_gets_the_fields_that_it_wants(hardened: Door) -> None:
    nulls = {
        "ReferenceTypeId": ua.NodeId(),
        "IsForward": False,
        "NodeClass": ua.NodeClass.Unspecified,
        "BrowseName": ua.QualifiedName(None, 0),
        "DisplayName": ua.LocalizedText(),
        "TypeDefinition": ua.NodeId(),
    }
    server = ua.NodeId(ua.ObjectIds.Server)
    async with hardened.connected() as client:
        (whole,) = await browse(client, server)
        for bit, name in enumerate(nulls):
            (only,) = await browse(client, server, ResultMask=1 << bit)
            assert [ref.NodeId for ref in only.References] == [ref.NodeId for ref in whole.References]
            assert [getattr(ref, name) for ref in only.References] == [getattr(ref, name) for ref in whole.References]
            for other, null in nulls.items():
                if other != name:
                    assert {getattr(ref, other) == null for ref in only.References} == {True}, (name, other)
        # A continuation point goes on with the fields that were asked for.
        (first,) = await browse(client, server, most=1, ResultMask=8)
        request = ua.BrowseNextRequest()
        request.Parameters.ContinuationPoints = [first.ContinuationPoint]
        request.Parameters.ReleaseContinuationPoints = False
        (rest,) = (await send(client, request, ua.BrowseNextResponse)).Parameters.Results
        (following,) = rest.References
        assert following.BrowseName == whole.References[1].BrowseName
        assert (following.ReferenceTypeId, following.DisplayName) == (ua.NodeId(), ua.LocalizedText())


async def test_a_path_without_a_name_is_refused(hardened: Door) -> None:
    request = ua.TranslateBrowsePathsToNodeIdsRequest()

    def path(*names: str | None) -> Any:
        found = ua.BrowsePath(ua.NodeId(ua.ObjectIds.ObjectsFolder))
        below = ua.NodeId(ua.ObjectIds.HierarchicalReferences)
        found.RelativePath.Elements = [
            ua.RelativePathElement(below, False, True, ua.QualifiedName(name, 0)) for name in names
        ]
        return found

    paths = [path("Server", "ServerStatus"), path(None, "ServerStatus"), path("Server", None), path("Server", "No")]
    request.Parameters.BrowsePaths = paths
    async with hardened.connected() as client:
        results = (await send(client, request, ua.TranslateBrowsePathsToNodeIdsResponse)).Results
    assert [result.StatusCode.name for result in results] == [
        "Good",
        "BadBrowseNameInvalid",
        "BadBrowseNameInvalid",
        "BadNoMatch",
    ]


async def test_endpoints_are_those_of_the_profiles_asked_for(hardened: Door) -> None:
    async def endpoints(*profiles: str) -> int:
        request = ua.GetEndpointsRequest()
        request.Parameters.EndpointUrl = hardened.url
        request.Parameters.ProfileUris = list(profiles)
        client: Any = AsyncuaClient(hardened.url)
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            return len((await send(client, request, ua.GetEndpointsResponse)).Endpoints)
        finally:
            await client.close_secure_channel()
            client.disconnect_socket()

    binary = "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary"
    everything = await endpoints()
    assert everything >= 3
    assert await endpoints(binary) == everything
    assert await endpoints("http://opcfoundation.org/UA-Profile/Transport/https-uabinary") == 0
    assert await endpoints("http://opcfoundation.org/UA-Profile/Transport/https-uabinary", binary) == everything


async def test_a_method_of_the_type_names_that_of_the_object(hardened: Door) -> None:
    """A client may call a Method of an Object by the NodeId that it has in the ObjectType (OPC 10000-4 5.12.2)."""
    server = ua.NodeId(ua.ObjectIds.Server)

    async def call(owner: Any, method: Any) -> str:
        return str((await answer(owner, method)).StatusCode.name)

    async def answer(owner: Any, method: Any) -> Any:
        request = ua.CallRequest()
        wanted = ua.CallMethodRequest(owner, method)
        wanted.InputArguments = [ua.Variant(4_000_000_000, ua.VariantType.UInt32)]
        request.Parameters.MethodsToCall = [wanted]
        return (await send(client, request, ua.CallResponse)).Results[0]

    of_type = ua.NodeId(ua.ObjectIds.ServerType_GetMonitoredItems)
    async with hardened.connected() as client:
        own = await call(server, ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems))
        assert own == "BadSubscriptionIdInvalid"
        assert await call(server, of_type) == own
        # The arguments were right, and what came of them was not.
        assert [each.name for each in (await answer(server, of_type)).InputArgumentResults] == ["Good"]
        assert await call(ua.NodeId(ua.ObjectIds.ObjectsFolder), of_type) == "BadMethodInvalid"
        assert await call(server, ua.NodeId(ua.ObjectIds.FileType_Open)) == "BadMethodInvalid"
        assert await call(server, ua.NodeId(ua.ObjectIds.ServerType)) == "BadMethodInvalid"
        # In the type it is there, as the standard has it, and nobody can execute it.
        assert (await read(client, of_type, 21)).Value.Value is True
        assert (await read(client, of_type, 22)).Value.Value is False
        assert await call(ua.NodeId(ua.ObjectIds.ServerType), of_type) == "BadNotImplemented"
