"""Feeds `runs` (all runs, keys are their ids), `run` (one of them), and `library` (the server's scenarios)."""

from __future__ import annotations

import asyncio
import json
from collections import Counter, deque
from collections.abc import Container, Mapping
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient, NodeNotFound, NotDone, Reading, RunTold, ScenarioClient, StepTold
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed, show_rows, telling
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters, NoParameters
from ua_fleet.console.outline import outline
from ua_fleet.console.shown import harmless_value, shown_instant, shown_moment, shown_value

__all__ = ["LIBRARY", "RUN", "RUNS"]

_FOLDER: Final = "ns=2;s=Fleet.Scenarios.Runs"
_HEAD: Final = ("State", "Scenario", "StartTime", "EndTime", "StartedBy", "Reason")
_COLUMNS: Final = ("Steps", "Tasks", "Robots", "Skills", "States", "Attempts", "Results", "Messages")
_TIMES: Final = ("Begun", "Ended")
_BRIDGES: Final = ("Bridges", "BridgeStates", "Tokens", "BridgeMessages")
"""Of a carried run."""
_TEXT: Final = "Text"
"""Like these times not there in a server of an earlier version."""
_OVER: Final = ("done", "failed")
_AT: Final = 20
"""Tasks that a run is at which are shown in the list."""
_MOST_FACTS: Final = 1000
_LIBRARY_S: Final = 2.0
"""Nothing tells of a scenario that was stored: the list is asked for."""


class RunFeedParameters(FeedParameters):
    """Which run."""

    run: str = Field(min_length=1, max_length=100)


def _head(run: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    return {
        "id": run,
        "state": parts["State"].value,
        "scenario": harmless_value(str(parts["Scenario"].value or "")),
        "started": shown_moment(parts["StartTime"].exact),
        "ended": shown_moment(parts["EndTime"].exact),
        "by": harmless_value(str(parts["StartedBy"].value or "")),
        "reason": harmless_value(str(parts["Reason"].value or "")),
    }


def _rows(parts: Mapping[str, Reading], names: tuple[str, ...]) -> list[tuple[Any, ...]]:
    return list(zip(*(parts[name].value or () for name in names), strict=False))


def _listed(run: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    tasks = _rows(parts, ("Tasks", "Robots", "States"))
    return {
        **_head(run, parts),
        "tasks": dict(Counter(str(state) for _, _, state in tasks)),
        "at": [
            {"task": harmless_value(task), "robot": harmless_value(robot), "state": state}
            for task, robot, state in tasks
            if state not in _OVER
        ][:_AT],
    }


async def _run_runs(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    async def look() -> dict[str, str]:
        nodes = await client.browse(_FOLDER)
        return {node.browse_name: node.node_id for node in nodes if node.node_class == "Object"}

    async def show(runs: dict[str, str]) -> None:
        await show_rows(client, board, runs, (*_HEAD, "Tasks", "Robots", "States"), _listed)

    await followed(client, look, show, telling(client, (RunTold,)))


def _results(text: Any) -> Any:
    try:
        return harmless_value(json.loads(str(text or "{}")))
    except ValueError:
        return {}


def _times(reading: Reading | None, count: int) -> list[str | None]:
    """Times of so many tasks; None for each that is not told. The arrays of a run change one after the other."""
    told = reading.exact if reading is not None and reading.exact is not None else ()
    return ([shown_moment(one) for one in told] + [None] * count)[:count]


def _bridges(parts: Mapping[str, Reading]) -> list[dict[str, Any]]:
    """The bridges that carry a run, and how they stand; none where the server orchestrates it."""
    if not all(name in parts for name in _BRIDGES):
        return []
    return [
        {"bridge": harmless_value(bridge), "state": state, "token": token, "message": harmless_value(message)}
        for bridge, state, token, message in _rows(parts, _BRIDGES)
    ]


class _Steps:
    """Puts one run onto the board: its head, its tasks, and what has happened."""

    def __init__(self, run: str, board: Board) -> None:
        self._run, self._board = run, board
        self._shown: set[str] = set()
        self._facts: deque[str] = deque()
        self._number = 0

    def show(self, key: str, parts: Mapping[str, Reading]) -> None:
        parameters = _results(parts["Parameters"].value)
        head = {**_head(self._run, parts), "parameters": parameters, "bridges": _bridges(parts)}
        self._board.put("run", head)
        rows = _rows(parts, _COLUMNS)
        keys: set[str] = set()
        begun, ended = [_times(parts.get(name), len(rows)) for name in _TIMES]
        for at, (step, task, robot, skill, state, attempt, result, message) in enumerate(rows):
            key = f"task/{step}"
            keys.add(key)
            self._board.put(
                key,
                {
                    "step": step,
                    "task": harmless_value(task),
                    "robot": harmless_value(robot),
                    "skill": harmless_value(skill),
                    "state": state,
                    "attempt": attempt,
                    "result": _results(result),
                    "message": harmless_value(message),
                    "begun": begun[at],
                    "ended": ended[at],
                },
            )
        for key in self._shown - keys:
            self._board.gone(key)
        self._shown = keys
        self._board.ready()

    def tell(self, told: RunTold | StepTold) -> None:
        fact: dict[str, Any] = {"at": shown_instant(told.at)}
        if isinstance(told, RunTold):
            fact |= {"fact": f"run {told.state}", "text": harmless_value(told.message)}
        else:
            fact |= {
                "fact": told.fact,
                "task": harmless_value(told.task),
                "robot": harmless_value(told.robot),
                "skill": harmless_value(told.skill),
                "outcome": told.outcome,
                "detail": harmless_value(shown_value(dict(told.detail))),
            }
        self._number += 1
        key = f"fact/{self._number}"
        self._board.put(key, fact)
        self._facts.append(key)
        if len(self._facts) > _MOST_FACTS:
            self._board.gone(self._facts.popleft())


async def _run_run(client: FleetClient, parameters: RunFeedParameters, board: Board) -> None:
    run = parameters.run
    node = f"{_FOLDER}.{run}"
    state = await client.read(f"{node}.State")
    steps = _Steps(run, board)
    async with client.told() as told, asyncio.TaskGroup() as group:
        there = {one.browse_name for one in await client.browse(node)}
        board.put("outline", await _outline(client, node, there))

        async def watch() -> None:
            names = (*_HEAD, "Parameters", *_COLUMNS, *(name for name in (*_TIMES, *_BRIDGES) if name in there))
            place = {f"{node}.{name}": name for name in names}
            parts: dict[str, Reading] = {}
            async for reading in client.watch(list(place)):
                parts[place[reading.node_id]] = reading
                if len(parts) == len(names):
                    steps.show(run, parts)

        group.create_task(watch())
        assert state.value is not None
        async for one in told:
            if isinstance(one, RunTold | StepTold) and one.run_id == run:
                steps.tell(one)


async def _outline(client: FleetClient, node: str, there: Container[str]) -> dict[str, Any] | None:
    """The steps of what runs; where the server does not keep its text, of the scenario of this name as it is now."""
    if _TEXT in there:
        text = str((await client.read(f"{node}.{_TEXT}")).value or "")
    else:
        scenario = str((await client.read(f"{node}.Scenario")).value or "")
        try:
            text, _ = await ScenarioClient(client).text(scenario)
        except (NotDone, NodeNotFound):
            return None
    return await asyncio.to_thread(outline, text)


async def _run_library(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    while True:
        scenarios = await ScenarioClient(client).scenarios()
        for one in scenarios:
            board.put(
                one.name,
                {"name": one.name, "description": harmless_value(one.description), "problems": one.problems},
            )
        board.keep({one.name for one in scenarios})
        board.ready()
        await asyncio.sleep(_LIBRARY_S)


RUNS: Final = FeedKind("runs", NoParameters, _run_runs)
RUN: Final = FeedKind("run", RunFeedParameters, _run_run)
LIBRARY: Final = FeedKind("library", NoParameters, _run_library)
