"""Runs, decisions and skills in the page's own way, with machines behind real bridges."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.console.harness import Browser, Live, console_at
from tests.integration.scenarios.conftest import Plant

SCENARIO = """\
  - {task: one, skill: work, robot: left, arguments: {seconds: 1}}
  - parallel:
      - {task: two, skill: work, robot: middle}
      - {task: three, skill: work, robot: right}
"""


@asynccontextmanager
async def page_of(plant: Plant) -> AsyncGenerator[tuple[Browser, Live]]:
    """The page of an operator, who is logged in at a server with three machines."""
    for robot in ("left", "middle", "right"):
        plant.bridge(robot)
    async with (
        plant.server() as server,
        console_at(plant.folder, {"hall": server.url}) as console,
        console.logged_in() as browser,
        browser.live() as live,
    ):
        await heard(live)
        yield browser, live


async def heard(live: Live) -> None:
    await live.want("all", "robots")
    await live.until(lambda: {one["state"]["v"] for one in live.feeds.get("all", {}).values()} == {"idle"}, 30)


async def test_a_run_is_seen_from_its_start_to_its_end(plant: Plant) -> None:
    plant.scenario("three", SCENARIO)
    async with page_of(plant) as (browser, live):
        await live.want("runs", "runs")
        await live.until(lambda: "runs" in live.feeds)
        run = (await browser.ask("scenario.run", scenario="three")).json()["result"]["run"]
        paused = await browser.ask("run.pause", run=run)  # what has happened before a page asks it is not told
        assert paused.status_code == 200
        await live.want("run", "run", run=run)
        await live.until(lambda: "outline" in live.feeds.get("run", {}))
        await browser.ask("run.resume", run=run)
        await live.until(lambda: live.feeds.get("run", {}).get("run", {}).get("state") == "done")
        await live.until(lambda: live.feeds["runs"].get(run, {}).get("state") == "done")
        feed = live.feeds["run"]
        await live.until(lambda: any(one["fact"] == "TaskOver" for key, one in feed.items() if key.startswith("fact/")))
        tasks = {one["task"]: (one["robot"], one["state"]) for key, one in feed.items() if key.startswith("task/")}
        assert tasks == {"one": ("left", "done"), "two": ("middle", "done"), "three": ("right", "done")}
        assert feed["run"]["by"] == "oscar"
        times = [(one["begun"], one["ended"]) for key, one in feed.items() if key.startswith("task/")]
        assert all(feed["run"]["started"] <= begun < ended <= feed["run"]["ended"] for begun, ended in times)
        steps = [one["step"] for one in feed["outline"]["steps"]]
        assert set(steps) <= {"0", "1"}
        assert live.feeds["runs"][run]["tasks"] == {"done": 3}
        late = await browser.ask("run.pause", run=run)
        assert late.status_code == 404, "it is not under way any more"
        await live.want("nobody", "run", run="no-such-run")
        await live.until(lambda: "nobody" in live.errors)


async def test_a_run_of_before_a_restart_has_its_times_and_the_text_that_it_began_with(plant: Plant) -> None:
    plant.scenario("three", SCENARIO)
    async with page_of(plant) as (browser, live):
        run = (await browser.ask("scenario.run", scenario="three")).json()["result"]["run"]
        await live.want("run", "run", run=run)
        await live.until(lambda: live.feeds.get("run", {}).get("run", {}).get("state") == "done")
        before = {key: one for key, one in live.feeds["run"].items() if not key.startswith("fact/")}
    plant.scenario("three", "  - {wait: 1}\n")
    async with page_of(plant) as (_, live):
        await live.want("run", "run", run=run)
        await live.until(lambda: "run" in live.feeds)
        assert live.feeds["run"] == before
        assert live.feeds["run"]["task/0"]["ended"] is not None


async def test_a_decision_is_previewed_and_made(plant: Plant) -> None:
    plant.scenario("one", "  - {task: a, skill: work, robot: right}\n")
    async with page_of(plant) as (browser, live):
        await live.want("decisions", "decisions")
        assert (await browser.ask("fault.raise", robot="right", reason="stuck")).status_code == 200
        run = (await browser.ask("scenario.run", scenario="one")).json()["result"]["run"]
        await live.until(lambda: any(one["state"] == "open" for one in live.feeds.get("decisions", {}).values()))
        (decision,) = live.feeds["decisions"]
        await live.want("counts", "counts")
        await live.until(lambda: live.feeds.get("counts") == {"alarms": 1, "decisions": 1})
        await live.want("decision", "decision", decision=decision)
        await live.until(lambda: live.feeds.get("decision", {}).get("decision", {}).get("ranking"))
        ranking = live.feeds["decision"]["decision"]["ranking"]
        assert {one["robot"] for one in ranking["robots"]} == {"left", "middle"}
        assert [one["robot"] for one in ranking["excluded"]] == ["right"]
        previewed = (await browser.ask("resilience.preview", decision=decision)).json()["result"]
        assert previewed["ranking"] == ranking
        wrong = await browser.ask("resilience.preview", decision=decision, judgements={"a/b": 3})
        assert wrong.json()["result"]["problem"]
        await live.want("run", "run", run=run)
        await live.until(lambda: live.feeds.get("run", {}).get("run", {}).get("state") == "running")
        assert live.feeds["run"]["run"]["started"] is not None
        assert live.feeds["run"]["run"]["ended"] is None, "it is under way"
        confirmed = await browser.ask("resilience.confirm", decision=decision, robot="left")
        assert confirmed.json()["result"] == {"outcome": "taken"}
        await live.until(lambda: live.feeds["decision"]["decision"]["state"] == "chosen")
        assert live.feeds["decision"]["decision"]["by"] == "oscar"
        await live.until(lambda: live.feeds["counts"]["decisions"] == 0)
        await live.want("runs", "runs")
        await live.until(lambda: live.feeds.get("runs", {}).get(run, {}).get("state") == "done")


async def test_a_skill_is_started_seen_and_halted(plant: Plant) -> None:
    async with page_of(plant) as (browser, live):
        await live.want("left", "robot", robot="left")
        await live.until(lambda: live.feeds.get("left", {}).get("now/work", {}).get("state") == "Ready")
        answer = await browser.ask("skill.start", robot="left", skill="work", arguments={"work": ENDLESS_WORK})
        assert answer.status_code == 200, answer.text
        execution = answer.json()["result"]["execution"]
        await live.until(lambda: live.feeds["left"]["now/work"]["state"] == "Running")
        assert live.feeds["left"]["now/work"]["execution"] == execution
        await live.until(lambda: f"execution/{execution}" in live.feeds["left"])
        shown = live.feeds["left"][f"execution/{execution}"]
        assert (shown["skill"], shown["state"], shown["place"]) == ("work", "running", 0)
        await live.until(lambda: live.feeds["all"]["left"]["state"]["v"] == "busy")
        assert (await browser.ask("skill.halt", robot="left", skill="work")).status_code == 200
        await live.until(lambda: live.feeds["left"]["now/work"]["state"] in ("Ready", "Halted"))
        await live.until(lambda: live.feeds["left"][f"execution/{execution}"]["state"] != "running")
        again = await browser.ask("skill.halt", robot="left", skill="work")
        assert again.status_code == 409
