"""Bombs, nulls and nonsense of a client who is logged in, in every service: each gets an answer, none is a mistake."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import pytest

from tests.attacks.bombs import BombMaker
from tests.attacks.harness import AttackedServer, attacked, binary, ua

SERVICES = (
    *("Read", "Write", "HistoryRead", "Browse", "BrowseNext", "TranslateBrowsePathsToNodeIds", "RegisterNodes"),
    *("UnregisterNodes", "Call", "CreateSubscription", "ModifySubscription", "DeleteSubscriptions"),
    *("SetPublishingMode", "TransferSubscriptions", "Publish", "Republish", "CreateMonitoredItems"),
    *("ModifyMonitoredItems", "SetMonitoringMode", "DeleteMonitoredItems", "GetEndpoints", "FindServers"),
)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    with attacked(tmp_path_factory.mktemp("attacked")) as running:
        yield running


@pytest.mark.parametrize("user", [None, "eva"])
def test_fuzzed_requests_of_a_session_are_answered(server: AttackedServer, user: str | None) -> None:
    maker = BombMaker(23, 3_000)
    with server.harm("oscar") as harm:
        for _ in range(25):
            with server.logged_in(user) as client:
                header = binary.struct_to_binary(client.header())
                for _ in range(60):
                    name = maker.random.choice(SERVICES)
                    kind = getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")
                    body = b"\1\0" + struct.pack("<H", kind) + header
                    client.send(body + maker.parameters(getattr(ua, f"{name}Parameters")))
                    # What a subscription tells comes later, or not at all.
                    assert name == "Publish" or client.answer(), name
    harm.check()
    assert "a mistake cost one item" not in server.log


def test_nulls_in_every_service_are_answered(server: AttackedServer) -> None:
    """All bytes 0, and all 0xFF: null and empty strings, arrays, NodeIds and structures wherever they may be."""
    with server.harm() as harm, server.logged_in("eva") as client:
        header = binary.struct_to_binary(client.header())
        for name in SERVICES:
            kind = getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")
            for body in (bytes(200), b"\xff" * 200, b"\1\0\0\0" + bytes(200), bytes(4) + b"\1" + bytes(200), b""):
                client.send(b"\1\0" + struct.pack("<H", kind) + header + body)
                assert name == "Publish" or client.answer(), name
    harm.check()
    assert "a mistake cost one item" not in server.log


def test_nulls_beside_what_there_is_are_answered(server: AttackedServer) -> None:
    """Nodes, methods and subscriptions that exist, with nulls for all that may be null beside them."""
    with server.harm() as harm, server.logged_in("eva") as client:
        created = client.call(
            ua.CreateSubscriptionRequest(Parameters=ua.CreateSubscriptionParameters(PublishingEnabled=True)),
            ua.CreateSubscriptionResponse,
        )
        subscription = created.Parameters.SubscriptionId
        goal, events = ua.NodeId(1002, 2), ua.NodeId(2253)
        null_name = ua.QualifiedName(None, 0)
        operand = ua.SimpleAttributeOperand(BrowsePath=[null_name, null_name], AttributeId=13)
        element = ua.ContentFilterElement(ua.FilterOperator.Equals, [operand, ua.LiteralOperand()])
        filters = (
            None,
            ua.ExtensionObject(),
            ua.DataChangeFilter(),
            ua.EventFilter(),
            ua.EventFilter([operand], ua.ContentFilter([element])),
            ua.EventFilter([ua.SimpleAttributeOperand()], ua.ContentFilter([ua.ContentFilterElement()])),
        )
        values = (
            ua.DataValue(),
            ua.DataValue(ua.Variant(None, ua.VariantType.Double, None, True)),
            ua.DataValue(ua.Variant(None, ua.VariantType.String)),
            ua.DataValue(ua.Variant(None, ua.VariantType.DateTime, None, True)),
            ua.DataValue(ua.Variant(None, ua.VariantType.ExtensionObject)),
            ua.DataValue(ua.Variant([None, None], ua.VariantType.String)),
            ua.DataValue(ua.Variant(ua.LocalizedText(), ua.VariantType.LocalizedText)),
        )
        methods = ("Fleet.Resilience.WhatIf", "Fleet.Faults.RaiseFault", "Fleet.RegisterRobot", "Fleet.Scenarios.Run")
        requests = [
            *_each(ua.ReadRequest, NodesToRead=[[ua.ReadValueId(goal, a, None, null_name)] for a in range(30)]),
            *_each(ua.WriteRequest, NodesToWrite=[[ua.WriteValue(goal, 13, None, value)] for value in values]),
            *_each(
                ua.WriteRequest, NodesToWrite=[[ua.WriteValue(ua.NodeId(1003, 2), 13, None, value)] for value in values]
            ),
            *_each(
                ua.CallRequest,
                MethodsToCall=[
                    [
                        ua.CallMethodRequest(
                            ua.NodeId(name.rpartition(".")[0], 2), ua.NodeId(name, 2), [value.Value] * count
                        )
                    ]
                    for name in methods
                    for value in values
                    for count in range(4)
                ],
            ),
            *_each(
                ua.CreateMonitoredItemsRequest,
                SubscriptionId=[subscription],
                TimestampsToReturn=[ua.TimestampsToReturn.Both],
                ItemsToCreate=[
                    [
                        ua.MonitoredItemCreateRequest(
                            ua.ReadValueId(node, attribute, None, null_name),
                            ua.MonitoringMode.Reporting,
                            ua.MonitoringParameters(1, float("nan"), wanted, 0, True),
                        )
                    ]
                    for node, attribute in ((goal, 13), (goal, 4), (events, 12), (events, 13), (ua.NodeId(), 13))
                    for wanted in filters
                ],
            ),
            *_each(ua.BrowseRequest, NodesToBrowse=[[ua.BrowseDescription(node)] for node in (goal, ua.NodeId())]),
            *_each(
                ua.TranslateBrowsePathsToNodeIdsRequest,
                BrowsePaths=[
                    [ua.BrowsePath(goal, ua.RelativePath(elements))]
                    for elements in ([], [ua.RelativePathElement()], [ua.RelativePathElement(TargetName=null_name)] * 3)
                ],
            ),
            *_each(ua.HistoryReadRequest, NodesToRead=[[ua.HistoryReadValueId(goal)], [ua.HistoryReadValueId()]]),
        ]
        assert len(requests) > 150
        for request in requests:
            assert client.ask(request), request
        fault = ua.CallMethodRequest(ua.NodeId("Fleet.Faults", 2), ua.NodeId("Fleet.Faults.RaiseFault", 2))
        fault.InputArguments = [ua.Variant(text, ua.VariantType.String) for text in ("rover", "drill")]
        for request in _each(ua.CallRequest, MethodsToCall=[[fault]]):
            assert client.ask(request)
        published = client.call(ua.PublishRequest(), ua.PublishResponse)
        assert published.Parameters.NotificationMessage.NotificationData
    harm.check()
    assert "a mistake cost one item" not in server.log


def _each(request: Any, **parameters: list[Any]) -> Iterator[Any]:
    """A request for each of the values of its last parameter; the others have one."""
    *first, (name, values) = parameters.items()
    for value in values:
        made = request()
        for other, (only,) in first:
            setattr(made.Parameters, other, only)
        setattr(made.Parameters, name, value)
        yield made
