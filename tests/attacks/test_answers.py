"""Small requests for large answers, by clients who may do nothing but look."""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.attacks.harness import AttackedServer, Attacker, attacked, binary, ua

IMAGE: Any = ua.NodeId(1004, 2)
SCAN: Any = ua.NodeId(1005, 2)
GOAL: Any = ua.NodeId(1002, 2)
MOST = 10_000
"""Operations of one request."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    """With an image of 50 KB and a scan of 6,000 numbers, since what clients write has to fit into a datagram."""
    with attacked(tmp_path_factory.mktemp("attacked")) as running:
        with running.logged_in("oscar") as operator:
            assert write(operator, IMAGE, ua.Variant(bytes(50_000), ua.VariantType.ByteString)) == "Good"
            assert write(operator, SCAN, ua.Variant([1.5] * 6_000, ua.VariantType.Double)) == "Good"
        yield running


def write(client: Attacker, node_id: Any, variant: Any) -> str:
    request = ua.WriteRequest()
    request.Parameters.NodesToWrite = [ua.WriteValue(node_id, ua.AttributeIds.Value, None, ua.DataValue(variant))]
    written = client.call(request, ua.WriteResponse)
    return written if isinstance(written, str) else str(written.Results[0].name)


def read(nodes: list[Any], attribute: Any = ua.AttributeIds.Value) -> Any:
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [ua.ReadValueId(node_id, attribute) for node_id in nodes]
    return request


def browse(nodes: list[Any], most: int = 0) -> Any:
    request = ua.BrowseRequest()
    request.Parameters.RequestedMaxReferencesPerNode = most
    request.Parameters.NodesToBrowse = [
        ua.BrowseDescription(NodeId=node_id, BrowseDirection=ua.BrowseDirection.Both, ResultMask=63)
        for node_id in nodes
    ]
    return request


def named(results: list[Any]) -> dict[str, int]:
    """How often each StatusCode."""
    counts: dict[str, int] = {}
    for result in results:
        counts[result.StatusCode.name] = counts.get(result.StatusCode.name, 0) + 1
    return counts


@pytest.mark.parametrize("node", [IMAGE, SCAN], ids=["image", "scan"])
def test_a_large_node_is_read_ten_thousand_times(server: AttackedServer, node: Any) -> None:
    with server.harm() as harm, server.logged_in() as client:
        answer = client.call(read([GOAL, *[node] * (MOST - 2), GOAL]), ua.ReadResponse)
    harm.check()
    codes = named(answer.Results)
    assert codes["Good"] > 150
    assert codes["BadEncodingLimitsExceeded"] > 9_000
    assert len(answer.Results) == MOST


def test_large_values_of_one_request_come_whole(server: AttackedServer) -> None:
    with server.logged_in() as client:
        answer = client.call(read([IMAGE, SCAN, GOAL]), ua.ReadResponse)
    assert [len(answer.Results[0].Value.Value), len(answer.Results[1].Value.Value)] == [50_000, 6_000]
    assert named(answer.Results) == {"Good": 3}


def test_a_large_type_is_browsed_ten_thousand_times(server: AttackedServer) -> None:
    with server.harm() as harm, server.logged_in() as client:
        answer = client.call(browse([ua.NodeId(58)] * MOST), ua.BrowseResponse)
    harm.check()
    codes = named(answer.Results)
    assert codes["Good"] + codes["BadNoContinuationPoints"] == MOST
    assert codes["BadNoContinuationPoints"] > 5_000
    points = [result for result in answer.Results if result.ContinuationPoint]
    assert len(points) == 10


def test_what_did_not_fit_is_browsed_with_continuation_points(server: AttackedServer) -> None:
    def taken(client: Attacker, results: list[Any]) -> list[Any]:
        request = ua.BrowseNextRequest()
        request.Parameters.ReleaseContinuationPoints = False
        request.Parameters.ContinuationPoints = [result.ContinuationPoint for result in results]
        answer = client.call(request, ua.BrowseNextResponse)
        assert named(answer.Parameters.Results) == {"Good": len(results)}
        return list(answer.Parameters.Results)

    with server.logged_in() as client:
        whole = client.call(browse([ua.NodeId(58)]), ua.BrowseResponse).Results[0].References
        answer = client.call(browse([ua.NodeId(58)] * MOST), ua.BrowseResponse)
        for result in answer.Results:
            if result.StatusCode.is_good() and not result.ContinuationPoint:
                assert len(result.References) == len(whole)
        open_results = [result for result in answer.Results if result.ContinuationPoint]
        found = [list(result.References) for result in open_results]
        for references, result in zip(found, taken(client, open_results), strict=True):
            references += result.References
            assert not result.ContinuationPoint
        assert all(references == whole for references in found)


def test_paths_are_translated_ten_thousand_times(server: AttackedServer) -> None:
    """Up and down again: each element leads to all subtypes of BaseObjectType, or back."""
    element = ua.RelativePathElement(ua.NodeId(45), False, True, ua.QualifiedName("BaseEventType", 0))
    back = ua.RelativePathElement(ua.NodeId(45), True, True, ua.QualifiedName("BaseObjectType", 0))
    path = ua.BrowsePath(ua.NodeId(58), ua.RelativePath([element, back] * 3))
    request = ua.TranslateBrowsePathsToNodeIdsRequest()
    request.Parameters.BrowsePaths = [path] * 2_000
    with server.harm() as harm, server.logged_in() as client:
        client.call(request, ua.TranslateBrowsePathsToNodeIdsResponse)
    harm.check()


def test_methods_are_called_no_more_often_than_is_advertised(server: AttackedServer) -> None:
    def call(client: Attacker, count: int) -> Any:
        request = ua.CallRequest()
        wanted = ua.CallMethodRequest(ua.NodeId("Fleet.Resilience", 2), ua.NodeId("Fleet.Resilience.WhatIf", 2))
        wanted.InputArguments = [ua.Variant("rover", ua.VariantType.String)]
        request.Parameters.MethodsToCall = [wanted] * count
        return client.call(request, ua.CallResponse)

    with server.harm() as harm, server.logged_in() as client:
        limit = client.call(read([ua.NodeId(11709)]), ua.ReadResponse).Results[0].Value.Value
        assert call(client, MOST) == "BadTooManyOperations"
        for _ in range(20):
            assert named(call(client, limit).Results) == {"Good": limit}
    harm.check()


def test_what_if_of_a_robot_with_thousands_of_tasks(server: AttackedServer) -> None:
    """1,600 tasks took 18 s in one go: each was ranked, and all were counted for each."""

    def call(client: Attacker, where: str, name: str, *texts: str) -> Any:
        inputs = [ua.Variant(text, ua.VariantType.String) for text in texts]
        inputs += [ua.Variant([], ua.VariantType.String, None, True)] * (2 if name == "Run" else 0)
        method = ua.NodeId(f"Fleet.{where}.{name}", 2)
        wanted = ua.CallMethodRequest(ua.NodeId(f"Fleet.{where}", 2), method, InputArguments=inputs)
        request = ua.CallRequest()
        request.Parameters.MethodsToCall = [wanted]
        return [output.Value for output in client.call(request, ua.CallResponse).Results[0].OutputArguments]

    tasks = "".join(f"  - {{task: t{number}, skill: go, robot: rover}}\n" for number in range(500))
    with server.logged_in("oscar", "127.0.0.4") as operator:
        run_ids = [call(operator, "Scenarios", "Run", f"version: 1\nname: long\nsteps:\n{tasks}")[0] for _ in range(8)]
        assert all(run_ids)
        with server.harm() as harm, contextlib.ExitStack() as stack:
            clients = [stack.enter_context(server.logged_in()) for _ in range(5)]
            for client in clients:
                runs, *_, status, message = call(client, "Resilience", "WhatIf", "rover")
                assert status == 0
                assert len(runs) <= 500
                assert "of 4000 tasks" in message
        harm.check()
        for run_id in run_ids:
            call(operator, "Scenarios", "Abort", run_id, "")


def test_nobody_waits_for_the_answers_of_who_has_left(server: AttackedServer) -> None:
    before = server.computed_s()
    with server.harm() as harm:
        for _ in range(20):
            with server.logged_in() as client:
                request = browse([ua.NodeId(58)] * MOST)
                request.RequestHeader = client.header()
                client.send(binary.struct_to_binary(request))
    harm.check()
    assert server.computed_s() - before < 20


def subscribe(client: Attacker, items: list[Any]) -> Any:
    created = client.call(
        ua.CreateSubscriptionRequest(
            Parameters=ua.CreateSubscriptionParameters(
                RequestedPublishingInterval=50.0,
                RequestedLifetimeCount=10_000,
                RequestedMaxKeepAliveCount=3,
                PublishingEnabled=True,
            )
        ),
        ua.CreateSubscriptionResponse,
    )
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = created.Parameters.SubscriptionId
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    request.Parameters.ItemsToCreate = items
    return client.call(request, ua.CreateMonitoredItemsResponse)


def item(node_id: Any, attribute: Any = ua.AttributeIds.Value, wanted: Any = None) -> Any:
    parameters = ua.MonitoringParameters(1, 0.0, wanted, 100, True)
    return ua.MonitoredItemCreateRequest(ua.ReadValueId(node_id, attribute), ua.MonitoringMode.Reporting, parameters)


def test_large_nodes_are_watched_and_never_acknowledged(server: AttackedServer) -> None:
    with server.harm() as harm, server.logged_in() as client, server.logged_in("oscar") as operator:
        for made in range(20):
            results = subscribe(client, [item(IMAGE)] * 500 + [item(SCAN)] * 500).Results
            good = 200 if made == 0 else 0  # 100 of a user on each of the two nodes
            assert named(results) == ({"Good": good} if good else {}) | {"BadTooManyMonitoredItems": 1000 - good}
        for number in range(30):
            image = ua.Variant(number.to_bytes(4, "little") * 12_500, ua.VariantType.ByteString)
            assert write(operator, IMAGE, image) == "Good"
        told, end = 0, time.monotonic() + 60
        while told < 15:  # those without items say in between that they live, more often on a busy machine
            assert time.monotonic() < end, told
            published = client.call(ua.PublishRequest(), ua.PublishResponse)
            told += len(published.Parameters.NotificationMessage.NotificationData)
        assert told == 15
    harm.check()


def test_what_an_event_field_is_called_blinds_nobody(server: AttackedServer) -> None:
    """Names of asyncua's own attributes, nulls, and attributes that there are not, as fields of events."""
    bad = [
        *[ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(name, 0)], AttributeId=13) for name in NAMES],
        ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(None, 0)], AttributeId=13),
        ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName("Time", 0), ua.QualifiedName(None, 0)], AttributeId=13),
        ua.SimpleAttributeOperand(BrowsePath=[], AttributeId=99),
        ua.SimpleAttributeOperand(BrowsePath=[], AttributeId=1),
    ]
    good = [ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName("Message", 0)], AttributeId=13)]
    with server.harm() as harm, server.logged_in() as attacker, server.logged_in("eva") as engineer:
        for fields in (bad, good, bad):
            wanted = ua.EventFilter(SelectClauses=fields)
            client = engineer if fields is good else attacker
            results = subscribe(client, [item(ua.NodeId(2253), ua.AttributeIds.EventNotifier, wanted)]).Results
            assert named(results) == {"Good": 1}
        request = ua.CallRequest()
        fault = ua.CallMethodRequest(ua.NodeId("Fleet.Faults", 2), ua.NodeId("Fleet.Faults.RaiseFault", 2))
        fault.InputArguments = [ua.Variant(text, ua.VariantType.String) for text in ("rover", "drill")]
        request.Parameters.MethodsToCall = [fault]
        assert named(engineer.call(request, ua.CallResponse).Results) == {"Good": 1}
        for client, count in ((engineer, 1), (attacker, len(bad))):
            published = client.call(ua.PublishRequest(), ua.PublishResponse)
            events = published.Parameters.NotificationMessage.NotificationData[0].Events
            assert len(events[0].EventFields) == count
    harm.check()


NAMES = ("data_types", "__class__", "to_event_fields", "emitting_node", "select_clauses", "__dict__", "NoSuchField")


def test_a_hundred_connections_ask_for_endpoints(server: AttackedServer) -> None:
    request = ua.GetEndpointsRequest()
    with server.harm() as harm:
        for _ in range(10):
            with server.connected() as client:
                request.RequestHeader = client.header()
                body = binary.struct_to_binary(request)
                for _ in range(90):
                    client.send(body)
                for _ in range(90):
                    assert client.answer()
    harm.check()


def test_a_write_of_all_that_a_message_holds(server: AttackedServer) -> None:
    """Structures, numbers and dimensions up to the limit of the message, for nodes of other types."""
    bombs = (
        b"\x97" + struct.pack("<i", 18_000) + bytes(18_000),
        b"\x84" + struct.pack("<i", 1_300_000) + b"\x80\x80" * 1_300_000,
        b"\x82" + struct.pack("<i", 1_300_000) + b"\x80" * 1_300_000,
        b"\x0c" + struct.pack("<i", 3_000_000) + b"a" * 2_999_996 + "\U0001f600".encode(),
        b"\x98" + struct.pack("<i", 70_000) + bytes(70_000),
    )
    with server.harm() as harm, server.logged_in("oscar") as client:
        for bomb in bombs:
            for node_id in (b"\1\2\xea\3", b"\1\2\xeb\3"):  # goal and name
                operation = node_id + struct.pack("<Ii", 13, -1) + b"\1" + bomb
                request = ua.WriteRequest(RequestHeader=client.header())
                head = binary.struct_to_binary(request)[:-4]
                client.send(head + struct.pack("<i", 1) + operation)
                assert client.answer()
    harm.check()


def test_ten_sessions_hold_no_more_than_one(server: AttackedServer) -> None:
    """As many sessions as a user may have ask for as much as an answer holds, and none reads it."""
    with server.harm("olga") as harm, contextlib.ExitStack() as stack:
        clients = [stack.enter_context(server.logged_in()) for _ in range(10)]
        for client in clients:
            request = read([IMAGE] * 1_000)
            request.RequestHeader = client.header()
            client.send(binary.struct_to_binary(request))
        with server.logged_in("oscar") as other:
            answer = other.call(read([IMAGE] * 20), ua.ReadResponse)
            assert named(answer.Results) == {"Good": 20}
    harm.check()
    with server.logged_in() as client:
        assert named(client.call(read([IMAGE] * 20), ua.ReadResponse).Results) == {"Good": 20}


def test_ten_sessions_write_all_that_a_message_holds(server: AttackedServer) -> None:
    operation = b"\1\2\xea\3" + struct.pack("<Ii", 13, -1) + b"\1"
    operation += b"\x84" + struct.pack("<i", 1_300_000) + b"\x80\x80" * 1_300_000
    with server.harm() as harm, contextlib.ExitStack() as stack:
        clients = [stack.enter_context(server.logged_in("oscar")) for _ in range(8)]
        for client in clients:
            head = binary.struct_to_binary(ua.WriteRequest(RequestHeader=client.header()))[:-4]
            client.send(head + struct.pack("<i", 1) + operation)
        for client in clients:
            assert client.answer()
    harm.check()
