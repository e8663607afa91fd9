"""What the server advertises is what it enforces."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.server_security.harness import Client, Door, Identities, Stock, bad, door, send, ua

pytestmark = pytest.mark.asyncio(loop_scope="module")

LIMITS = {
    "nodes_per_request": 20,
    "sessions": 7,
    "subscriptions_per_session": 3,
    "monitored_items_per_subscription": 5,
    "continuation_points": 2,
    "references_per_node": 25,
    "queue_size": 4,
    "event_queue_size": 3,
}


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def small(tmp_path_factory: pytest.TempPathFactory, identities: Identities) -> AsyncGenerator[Door]:
    """A server with small limits."""
    async with door(tmp_path_factory.mktemp("small"), identities, limits=LIMITS) as running:
        yield running


async def test_advertised_limits_are_the_real_ones(small: Door) -> None:
    expected = {
        "MaxSessions": 7,
        "MaxSubscriptionsPerSession": 3,
        "MaxSubscriptions": 21,
        "MaxMonitoredItemsPerSubscription": 5,
        "MaxBrowseContinuationPoints": 2,
        "MaxMonitoredItemsQueueSize": 4,
        "OperationLimits_MaxNodesPerRead": 20,
        "OperationLimits_MaxNodesPerWrite": 20,
        "OperationLimits_MaxNodesPerBrowse": 20,
        "OperationLimits_MaxNodesPerMethodCall": 20,
        "OperationLimits_MaxNodesPerRegisterNodes": 20,
        "OperationLimits_MaxNodesPerTranslateBrowsePathsToNodeIds": 20,
        "OperationLimits_MaxMonitoredItemsPerCall": 20,
        "OperationLimits_MaxNodesPerHistoryReadData": 20,
        "OperationLimits_MaxNodesPerHistoryReadEvents": 20,
    }
    async with small.connected("olga") as client:
        for name, value in expected.items():
            node = client.get_node(ua.NodeId(getattr(ua.ObjectIds, f"Server_ServerCapabilities_{name}")))
            assert (name, await node.read_value()) == (name, value)


def requests(nodes: Any, count: int, subscription: int = 0) -> dict[str, tuple[Any, Any]]:
    """A request of each service with so many operations, and the class of its response."""
    both = ua.TimestampsToReturn.Both
    built: dict[str, tuple[Any, Any]] = {}
    read = ua.ReadRequest()
    read.Parameters.NodesToRead = [ua.ReadValueId(nodes.plain, ua.AttributeIds.Value)] * count
    read.Parameters.TimestampsToReturn = both
    built["Read"] = read, ua.ReadResponse
    write = ua.WriteRequest()
    write.Parameters.NodesToWrite = [ua.WriteValue(nodes.plain, ua.AttributeIds.Value, None, ua.DataValue())] * count
    built["Write"] = write, ua.WriteResponse
    browse = ua.BrowseRequest()
    browse.Parameters.View.Timestamp = ua.get_win_epoch()
    browse.Parameters.NodesToBrowse = [ua.BrowseDescription(nodes.plain, IncludeSubtypes=True)] * count
    built["Browse"] = browse, ua.BrowseResponse
    following = ua.BrowseNextRequest()
    following.Parameters.ContinuationPoints = [b"none"] * count
    built["BrowseNext"] = following, ua.BrowseNextResponse
    translate = ua.TranslateBrowsePathsToNodeIdsRequest()
    path = ua.BrowsePath(nodes.plain)
    path.RelativePath.Elements = [ua.RelativePathElement(TargetName=ua.QualifiedName("x", 2))]
    translate.Parameters.BrowsePaths = [path] * count
    built["Translate"] = translate, ua.TranslateBrowsePathsToNodeIdsResponse
    call = ua.CallRequest()
    call.Parameters.MethodsToCall = [ua.CallMethodRequest(nodes.folder, nodes.folder)] * count
    built["Call"] = call, ua.CallResponse
    register = ua.RegisterNodesRequest()
    register.Parameters.NodesToRegister = [nodes.plain] * count
    built["RegisterNodes"] = register, ua.RegisterNodesResponse
    items = ua.CreateMonitoredItemsRequest()
    items.Parameters.SubscriptionId = subscription
    items.Parameters.TimestampsToReturn = both
    items.Parameters.ItemsToCreate = [monitored(nodes.plain)] * count
    built["CreateMonitoredItems"] = items, ua.CreateMonitoredItemsResponse
    links = ua.SetTriggeringRequest()
    links.Parameters.SubscriptionId, links.Parameters.TriggeringItemId = subscription, 1
    links.Parameters.LinksToAdd, links.Parameters.LinksToRemove = [1] * (count // 2), [1] * (count - count // 2)
    built["SetTriggering"] = links, ua.SetTriggeringResponse
    history = ua.HistoryReadRequest()
    history.Parameters.HistoryReadDetails = ua.ReadRawModifiedDetails()
    history.Parameters.TimestampsToReturn = both
    history.Parameters.ReleaseContinuationPoints = False
    history.Parameters.NodesToRead = [ua.HistoryReadValueId(nodes.plain)] * count
    built["HistoryRead"] = history, ua.HistoryReadResponse
    return built


def monitored(node_id: Any, **parameters: Any) -> Any:
    item = ua.MonitoredItemCreateRequest()
    item.ItemToMonitor.NodeId = node_id
    item.ItemToMonitor.AttributeId = ua.AttributeIds.Value
    item.MonitoringMode = ua.MonitoringMode.Reporting
    item.RequestedParameters.QueueSize = 1
    for name, value in parameters.items():
        setattr(item.RequestedParameters, name, value)
    return item


async def create_subscription(client: Client, **options: Any) -> Any:
    request = ua.CreateSubscriptionRequest()
    request.Parameters.RequestedPublishingInterval = 10
    request.Parameters.RequestedLifetimeCount = 3000
    request.Parameters.RequestedMaxKeepAliveCount = 100
    request.Parameters.PublishingEnabled = True
    for name, value in options.items():
        setattr(request.Parameters, name, value)
    return (await send(client, request, ua.CreateSubscriptionResponse)).Parameters


async def test_too_many_operations(small: Door) -> None:
    """Stock asyncua advertises 10,000 and serves 20,000."""
    async with small.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        for name, (request, response) in requests(small.nodes, 21, subscription).items():
            assert (name, await bad(send(client, request, response))) == (name, "BadTooManyOperations")
        for name, (request, response) in requests(small.nodes, 20, subscription).items():
            assert (name, await bad(send(client, request, response))) == (name, "Good")
        for name, (request, response) in requests(small.nodes, 0, subscription).items():
            assert (name, await bad(send(client, request, response))) == (name, "BadNothingToDo")


async def test_too_many_operations_stock(plain: Stock) -> None:
    async with plain.client() as client:
        request, response = requests(plain.nodes, 10_001)["Read"]
        assert len((await send(client, request, response)).Results) == 10_001


async def test_too_many_subscriptions_and_items(small: Door) -> None:
    async with small.connected() as client:
        first = (await create_subscription(client)).SubscriptionId
        await create_subscription(client)
        await create_subscription(client)
        assert await bad(create_subscription(client)) == "BadTooManySubscriptions"
        request, response = requests(small.nodes, 7, first)["CreateMonitoredItems"]
        results = (await send(client, request, response)).Results
        assert [str(result.StatusCode.name) for result in results] == ["Good"] * 5 + ["BadTooManyMonitoredItems"] * 2


async def test_requested_times_and_queues_are_revised(small: Door) -> None:
    """Stock asyncua takes any publishing interval, queue size 0 as endless in ModifyMonitoredItems, and no sampling."""
    async with small.connected() as client:
        revised = await create_subscription(
            client, RequestedPublishingInterval=0.0, RequestedLifetimeCount=4_000_000_000
        )
        assert revised.RevisedPublishingInterval == 10.0
        assert revised.RevisedLifetimeCount * revised.RevisedPublishingInterval <= 3_600_000
        request = ua.CreateMonitoredItemsRequest()
        request.Parameters.SubscriptionId = revised.SubscriptionId
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        request.Parameters.ItemsToCreate = [monitored(small.nodes.plain, QueueSize=1_000_000, SamplingInterval=100.0)]
        created = (await send(client, request, ua.CreateMonitoredItemsResponse)).Results[0]
        assert (created.RevisedQueueSize, created.RevisedSamplingInterval) == (4, 100.0)
        for asked, revised_size in ((0, 3), (1_000_000, 3), (2, 2)):  # with 0 the server decides
            request.Parameters.ItemsToCreate = [monitored(ua.NodeId(ua.ObjectIds.Server), QueueSize=asked)]
            request.Parameters.ItemsToCreate[0].ItemToMonitor.AttributeId = ua.AttributeIds.EventNotifier
            select = ua.SimpleAttributeOperand(ua.NodeId(ua.ObjectIds.BaseEventType), [ua.QualifiedName("Message")])
            request.Parameters.ItemsToCreate[0].RequestedParameters.Filter = ua.EventFilter([select])
            events = (await send(client, request, ua.CreateMonitoredItemsResponse)).Results[0]
            assert (events.StatusCode.is_good(), events.RevisedQueueSize) == (True, revised_size)
        modify = ua.ModifyMonitoredItemsRequest()
        modify.Parameters.SubscriptionId = revised.SubscriptionId
        modify.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        for item_id in (created.MonitoredItemId, 999):
            change = ua.MonitoredItemModifyRequest(item_id)
            change.RequestedParameters.QueueSize = 0
            modify.Parameters.ItemsToModify.append(change)
        results = (await send(client, modify, ua.ModifyMonitoredItemsResponse)).Results
        assert [(str(r.StatusCode.name), r.RevisedQueueSize) for r in results] == [
            ("Good", 1),
            ("BadMonitoredItemIdInvalid", 0),
        ]
        change = ua.ModifySubscriptionRequest()
        change.Parameters.SubscriptionId = revised.SubscriptionId
        change.Parameters.RequestedPublishingInterval = 500.0
        change.Parameters.RequestedLifetimeCount = 700
        answer = (await send(client, change, ua.ModifySubscriptionResponse)).Parameters
        assert (answer.RevisedPublishingInterval, answer.RevisedLifetimeCount) == (500.0, 700)
        # A client that wants to change another part leaves it out, as 0.
        change.Parameters.RequestedLifetimeCount = 0
        answer = (await send(client, change, ua.ModifySubscriptionResponse)).Parameters
        assert answer.RevisedLifetimeCount == 700


async def browse(client: Client, node_id: Any, portion: int = 0) -> Any:
    request = ua.BrowseRequest()
    request.Parameters.View.Timestamp = ua.get_win_epoch()
    request.Parameters.RequestedMaxReferencesPerNode = portion
    description = ua.BrowseDescription(node_id, ua.BrowseDirection.Forward, IncludeSubtypes=True)
    description.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HierarchicalReferences)
    description.ResultMask = 63
    request.Parameters.NodesToBrowse = [description]
    return (await send(client, request, ua.BrowseResponse)).Results[0]


async def browse_next(client: Client, *points: bytes, release: bool = False) -> list[Any]:
    request = ua.BrowseNextRequest()
    request.Parameters.ContinuationPoints = list(points)
    request.Parameters.ReleaseContinuationPoints = release
    return list((await send(client, request, ua.BrowseNextResponse)).Parameters.Results)


async def test_browse_in_portions(small: Door, plain: Stock) -> None:
    """Stock asyncua ignores RequestedMaxReferencesPerNode and knows no BrowseNext."""
    async with small.connected("olga") as client, small.connected() as other:
        result = await browse(client, small.nodes.folder, 12)
        names = [reference.BrowseName.Name for reference in result.References]
        sizes = [len(names)]
        while result.ContinuationPoint:
            point = result.ContinuationPoint
            assert (await browse_next(other, point))[0].StatusCode.name == "BadContinuationPointInvalid"
            (result,) = await browse_next(client, point)
            sizes.append(len(result.References))
            names += [reference.BrowseName.Name for reference in result.References]
            assert (await browse_next(client, point))[0].StatusCode.name == "BadContinuationPointInvalid"
        assert sizes == [12, 12, 6]
        assert sorted(names) == sorted(f"child{number}" for number in range(30))
        assert len((await browse(client, small.nodes.folder)).References) == 25
        # A point of an earlier request gives way, none of this one (OPC 10000-4 7.9).
        earlier = [(await browse(client, small.nodes.folder, 1)).ContinuationPoint for _ in range(2)]
        last = (await browse(client, small.nodes.folder, 1)).ContinuationPoint
        codes = [(await browse_next(client, point, release=True))[0].StatusCode.name for point in [*earlier, last]]
        assert codes == ["BadContinuationPointInvalid", "Good", "Good"]
        request = ua.BrowseRequest()
        request.Parameters.RequestedMaxReferencesPerNode = 1
        request.Parameters.NodesToBrowse = [ua.BrowseDescription(NodeId=small.nodes.folder, ResultMask=63)] * 3
        results = (await send(client, request, ua.BrowseResponse)).Results
        assert [len(result.References) for result in results] == [1, 1, 0]
        assert results[2].StatusCode.name == "BadNoContinuationPoints"
    async with small.connected("olga") as client:
        # asyncua's own client follows the continuation points.
        assert len(await client.get_node(small.nodes.folder).get_children()) == 30
        point = (await browse(client, small.nodes.folder, 1)).ContinuationPoint
        assert (await browse_next(client, point, release=True))[0].References == []
        assert (await browse_next(client, point))[0].StatusCode.name == "BadContinuationPointInvalid"
    async with plain.client() as client:
        assert len((await browse(client, plain.nodes.folder, 12)).References) == 30


async def test_paths_cannot_explode(small: Door) -> None:
    """Back and forth along all references visits each node once for each element, and paths have an end."""
    up = ua.RelativePathElement(ua.NodeId(ua.ObjectIds.Organizes), True, True, ua.QualifiedName("Root", 0))
    down = ua.RelativePathElement(ua.NodeId(ua.ObjectIds.Organizes), False, True, ua.QualifiedName("Objects", 0))
    request = ua.TranslateBrowsePathsToNodeIdsRequest()

    def path(*elements: Any) -> Any:
        built = ua.BrowsePath(ua.NodeId(ua.ObjectIds.ObjectsFolder))
        built.RelativePath.Elements = list(elements)
        return built

    request.Parameters.BrowsePaths = [path(*([up, down] * 30)), path(*([up, down] * 60)), path()]
    async with small.connected("olga") as client:
        results = (await send(client, request, ua.TranslateBrowsePathsToNodeIdsResponse)).Results
    assert [str(r.StatusCode.name) for r in results] == ["Good", "BadQueryTooComplex", "BadNothingToDo"]
    assert len(results[0].Targets) == 1


@pytest.mark.parametrize(
    ("index_range", "expected"),
    [
        ("2", [2]),
        ("2:4", [2, 3, 4]),
        ("8:100", [8, 9]),
        ("10", "BadIndexRangeNoData"),
        ("4:2", "BadIndexRangeInvalid"),
        ("x", "BadIndexRangeInvalid"),
        ("-1", "BadIndexRangeInvalid"),
        ("1,1", "BadIndexRangeNoData"),
    ],
)
async def test_index_range(small: Door, index_range: str, expected: Any) -> None:
    """Stock asyncua ignores it and returns the whole array as Good."""
    from tests.integration.server_security.test_access import read

    async with small.connected("olga") as client:
        value = await read(client, small.nodes.array, index_range=index_range)
        if isinstance(expected, str):
            content = value.Value.Value if value.Value is not None else None
            assert (str(value.StatusCode.name), content) == (expected, None)
        else:
            assert (str(value.StatusCode.name), value.Value.Value) == ("Good", expected)
        if index_range == "2:4":
            assert (await read(client, small.nodes.text, index_range="2:3")).Value.Value == "cd"
            scalar = await read(client, small.nodes.plain, index_range="0")
            assert str(scalar.StatusCode.name) == "BadIndexRangeNoData"


async def create(client: Client, node_id: Any, count: int) -> list[str]:
    """Watch a node by some items of a new subscription."""
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = (await create_subscription(client)).SubscriptionId
    request.Parameters.ItemsToCreate = [monitored(node_id)] * count
    response = await send(client, request, ua.CreateMonitoredItemsResponse)
    return [result.StatusCode.name for result in response.Results]


async def test_a_user_has_so_many_items_on_one_node(tmp_path: Path, identities: Identities) -> None:
    """Each write to the node went to 10,000 items of one client."""
    async with (
        door(tmp_path, identities, limits={"items_per_node_and_user": 3}) as small,
        small.connected() as one,
        small.connected() as two,
        small.connected("olga") as other,
    ):
        assert await create(one, small.nodes.plain, 2) == ["Good"] * 2
        assert await create(two, small.nodes.plain, 2) == ["Good", "BadTooManyMonitoredItems"]
        assert await create(two, small.nodes.text, 1) == ["Good"]
        assert await create(other, small.nodes.plain, 2) == ["Good"] * 2


async def test_monitored_items_of_a_user_are_counted_over_all_sessions(tmp_path: Path, identities: Identities) -> None:
    """With 20,000 in each of 50 subscriptions of each of 10 sessions an observer could take 14 GB."""
    refused = "BadTooManyMonitoredItems"
    async with door(tmp_path, identities, limits={"monitored_items_per_subscription": 2}) as small:
        plain = small.nodes.plain
        async with small.connected() as one, small.connected() as two, small.connected("olga") as other:
            assert await create(one, plain, 3) == ["Good", "Good", refused]
            assert await create(two, plain, 2) == ["Good"] * 2
            assert await create(one, plain, 1) == ["Good"]
            assert await create(two, plain, 2) == ["Good", refused]
            assert await create(one, plain, 1) == [refused]
            assert await create(other, plain, 2) == ["Good"] * 2
            await one.uaclient.close_session(True)
            assert await create(two, plain, 1) == ["Good"]
