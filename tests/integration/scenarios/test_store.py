"""Text, Store and Delete of Scenarios over OPC UA: who may, what is refused, and what runs then."""

from __future__ import annotations

from typing import Any

import pytest

from tests.integration.scenarios.conftest import ENGINEER, Plant, call, run, run_is
from tests.integration.server_model.harness import OBSERVER, OPERATOR, ua
from ua_fleet.client import ClientIdentity, FleetClient, NotDone, ScenarioClient

WAIT = "version: 1\nname: pause\nsteps:\n  - {wait: 0.1}  # as short as can be\n"


def text(value: str) -> Any:
    return ua.Variant(value, ua.VariantType.String)


async def test_an_engineer_stores_what_operators_run(plant: Plant) -> None:
    async with plant.server() as server, server.client(ENGINEER) as engineer, server.client(OPERATOR) as operator:
        stored = await call(engineer, "Scenarios", "Store", text("pause"), text(WAIT), text(""))
        assert stored.status == 0, stored.message
        async with server.client(OBSERVER) as observer:
            read = await call(observer, "Scenarios", "Text", text("pause"))
        assert read.outputs == [WAIT, stored.outputs[0]]
        assert (plant.folder / "scenarios" / "pause.yaml").read_text() == WAIT
        assert await run_is(operator, await run(operator, "pause"), "done", "failed") == "done"

        for name, arguments in (("Store", ("pause", WAIT, "")), ("Delete", ("pause", ""))):
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await call(operator, "Scenarios", name, *[text(one) for one in arguments])

        wrong = WAIT.replace("wait: 0.1", "task: a, skill: work, robot: lefd")
        refused = await call(engineer, "Scenarios", "Store", text("pause"), text(wrong), text(stored.outputs[0]))
        assert (refused.status, refused.outputs[0], refused.outputs[2]) == (2, "", [4])
        assert "lefd" in refused.outputs[1][0]
        outside = await call(engineer, "Scenarios", "Store", text("../fleet"), text(WAIT), text(""))
        assert (outside.status, "is no name of a scenario" in outside.message) == (1, True)
        large = await call(engineer, "Scenarios", "Store", text("pause"), text(f"{WAIT}#" + "x" * 300_000), text(""))
        assert (large.status, "at most" in large.message) == (2, True)

        (plant.folder / "scenarios" / "pause.yaml").write_text(f"{WAIT}# by an editor\n")
        late = await call(engineer, "Scenarios", "Store", text("pause"), text(WAIT), text(stored.outputs[0]))
        assert (late.status, "since it was read; read it again" in late.message) == (3, True)
        late = await call(engineer, "Scenarios", "Delete", text("pause"), text(stored.outputs[0]))
        assert late.status == 3


async def test_the_typed_client_stores_and_deletes(plant: Plant) -> None:
    async with plant.server() as server:
        identity = ClientIdentity(server.folder / "identity")
        async with FleetClient.connect(server.url, user=ENGINEER[0], password=ENGINEER[1], identity=identity) as client:
            scenarios = ScenarioClient(client)
            version = await scenarios.store("pause", WAIT)
            assert await scenarios.text("pause") == (WAIT, version)
            with pytest.raises(NotDone, match="there is a scenario pause already"):
                await scenarios.store("pause", WAIT)
            await scenarios.delete("pause", version)
            assert await scenarios.scenarios() == []
            with pytest.raises(NotDone, match="there is no scenario 'pause'"):
                await scenarios.text("pause")
