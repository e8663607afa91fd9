"""The Methods of Scenarios for runs that bridges carry; see `ua_fleet.nodes.method_factory`.

They are Methods of their own, since a Method whose arguments change is another one to every client.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, Final

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.endpoint.users import Role
from ua_fleet.errors import ScenarioError, ScenarioInvalid, UaFleetError
from ua_fleet.nodes.method_factory import NOT_FOUND, NOT_POSSIBLE, NOT_VALID, MethodArgument, MethodFactory, caller
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.scenario_nodes import SCENARIOS
from ua_fleet.operation.runs.carried import CarriedRuns
from ua_fleet.operation.runs.carried_questions import BridgesAnswered
from ua_fleet.operation.runs.library import MOST_BYTES, ScenarioUnknown
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.values import ARRAY, BuiltinType

__all__ = ["CarriedMethods", "said_by_bridges"]

_TEXT: Final = int(BuiltinType.STRING)
_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
_COUNTS: Final = int(BuiltinType.INT32 | ARRAY)
_FLAG: Final = int(BuiltinType.BOOLEAN)
_SCENARIO: Final = MethodArgument("Scenario", _TEXT, "name of a scenario of the folder, or the text of one")


class CarriedMethods:
    """Answers the Methods."""

    def __init__(
        self, server: HardenedServer, parts: NodeFactory, service: ScenarioService, carried: CarriedRuns
    ) -> None:
        """Make the Methods and let them be called."""
        self._service, self._carried = service, carried
        self._at_once = asyncio.Semaphore(1)
        """What is read and split takes a thread; one at a time is enough."""
        add = MethodFactory(server, parts, _code_of).add
        add(SCENARIOS, "ValidateCarried", Role.OPERATOR, self._validate, (_SCENARIO,), (
            MethodArgument("Valid", _FLAG, "whether bridges can carry a run of it"),
            MethodArgument("Problems", _TEXTS, "all that is wrong with it, or keeps bridges from carrying it"),
            MethodArgument("Lines", _COUNTS, "the line of each problem; 0 where it has none"),
        ))  # fmt: skip
        add(SCENARIOS, "RunCarried", Role.OPERATOR, self._run, (
            _SCENARIO,
            MethodArgument("ParameterNames", _TEXTS, "parameters of the scenario; the others have their defaults"),
            MethodArgument("ParameterValues", _TEXTS, "their values, e.g. 20, true, left"),
        ), (MethodArgument("RunId", _TEXT, "the run"),))  # fmt: skip
        add(SCENARIOS, "Adopt", Role.OPERATOR, self._adopt, (
            MethodArgument("RunId", _TEXT, "a run that bridges carry"),
            MethodArgument("Bridge", _TEXT, "a bridge of it that does not answer"),
            MethodArgument("IsOff", _FLAG, "whether it is off, and stays so until this is done"),
            MethodArgument("Done", _TEXTS, "tasks that its robots have done and no bridge reported, or their steps"),
        ), (MethodArgument("Heir", _TEXT, "who goes on for it; empty where the run ends without it"),))  # fmt: skip

    async def _adopt(self, run_id: str, bridge: str, is_off: bool, done: list[str]) -> Sequence[Any]:
        if not is_off:
            raise ScenarioError(
                f"IsOff is false: switch {bridge[:80]!r} off, then set IsOff; otherwise robots could be commanded twice"
            )
        if not self._carried.has(run_id):
            raise ScenarioUnknown(f"there is no run {run_id[:80]!r} under way that bridges carry")
        return (self._carried.adopt(run_id, bridge, done, caller().name),)

    async def _validate(self, scenario: str) -> Sequence[Any]:
        async with self._at_once:
            checked, found = await asyncio.to_thread(self._carried.check, _short(scenario))
        problems = checked.problems or found.problems
        return not problems, [str(problem) for problem in problems], [problem.line for problem in problems]

    async def _run(self, scenario: str, names: list[str], values: list[str]) -> Sequence[Any]:
        async with self._at_once:
            valid = await asyncio.to_thread(self._service.runs.valid, _short(scenario))
        return (self._carried.start(valid, names, values, caller().name),)


async def said_by_bridges(ask: Callable[[BridgesAnswered], object]) -> str:
    """What a bridge has answered to a person; `ask` hands on what that has said.

    Raises:
        ScenarioError: no bridge has taken it, and why.
    """
    answered: asyncio.Future[tuple[str, str]] = asyncio.get_running_loop().create_future()

    def said(problem: str, answer: str) -> None:
        if not answered.done():
            answered.set_result((problem, answer))

    ask(said)
    problem, answer = await answered
    if problem:
        raise ScenarioError(problem)
    return answer


def _short(scenario: str) -> str:
    if len(scenario) > MOST_BYTES:
        raise ScenarioError(f"a scenario has at most {MOST_BYTES} bytes")
    return scenario


def _code_of(error: UaFleetError) -> int:
    if isinstance(error, ScenarioUnknown):
        return NOT_FOUND
    return NOT_VALID if isinstance(error, ScenarioInvalid) else NOT_POSSIBLE
