"""`ua-fleet scenario ...`: scenarios and their runs."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import aclosing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line, print_table
from ua_fleet.cli.process import run as run_until_done
from ua_fleet.errors import NotConnected, ScenarioError, ScenarioInvalid

if TYPE_CHECKING:
    from ua_fleet.client import RunInfo, ScenarioClient

__all__ = [
    "ABORT_EXAMPLES",
    "ADOPT_EXAMPLES",
    "ANSWER_EXAMPLES",
    "DRYRUN_EXAMPLES",
    "LIST_EXAMPLES",
    "PAUSE_EXAMPLES",
    "RESUME_EXAMPLES",
    "RUN_EXAMPLES",
    "TELL_EXAMPLES",
    "VALIDATE_EXAMPLES",
    "WATCH_EXAMPLES",
    "abort",
    "adopt",
    "answer",
    "dryrun",
    "pause",
    "resume",
    "run",
    "show",
    "tell",
    "validate",
    "watch",
    "with_scenarios",
]

LIST_EXAMPLES = ("ua-fleet scenario list -u anna",)
VALIDATE_EXAMPLES = ("ua-fleet scenario validate nine_tasks -u anna", "ua-fleet scenario validate ./new.yaml -u anna")
RUN_EXAMPLES = ("ua-fleet scenario run nine_tasks angle=20 -u anna", "ua-fleet scenario run nine_tasks --wait -u anna")
WATCH_EXAMPLES = ("ua-fleet scenario watch 20300131-120000-a1b2c3 -u anna --json",)
PAUSE_EXAMPLES = ("ua-fleet scenario pause 20300131-120000-a1b2c3 -u anna",)
RESUME_EXAMPLES = ("ua-fleet scenario resume 20300131-120000-a1b2c3 -u anna",)
ABORT_EXAMPLES = ('ua-fleet scenario abort 20300131-120000-a1b2c3 --reason "door open" -u anna',)
ADOPT_EXAMPLES = ("ua-fleet scenario adopt 20300131-120000-a1b2c3 carrier_cell --off --done fetch -u anna",)
ANSWER_EXAMPLES = ("ua-fleet scenario answer 20300131-120000-a1b2c3 fetch done -u anna",)

DRYRUN_EXAMPLES = (
    "ua-fleet scenario dryrun nine_tasks -u anna",
    "ua-fleet scenario dryrun ./new.yaml angle=20 --value temperature=25 --value fetch.weight=2 -u anna",
)
TELL_EXAMPLES = ("ua-fleet scenario tell door_open -u anna",)

RunId = Annotated[str, typer.Argument(help="Id of the run.")]
ScenarioName = Annotated[str, typer.Argument(help="Name of a scenario of the server, or a file: ./new.yaml.")]


def with_scenarios(connection: ConnectionOptions, work: Callable[[ScenarioClient], Awaitable[None]]) -> None:
    """Connect, and do something with scenarios."""

    async def main() -> None:
        async with connected(connection) as client:
            from ua_fleet.client import ScenarioClient

            await work(ScenarioClient(client))

    run_until_done(main())


@connecting
def show(
    connection: ConnectionOptions,
    as_json: Json = False,
) -> None:
    """List the scenarios that the server has."""

    async def work(scenarios: ScenarioClient) -> None:
        found = await scenarios.scenarios()
        if as_json:
            for one in found:
                print_json(asdict(one))
        else:
            print_table(
                [("scenario", "problems", "description"), *((s.name, str(s.problems), s.description) for s in found)]
            )

    with_scenarios(connection, work)


@connecting
def validate(
    connection: ConnectionOptions,
    scenario: ScenarioName,
    carried: Annotated[
        bool, typer.Option("--carried", help="Say also what keeps bridges from carrying a run of it.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Check a scenario against the server's fleet, and print all its problems.

    The exit code is 2 if it has problems.
    """
    text = _given(scenario)

    async def work(scenarios: ScenarioClient) -> None:
        problems = await scenarios.validate(text, carried=carried)
        if as_json:
            for problem in problems:
                print_json(asdict(problem))
        if problems:
            said = (
                ["the scenario cannot be run; see the problems above"]
                if as_json
                else [problem.text for problem in problems]
            )
            raise _Invalid(said)

    with_scenarios(connection, work)


@connecting
def run(
    connection: ConnectionOptions,
    scenario: ScenarioName,
    parameters: Annotated[list[str] | None, typer.Argument(help="Parameters as name=value.")] = None,
    carried: Annotated[
        bool, typer.Option("--carried", help="Have the bridges carry the run, which then needs no server.")
    ] = False,
    wait: Annotated[bool, typer.Option("--wait", help="Print what happens until the run has ended.")] = False,
    as_json: Json = False,
) -> None:
    """Start a run, and print its id.

    With --wait, the exit code is 1 if the run was not done in the end. Ctrl-C ends this command; the run goes on.
    """
    text, given = _given(scenario), dict(_parameter(one) for one in parameters or ())

    async def work(scenarios: ScenarioClient) -> None:
        run_id = await scenarios.run(text, given, carried=carried)
        if as_json:
            print_json({"run_id": run_id})
        else:
            print_line(run_id)
        if wait:
            await _follow(scenarios, run_id, as_json=as_json)
        elif (info := await scenarios.run_info(run_id)).reason:
            message(info.reason)

    with_scenarios(connection, work)


@connecting
def dryrun(
    connection: ConnectionOptions,
    scenario: ScenarioName,
    parameters: Annotated[list[str] | None, typer.Argument(help="Parameters as name=value.")] = None,
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--value", help="A robot's value or a task's result as name=value, for conditions; may be repeated."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the course of a run in which every robot does each skill at once. No robot is asked.

    The exit code is 1 if the run would not be done.
    """
    text = _given(scenario)
    given, known = (dict(_parameter(one) for one in pairs or ()) for pairs in (parameters, values))

    async def work(scenarios: ScenarioClient) -> None:
        found = await scenarios.dry_run(text, given, known)
        if as_json:
            print_json(asdict(found))
        else:
            for moment in found.timeline:
                print_line(f"{moment.at_s:8.2f} s  {moment.text}")
        if found.outcome != "done":
            end = {"": "it would not end", "failed": "it would fail"}.get(found.outcome, f"it would be {found.outcome}")
            raise ScenarioError(f"{end}: {found.reason}")

    with_scenarios(connection, work)


@connecting
def tell(
    connection: ConnectionOptions,
    name: Annotated[str, typer.Argument(help="Name of the event, as in `wait: {event: NAME}`.")],
    as_json: Json = False,
) -> None:
    """Report that an event has happened. Steps that wait for it go on."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.tell_event(name)
        if as_json:
            print_json({"event": name, "done": True})

    with_scenarios(connection, work)


@connecting
def watch(
    connection: ConnectionOptions,
    run_id: RunId,
    as_json: Json = False,
) -> None:
    """Print a run now and whenever it changes, until it has ended. Exit code 1 if it was not done."""

    async def work(scenarios: ScenarioClient) -> None:
        await _follow(scenarios, run_id, as_json=as_json)

    with_scenarios(connection, work)


@connecting
def pause(
    connection: ConnectionOptions,
    run_id: RunId,
    as_json: Json = False,
) -> None:
    """Pause a run: it starts no further task; tasks under way go on."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.pause(run_id)
        if as_json:
            print_json({"run_id": run_id, "done": True})

    with_scenarios(connection, work)


@connecting
def resume(
    connection: ConnectionOptions,
    run_id: RunId,
    as_json: Json = False,
) -> None:
    """Let a run go on."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.resume(run_id)
        if as_json:
            print_json({"run_id": run_id, "done": True})

    with_scenarios(connection, work)


@connecting
def abort(
    connection: ConnectionOptions,
    run_id: RunId,
    reason: Annotated[str, typer.Option(help="Reason, shown to users.")] = "",
    as_json: Json = False,
) -> None:
    """Abort a run; skills that can be halted are halted."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.abort(run_id, reason)
        if as_json:
            print_json({"run_id": run_id, "done": True})

    with_scenarios(connection, work)


@connecting
def answer(
    connection: ConnectionOptions,
    run_id: RunId,
    step: Annotated[str, typer.Argument(help="Key of the step, or name of its task.")],
    answer: Annotated[str, typer.Argument(help="done, retry, fail, or replace: another robot is looked for.")],
    as_json: Json = False,
) -> None:
    """Answer what became of a task whose outcome is unknown."""

    async def work(scenarios: ScenarioClient) -> None:
        await scenarios.answer(run_id, step, answer)
        if as_json:
            print_json({"run_id": run_id, "done": True})

    with_scenarios(connection, work)


@connecting
def adopt(
    connection: ConnectionOptions,
    run_id: RunId,
    bridge: Annotated[str, typer.Argument(help="Bridge that does not answer.")],
    is_off: Annotated[bool, typer.Option("--off", help="Say that it is off, and stays so until this is done.")] = False,
    done: Annotated[
        list[str] | None,
        typer.Option(
            "--done", help="Task that its robots have done and no bridge has reported; in a repeat TASK@ROUND, from 0."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Have another bridge go on with what a bridge of a carried run had that is off for good."""
    if not is_off:
        raise UsageError(f"see that {bridge} is off and what its robots have done, then say --off")

    async def work(scenarios: ScenarioClient) -> None:
        heir = await scenarios.adopt(run_id, bridge, done or ())
        if as_json:
            print_json({"run_id": run_id, "heir": heir})
        else:
            message(f"{heir} goes on for {bridge}" if heir else f"the run ends without {bridge}")

    with_scenarios(connection, work)


class _Invalid(UsageError, ScenarioInvalid):
    """A scenario has problems: exit code 2."""


async def _follow(scenarios: ScenarioClient, run_id: str, *, as_json: bool) -> None:
    try:
        last = await _print_changes(scenarios, run_id, as_json=as_json)
    except NotConnected:
        message(f"the run goes on without this command; see: ua-fleet scenario watch {run_id}")
        raise
    if last is None or not last.is_over:
        message(f"the connection has ended; see: ua-fleet scenario watch {run_id}")
    elif last.state != "done":
        raise ScenarioError(f"run {run_id} {last.state}: {last.reason}")


async def _print_changes(scenarios: ScenarioClient, run_id: str, *, as_json: bool) -> RunInfo | None:
    """Print a run whenever it changes; how it was last."""
    last: RunInfo | None = None
    shown = told = ""
    async with aclosing(scenarios.follow(run_id)) as changes:
        async for info in changes:
            last = info
            if as_json:
                print_json(asdict(info))
            else:
                tasks = [
                    f"{task} ({robot}) {state}"
                    for task, robot, state in zip(info.tasks, info.robots, info.states, strict=False)
                ]
                line = f"{info.state}: {', '.join(tasks) or 'no task yet'}"
                if line != shown:
                    shown = line
                    print_line(line)
                if info.reason != told and not info.is_over:
                    told = info.reason
                    if told:
                        print_line(f"  {told}")
    return last


def _given(scenario: str) -> str:
    """A scenario's name, or the text of a file."""
    if not scenario.endswith((".yaml", ".yml", ".json")):
        return scenario
    try:
        text = Path(scenario).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UsageError(f"{scenario}: cannot be read: {reason}; name a file, or a scenario of the server") from error
    return f"{text}\n"


def _parameter(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"{text!r} is no parameter; write name=value")
    return name, value
