"""What users may read, write and call, and what they are told when they may not."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Door, Stock, bad, send, ua
from ua_fleet.endpoint.users import User

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def read(client: Client, node_id: Any, attribute: Any = None, index_range: str | None = None) -> Any:
    request = ua.ReadRequest()
    wanted = ua.ReadValueId(node_id, attribute or ua.AttributeIds.Value)
    wanted.IndexRange = index_range
    request.Parameters.NodesToRead = [wanted]
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    return (await send(client, request, ua.ReadResponse)).Results[0]


async def write(client: Client, node_id: Any, value: Any, attribute: Any = None, **options: Any) -> str:
    request = ua.WriteRequest()
    wanted = ua.WriteValue(node_id, attribute or ua.AttributeIds.Value, None, value)
    for name, option in options.items():
        setattr(wanted, name, option)
    request.Parameters.NodesToWrite = [wanted]
    return str((await send(client, request, ua.WriteResponse)).Results[0].name)


async def call(client: Client, method: Any, *arguments: Any, owner: Any = None) -> Any:
    request = ua.CallRequest()
    wanted = ua.CallMethodRequest(owner or ua.NodeId(ua.ObjectIds.ObjectsFolder), method)
    wanted.InputArguments = list(arguments)
    request.Parameters.MethodsToCall = [wanted]
    return (await send(client, request, ua.CallResponse)).Results[0]


def double(value: float) -> Any:
    return ua.DataValue(ua.Variant(value, ua.VariantType.Double))


def int64(value: int) -> Any:
    return ua.Variant(value, ua.VariantType.Int64)


async def test_access_level_holds_for_reads(hardened: Door, plain: Stock) -> None:
    """Stock asyncua reads variables with AccessLevel 0 to everybody."""
    async with hardened.connected("eva") as client:
        value = await read(client, hardened.nodes.hidden)
        assert (value.StatusCode.name, value.Value.Value if value.Value else None) == ("BadNotReadable", None)
        assert (await read(client, ua.NodeId("nowhere", 2))).StatusCode.name == "BadNodeIdUnknown"
        assert (await read(client, hardened.nodes.folder)).StatusCode.name == "BadAttributeIdInvalid"
    async with plain.client() as client:
        assert (await read(client, plain.nodes.hidden)).Value.Value == 42


async def test_access_level_holds_for_subscriptions(hardened: Door, plain: Stock) -> None:
    """Stock asyncua tells values with AccessLevel 0 to every subscriber."""

    async def watch(client: Client, node_id: Any) -> str:
        subscription = await client.create_subscription(100, Ignore())
        try:
            return await bad(subscription.subscribe_data_change(client.get_node(node_id)))
        finally:
            await subscription.delete()

    async with hardened.connected() as client:
        assert await watch(client, hardened.nodes.hidden) == "BadNotReadable"
        assert await watch(client, hardened.nodes.plain) == "Good"
        assert await watch(client, ua.NodeId("nowhere", 2)) == "BadNodeIdUnknown"
    async with plain.client() as client:
        assert await watch(client, plain.nodes.hidden) == "Good"


class Ignore:
    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        pass


async def test_history_needs_its_access_level(hardened: Door, plain: Stock) -> None:
    """Stock asyncua looks into its history whatever the node's AccessLevel says."""

    async def history(client: Client, node_id: Any) -> str:
        request = ua.HistoryReadRequest()
        request.Parameters.HistoryReadDetails = ua.ReadRawModifiedDetails()
        request.Parameters.ReleaseContinuationPoints = False
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        request.Parameters.NodesToRead = [ua.HistoryReadValueId(node_id)]
        return str((await send(client, request, ua.HistoryReadResponse)).Results[0].StatusCode.name)

    async with hardened.connected() as client:
        assert await history(client, hardened.nodes.plain) == "BadHistoryOperationUnsupported"
        assert await history(client, ua.NodeId("nowhere", 2)) == "BadNodeIdUnknown"
    async with plain.client() as client:
        assert await bad(history(client, plain.nodes.plain)) != "BadHistoryOperationUnsupported"


@pytest.mark.parametrize("user", ["olga", "oscar", "eva"])
async def test_writes_need_the_role_and_the_access_level(hardened: Door, user: str) -> None:
    allowed = user != "olga"
    async with hardened.connected(user) as client:
        expected = "Good" if allowed else "BadUserAccessDenied"
        assert await write(client, hardened.nodes.value, double(3.25)) == expected
        assert await write(client, hardened.nodes.plain, double(3.25)) == "BadNotWritable"
        assert await write(client, hardened.nodes.hidden, double(3.25)) == "BadNotWritable"
        assert await write(client, ua.NodeId("nowhere", 2), double(1.0)) == "BadNodeIdUnknown"
        for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.DisplayName, ua.AttributeIds.DataType):
            assert await write(client, hardened.nodes.value, double(1.0), attribute) == "BadNotWritable"


async def test_writes_of_wrong_values(hardened: Door) -> None:
    async with hardened.connected() as client:
        node = hardened.nodes.value
        await write(client, node, double(5.0))
        assert await write(client, node, ua.DataValue(ua.Variant(1, ua.VariantType.Int32))) == "BadTypeMismatch"
        assert await write(client, node, ua.DataValue()) == "BadTypeMismatch"
        assert await write(client, node, double(1.0), IndexRange="0:1") == "BadIndexRangeNoData"
        forged = double(9.0)
        forged.StatusCode = ua.StatusCode(ua.StatusCodes.BadSensorFailure)
        assert await write(client, node, forged) == "BadWriteNotSupported"
        assert (await read(client, node)).Value.Value == 5.0


async def test_base_nodes_cannot_be_written(hardened: Door) -> None:
    """The standard address space has 23 writable variables with nothing behind them."""
    enabled = ua.NodeId(ua.ObjectIds.Server_ServerDiagnostics_EnabledFlag)
    async with hardened.connected("eva") as client:
        value = ua.DataValue(ua.Variant(True, ua.VariantType.Boolean))
        assert await write(client, enabled, value) == "BadNotWritable"


class Gate:
    """A gate that remembers, and refuses what is above 100."""

    def __init__(self) -> None:
        self.checked: list[tuple[float, str]] = []
        self.wrote: list[tuple[float, str]] = []

    def check_write(self, node_id: Any, value: Any, user: User) -> int:
        self.checked.append((value.Value.Value, user.name))
        if value.Value.Value == 666:
            raise LookupError("a mistake in the gate")
        return int(ua.StatusCodes.BadOutOfRange) if value.Value.Value > 100 else 0

    def written(self, node_id: Any, value: Any, user: User) -> None:
        self.wrote.append((value.Value.Value, user.name))

    def request_done(self) -> None:
        pass


@pytest.fixture
def gate(hardened: Door) -> Iterator[Gate]:
    gate = Gate()
    hardened.server.gate = gate
    yield gate
    hardened.server.gate = None


async def test_gate_has_the_last_word(hardened: Door, gate: Gate) -> None:
    async with hardened.connected() as client, hardened.connected("olga") as observer:
        assert await write(client, hardened.nodes.value, double(50.0)) == "Good"
        assert await write(client, hardened.nodes.value, double(150.0)) == "BadOutOfRange"
        assert await write(client, hardened.nodes.value, double(666.0)) == "BadInternalError"
        assert await write(observer, hardened.nodes.value, double(60.0)) == "BadUserAccessDenied"
        assert (await read(client, hardened.nodes.value)).Value.Value == 50.0
    assert gate.wrote == [(50.0, "oscar")]
    assert (60.0, "olga") not in gate.checked


async def test_executable_holds_for_calls(hardened: Door, plain: Stock) -> None:
    """Stock asyncua runs methods with Executable false."""
    before = len(hardened.nodes.called)
    async with hardened.connected("eva") as client:
        result = await call(client, hardened.nodes.methods["locked"], int64(1), int64(2))
        assert result.StatusCode.name == "BadNotExecutable"
    assert len(hardened.nodes.called) == before
    async with plain.client() as client:
        assert (await call(client, plain.nodes.methods["locked"], int64(1), int64(2))).StatusCode.is_good()


async def test_roles_hold_for_calls(hardened: Door, plain: Stock) -> None:
    """Stock asyncua lets anonymous users call everything."""
    add, engineering = hardened.nodes.methods["add"], hardened.nodes.methods["engineering"]
    for user, may_add, may_engineer in (("olga", False, False), ("oscar", True, False), ("eva", True, True)):
        async with hardened.connected(user) as client:
            for method, may in ((add, may_add), (engineering, may_engineer)):
                result = await call(client, method, int64(1), int64(2))
                assert result.StatusCode.name == ("Good" if may else "BadUserAccessDenied")
    async with plain.client() as client:
        assert (await call(client, plain.nodes.methods["add"], int64(1), int64(2))).StatusCode.is_good()


async def test_observers_see_that_they_may_not(hardened: Door) -> None:
    async with hardened.connected("olga") as observer, hardened.connected("oscar") as operator:
        for client, may in ((observer, False), (operator, True)):
            level = await read(client, hardened.nodes.value, ua.AttributeIds.UserAccessLevel)
            assert bool(level.Value.Value & 2) is may
            executable = await read(client, hardened.nodes.methods["add"], ua.AttributeIds.UserExecutable)
            assert executable.Value.Value is may


@pytest.mark.parametrize(
    ("arguments", "status", "results"),
    [
        ([], "BadArgumentsMissing", []),
        ([1], "BadArgumentsMissing", []),
        ([1, 2, 3], "BadTooManyArguments", []),
        ([1, "two"], "BadInvalidArgument", ["Good", "BadTypeMismatch"]),
        ([1.5, [2]], "BadInvalidArgument", ["BadTypeMismatch", "BadTypeMismatch"]),
        ([None, 2], "BadInvalidArgument", ["BadTypeMismatch", "Good"]),
    ],
)
async def test_arguments_are_checked(hardened: Door, arguments: list[Any], status: str, results: list[str]) -> None:
    """Stock asyncua hands wrong arguments to the method, and reports Bad_UnexpectedError where that fails."""
    before = len(hardened.nodes.called)
    given = [
        int64(value)
        if type(value) is int
        else ua.Variant([2], ua.VariantType.Int64)
        if value == [2]
        else ua.Variant(value)
        for value in arguments
    ]
    async with hardened.connected() as client:
        result = await call(client, hardened.nodes.methods["add"], *given)
    assert result.StatusCode.name == status
    assert [code.name for code in result.InputArgumentResults] == results
    assert len(hardened.nodes.called) == before


async def test_wrong_arguments_stock(plain: Stock) -> None:
    async with plain.client() as client:
        result = await call(client, plain.nodes.methods["add"], ua.Variant("1"), ua.Variant("2"))
        assert (result.StatusCode.name, result.OutputArguments[0].Value) == ("Good", "12")
        assert (await call(client, plain.nodes.methods["add"])).StatusCode.name == "BadUnexpectedError"


async def test_methods_that_fail_refuse_or_hang(hardened: Door) -> None:
    """Errors on purpose give their StatusCode, mistakes Bad_InternalError, and the connection goes on."""
    async with hardened.connected() as client:
        assert (await call(client, hardened.nodes.methods["refuses"])).StatusCode.name == "BadRequestNotAllowed"
        assert (await call(client, hardened.nodes.methods["fails"])).StatusCode.name == "BadInternalError"
        good = await call(client, hardened.nodes.methods["add"], int64(20), int64(22))
        assert good.OutputArguments[0].Value == 42
        missing = await call(client, ua.NodeId("nowhere", 2))
        assert missing.StatusCode.name == "BadMethodInvalid"
        elsewhere = await call(client, hardened.nodes.methods["add"], int64(1), int64(2), owner=hardened.nodes.folder)
        assert elsewhere.StatusCode.name == "BadMethodInvalid"
        nothing = await call(client, hardened.nodes.methods["add"], owner=ua.NodeId("nowhere", 2))
        assert nothing.StatusCode.name == "BadNodeIdUnknown"


async def test_method_knows_its_caller(hardened: Door) -> None:
    """Stock asyncua does not tell a method who calls."""
    async with hardened.connected("oscar") as one, hardened.connected("eva") as two:
        for client, name in ((one, "oscar"), (two, "eva")):
            result = await call(client, hardened.nodes.methods["who"])
            assert result.OutputArguments[0].Value == name


async def test_one_who_waits_does_not_block_others(hardened: Door) -> None:
    """A method that hangs is stopped, and other connections do not wait for it."""
    object.__setattr__(hardened.server.context.limits, "method_s", 0.3)
    async with hardened.connected() as slow, hardened.connected("eva") as other:
        hanging = asyncio.ensure_future(call(slow, hardened.nodes.methods["sleeps"]))
        await asyncio.sleep(0)
        assert await other.get_node(hardened.nodes.plain).read_value() == 7.0
        assert not hanging.done()
        assert (await hanging).StatusCode.name == "BadTimeout"
        assert await slow.get_node(hardened.nodes.plain).read_value() == 7.0
