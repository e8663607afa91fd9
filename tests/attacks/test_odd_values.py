"""Values of every built-in type, odd ones too, written to every kind of node and given to every Method."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest

from tests.attacks.harness import ROBOTS, AttackedServer, Attacker, attacked, binary, ua
from tests.attacks.odd_values import odd_variants

TYPES = [
    *("Boolean", "SByte", "Byte", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
    *("Float", "Double", "String", "DateTime", "ByteString"),
]
NODES = {
    f"{kind}{'s' * array}": {"id": 2000 + 2 * number + array, "type": kind, "array": bool(array), "origin": "server"}
    for number, kind in enumerate(TYPES)
    for array in (0, 1)
}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    robots: dict[str, Any] = {"rover": {**ROBOTS["rover"], "data": {**ROBOTS["rover"]["data"], **NODES}}}
    with attacked(tmp_path_factory.mktemp("odd"), robots=robots) as running:
        yield running


def mistakes(server: AttackedServer) -> Any:
    """What `ServerStatus` says of them; it is brought up to date once a second."""
    with server.logged_in("olga", "127.0.0.9") as client:
        request = ua.ReadRequest()
        names = ("Server.Mistakes", "Server.LastMistake")
        request.Parameters.NodesToRead = [ua.ReadValueId(ua.NodeId(name, 2), ua.AttributeIds.Value) for name in names]
        return [result.Value.Value for result in client.call(request, ua.ReadResponse).Results]


def write(client: Attacker, node_id: bytes, variants: list[bytes]) -> list[str]:
    """Write these Variants to a node in one request; the StatusCodes, or the one of the request."""
    operations = [node_id + struct.pack("<Ii", 13, -1) + b"\1" + variant for variant in variants]
    head = binary.struct_to_binary(ua.WriteRequest(RequestHeader=client.header()))[:-4]
    client.send(head + struct.pack("<i", len(operations)) + b"".join(operations))
    return codes(client.answer(), ua.WriteResponse)


def codes(answer: bytes, response: Any) -> list[str]:
    assert answer, "the connection was closed"
    kind = binary.nodeid_from_binary(ua.utils.Buffer(answer))
    if kind == ua.NodeId(ua.ObjectIds.ServiceFault_Encoding_DefaultBinary):
        fault = binary.struct_from_binary(ua.ServiceFault, ua.utils.Buffer(answer))
        return [str(fault.ResponseHeader.ServiceResult.name)]
    results = binary.struct_from_binary(response, ua.utils.Buffer(answer)).Results
    return [str(getattr(result, "StatusCode", result).name) for result in results]


def test_odd_values_are_written_to_every_kind_of_node(server: AttackedServer) -> None:
    got = Counter[str]()
    variants = [variant for _, variant in odd_variants()]
    with server.logged_in("oscar") as client:
        for node in NODES.values():
            got.update(write(client, struct.pack("<BBH", 1, 2, node["id"]), variants))
    assert set(got) == {"Good", "BadTypeMismatch", "BadOutOfRange"}, got
    assert got["Good"] > 60
    assert mistakes(server) == [0, ""], server.log[-3_000:]


@pytest.mark.parametrize("data", [b"\xff\xfe", b"\xed\xa0\x80", b"ok\xc3", b"\xc0\x80"])
def test_what_is_no_utf8_is_refused(server: AttackedServer, data: bytes) -> None:
    """It was Bad_InternalError, and a mistake of the server."""
    text = struct.pack("<i", len(data)) + data
    carriers = [b"\x0c" + text, b"\x8c" + struct.pack("<i", 1) + text, b"\x15\2" + text, b"\x14\0\0" + text]
    carriers += [b"\x11\3\2\0" + text, b"\x12\x80\1" + text, b"\x10" + text]
    with server.logged_in("oscar") as client:
        for carrier in carriers:
            assert write(client, b"\1\2\xeb\3", [carrier]) == ["BadDecodingError"], carrier
        bytes_of_any_kind = b"\x0f" + text
        assert write(client, b"\1\2\xec\3", [bytes_of_any_kind]) == ["Good"]
    assert mistakes(server) == [0, ""], server.log[-3_000:]


METHODS = {
    "Fleet": ("RegisterRobot", "UnregisterRobot", "OfferSkill", "WithdrawSkill"),
    "Fleet.Scenarios": ("List", "Validate", "Run", "Pause", "Resume", "Abort", "Answer", "DryRun", "TellEvent"),
    "Fleet.Resilience": ("Confirm", "WhatIf", "SetJudgements", "SetMode"),
    "Fleet.Faults": ("RaiseFault", "ClearFault"),
}


def test_odd_values_are_given_to_every_method(server: AttackedServer) -> None:
    got = Counter[str]()
    with server.logged_in("eva") as client:
        methods = [
            (ua.NodeId(owner, 2), ua.NodeId(f"{owner}.{name}", 2)) for owner, names in METHODS.items() for name in names
        ]
        methods += standard_methods(client)
        for owner, method in methods:
            declared = inputs(client, method)
            for position in range(max(1, len(declared))):
                calls = [
                    [*declared[:position], odd, *declared[position + 1 :]]
                    for _, odd in odd_variants()
                    if len(odd) < 1_000
                ]
                for at in range(0, len(calls), 100):
                    got.update(call(client, owner, method, calls[at : at + 100]))
    print(got)
    assert not {code for code in got if "Internal" in code or "Unexpected" in code}, got
    assert mistakes(server) == [0, ""], server.log[-3_000:]


def standard_methods(client: Attacker) -> list[tuple[Any, Any]]:
    """GetMonitoredItems, ResendData and ConditionRefresh."""
    return [
        (ua.NodeId(2253), ua.NodeId(11492)),
        (ua.NodeId(2253), ua.NodeId(12873)),
        (ua.NodeId(2782), ua.NodeId(3875)),
    ]


def inputs(client: Attacker, method: Any) -> list[bytes]:
    """A harmless value for each InputArgument of a Method."""
    request = ua.BrowseRequest()
    request.Parameters.NodesToBrowse = [
        ua.BrowseDescription(method, ua.BrowseDirection.Forward, ua.NodeId(46), True, 0, 63)
    ]
    found = client.call(request, ua.BrowseResponse).Results[0]
    for reference in found.References:
        if reference.BrowseName.Name == "InputArguments":
            read = ua.ReadRequest()
            read.Parameters.NodesToRead = [ua.ReadValueId(reference.NodeId, ua.AttributeIds.Value)]
            arguments = client.call(read, ua.ReadResponse).Results[0].Value.Value
            return [harmless(each.DataType.Identifier, each.ValueRank) for each in arguments]
    return []


def harmless(kind: int, rank: int) -> bytes:
    kind = kind if kind <= 25 else 7  # IntegerId
    if rank >= 0:
        return bytes((kind | 0x80,)) + struct.pack("<i", 0)
    texts = {12: b"\0\0\0\0", 15: b"\0\0\0\0"}
    return bytes((kind,)) + texts.get(kind, bytes({1: 1, 6: 4, 7: 4, 8: 8, 9: 8, 11: 8, 17: 2}.get(kind, 4)))


def call(client: Attacker, owner: Any, method: Any, calls: list[list[bytes]]) -> list[str]:
    each = binary.nodeid_to_binary(owner) + binary.nodeid_to_binary(method)
    body = b"".join(each + struct.pack("<i", len(arguments)) + b"".join(arguments) for arguments in calls)
    head = binary.struct_to_binary(ua.CallRequest(RequestHeader=client.header()))[:-4]
    client.send(head + struct.pack("<i", len(calls)) + body)
    return codes(client.answer(), ua.CallResponse)
