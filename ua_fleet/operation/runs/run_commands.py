"""Scenarios and their runs, as people command them: listed, rehearsed, started, paused, aborted, answered."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from ua_fleet.errors import StorageUnavailable
from ua_fleet.operation.log import Log
from ua_fleet.operation.runs.carrying import OutputCarrier
from ua_fleet.operation.runs.library import MOST_NAME, Library, Listed, ScenarioUnknown, parameters_of, read_values
from ua_fleet.operation.runs.robot_news import RobotNews
from ua_fleet.orchestrator import Orchestrator, RunChanged
from ua_fleet.orchestrator.dry_run import DryRun, dry_run
from ua_fleet.scenario import Lookup, Scenario

__all__ = ["RunCommands", "new_run_id"]


def new_run_id(now: float) -> str:
    """An id that is never used twice, since execution ids follow from it; `now` by the wall clock."""
    stamp = datetime.fromtimestamp(now, UTC).strftime("%Y%m%d-%H%M%S")
    return f"{stamp}-{secrets.token_hex(3)}"


class RunCommands:
    """The scenarios of the folder, and the runs that are under way. Methods raise UaFleetError with the reason."""

    def __init__(
        self,
        orchestrator: Orchestrator,
        carrier: OutputCarrier,
        library: Library,
        news: RobotNews,
        lookup: Lookup,
        *,
        check_room: Callable[[], None],
        wall_s: Callable[[], float],
        log: Log,
    ) -> None:
        """Connect the parts.

        Args:
            orchestrator: has the runs.
            carrier: writes down what has happened, and carries it out.
            library: the scenarios of the folder.
            news: what is known of robots; it is taken in before anything is decided.
            lookup: the values of robots.
            check_room: raises TooManyRuns where no further run may begin.
            wall_s: seconds since 1970.
            log: is told of each start.
        """
        self._orchestrator, self._carrier, self._do = orchestrator, carrier, carrier.do
        self._library, self._news, self._lookup = library, news, lookup
        self._check_room, self._wall_s, self._log = check_room, wall_s, log

    def listed(self) -> list[Listed]:
        """The scenarios of the folder, with how much is wrong with each. May be called from any thread."""
        return self._library.listed(self._news.fleet)

    def valid(self, name_or_text: str) -> Scenario:
        """A scenario that can be run. May wait for the disk, and be called from any thread.

        Raises:
            ScenarioInvalid: it has problems, the first of which are said.
            ScenarioError: it is not there, or too long.
        """
        return self._library.valid(name_or_text, self._news.fleet)

    def rehearse(
        self,
        name_or_text: str,
        names: Sequence[str],
        values: Sequence[str],
        given_names: Sequence[str],
        given_values: Sequence[str],
    ) -> DryRun:
        """What a run would come to, with these values; raises as `valid` does. May be called from any thread."""
        scenario = self.valid(name_or_text)
        given = read_values(given_names, given_values)
        parameters = parameters_of(scenario, names, values)
        return dry_run(scenario, self._news.fleet, self._orchestrator.settings, parameters, given, lookup=self._lookup)

    def start(self, scenario: Scenario, names: Sequence[str], values: Sequence[str], by: str) -> str:
        """Start a run of a valid scenario; its id.

        Raises:
            ScenarioError: a parameter does not fit, or too many runs are under way.
            StorageUnavailable: it cannot be written down, and there is no run.
        """
        self._check_room()
        self._news.take_news()
        now = self._wall_s()
        run_id = new_run_id(now)
        outputs = self._orchestrator.start(run_id, scenario, parameters_of(scenario, names, values), by=by, now=now)
        created = self._carrier.first_unwritten(run_id)
        assert created is not None, "a run begins with a fact"
        try:
            self._do([RunChanged(run_id, created), *outputs], must_be_written=True)
        except StorageUnavailable:
            if self._carrier.first_unwritten(run_id) is created:
                self._take_back(run_id, now)
                raise
        self._log.info("run started", run_id=run_id, scenario=scenario.name, by=by)
        return run_id

    def _take_back(self, run_id: str, now: float) -> None:
        """A run of which nothing is written down and nothing was carried out."""
        outputs = self._orchestrator.take_back(run_id, now)
        self._carrier.drop(run_id)
        self._do([output for output in outputs if getattr(output, "run_id", "") != run_id])

    def pause(self, run_id: str, by: str) -> None:
        """Let a run start no further task."""
        self._news.take_news()
        self._do(self._orchestrator.pause(self._known(run_id), by, self._wall_s()), must_be_written=True)

    def resume(self, run_id: str, by: str) -> None:
        """Let a run go on."""
        self._news.take_news()
        self._do(self._orchestrator.resume(self._known(run_id), by, self._wall_s()), must_be_written=True)

    def abort(self, run_id: str, reason: str, by: str) -> None:
        """End a run."""
        self._news.take_news()
        reason = " ".join(reason.split())[:MOST_NAME] or f"aborted by {by}"
        self._do(self._orchestrator.abort(self._known(run_id), reason, by, self._wall_s()), must_be_written=True)

    def answer(self, run_id: str, step: str, answer: str, by: str) -> None:
        """Say what became of a task; the step may be named by its task."""
        self._news.take_news()
        run = self._orchestrator.runs[self._known(run_id)]
        steps = [key for key, task in run.state.tasks.items() if step in (key, task.name)]
        key = steps[-1] if steps else step
        self._do(self._orchestrator.answer(run_id, key, answer, by, self._wall_s()), must_be_written=True)

    def tell_event(self, name: str) -> None:
        """An event has happened that steps may wait for."""
        self._news.take_news()
        self._do(self._orchestrator.event(name[:MOST_NAME], self._wall_s()), must_be_written=True)

    def _known(self, run_id: str) -> str:
        if run_id not in self._orchestrator.runs:
            raise ScenarioUnknown(f"there is no run {run_id[:MOST_NAME]!r} under way")
        return run_id
