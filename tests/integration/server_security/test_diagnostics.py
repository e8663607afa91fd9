"""What the server tells of its sessions and subscriptions, and whom (OPC 10000-5 6.3), seen by asyncua's client."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest
from asyncua.ua import ua_binary

from tests.integration.server_security.harness import Client, Door, bad, send, ua
from tests.integration.server_security.test_services import browse, read
from ua_fleet.endpoint import diagnostics
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.sessions import Session
from ua_fleet.endpoint.users import Role

pytestmark = pytest.mark.asyncio(loop_scope="module")

ROOT = "Server_ServerDiagnostics_"
ARRAYS = (
    f"{ROOT}SubscriptionDiagnosticsArray",
    f"{ROOT}SessionsDiagnosticsSummary_SessionDiagnosticsArray",
    f"{ROOT}SessionsDiagnosticsSummary_SessionSecurityDiagnosticsArray",
)


def node(name: str) -> Any:
    return ua.NodeId(getattr(ua.ObjectIds, name))


async def value(client: Client, node_id: Any) -> Any:
    """The value of a node, or the name of the StatusCode with which it is refused."""
    found = await read(client, node_id)
    return found.Value.Value if found.StatusCode.is_good() else str(found.StatusCode.name)


async def summary(client: Client) -> Any:
    return await value(client, node(f"{ROOT}ServerDiagnosticsSummary"))


class Seen:
    """What a subscription was told."""

    def __init__(self) -> None:
        self.values: list[Any] = []

    def datachange_notification(self, _node: Any, told: Any, data: Any) -> None:
        del data
        self.values.append(told)

    async def until(self, count: int) -> None:
        async with asyncio.timeout(60):
            while len(self.values) < count:
                await asyncio.sleep(0.01)


async def test_sessions_and_requests_are_counted(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        before = await summary(client)
        assert await value(client, node(f"{ROOT}EnabledFlag")) is True
        count = await value(client, node(f"{ROOT}ServerDiagnosticsSummary_CurrentSessionCount"))
        assert (count, before.ServerViewCount) == (before.CurrentSessionCount, 0)
        seen = Seen()
        watching = await client.create_subscription(50, seen)
        await watching.subscribe_data_change(
            client.get_node(node(f"{ROOT}ServerDiagnosticsSummary_CurrentSessionCount"))
        )
        await seen.until(1)
        async with hardened.connected():
            within = await summary(client)
            await seen.until(2)
        await seen.until(3)
        assert seen.values == [count, count + 1, count]
        wrong = await hardened.client("oscar", password="wrong")
        with contextlib.suppress(ua.UaStatusCodeError):
            await wrong.connect()
        with contextlib.suppress(ua.UaStatusCodeError):
            await wrong.disconnect()
        assert await bad(send(client, ua.AddNodesRequest(), ua.AddNodesResponse)) == "BadServiceUnsupported"
        after = await summary(client)
    assert within.CurrentSessionCount == before.CurrentSessionCount + 1
    assert within.CumulatedSessionCount == before.CumulatedSessionCount + 1
    assert within.CurrentSubscriptionCount == before.CurrentSubscriptionCount + 1
    assert within.CumulatedSubscriptionCount == before.CumulatedSubscriptionCount + 1
    assert within.PublishingIntervalCount >= 1
    assert after.SecurityRejectedSessionCount == before.SecurityRejectedSessionCount + 1
    assert after.RejectedSessionCount == before.RejectedSessionCount + 1
    assert after.SecurityRejectedRequestsCount == before.SecurityRejectedRequestsCount + 1
    assert after.RejectedRequestsCount >= before.RejectedRequestsCount + 2


async def test_engineers_see_all_sessions_and_subscriptions(hardened: Door) -> None:
    async with hardened.connected("eva") as engineer, hardened.connected("olga") as other:
        watching = await other.create_subscription(200, Seen())
        await watching.subscribe_data_change(other.get_node(hardened.nodes.plain))
        for name in ARRAYS:
            assert await value(other, node(name)) == "BadUserAccessDenied"
            assert (await read(other, node(name), 17)).Value.Value & 1
            assert not (await read(other, node(name), 18)).Value.Value & 1
            assert (await read(engineer, node(name), 18)).Value.Value & 1
            refused = await bad(watching.subscribe_data_change(other.get_node(node(name))))
            assert refused == "BadUserAccessDenied"
        # asyncua's own class has lost a field of the security diagnostics: see below.
        subscriptions, sessions = [await value(engineer, node(name)) for name in ARRAYS[:2]]
        (told,) = [each for each in subscriptions if each.SubscriptionId == watching.subscription_id]
        assert (told.PublishingInterval, told.MonitoredItemCount, told.PublishingEnabled) == (200.0, 1, True)
        (session,) = [each for each in sessions if each.SessionId == told.SessionId]
        assert (session.CurrentSubscriptionsCount, session.CurrentMonitoredItemsCount) == (1, 1)
        assert (session.ReadCount.TotalCount, session.CreateSubscriptionCount.TotalCount) == (9, 1)
        assert len(sessions) >= 2
        await watching.delete()
        assert told.SubscriptionId not in [each.SubscriptionId for each in await value(engineer, node(ARRAYS[0]))]


async def children(client: Client, parent: Any) -> dict[str, Any]:
    (result,) = await browse(client, parent, ReferenceTypeId=ua.NodeId(ua.ObjectIds.HasComponent))
    return {str(ref.BrowseName.Name): ref.NodeId for ref in result.References}


async def browse_name(client: Client, node_id: Any) -> Any:
    return (await read(client, node_id, 3)).Value.Value


async def test_a_session_has_nodes_while_it_lasts_for_its_user_and_engineers(hardened: Door) -> None:
    sessions = node(f"{ROOT}SessionsDiagnosticsSummary")
    async with hardened.connected("eva") as engineer, hardened.connected("oscar") as stranger:
        before = set((await children(engineer, sessions)).values())
        async with hardened.connected("olga") as client:
            (own,) = set((await children(engineer, sessions)).values()) - before
            parts = await children(client, own)
            assert set(parts) == {"SessionDiagnostics", "SessionSecurityDiagnostics", "SubscriptionDiagnosticsArray"}
            fields = await children(client, parts["SessionDiagnostics"])
            assert len(fields) == 43
            whole = await value(client, parts["SessionDiagnostics"])
            assert whole.SessionId == own
            assert await value(client, fields["SessionId"]) == own
            assert (await value(engineer, fields["ReadCount"])).TotalCount == whole.ReadCount.TotalCount + 1
            assert await value(stranger, fields["ReadCount"]) == "BadUserAccessDenied"
            assert await value(stranger, parts["SessionDiagnostics"]) == "BadUserAccessDenied"
            for field, found in fields.items():
                got = await read(client, found)
                rank = (await read(client, found, 15)).Value.Value
                assert got.StatusCode.is_good(), field
                assert isinstance(got.Value.Value, list) == (rank == 1), field
            security = parts["SessionSecurityDiagnostics"]
            told = await children(engineer, security)
            assert len(told) == 9
            assert await value(engineer, told["ClientUserIdOfSession"]) == "olga"
            assert await value(engineer, told["Encoding"]) == "UA Binary"
            assert await value(engineer, told["SecurityMode"]) == int(ua.MessageSecurityMode.SignAndEncrypt)
            assert await value(client, security) == "BadUserAccessDenied"
        assert set((await children(engineer, sessions)).values()) == before
        for gone in (own, parts["SessionDiagnostics"], fields["ReadCount"]):
            assert await value(engineer, gone) == "BadNodeIdUnknown"


async def test_a_subscription_has_a_node_while_it_lasts_for_its_user_and_engineers(hardened: Door) -> None:
    """OPC 10000-5 7.15: for each entry of the array a Variable with the fields."""
    array = node(ARRAYS[0])
    async with hardened.connected("eva") as engineer, hardened.connected("oscar") as stranger:
        before = await children(engineer, array)
        async with hardened.connected("olga") as client:
            subscription = await client.create_subscription(200, Seen())
            own = (await children(engineer, array))[str(subscription.subscription_id)]
            assert set(await children(engineer, array)) == {*before, str(subscription.subscription_id)}
            assert (own.NamespaceIndex, (await browse_name(engineer, own)).NamespaceIndex) == (1, 1)
            fields = await children(client, own)
            assert len(fields) == 31
            for reader in (engineer, client):
                whole = await value(reader, own)
                assert (whole.SubscriptionId, whole.PublishingInterval) == (subscription.subscription_id, 200.0)
                assert await value(reader, fields["PublishingInterval"]) == 200.0
            for found in (own, fields["PublishingInterval"]):
                assert await value(stranger, found) == "BadUserAccessDenied"
            watching = await engineer.create_subscription(50, seen := Seen())
            await watching.subscribe_data_change(engineer.get_node(fields["ModifyCount"]))
            await seen.until(1)
            await subscription.update(ua.ModifySubscriptionParameters(subscription.subscription_id, 300.0, 100, 10, 0))
            await seen.until(2)
            assert seen.values == [0, 1]
            assert (await value(engineer, own)).PublishingInterval == 300.0
            await subscription.delete()
            for gone in (own, fields["PublishingInterval"]):
                assert await value(engineer, gone) == "BadNodeIdUnknown"
            await watching.delete()
            left = await client.create_subscription(200, Seen())
            assert str(left.subscription_id) in await children(engineer, array)
        assert await children(engineer, array) == before


async def test_the_node_of_a_subscription_goes_with_its_lifetime(hardened: Door) -> None:
    async with hardened.connected("eva") as engineer:
        before = await children(engineer, node(ARRAYS[0]))
        request = ua.CreateSubscriptionRequest()
        request.Parameters = ua.CreateSubscriptionParameters(50.0, 3, 1, 0, True, 0)
        await send(engineer, request, ua.CreateSubscriptionResponse)
        assert len(await children(engineer, node(ARRAYS[0]))) == len(before) + 1
        async with asyncio.timeout(60):
            while await children(engineer, node(ARRAYS[0])) != before:
                await asyncio.sleep(0.05)


async def test_the_fields_of_a_session_are_made_when_somebody_browses_them(hardened: Door) -> None:
    server: Any = hardened.server
    space = server.iserver.aspace

    def nodes_of(session: Any) -> int:
        return sum(str(each.Identifier).startswith(session.key) for each in list(space.keys()))

    async with hardened.connected("olga") as client:
        session: Any = next(each for each in server._services.sessions if each.user.name == "olga")
        assert nodes_of(session) == 0
        parts = await children(client, session.session_id)
        assert nodes_of(session) == 4
        await children(client, parts["SessionDiagnostics"])
        assert nodes_of(session) == 4 + 43
    assert (nodes_of(session), session.session_id in space) == (0, False)
    made: list[Any] = []
    async with hardened.connected("olga"):
        session = next(each for each in server._services.sessions if each.user.name == "olga")
        space[raw_id(f"{session.key}.SessionDiagnostics", 1)].expect(made.append)
    # What nobody has browsed is not made to be removed.
    assert (nodes_of(session), session.session_id in space, made) == (0, False, [])


async def test_the_nodes_of_hundreds_of_sessions_are_made_by_one_browse(hardened: Door) -> None:
    server: Any = hardened.server
    events, mistakes, user = server._services.session, server.context.mistakes, hardened.users.get("olga")
    sessions = [Session(None, b"", "urn:client", 60.0, user=user) for _ in range(400)]
    before = mistakes.count
    for session in sessions:
        events.activated(session)
    try:
        # One that is asked for by its id is made alone.
        assert sessions[7].session_id in server.iserver.aspace
        assert server.iserver.aspace._nodes.keys() & {each.session_id for each in sessions} == {sessions[7].session_id}
        async with hardened.connected("eva") as engineer:
            found = await engineer.get_node(node(f"{ROOT}SessionsDiagnosticsSummary")).get_children()
            assert {each.session_id for each in sessions} <= {each.nodeid for each in found}
            array = await engineer.get_node(node(ARRAYS[1])).get_children()
            names = {f"{each.key}.SessionDiagnostics" for each in sessions}
            assert names <= {str(each.nodeid.Identifier) for each in array}
    finally:
        for session in sessions:
            await events.ended(session)
    assert mistakes.count == before


async def test_each_one_who_watches_is_told_what_there_was_before_and_is_again(hardened: Door) -> None:
    count = node(f"{ROOT}ServerDiagnosticsSummary_CurrentSessionCount")
    server: Any = hardened.server
    context = server.context
    (tell,) = [each for each in context.housekeeping if each.__name__ == "tell"]
    context.housekeeping.remove(tell)
    try:
        async with hardened.connected() as client:
            first, second = Seen(), Seen()
            watching = await client.create_subscription(50, first)
            await watching.subscribe_data_change(client.get_node(count))
            await first.until(1)
            await tell()
            other = await hardened.client("oscar")
            await other.connect()
            also = await client.create_subscription(50, second)
            await also.subscribe_data_change(client.get_node(count))
            await second.until(1)
            await other.disconnect()
            await tell()
            await second.until(2)
            assert second.values == [first.values[0] + 1, first.values[0]]
            assert len(first.values) == 1
    finally:
        context.housekeeping.append(tell)


async def test_a_sessions_own_subscriptions_are_not_counted_anew_for_each_read(
    hardened: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []
    real = diagnostics._subscription_diagnostics  # pyright: ignore[reportPrivateUsage]

    def counted(subscription: Any) -> Any:
        made.append(subscription.id)
        return real(subscription)

    monkeypatch.setattr(diagnostics, "_subscription_diagnostics", counted)
    sessions = node(f"{ROOT}SessionsDiagnosticsSummary")
    async with hardened.connected("eva") as engineer:
        before = set((await children(engineer, sessions)).values())
    async with hardened.connected("olga") as client:
        subscription = await client.create_subscription(1000, Seen())
        (own,) = set((await children(client, sessions)).values()) - before
        array = (await children(client, own))["SubscriptionDiagnosticsArray"]
        values = await client.read_values([client.get_node(array)] * 200)
        assert {each[0].SubscriptionId for each in values} == {subscription.subscription_id}
        of_all = await children(client, node(ARRAYS[0]))
        fields = await children(client, of_all[str(subscription.subscription_id)])
        counts = await client.read_values([client.get_node(fields["DisabledMonitoredItemCount"])] * 200)
        assert set(counts) == {0}
        assert len(made) < 20


async def test_who_is_engineer_no_more_is_told_no_more(hardened: Door) -> None:
    async with hardened.connected("eva") as client, hardened.connected() as other:
        seen = Seen()
        watching = await client.create_subscription(50, seen)
        handle = await watching.subscribe_data_change(client.get_node(node(ARRAYS[0])))
        await seen.until(1)
        server: Any = hardened.server
        session: Any = next(each for each in server._services.sessions if each.user.name == "eva")
        user, session.user = session.user, hardened.users.get("olga")
        try:
            async with asyncio.timeout(60):
                while len(next(iter(session.subscriptions.values())).items):
                    await asyncio.sleep(0.01)
            another = await other.create_subscription(50, Seen())
            await asyncio.sleep(0.2)
            await another.delete()
            assert len(seen.values) == 1
            assert await bad(watching.unsubscribe(handle)) == "BadMonitoredItemIdInvalid"
        finally:
            session.user = user
        assert user.role is Role.ENGINEER


async def test_who_comes_back_on_a_channel_that_is_not_encrypted_is_told_no_secrets(hardened: Door) -> None:
    async with hardened.connected("eva") as client:
        watching = await client.create_subscription(50, Seen())
        handle = await watching.subscribe_data_change(client.get_node(node(ARRAYS[2])))
        server: Any = hardened.server
        session: Any = next(each for each in server._services.sessions if each.user.name == "eva")
        session.usage.security_mode = int(ua.MessageSecurityMode.Sign)  # as ActivateSession does
        async with asyncio.timeout(60):
            while len(next(iter(session.subscriptions.values())).items):
                await asyncio.sleep(0.01)
        assert await bad(watching.unsubscribe(handle)) == "BadMonitoredItemIdInvalid"


async def test_the_security_diagnostics_have_the_standards_bytes(hardened: Door) -> None:
    """asyncua's own class has lost the field Encoding."""
    async with hardened.connected("eva") as client:
        request = ua.ReadRequest()
        request.Parameters.NodesToRead = [ua.ReadValueId(node(ARRAYS[2]), ua.AttributeIds.Value)]
        data = await client.uaclient.protocol.send_request(request)
    found = bytes(data)
    sequence = b"".join(ua_binary.Primitives.String.pack(text) for text in ("UserName", "UA Binary", "opc.tcp"))
    assert sequence + b"\x03\x00\x00\x00" in found
