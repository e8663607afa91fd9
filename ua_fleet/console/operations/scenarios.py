"""Scenarios and their runs."""

from __future__ import annotations

import asyncio
from typing import Any, Final
from weakref import WeakKeyDictionary

from pydantic import Field

from ua_fleet.client import FleetClient, Problem, ScenarioClient
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters
from ua_fleet.console.outline import outline
from ua_fleet.console.shown import harmless_value

__all__ = ["SCENARIO_OPERATIONS"]

_MOST_TEXT: Final = 300_000
"""Characters of a scenario; the server's own bound is lower, and says so."""
_OUTLINING: Final[WeakKeyDictionary[FleetClient, asyncio.Lock]] = WeakKeyDictionary()


class Named(OperationParameters):
    """A scenario of the server's folder."""

    name: str = Field(min_length=1, max_length=100)


class Text(OperationParameters):
    """A scenario by its name, or its text."""

    scenario: str = Field(min_length=1, max_length=_MOST_TEXT)


class Validated(Text):
    """What is asked of it: whether the server can orchestrate it, or bridges carry it, too."""

    carried: bool = False


class Stored(Named):
    """A text for the folder, and the version in whose place it is."""

    text: str = Field(max_length=_MOST_TEXT)
    version: str = Field(default="", max_length=100)


class Deleted(Named):
    """The version that is to go."""

    version: str = Field(max_length=100)


class StartParameters(Text):
    """What a run is started with, as texts."""

    parameters: dict[str, str] = Field(default_factory=dict[str, str], max_length=200)


class Started(StartParameters):
    """Who carries it out: the server, or the bridges."""

    carried: bool = False


class Rehearsed(StartParameters):
    """Values of robots and results of tasks, in place of those of now."""

    values: dict[str, str] = Field(default_factory=dict[str, str], max_length=1000)


class RunParameters(OperationParameters):
    """A run."""

    run: str = Field(min_length=1, max_length=100)


class AbortParameters(RunParameters):
    """Why."""

    reason: str = Field(default="", max_length=500)


class Answered(RunParameters):
    """What became of a task."""

    step: str = Field(min_length=1, max_length=500)
    answer: str = Field(pattern="^(done|retry|fail|replace)$")


class Adopted(RunParameters):
    """A bridge of a carried run that is off, as a person has seen, and the tasks that its robots have done."""

    bridge: str = Field(min_length=1, max_length=200)
    is_off: bool
    done: list[str] = Field(default_factory=list[str], max_length=500)


class ToldEvent(OperationParameters):
    """Something that has happened."""

    event: str = Field(min_length=1, max_length=200)


def _problems(problems: list[Problem]) -> list[dict[str, Any]]:
    return [{"line": one.line, "message": harmless_value(one.text)} for one in problems]


async def _text(client: FleetClient, asked: Named) -> dict[str, Any]:
    text, version = await ScenarioClient(client).text(asked.name)
    return {"name": asked.name, "text": text, "version": version}


async def _outline(client: FleetClient, asked: Text) -> dict[str, Any]:
    # It takes a thread, and of a large text its time from all others: one of each user at a time.
    async with _OUTLINING.setdefault(client, asyncio.Lock()):
        return await asyncio.to_thread(outline, asked.scenario)


async def _validate(client: FleetClient, asked: Validated) -> dict[str, Any]:
    return {"problems": _problems(await ScenarioClient(client).validate(asked.scenario, carried=asked.carried))}


async def _dry_run(client: FleetClient, asked: Rehearsed) -> dict[str, Any]:
    run = await ScenarioClient(client).dry_run(asked.scenario, asked.parameters, asked.values)
    return {
        "outcome": run.outcome,
        "reason": harmless_value(run.reason),
        "timeline": [{"at_s": one.at_s, "step": one.step, "text": harmless_value(one.text)} for one in run.timeline],
    }


async def _store(client: FleetClient, asked: Stored) -> dict[str, Any]:
    return {"version": await ScenarioClient(client).store(asked.name, asked.text, asked.version)}


async def _delete(client: FleetClient, asked: Deleted) -> None:
    await ScenarioClient(client).delete(asked.name, asked.version)


async def _run(client: FleetClient, asked: Started) -> dict[str, Any]:
    return {"run": await ScenarioClient(client).run(asked.scenario, asked.parameters, carried=asked.carried)}


async def _pause(client: FleetClient, asked: RunParameters) -> None:
    await ScenarioClient(client).pause(asked.run)


async def _resume(client: FleetClient, asked: RunParameters) -> None:
    await ScenarioClient(client).resume(asked.run)


async def _abort(client: FleetClient, asked: AbortParameters) -> None:
    await ScenarioClient(client).abort(asked.run, asked.reason)


async def _answer(client: FleetClient, asked: Answered) -> None:
    await ScenarioClient(client).answer(asked.run, asked.step, asked.answer)


async def _adopt(client: FleetClient, asked: Adopted) -> dict[str, Any]:
    heir = await ScenarioClient(client).adopt(asked.run, asked.bridge, asked.done, is_off=asked.is_off)
    return {"heir": harmless_value(heir)}


async def _tell_event(client: FleetClient, asked: ToldEvent) -> None:
    await ScenarioClient(client).tell_event(asked.event)


SCENARIO_OPERATIONS: Final = (
    OperationKind("scenario.text", Named, _text, "Scenarios.Text", "observer"),
    OperationKind("scenario.outline", Text, _outline, "nothing", "observer"),
    OperationKind("scenario.validate", Validated, _validate, "Scenarios.Validate", "operator"),
    OperationKind("scenario.dry_run", Rehearsed, _dry_run, "Scenarios.DryRun", "operator"),
    OperationKind("scenario.store", Stored, _store, "Scenarios.Store", "engineer"),
    OperationKind("scenario.delete", Deleted, _delete, "Scenarios.Delete", "engineer"),
    OperationKind("scenario.run", Started, _run, "Scenarios.Run", "operator"),
    OperationKind("run.pause", RunParameters, _pause, "Scenarios.Pause", "operator"),
    OperationKind("run.resume", RunParameters, _resume, "Scenarios.Resume", "operator"),
    OperationKind("run.abort", AbortParameters, _abort, "Scenarios.Abort", "operator"),
    OperationKind("run.answer", Answered, _answer, "Scenarios.Answer", "operator"),
    OperationKind("run.adopt", Adopted, _adopt, "Scenarios.Adopt", "operator"),
    OperationKind("run.tell_event", ToldEvent, _tell_event, "Scenarios.TellEvent", "operator"),
)
