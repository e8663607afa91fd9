"""Runs, faults and decisions of one server: carries out what the orchestrator says.

    values, SkillStatus, outcomes, time, people -> orchestrator -> facts -> journal -> requests to robots; nodes, events

What follows is written down before it is carried out or shown (`carrying`). Everything here runs in the server's event
loop; the core of the server calls `poll` when `next_deadline` has come.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from ua_fleet.config.criterion_units import settings_with_units
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ScenarioError, StorageUnavailable
from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.operation.log import Log, MistakeLog
from ua_fleet.operation.runs.carrying import OutputCarrier, TaskOutput
from ua_fleet.operation.runs.clock import SteadyTime
from ua_fleet.operation.runs.decision_judgements import DecisionJudgements
from ua_fleet.operation.runs.fault_reports import FaultReports
from ua_fleet.operation.runs.holding import RobotHolds
from ua_fleet.operation.runs.kept_settings import KeptSettings
from ua_fleet.operation.runs.library import (
    MOST_NAME,
    Checked,
    Library,
    ScenarioUnknown,
)
from ua_fleet.operation.runs.membership import FleetMembership
from ua_fleet.operation.runs.operator_decisions import OperatorDecisions
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.operation.runs.requests import TaskRequests
from ua_fleet.operation.runs.restart import parted_halts, restore_faults, runs_of_journal, time_to_go_on
from ua_fleet.operation.runs.robot_news import RobotNews
from ua_fleet.operation.runs.run_commands import RunCommands
from ua_fleet.operation.runs.task_calls import Requests
from ua_fleet.operation.runs.values import FleetValues, fleet_view
from ua_fleet.orchestrator import (
    BridgesFollowed,
    DecisionChanged,
    Fault,
    FaultChanged,
    Orchestrator,
    Output,
    ResilienceSettings,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TaskStarted,
    TaskWaiting,
)
from ua_fleet.scenario import FleetView, Value
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.facts import Fact, RunEnded, TaskOutcome
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.values import NodeId

__all__ = ["ScenarioService", "TooManyRuns"]


class TooManyRuns(ScenarioError):
    """As many runs are under way as may be."""


class ScenarioService:
    """The orchestrator of one server. Methods that people call raise UaFleetError with the reason.

    What people do with scenarios and runs is in `runs`, with decisions in `decisions`, with faults in `fault_reports`,
    with robots that they hold back in `holds`. What becomes known of robots is in `news`.
    """

    def __init__(
        self,
        config: FleetConfig,
        model: FleetModel,
        journal: RunJournal,
        requests: Requests,
        *,
        folder: Path,
        show: Callable[[Output], None],
        forgotten: Callable[[str], None],
        requested: Callable[[NodeId, bytes], None],
        sooner: Callable[[], None],
        clock: Callable[[], float],
        wall_s: Callable[[], float],
        capacities: Capacities | None = None,
        mistakes: MistakeLog,
        log: Log,
        faulted: Callable[[str, bool], None] = lambda robot, can_do_nothing: None,
    ) -> None:
        """Make a service; `restore` before all else.

        Args:
            config: the fleet's.
            model: its robots.
            journal: of runs and faults.
            requests: asks robots.
            folder: of the scenarios' files.
            show: told of everything that happens, in order, once it is written down.
            forgotten: told of runs that are no longer kept.
            requested: told of each skill (its node) that was asked for, with the execution's id.
            sooner: called when `next_deadline` may have come nearer.
            clock: monotonic seconds.
            wall_s: seconds since 1970, which somebody may set: it is looked at once, for `wall_s`.
            capacities: of robots, where data gives them some.
            mistakes: counts what has cost an output.
            log: gets the lines.
            faulted: told of robots with faults, and whether these take away all that they can do.
        """
        self._faulted = faulted
        self._config, self._journal = config, journal
        self._show, self._forgotten = show, forgotten
        self.wall_s = wall_s = SteadyTime(clock, wall_s)
        """The time of runs: seconds since 1970, which nobody sets; `restore` may set it forward."""
        self._clock, self._wall_s = clock, wall_s
        self._mistakes, self._log = mistakes, log
        self._robots = {robot.name: robot for robot in model.robots}
        self._values = FleetValues(model)
        self.library = Library(folder)
        self._settings = KeptSettings(settings_with_units(config), journal, log)
        self._judgements = DecisionJudgements(journal, log)
        self._tasks = TaskRequests(
            self._robots,
            requests,
            requested=requested,
            clock=clock,
            is_silent=self._is_silent,
            accepted=self._accepted,
            ended=self._ended,
            mistakes=mistakes,
            log=log,
        )
        ask, carry_out, not_asked = self._ask, self._carry_out, self._not_asked
        self._carrier = OutputCarrier(
            journal, self._tasks, ask, carry_out, not_asked, mistakes=mistakes, log=log, clock=clock, sooner=sooner
        )
        self._do, self.forget_facts = self._carrier.do, journal.forget
        fleet = fleet_view(model.robots, self._values.meanings, capacities)
        self._orchestrator = Orchestrator(self._settings.current, fleet, self._values.look_up, self._carrier.note)
        self._orchestrator.tell_mistakes(mistakes.caught)
        self.news = news = RobotNews(
            model,
            self._robots,
            fleet,
            config.resilience.rules(),
            self._values,
            self._tasks,
            self._orchestrator,
            self._carrier,
            capacities=capacities,
            faulted=self._tell_faulted,
            sooner=sooner,
            clock=clock,
            wall_s=wall_s,
            mistakes=mistakes,
        )
        self.take_news = news.take_news
        self.holds = RobotHolds(self._orchestrator, self._do, self._robot_now, wall_s)
        self._membership = FleetMembership(
            self._robots, self._orchestrator, news, self._tasks, self.holds, self._do, wall_s, log
        )
        self.add_robot, self.remove_robot = self._membership.add, self._membership.remove
        self.told_of = self._membership.told_of
        self.runs = RunCommands(
            self._orchestrator,
            self._carrier,
            self.library,
            news,
            self._values.look_up,
            check_room=self.check_room,
            wall_s=wall_s,
            log=log,
        )
        self.decisions = OperatorDecisions(
            self._orchestrator, self._judgements, self._settings, self._do, self._robot, self.take_news, wall_s
        )
        self.fault_reports = FaultReports(self._orchestrator, news, self._do, self._robot, wall_s)
        self.carried: list[RunRecord] = []
        """Runs of the journal that bridges carry, and that have not ended."""
        self.untold: list[RunRecord] = []
        """Those that have ended without bridges that were off, which are to know it."""
        # What the core of the server says of robots goes there at once.
        self.value_changed, self.published, self.fleet_changed = news.value_changed, news.published, news.fleet_changed
        self.heard, self.source_lost, self.source_returned = news.heard, news.source_lost, news.source_returned
        self.end_batch = news.end_batch

    # What is there.

    @property
    def problem(self) -> str:
        """Why runs stand still; empty while they go on."""
        return self._carrier.problem

    @property
    def settings(self) -> ResilienceSettings:
        """How replacements are chosen now."""
        return self._orchestrator.settings

    @property
    def faults(self) -> list[Fault]:
        """All faults that are active, or not acknowledged."""
        return list(self._orchestrator.faults)

    @property
    def run_ids(self) -> list[str]:
        """Those that are under way."""
        return list(self._orchestrator.runs)

    @property
    def open_decisions(self) -> int:
        """Replacements that somebody has to choose."""
        return len(self._orchestrator.decisions)

    def needed_values(self) -> set[NodeId]:
        """The nodes whose values runs that are under way may ask for."""
        return self._values.keys_of(self._orchestrator.needed_names())

    @property
    def fleet(self) -> FleetView:
        """What robots can do now."""
        return self.news.fleet

    def _is_silent(self, robot: str) -> bool:
        return self._orchestrator.is_silent(robot)

    def check(self, name_or_text: str) -> Checked:
        """A scenario with its problems; nothing is started."""
        return self.library.checked(name_or_text, self.fleet)

    def check_text(self, text: str) -> Checked:
        """The text of a run with its problems now."""
        return self.library.checked_text(text, self.fleet)

    def bridge_of(self, robot: str) -> str:
        """The bridge that a robot lives behind; raises ScenarioUnknown where there is no such robot."""
        return self._robot(robot).bridge

    # Restart.

    def restore(self) -> list[RunRecord]:
        """Go on where the journal ends; the records of all runs, to be shown before what follows.

        Raises:
            StorageUnavailable: the journal cannot be read.
        """
        now = time_to_go_on(self.wall_s, self._journal, self._log)
        self.news.wait_for_robots(max(5.0, 2 * self._config.pubsub.receive_timeout_s))
        self._journal.prune(self._config.scenarios.kept_runs)
        found = runs_of_journal(self._journal, self.check_text, log=self._log, now=now)
        self.carried += found.carried
        self.untold += [record for record in found.records if record.state.untold and record.state.outcome is not None]
        outputs = restore_faults(self._journal.faults(), self._robots, self._orchestrator, self.news.finder, now)
        outputs += self._orchestrator.not_heard(self._robots, now)
        self._orchestrator.restore_judgements(self._judgements.restored(self.settings, found.going_on_ids))
        self.holds.restore(self._journal.holds())
        halts, self._membership.parted = parted_halts(self._journal.halts(), self._robots)
        outputs += self._orchestrator.restore_all(found.going_on, now, halts)
        self._carrier.hold(outputs)
        return found.records

    def must_not_begin(self) -> list[bytes]:
        """Executions that were asked for before a restart and must not begin any more: see the orchestrator."""
        parted = [halt.execution_id for halt in self._membership.parted]
        return [bytes.fromhex(one) for one in (*self._orchestrator.must_not_begin(), *parted)]

    def go_on(self) -> None:
        """Carry out what follows from `restore`; the records are shown."""
        self._do([])

    # Runs that bridges carry: see `carried`.

    @property
    def robots(self) -> Mapping[str, RobotModel]:
        """All robots by their names."""
        return self._robots

    def check_room(self, carried: int = 0) -> None:
        """Raises TooManyRuns where no further run may begin; `carried` are under way beside these."""
        most = self._config.scenarios.most_runs
        if len(self._orchestrator.runs) + carried >= most:
            raise TooManyRuns(f"{most} runs are under way, and more may not be; abort one, or wait for its end")

    def note(self, run_id: str, facts: Sequence[Fact], *, must_be_written: bool = False) -> None:
        """Write down and show facts of a run that is not ours to decide; later, where that is not possible now.

        Raises:
            StorageUnavailable: it is not, and `must_be_written`; then it is done later all the same.
        """
        for fact in facts:
            self._carrier.note(run_id, fact)
        self._do([RunChanged(run_id, fact) for fact in facts], must_be_written=must_be_written)

    def note_now(self, run_id: str, facts: Sequence[Fact]) -> None:
        """The same of what is not so before it is written; raises StorageUnavailable, and then it never is."""
        try:
            self.note(run_id, facts, must_be_written=True)
        except StorageUnavailable:
            if self._carrier.take_back(facts):
                raise

    def facts_of(self, run_id: str) -> list[Fact]:
        """The facts of a run in the journal; raises StorageUnavailable."""
        return self._journal.facts(run_id)

    def show_waiting(self, run_id: str, waits: TaskWaits) -> None:
        """Show why such a run does not go on now."""
        self._do([TaskWaiting(run_id, waits)])

    def show_told(self, told: DecisionChanged | BridgesFollowed) -> None:
        """Show what became of a decision of such a run, or how its bridges stand."""
        self._do([told])

    # Robots.

    def users_of(self, robot: str) -> list[str]:
        """Runs with tasks that a robot is at, or has ahead."""
        return sorted(self._orchestrator.runs_with(robot))

    def driven(self, robot: str, told: str) -> None:
        """People drive a robot by hand, in words that follow its name; empty: nobody does."""
        self._do(self._orchestrator.driven(robot, told, self._wall_s()))

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """The outcome of a request is known."""
        self.take_news()
        self._tasks.concluded(execution_id, outcome)

    def _accepted(self, execution_id: str) -> None:
        self._do(self._orchestrator.accepted(execution_id, self._wall_s()))

    def _ended(self, execution_id: str, outcome: TaskOutcome, message: str, results: Mapping[str, Value]) -> None:
        outputs = self._orchestrator.ended(execution_id, outcome, self._wall_s(), message=message, results=results)
        self._do(outputs)

    # Time.

    def poll(self) -> None:
        """Do what is due."""
        now = self._clock()
        self._carrier.poll(now)
        self.news.poll(now)
        self._tasks.poll(may_begin=not self._carrier.is_behind)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, by the monotonic clock, or None."""
        deadlines = [self._carrier.next_deadline(), self.news.next_deadline()]
        deadlines.append(self._tasks.next_deadline(may_begin=not self._carrier.is_behind))
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    # Carrying out.

    def _ask(self, output: TaskOutput, taken_back: Collection[str]) -> None:
        if isinstance(output, TaskStarted):
            self._tasks.begin(output, is_taken_back=output.execution_id in taken_back)
        elif isinstance(output, TaskCancelled):
            self._tasks.cancel(output)
        else:
            self._tasks.follow(output)

    def _carry_out(self, output: Output) -> None:
        if isinstance(output, RunBroken):
            self._mistakes.caught("runs", output.error, run_id=output.run_id)
        self._show(output)
        if isinstance(output, DecisionChanged):
            self._judgements.closed(output)
        if isinstance(output, FaultChanged):
            self._tell_faulted(output.fault.robot)
        if isinstance(output, RunChanged) and isinstance(output.fact, RunEnded):
            for run_id in self._journal.prune(self._config.scenarios.kept_runs):
                self._forgotten(run_id)

    def _tell_faulted(self, robot: str) -> None:
        self._faulted(robot, self.fault_reports.can_do_nothing(robot))

    def _not_asked(self, execution_id: str, error: Exception) -> None:
        self._tasks.failed(execution_id, error)

    # Within.

    def _robot_now(self, name: str) -> RobotModel:
        """A robot, with all that is known of it; raises as `_robot` does."""
        self.take_news()
        return self._robot(name)

    def _robot(self, name: str) -> RobotModel:
        robot = self._robots.get(name)
        if robot is None:
            raise ScenarioUnknown(f"there is no robot {name[:MOST_NAME]!r}")
        return robot
