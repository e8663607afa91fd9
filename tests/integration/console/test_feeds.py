"""The feeds and operations beside a robot's, each against a real server."""

from __future__ import annotations

from tests.integration.console.harness import ENGINEER, OBSERVER, OPERATOR, Console
from tests.integration.server_model.harness import SPEED, Running
from ua_fleet.values import StatusCode

SCENARIO = """\
version: 1
name: there
description: to the gate and back
parameters:
  x: {default: 2, unit: m, range: [0, 5]}
steps:
  - task: go
    robot: rover
    skill: goto
    arguments: {x: =x}
  - parallel:
      - wait: 1
      - end: done
"""


FAULT = "ns=2;s=Fleet.Faults.rover.robot"


async def test_a_fault_is_an_alarm_until_it_is_over_and_seen(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("alarms", "alarms")
        await live.until(lambda: "alarms" in live.feeds)
        answer = await browser.ask("fault.raise", robot="rover", reason="the drive is\u202e hot", capacities=["mobile"])
        assert answer.status_code == 200, answer.text
        await live.until(lambda: FAULT in live.feeds["alarms"])
        alarm = live.feeds["alarms"][FAULT]
        assert (alarm["id"], alarm["kind"], alarm["robot"]) == ("rover.robot", "fault", "rover")
        assert (alarm["active"], alarm["acknowledged"], alarm["capacities"]) == (True, False, ["mobile"])
        assert "\\u202e" in alarm["reason"]
        seen = {"alarm": FAULT, "event": alarm["event"]}
        answer = await browser.ask("alarm.acknowledge", **seen, comment="I look")
        assert answer.status_code == 200, answer.text
        await live.until(lambda: live.feeds["alarms"][FAULT]["acknowledged"])
        assert live.feeds["alarms"][FAULT]["comment"] == "I look"
        assert (await browser.ask("fault.clear", fault="rover.robot")).status_code == 200
        await live.until(lambda: FAULT not in live.feeds["alarms"])
        assert live.wholes == {"alarms": 1}
        missing = await browser.ask("alarm.acknowledge", **{**seen, "alarm": "ns=2;s=Fleet.Faults.rover.nothing"})
        assert missing.status_code == 404


async def test_the_page_of_a_robot_reads_its_own_card_and_faults_alone(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        for feed in ("robots", "alarms"):
            await live.want(feed, feed, robot="rover")
            await live.want(f"no {feed}", feed, robot="nobody")
        await live.until(
            lambda: live.feeds.keys() >= {"robots", "alarms", "no alarms"} and live.errors.get("no robots")
        )
        assert live.errors["no robots"]["status"] == "BadNodeIdUnknown"
        assert (await browser.ask("fault.raise", robot="rover", reason="it smokes")).status_code == 200
        await live.until(lambda: live.feeds["robots"]["rover"]["faults"] and live.feeds["alarms"])
        assert live.feeds["alarms"][FAULT]["reason"] == "it smokes"
        assert live.feeds["robots"]["rover"]["fault"] == "it smokes"
        assert live.feeds["no alarms"] == {}


async def test_what_waits_for_a_person_is_counted(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("counts", "counts")
        await live.want("alarms", "alarms")
        await live.until(lambda: live.feeds.keys() >= {"counts", "alarms"})
        assert live.feeds["counts"]["decisions"] == 0

        def waiting() -> int:
            """The alarm of the bridge, which nobody plays, may be there already."""
            return sum(one["active"] and not one["acknowledged"] for one in live.feeds["alarms"].values())

        assert (await browser.ask("fault.raise", robot="rover", reason="it smokes")).status_code == 200
        await live.until(lambda: FAULT in live.feeds["alarms"] and live.feeds["counts"]["alarms"] == waiting())
        event = live.feeds["alarms"][FAULT]["event"]
        assert (await browser.ask("alarm.acknowledge", alarm=FAULT, event=event, comment="seen")).status_code == 200
        await live.until(
            lambda: live.feeds["alarms"][FAULT]["acknowledged"] and live.feeds["counts"]["alarms"] == waiting()
        )
        assert live.wholes["counts"] == 1


async def test_a_card_has_the_battery(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.until(lambda: live.feeds.get("all", {}).get("rover", {}).get("marked"))
        (battery,) = live.feeds["all"]["rover"]["marked"]
        assert (battery["name"], battery["v"], battery["u"], battery["s"]) == ("battery", 80, "%", 0)
        assert (await browser.ask("node.write", node="ns=2;i=1005", value="12")).status_code == 200
        await live.until(lambda: live.feeds["all"]["rover"]["marked"][0]["v"] == 12)
        assert live.wholes == {"all": 1}


async def test_a_held_robot_shows_by_whom(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("one", "robot", robot="rover")
        await live.want("all", "robots")
        await live.until(lambda: live.feeds.keys() >= {"one", "all"})
        assert (await browser.ask("robots.hold", robot="rover", reason="new tyre")).status_code == 200
        await live.until(lambda: live.feeds["one"]["held"] and live.feeds["all"]["rover"]["held"])
        assert live.feeds["one"]["held"]["by"] == OPERATOR[0]
        assert (await browser.ask("robots.release", robot="rover")).status_code == 200
        await live.until(lambda: live.feeds["one"]["held"] is None and live.feeds["all"]["rover"]["held"] is None)
        answer = await browser.ask("robots.release", robot="rover")
        assert answer.status_code == 409


async def test_a_scenario_is_stored_with_the_version_that_was_read(console: Console) -> None:
    async with console.logged_in(ENGINEER) as browser, browser.live() as live:
        await live.want("library", "library")
        await live.until(lambda: "library" in live.feeds)
        broken = await browser.ask("scenario.store", name="there", text=SCENARIO.replace("goto", "fly"))
        assert broken.status_code == 400
        assert [one["line"] for one in broken.json()["error"]["problems"]] == [7]
        first = await browser.ask("scenario.store", name="there", text=SCENARIO)
        assert first.status_code == 200, first.text
        await live.until(lambda: "there" in live.feeds["library"])
        assert live.feeds["library"]["there"]["description"] == "to the gate and back"
        stale = await browser.ask("scenario.store", name="there", text=SCENARIO, version="another")
        assert stale.status_code == 409
        read = (await browser.ask("scenario.text", name="there")).json()["result"]
        assert (read["text"], read["version"]) == (SCENARIO, first.json()["result"]["version"])
        checked = (await browser.ask("scenario.validate", scenario=SCENARIO.replace("rover", "nobody"))).json()
        assert checked["result"]["problems"][0]["line"] == 7
        rehearsed = (await browser.ask("scenario.dry_run", scenario="there")).json()["result"]
        assert rehearsed["outcome"] == "done", rehearsed
        assert (await browser.ask("scenario.delete", name="there", version=read["version"])).status_code == 200
        await live.until(lambda: "there" not in live.feeds["library"])


async def test_an_outline_has_the_keys_of_the_steps(console: Console) -> None:
    async with console.logged_in(OBSERVER) as browser:
        told = (await browser.ask("scenario.outline", scenario=SCENARIO)).json()["result"]
        task, parallel = told["steps"]
        assert (task["kind"], task["step"], task["name"], task["robot"]) == ("task", "0", "go", "rover")
        assert [one["steps"][0]["kind"] for one in parallel["steps"]] == ["wait", "end"]
        assert told["parameters"][0]["high"] == 5
        told = (await browser.ask("scenario.outline", scenario="version: 1\nname: [")).json()["result"]
        assert told["problems"]


async def test_nodes_are_browsed_read_written_and_watched(console: Console) -> None:
    goal, gone = "ns=2;i=1002", "ns=2;i=9999"
    async with console.logged_in() as browser, browser.live() as live:
        below = (await browser.ask("node.browse", node="ns=2;s=Robots.rover.Data")).json()["result"]
        assert {one["name"] for one in below} == {"speed", "goal", "velocity", "pose", "battery"}
        await live.want("watch", "nodes", nodes=[goal, gone, f"ns=2;i={SPEED.id}"])
        await live.until(lambda: "watch" in live.feeds)
        assert live.feeds["watch"][goal]["v"] == 0
        assert live.feeds["watch"][gone]["s"] == StatusCode.BAD_NODE_ID_UNKNOWN
        written = await browser.ask("node.write", node=goal, value="0.5")
        assert written.json()["result"]["value"]["v"] == 0.5
        await live.until(lambda: live.feeds["watch"][goal]["v"] == 0.5)
        for value, status in (("7", 400), ("fast", 400)):
            assert (await browser.ask("node.write", node=goal, value=value)).status_code == status
        assert (await browser.ask("node.write", node=f"ns=2;i={SPEED.id}", value="1")).status_code == 403
        attributes = (await browser.ask("node.attributes", node=goal)).json()["result"]
        assert {"name": "NodeClass", "v": "Variable", "s": 0} in attributes
        assert (await browser.ask("node.read", node=gone)).status_code == 404
    async with console.logged_in(OBSERVER) as browser:
        refused = await browser.ask("node.write", node=goal, value="0.1")
        assert refused.status_code == 403
        assert "Write of this node" in refused.json()["error"]["message"]


async def test_events_come_in_order_and_audits_for_engineers_alone(console: Console) -> None:
    async with (
        console.logged_in() as oscar,
        console.logged_in(ENGINEER) as erna,
        oscar.live() as plain,
        erna.live() as audited,
    ):
        for live in (plain, audited):
            await live.want("events", "events", most=50)
            await live.until(lambda live=live: "events" in live.feeds)  # type: ignore[misc]
        assert (await oscar.ask("robots.hold", robot="rover", reason="tyre")).status_code == 200
        await plain.until(lambda: any(one["type"] == "RobotHoldEventType" for one in plain.events))
        await audited.until(lambda: any(one["audit"] for one in audited.events))
        assert not any(one["audit"] for one in plain.events)
        await plain.until(lambda: plain.feeds["events"]["history"]["state"] != "loading")
        assert plain.feeds["events"]["history"]["state"] == "none", "this server keeps no events"


async def test_health_names_bridges_and_drops(console: Console, server: Running) -> None:
    async with console.logged_in(OBSERVER) as browser, browser.live() as live:
        await live.want("health", "health")
        await live.want("resilience", "resilience")
        await live.until(lambda: live.feeds.keys() >= {"health", "resilience"})
        health = live.feeds["health"]
        assert health["server"]["state"] == "Running"
        assert (health["bridge/mobile_side"]["kind"], health["bridge/mobile_side"]["online"]) == ("ros2", False)
        assert "MessagesIn" in health["traffic"]
        assert live.feeds["resilience"]["settings"]["mode"] == "operator"
        server.peer.send(b"no message at all")
        await live.until(lambda: live.feeds["health"]["drops"].get("malformed"))


CART = """\
robots:
  cart:
    bridge: mobile_side
    capacities: [carry]
    data:
      load: {id: 1701, type: Double, unit: kg}
"""


async def test_a_robot_that_comes_while_somebody_looks_is_there_by_itself(console: Console) -> None:
    async with console.logged_in(ENGINEER) as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.want("cart", "robot", robot="cart")
        await live.until(lambda: "all" in live.feeds and live.errors.get("cart"))
        assert live.errors["cart"]["status"] == "BadNodeIdUnknown"
        wrong = await browser.ask("robots.register", robot="cart", definition=CART.replace("Double", "Dubble"))
        assert wrong.status_code == 400
        assert [one["line"] for one in wrong.json()["error"]["problems"]] == [6]
        made = await browser.ask("robots.register", robot="cart", definition=CART)
        assert made.status_code == 200, made.text
        await live.until(lambda: "cart" in live.feeds["all"])
        await live.until(lambda: any(key.startswith("data/") for key in live.feeds.get("cart", {})))
        await live.until(lambda: "cart" not in live.errors)
        assert (await browser.ask("robots.unregister", robot="cart")).status_code == 200
        await live.until(lambda: "cart" not in live.feeds["all"] and "cart" in live.errors)
        assert "rover" in live.feeds["all"]


ODD_NODES = [
    "ns=99999999;i=1",
    "ns=2;i=99999999999",
    "i=-1",
    "i=x",
    "ns=2;g=none",
    "ns=2;b=!!!",
    "ns=2;s=\x00\u202e",
    "x;y",
]


async def test_what_is_no_node_is_told_and_is_no_mistake(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        battery = "ns=2;i=1005"
        await live.want("odd", "nodes", nodes=[*ODD_NODES, battery])
        await live.until(lambda: "odd" in live.feeds and live.feeds["odd"].keys() == {*ODD_NODES, battery}, 60)
        assert [one for one in ODD_NODES if not live.feeds["odd"][one]["error"]] == []
        assert live.feeds["odd"][battery]["v"] == 80
        for node in ODD_NODES:
            for operation in ("node.read", "node.browse", "node.attributes"):
                answer = await browser.ask(operation, node=node)
                assert answer.status_code < 500, (operation, node, answer.text)
        assert (await browser.http.get("healthz")).json()["mistakes"] == {}
