"""Preview and JudgeDecision over OPC UA: the ranking as its node has it, who may, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest
from asyncua.client.client import Client

from tests.integration.scenarios.conftest import Called, Plant, all_heard, call, open_decision, run, texts, value
from tests.integration.server_model.harness import OBSERVER, ua, until
from ua_fleet.config.schema import FleetConfig

FIELDS = (
    *("Robots", "Scores", "Criteria", "Weights", "RawValues", "CriterionScores", "Missing", "Excluded", "Reasons"),
    "ConsistencyRatio",
)

TIMES = ("StartTime", "Deadline")


def numbers(*values: float) -> Any:
    return ua.Variant(list(values), ua.VariantType.Double, None, True)


async def ranked(client: Client, method: str, decision: str, pairs: tuple[str, ...] = (), *values: float) -> Called:
    return await call(client, "Resilience", method, decision, texts(pairs), numbers(*values))


async def shown(client: Client, decision: str) -> list[Any]:
    return [await value(client, f"Resilience.Decisions.{decision}.{name}") or [] for name in FIELDS[:-1]]


async def test_a_decision_is_previewed_and_judged(plant: Plant) -> None:
    raw = plant.config.model_dump(exclude_unset=True)
    raw["resilience"] |= {
        "criteria": {
            "free": {"kind": "benefit", "range": [0, 100], "tasks_ahead": True},
            "go_on": {"kind": "benefit", "range": [0, 10], "value": "go_on"},
        },
        "judgements": {"free": {"go_on": 3}},
    }
    plant.config = FleetConfig.model_validate(raw)
    plant.scenario("one", "  - {task: a, skill: work, robot: right}\n")
    for robot in ("left", "middle", "right"):
        plant.bridge(robot)
    async with plant.server() as server, server.client() as operator, server.client(OBSERVER) as observer:
        await all_heard(operator)
        assert (await call(operator, "Faults", "RaiseFault", "right", "stuck")).status == 0
        await run(operator, "one")
        decision = await open_decision(operator)
        begun, due = [await value(operator, f"Resilience.Decisions.{decision}.{name}") for name in TIMES]
        assert (due - begun).total_seconds() == pytest.approx(60, abs=2), "limit_s of the plant"
        before = await shown(operator, decision)
        as_it_is = await ranked(observer, "Preview", decision)
        assert (as_it_is.status, [part or [] for part in as_it_is.outputs[:-1]]) == (0, before), as_it_is.message
        other = await ranked(observer, "Preview", decision, ("free/go_on",), 1 / 9)
        weights = dict(zip(other.outputs[2], other.outputs[3], strict=True))
        assert weights == {"free": pytest.approx(0.1), "go_on": pytest.approx(0.9)}
        assert other.outputs[0][0] == "left", "it alone has the value"
        assert other.outputs[7] == ["right"]
        assert await shown(operator, decision) == before

        for pairs, values, said in (
            (("free/go_on",), (), "1 pairs were given with 0 values"),
            (("free",), (1.0,), "is no pair of criteria"),
            (("free/go_on",), (float("nan"),), "free"),
            (("free/speed",), (2.0,), "speed"),
        ):
            refused = await ranked(observer, "Preview", decision, pairs, *values)
            assert (refused.status, said in refused.message, refused.outputs[0] or []) == (2, True, []), refused
        assert (await ranked(observer, "Preview", "nothing")).status == 1
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            await ranked(observer, "JudgeDecision", decision)

        judged = await ranked(operator, "JudgeDecision", decision, ("free/go_on",), 1 / 9)
        assert judged.outputs == other.outputs
        await until(lambda: shown(operator, decision), lambda found: found[3] == judged.outputs[3])
        assert await value(operator, "Resilience.Weights") == [pytest.approx(0.75), pytest.approx(0.25)]
        assert (await ranked(operator, "JudgeDecision", decision)).status == 0
        await until(lambda: shown(operator, decision), lambda found: found == before)
        assert (await call(operator, "Resilience", "Confirm", decision, "middle")).status == 0
        late = await ranked(operator, "JudgeDecision", decision, ("free/go_on",), 2.0)
        assert (late.status, "it may have been decided already" in late.message) == (1, True)
