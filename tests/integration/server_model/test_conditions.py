"""Comments and refreshes of conditions through a whole server."""

from __future__ import annotations

from pathlib import Path

from tests.integration.server_model.harness import OPERATOR, fleet_config, serving, ua, until
from tests.integration.server_model.test_alarms import (
    ACKNOWLEDGE,
    ADD_COMMENT,
    ALARM,
    REFRESH,
    SUPPRESS,
    robots,
    text,
    watching,
)
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore


async def test_a_fault_keeps_its_comment_where_none_is_given(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots())
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        await client.get_node("ns=2;s=Fleet.Faults").call_method(
            ua.NodeId("Fleet.Faults.RaiseFault", 2), "rover", "hot"
        )
        fault = client.get_node("ns=2;s=Fleet.Faults.rover.robot")
        raised = await watched.next(SourceName="rover")
        await fault.call_method(ADD_COMMENT, raised["EventId"], text("call the electrician first"))
        commented = await watched.next(SourceName="rover")
        await fault.call_method(ADD_COMMENT, commented["EventId"], text(None))
        await fault.call_method(ACKNOWLEDGE, commented["EventId"], text(None))
        event = await watched.next(SourceName="rover", AckedState_Id=True)
        assert event["Comment"].Text == "call the electrician first"


async def test_a_subscription_is_refreshed_after_its_user_has_got_another_role(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots())
    async with serving(tmp_path, config) as running, running.client() as client, watching(client) as watched:
        number = ua.Variant(watched.subscription.subscription_id, ua.VariantType.UInt32)
        conditions = client.get_node(ua.NodeId(2782, 0))
        await conditions.call_method(REFRESH, number)
        (users,) = tmp_path.rglob(USERS_FILE)
        store = UserStore(users, ScryptCost(2**8, 8, 1))
        store.add(OPERATOR[0], OPERATOR[1], Role.ENGINEER, replace_existing=True)

        async def suppressed() -> bool:
            await client.get_node(ALARM).call_method(SUPPRESS)
            return True

        await until(suppressed, bool)  # an engineer may
        await conditions.call_method(REFRESH, number)
