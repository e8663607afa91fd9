"""The Methods of Scenarios; see `ua_fleet.nodes.method_factory` for what Methods have in common."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, TypeVar

import structlog

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.turns import Places
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import ScenarioInvalid
from ua_fleet.nodes.carried_methods import said_by_bridges
from ua_fleet.nodes.method_factory import (
    MethodArgument,
    MethodFactory,
    NotValid,
    caller,
)
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.run_calls import code_of, whose_place
from ua_fleet.nodes.scenario_nodes import SCENARIOS
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.library import MOST_BYTES, version_of
from ua_fleet.operation.runs.run_commands import RunCommands
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.values import ARRAY, BuiltinType

__all__ = ["ScenarioMethods"]

_log: Any = structlog.get_logger("ua_fleet.scenarios")

Result = TypeVar("Result")
_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_NUMBER: Final = int(BuiltinType.DOUBLE)
_NUMBERS: Final = int(BuiltinType.DOUBLE | ARRAY)
_COUNTS: Final = int(BuiltinType.INT32 | ARRAY)
_FLAG: Final = int(BuiltinType.BOOLEAN)
_SCENARIO: Final = MethodArgument("Scenario", _TEXT, "name of a scenario of the folder, or the text of one")
_RUN_ID: Final = MethodArgument("RunId", _TEXT, "the run")
_PARAMETERS: Final = (
    MethodArgument("ParameterNames", _TEXTS, "parameters of the scenario; the others have their defaults"),
    MethodArgument("ParameterValues", _TEXTS, "their values, e.g. 20, true, left"),
)


class ScenarioMethods:
    """Answers the Methods."""

    def __init__(
        self,
        server: HardenedServer,
        parts: NodeFactory,
        service: ScenarioService,
        carried: CarriedRuns,
        background: Places,
    ) -> None:
        """Prepare to answer; `build` makes the Methods.

        Args:
            server: whose Methods they are.
            parts: of the fleet.
            service: does what is asked for.
            carried: does it for runs that bridges carry.
            background: of what computes for long, a place for each user.
        """
        self._service, self._carried, self._background = service, carried, background
        self._methods = MethodFactory(server, parts, code_of)

    def build(self) -> None:
        """Make the Methods and let them be called."""
        observer, operator, engineer = Role.OBSERVER, Role.OPERATOR, Role.ENGINEER
        add = self._methods.add
        add(SCENARIOS, "List", observer, self._list, (), (
            MethodArgument("Names", _TEXTS, "the scenarios of the folder"),
            MethodArgument("Descriptions", _TEXTS, "what they are for"),
            MethodArgument("Problems", _COUNTS, "how many problems each has, as Validate tells them"),
        ))  # fmt: skip
        stored = MethodArgument("Name", _TEXT, "name of the scenario: letters, digits, _ and -")
        version = MethodArgument("Version", _TEXT, "the version that was read; empty for a scenario that is new")
        add(SCENARIOS, "Text", observer, self._text, (stored,), (
            MethodArgument("Text", _TEXT, "as it stands in the file"),
            MethodArgument("Version", _TEXT, "differs when the text differs"),
        ))  # fmt: skip
        add(SCENARIOS, "Store", engineer, self._store, (
            stored, MethodArgument("Text", _TEXT, "written as it stands, comments too"), version
        ), (
            MethodArgument("NewVersion", _TEXT, "of the text that was stored"),
            MethodArgument("Problems", _TEXTS, "all that is wrong with it; then nothing was stored"),
            MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
        ))  # fmt: skip
        add(SCENARIOS, "Delete", engineer, self._delete, (stored, version), ())
        add(SCENARIOS, "Validate", operator, self._validate, (_SCENARIO,), (
            MethodArgument("Valid", _FLAG, "whether it can be run"),
            MethodArgument("Problems", _TEXTS, "all that is wrong with it"),
            MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
        ))  # fmt: skip
        add(SCENARIOS, "Run", operator, self._run, (_SCENARIO, *_PARAMETERS), (_RUN_ID,))
        add(SCENARIOS, "Pause", operator, self._pause, (_RUN_ID,), ())
        add(SCENARIOS, "Resume", operator, self._resume, (_RUN_ID,), ())
        add(SCENARIOS, "Abort", operator, self._abort, (_RUN_ID, MethodArgument("Reason", _TEXT, "for people")), ())
        add(SCENARIOS, "Answer", operator, self._answer, (
            _RUN_ID,
            MethodArgument("Step", _TEXT, "key of the step, or name of its task"),
            MethodArgument("Answer", _TEXT, "done, retry, fail, or replace: another robot is looked for"),
        ), ())  # fmt: skip
        add(SCENARIOS, "DryRun", operator, self._dry_run, (
            _SCENARIO,
            *_PARAMETERS,
            MethodArgument("ValueNames", _TEXTS, "in place of those of now, and results: ur3.battery, fetch.weight"),
            MethodArgument("Values", _TEXTS, "these values"),
        ), (
            MethodArgument("Outcome", _TEXT, "done, failed, aborted; empty where it would not end"),
            MethodArgument("Reason", _TEXT, "why"),
            MethodArgument("Times", _NUMBERS, "seconds since the start"),
            MethodArgument("Steps", _TEXTS, "keys of the steps"),
            MethodArgument("Texts", _TEXTS, "what would happen then"),
        ))  # fmt: skip
        add(
            SCENARIOS,
            "TellEvent",
            operator,
            self._tell_event,
            (MethodArgument("Name", _TEXT, "name of the event"),),
            (),
        )

    async def _aside(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """Do something that computes for long in a thread: one for each user at a time, until it is really done.

        A call that has taken too long ends, and its thread goes on; with one for each call a user would have them all.
        """
        place = self._background.of(whose_place())
        await place.acquire()
        running = asyncio.ensure_future(asyncio.to_thread(work, *arguments))

        def done(ended: asyncio.Future[Result]) -> None:
            place.release()
            if not ended.cancelled():
                ended.exception()  # told to the caller, if it still waits

        running.add_done_callback(done)
        return await asyncio.shield(running)

    # Scenarios.

    async def _list(self) -> Sequence[Any]:
        listed = await self._aside(self._service.runs.listed)
        return (
            [one.name for one in listed],
            [one.description for one in listed],
            [one.problems for one in listed],
        )

    async def _text(self, name: str) -> Sequence[Any]:
        return await self._aside(self._service.library.stored, name)

    async def _store(self, name: str, text: str, version: str) -> Sequence[Any]:
        checked = await self._aside(self._service.library.store, name, text, version, self._service.fleet)
        if checked.problems:
            problems, lines = [str(one) for one in checked.problems], [one.line for one in checked.problems]
            raise NotValid(problems[0], ("", problems, lines))
        stored = version_of(text)
        _log.info("scenario stored", scenario=name, by=caller().name, version=stored, instead_of=version)
        return stored, [], []

    async def _delete(self, name: str, version: str) -> Sequence[Any]:
        await self._aside(self._service.library.delete, name, version)
        _log.info("scenario deleted", scenario=name, by=caller().name, version=version)
        return ()

    async def _validate(self, scenario: str) -> Sequence[Any]:
        _, problems = await self._aside(self._service.check, _short(scenario, MOST_BYTES))
        return not problems, [str(problem) for problem in problems], [problem.line for problem in problems]

    async def _run(self, scenario: str, names: list[str], values: list[str]) -> Sequence[Any]:
        valid = await self._aside(self._service.runs.valid, _short(scenario, MOST_BYTES))
        return (self._service.runs.start(valid, names, values, caller().name),)

    def _of(self, run_id: str) -> CarriedRuns | RunCommands:
        """Who has a run."""
        return self._carried if self._carried.has(run_id) else self._service.runs

    async def _pause(self, run_id: str) -> Sequence[Any]:
        self._of(run_id).pause(run_id, caller().name)
        return ()

    async def _resume(self, run_id: str) -> Sequence[Any]:
        self._of(run_id).resume(run_id, caller().name)
        return ()

    async def _abort(self, run_id: str, reason: str) -> Sequence[Any]:
        self._of(run_id).abort(run_id, reason, caller().name)
        return ()

    async def _answer(self, run_id: str, step: str, answer: str) -> Sequence[Any]:
        by = caller().name
        if self._carried.has(run_id):
            await said_by_bridges(partial(self._carried.answer, run_id, step, answer, by))
        else:
            self._service.runs.answer(run_id, step, answer, by)
        return ()

    async def _dry_run(
        self, scenario: str, names: list[str], values: list[str], given_names: list[str], given: list[str]
    ) -> Sequence[Any]:
        text = _short(scenario, MOST_BYTES)
        run = await self._aside(self._service.runs.rehearse, text, names, values, given_names, given)
        return (
            "" if run.outcome is None else run.outcome.value,
            run.reason,
            [moment.at for moment in run.timeline],
            [moment.step for moment in run.timeline],
            [moment.text for moment in run.timeline],
        )

    async def _tell_event(self, name: str) -> Sequence[Any]:
        self._service.runs.tell_event(name)
        return ()


def _short(text: str, most: int) -> str:
    if len(text) > most:
        raise ScenarioInvalid([f"a scenario has at most {most} characters"])
    return text
