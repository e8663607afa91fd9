"""The typed client and the command line: robots registered and listed, and skills that they offer."""

from __future__ import annotations

import asyncio
import gc
import json
import sys
from collections import Counter
from collections.abc import AsyncGenerator
from contextlib import aclosing, asynccontextmanager
from functools import partial
from typing import Any

import pytest
from asyncua.common.subscription import SubscriptionItemData

from tests.integration.robots.conftest import MACHINE, Yard
from tests.integration.server_model.harness import ENGINEER, OPERATOR, Running
from tests.system import clean_environment, cli, forked, run
from ua_fleet.client import (
    ClientIdentity,
    FleetClient,
    NodeNotFound,
    NotDone,
    RobotClient,
    RobotInfo,
    RobotInvalid,
    SkillRequest,
)
from ua_fleet.client.subscriptions import Feed
from ua_fleet.errors import AccessRefused, NotConnected, RobotOffline, SkillFailed, SkillRejected

SKILL = {
    "needs": ["repair"],
    "arguments": {"what": {"type": "String"}},
    "results": {"fixed": {"type": "Boolean"}, "cost": {"type": "Double"}},
    "timeout_s": 10,
}


def held() -> Counter[str]:
    """What subscriptions of this process hold: their handlers, with what waits there, and their nodes."""
    gc.collect()
    kinds = (SubscriptionItemData, Feed)
    return Counter(kind.__name__ for one in gc.get_objects() for kind in kinds if isinstance(one, kind))


async def look(client: FleetClient) -> None:
    """Watch whatever can be watched, each for a moment."""
    async with aclosing(client.watch(["ns=2;s=Robots.machine.State"])) as changes:
        await anext(changes)
    for context in (client.told(), client.events(), client.conditions()):
        async with context:
            pass
    async with client.offer_skill("mechanic", "repair", SKILL):
        pass


@asynccontextmanager
async def connected(running: Running, user: tuple[str, str] = ENGINEER) -> AsyncGenerator[FleetClient]:
    identity = ClientIdentity(running.folder / "identity")
    async with FleetClient.connect(running.url, user=user[0], password=user[1], identity=identity) as client:
        yield client


async def command(
    yard: Yard, url: str, *arguments: str, user: tuple[str, str] = ENGINEER, stdin: str = ""
) -> tuple[int, str, str]:
    env = clean_environment(UA_FLEET_PASSWORD=user[1], XDG_STATE_HOME=str(yard.folder / "config"))
    words = cli(*arguments, "-u", user[0], "-e", url)
    ended = await asyncio.to_thread(partial(run, *words, env=env, stdin=stdin))
    return ended.returncode, ended.stdout, ended.stderr


async def test_robots_are_registered_listed_and_unregistered(yard: Yard) -> None:
    async with yard.server() as running, connected(running) as client:
        robots = RobotClient(client)
        assert await robots.register("machine", MACHINE, bridge="cell") == "ns=2;s=Robots.machine"
        assert await robots.robots() == [
            RobotInfo("machine", "offline", "registered", ("weld",), ("work", "quick"), "Works")
        ]
        with pytest.raises(RobotInvalid, match="there is no bridge `sell`") as caught:
            await robots.register("other", "skills:\n  x: {}\n", bridge="sell")
        assert [problem.line for problem in caught.value.problems] == [0, 0, 2]
        with pytest.raises(NotDone, match="registered before; unregister that first"):
            await robots.register("machine", {}, bridge="cell")
        await robots.unregister("machine")
        assert await robots.robots() == []

        file = yard.folder / "cart.yaml"
        file.write_text(json.dumps({"robots": {"cart": {**MACHINE, "bridge": "cell"}}}))
        code, output, errors = await command(yard, running.url, "robot", "register", str(file))
        assert (code, output) == (0, "cart is registered: ns=2;s=Robots.cart\n"), errors
        code, output, errors = await command(yard, running.url, "robot", "list", "--json")
        assert (code, json.loads(output)["name"]) == (0, "cart"), errors
        file.write_text("skills:\n  drive: {needs: [fly]}\n")
        code, _, errors = await command(
            yard, running.url, "robot", "register", str(file), "--name", "x", "--bridge", "cell"
        )
        assert code == 2
        assert f"{file}:2:robots.x.skills.drive.id: `id` is missing" in errors
        assert f"{file}:2:robots.x.skills.drive.needs[0]: x lacks the capacity `fly`" in errors
        code, _, errors = await command(yard, running.url, "robot", "unregister", "cart", user=OPERATOR)
        assert (code, "BadUserAccessDenied" in errors) == (1, True)
        assert (await command(yard, running.url, "robot", "unregister", "cart"))[0] == 0
        assert (await command(yard, running.url, "robot", "unregister", "cart"))[0] == 3


async def test_a_program_offers_a_skill_and_others_call_it(yard: Yard) -> None:
    async def repair(request: SkillRequest) -> dict[str, Any]:
        if request.arguments["what"] == "the roof":
            raise SkillFailed("too high")
        await request.report(0.5, "at it")
        return {"fixed": True, "cost": 12.5}

    async with (
        yard.server() as running,
        connected(running) as client,
        connected(running, OPERATOR) as caller,
    ):
        with pytest.raises(
            AccessRefused, match=r"mechanic\.repair is not registered, and only an engineer may change that"
        ):
            async with caller.offer_skill("mechanic", "repair", SKILL):
                pass
        with pytest.raises(NotDone, match="there is no robot 'mechanic'"):
            async with client.offer_skill("mechanic", "repair"):
                pass
        with pytest.raises(RobotInvalid, match="arguments"):
            async with client.offer_skill("mechanic", "repair", {"arguments": 3}):
                pass
        async with client.offer_skill("mechanic", "repair", SKILL) as offered:
            serving = asyncio.ensure_future(offered.serve(repair))
            assert await caller.call_skill("mechanic", "repair", what="the belt") == {"fixed": True, "cost": 12.5}
            with pytest.raises(SkillFailed, match="too high"):
                await caller.call_skill("mechanic", "repair", what="the roof")
            serving.cancel()
        async with caller.offer_skill("mechanic", "repair") as offered:
            execution = await client.start_skill("mechanic", "repair", what="x")
            request = await anext(aiter(offered))
            assert (request.id, request.arguments) == (execution.id, {"what": "x"})
            await request.fail("not today")
            with pytest.raises(SkillRejected, match="not today"):
                await execution.result()


async def test_the_command_line_offers_by_hand_and_by_a_program(yard: Yard) -> None:
    file = yard.folder / "repair.yaml"
    file.write_text(json.dumps(SKILL))
    script = yard.folder / "repair.py"
    script.write_text(
        "import json, sys\n"
        "what = json.load(sys.stdin)['what']\n"
        "if what == 'the roof':\n    sys.exit('too high')\n"
        "print(json.dumps({'fixed': True, 'cost': len(what)}))\n"
    )
    async with yard.server() as running, connected(running, OPERATOR) as caller:

        async def called(what: str) -> Any:
            async with asyncio.timeout(60):
                while True:
                    try:
                        return await caller.call_skill("mechanic", "repair", what=what)
                    except SkillFailed as error:
                        return str(error)
                    except (NodeNotFound, RobotOffline):
                        await asyncio.sleep(0.1)

        offering = asyncio.ensure_future(
            command(
                yard,
                running.url,
                *("skill", "offer", "mechanic", "repair", "--definition", str(file)),
                stdin="accept\ndone fixed=perhaps cost=3\ndone fixed=true cost=3\n",
            )
        )
        assert await called("the belt") == {"fixed": True, "cost": 3.0}
        code, output, errors = await offering
        assert (code, output) == (0, 'mechanic.repair what="the belt"\n')
        assert "fixed is 'perhaps'; it has to be true or false" in errors
        process = forked(
            *cli("skill", "offer", "mechanic", "repair"),
            *("--run", f"{sys.executable} {script}", "-u", OPERATOR[0], "-e", running.url),
            env=clean_environment(UA_FLEET_PASSWORD=OPERATOR[1], XDG_STATE_HOME=str(yard.folder / "config")),
        )
        assert await called("the belt") == {"fixed": True, "cost": 8.0}
        assert "too high" in await called("the roof")
        process.terminate()
        assert await asyncio.to_thread(process.wait, 60) == 130
        process.close()


async def test_a_skill_that_is_offered_anew_is_started_with_its_arguments_as_they_are_now(yard: Yard) -> None:
    """Start takes them by their places: a client that is connected since before must not have them in an old order."""
    got: list[dict[str, Any]] = []

    async def work(request: SkillRequest) -> dict[str, Any]:
        got.append(dict(request.arguments))
        return {}

    asked = {"x": 1.0, "y": 2.0, "z": 3.0}
    async with yard.server() as running, connected(running) as engineer, connected(running, OPERATOR) as other:
        for names in (("x", "y"), ("y", "x"), ("x", "y", "z")):
            arguments = {name: {"type": "Double"} for name in names}
            definition = {"needs": ["move"], "arguments": arguments, "results": {}, "timeout_s": 10}
            async with engineer.offer_skill("porter", "go", definition) as offered:
                serving = asyncio.ensure_future(offered.serve(work))
                await other.call_skill("porter", "go", **{name: asked[name] for name in names})
                serving.cancel()
    assert got == [{"x": 1.0, "y": 2.0}, {"x": 1.0, "y": 2.0}, asked]


async def test_nothing_is_kept_of_subscriptions_that_have_ended(yard: Yard) -> None:
    async with yard.server() as running, connected(running) as client:
        await RobotClient(client).register("machine", MACHINE, bridge="cell")
        before = held()
        for _ in range(3):
            await look(client)
        assert held() - before == Counter()
        assert client._client._subscriptions == []  # pyright: ignore[reportPrivateUsage] - where asyncua keeps them


async def test_nothing_is_kept_of_a_subscription_whose_connection_is_lost(yard: Yard) -> None:
    async with yard.server() as running, connected(running) as client:
        await RobotClient(client).register("machine", MACHINE, bridge="cell")
        before = held()
        changes = client.watch(["ns=2;s=Robots.machine.State"])
        with pytest.raises(NotConnected):  # noqa: PT012 - it is raised where the next change is awaited
            async with aclosing(changes), client.events():
                await anext(changes)
                assert held() - before == Counter({"SubscriptionItemData": 2, "Feed": 2})
                client._client.disconnect_socket()  # pyright: ignore[reportPrivateUsage] - as when a cable is cut
                await anext(changes)
        del changes
        assert held() - before == Counter()
