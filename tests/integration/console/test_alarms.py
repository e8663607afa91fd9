"""The console's alarms of values: what its feed tells, and what people do with them."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio

from tests.integration.console.harness import ENGINEER, OBSERVER, Browser, Console, Live, console_at
from tests.integration.server_model.harness import ROBOTS, SPEED, Running, fleet_config, serving
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

ALARM: Final = "ns=2;s=Alarms.rover.speed"
AWAY: Final = "ns=2;s=Alarms.mobile_side.Online"
LIMITS: Final = {"high": 1, "high_high": 1.5, "hysteresis": 0.1, "confirm": True}


@pytest_asyncio.fixture
async def server(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Running]:
    """A server with a robot whose speed has limits; nobody plays its bridge, which so is away."""
    rover = ROBOTS["rover"]
    robots = {"rover": {**rover, "data": {**rover["data"], "speed": {**rover["data"]["speed"], "limits": LIMITS}}}}
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=robots)) as running:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        yield running


async def alarms(live: Live, **parameters: Any) -> None:
    await live.want("alarms", "alarms", **parameters)
    await live.until(lambda: "alarms" in live.feeds)


async def done(browser: Browser, operation: str, **parameters: Any) -> None:
    answer = await browser.ask(operation, **{"alarm": ALARM, **parameters})
    assert answer.status_code == 200, answer.text


async def refused(browser: Browser, http: int, operation: str, **parameters: Any) -> dict[str, Any]:
    answer = await browser.ask(operation, **{"alarm": ALARM, **parameters})
    assert answer.status_code == http, answer.text
    error: dict[str, Any] = answer.json()["error"]
    return error


async def test_a_limit_is_told_acknowledged_confirmed_and_forgotten(server: Running, console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await alarms(live, robot="rover")
        assert live.feeds["alarms"] == {}
        server.peer.publish(SPEED, 1.2)
        await live.until(lambda: ALARM in live.feeds["alarms"])
        high = live.feeds["alarms"][ALARM]
        assert (high["id"], high["kind"], high["limit"], high["robot"]) == ("rover.speed", "limit", "High", "rover")
        assert (high["active"], high["acknowledged"], high["confirmed"], high["severity"]) == (True, False, True, 500)
        assert high["message"] == "rover.speed: 1.2 m/s is above 1 m/s"
        server.peer.publish(SPEED, 1.8)
        await live.until(lambda: live.feeds["alarms"][ALARM]["limit"] == "HighHigh")
        assert live.feeds["alarms"][ALARM]["severity"] == 700
        event = live.feeds["alarms"][ALARM]["event"]
        await done(browser, "alarm.comment", event=event, comment="it is charged\u202e")
        await live.until(lambda: live.feeds["alarms"][ALARM]["comment"] == "it is charged\\u202e")
        assert live.feeds["alarms"][ALARM]["by"] == "oscar"
        await done(browser, "alarm.acknowledge", event=event)
        await live.until(lambda: live.feeds["alarms"][ALARM]["acknowledged"])
        assert live.feeds["alarms"][ALARM]["comment"], "an empty comment takes none away"
        again = await refused(browser, 409, "alarm.acknowledge", event=event)
        assert again["status"] == "BadConditionBranchAlreadyAcked"
        assert "rover.speed is acknowledged already" in again["message"]
        server.peer.publish(SPEED, 0.5)
        await live.until(lambda: not live.feeds["alarms"][ALARM]["active"])
        assert live.feeds["alarms"][ALARM]["confirmed"] is False
        await done(browser, "alarm.confirm", event=live.feeds["alarms"][ALARM]["event"], comment="full")
        await live.until(lambda: ALARM not in live.feeds["alarms"])
        unknown = await refused(browser, 409, "alarm.acknowledge", event="00" * 16)
        assert unknown["status"] == "BadEventIdUnknown"
        assert live.wholes == {"alarms": 1}


async def test_what_is_put_aside_is_listed_though_no_refresh_tells_it(console: Console) -> None:
    async with console.logged_in(ENGINEER) as erna:
        async with erna.live() as live:
            await alarms(live)
            await done(erna, "alarm.suppress")
            await done(erna, "alarm.disable", alarm=AWAY)
            await live.until(lambda: live.feeds["alarms"].keys() >= {ALARM, AWAY})
        # Another browser, whose feed begins anew with a refresh.
        async with console.logged_in(OBSERVER) as browser, browser.live() as live:
            await alarms(live)
            await live.until(lambda: live.feeds["alarms"].keys() >= {ALARM, AWAY})
            assert not live.feeds["alarms"][ALARM]["retained"]
            assert live.feeds["alarms"][ALARM]["suppressed"]
            assert not live.feeds["alarms"][AWAY]["enabled"]
            assert live.feeds["alarms"][AWAY]["kind"] == "off_normal"
            denied = await refused(browser, 403, "alarm.unsuppress")
            assert "Unsuppress of an alarm" in denied["message"]
            # All are found by their names, whatever their state.
            found = (await browser.ask("alarm.list", text="SPEED rover")).json()["result"]
            speed = {"id": "rover.speed", "node": ALARM, "kind": "limit", "put_aside": True}
            assert found == {"alarms": [speed], "all": 1}
            found = (await browser.ask("alarm.list", most=1)).json()["result"]
            assert found["all"] > len(found["alarms"]) == 1
            await done(erna, "alarm.unsuppress")
            await done(erna, "alarm.enable", alarm=AWAY)
            await live.until(lambda: ALARM not in live.feeds["alarms"])
            # It is active by now, or will be in a moment.
            await live.until(lambda: live.feeds["alarms"].get(AWAY, {}).get("enabled") is True)


async def test_what_is_shelved_does_not_wait_for_a_person(server: Running, console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await alarms(live)
        await live.want("counts", "counts")
        await live.until(lambda: AWAY in live.feeds["alarms"])  # nobody plays its bridge
        assert live.feeds["alarms"][AWAY]["robot"] == ""
        await live.until(lambda: live.feeds.get("counts", {}).get("alarms", 0) >= 1)
        others = sum(one["active"] and not one["acknowledged"] for one in live.feeds["alarms"].values())
        await live.until(lambda: live.feeds["counts"]["alarms"] == others)
        server.peer.publish(SPEED, 1.2)
        await live.until(lambda: live.feeds["counts"]["alarms"] == others + 1)
        await done(browser, "alarm.shelve", time_s=3600)
        await live.until(lambda: live.feeds["counts"]["alarms"] == others)
        await live.until(lambda: live.feeds["alarms"][ALARM]["unshelve_at"])
        shelved = live.feeds["alarms"][ALARM]
        assert (shelved["shelved"], shelved["active"], shelved["unshelve_at"] > shelved["time"]) == (
            "timed",
            True,
            True,
        )
        again = await refused(browser, 409, "alarm.shelve", time_s=60)
        assert again["status"] == "BadConditionAlreadyShelved"
        await done(browser, "alarm.unshelve")
        await live.until(lambda: live.feeds["counts"]["alarms"] == others + 1)
        await done(browser, "alarm.shelve", time_s=None)
        await live.until(lambda: live.feeds["alarms"][ALARM]["shelved"] == "one_shot")
        server.peer.publish(SPEED, 0.5)
        await live.until(
            lambda: live.feeds["alarms"][ALARM]["shelved"] == "" and not live.feeds["alarms"][ALARM]["active"]
        )


async def test_an_operator_puts_no_alarm_out_of_service(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        for operation in ("alarm.suppress", "alarm.disable", "alarm.enable", "alarm.unsuppress"):
            assert (await refused(browser, 403, operation))["status"] == "BadUserAccessDenied"
        await live.until(lambda: "hall" in live.links)
        may = live.links["hall"]["may"]
        assert {"alarm.acknowledge", "alarm.confirm", "alarm.comment", "alarm.shelve", "alarm.unshelve"} <= set(may)
        assert not {"alarm.suppress", "alarm.disable"} & set(may)


@pytest.mark.parametrize(
    ("operation", "parameters", "http"),
    [
        ("alarm.shelve", {"time_s": 0}, 400),
        ("alarm.shelve", {"time_s": 1e12}, 400),
        ("alarm.shelve", {}, 400),
        ("alarm.acknowledge", {"event": "no hexadecimal"}, 400),
        ("alarm.acknowledge", {"event": "00" * 1000}, 400),
        ("alarm.unshelve", {"alarm": "ns=2;s=Alarms.nobody"}, 404),
        ("alarm.unshelve", {"alarm": "no node"}, 400),
        ("alarm.unshelve", {"alarm": "ns=99999999;s=x"}, 400),
        ("alarm.shelve", {"alarm": "ns=2;s=Robots.rover", "time_s": 1}, 404),
    ],
)
async def test_what_cannot_be_meant_is_refused(
    console: Console, operation: str, parameters: dict[str, Any], http: int
) -> None:
    async with console.logged_in() as browser:
        await refused(browser, http, operation, **parameters)
        assert (await browser.http.get("healthz")).json()["mistakes"] == {}


async def test_what_happened_to_an_alarm_is_among_the_events(server: Running, console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("events", "events")
        await live.until(lambda: "events" in live.feeds)
        server.peer.publish(SPEED, 1.2)
        await live.until(lambda: any(one["fields"].get("ConditionName") == "rover.speed" for one in live.events))
        event = next(one for one in live.events if one["source"] == "rover.speed")
        fields = event["fields"]
        assert (fields["ActiveState"], fields["AckedState"]) == ("Active", "Unacknowledged")
        assert fields["ShelvingState/CurrentState"] == "Unshelved"


async def test_the_console_finds_its_alarms_again(server: Running, tmp_path: Path) -> None:
    """A feed of a console that begins after all has happened."""
    async with console_at(tmp_path / "first", {"hall": server.url}) as first, first.logged_in() as browser:
        server.peer.publish(SPEED, 1.2)
        await done(browser, "alarm.shelve", time_s=3600)
    async with (
        console_at(tmp_path / "second", {"hall": server.url}) as second,
        second.logged_in() as browser,
        browser.live() as live,
    ):
        await alarms(live)
        await live.until(lambda: live.feeds["alarms"].get(ALARM, {}).get("shelved") == "timed")
