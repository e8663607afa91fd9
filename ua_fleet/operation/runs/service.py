"""Runs, faults and decisions of one server: carries out what the orchestrator says.

    values, SkillStatus, outcomes, time, people -> orchestrator -> facts -> journal -> requests to robots; nodes, events

What follows is written down before it is carried out or shown (`carrying`). Everything here runs in the server's event
loop; the core of the server calls `poll` when `next_deadline` has come.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import Final

from ua_fleet.config.criterion_units import settings_with_units
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ScenarioError, StorageUnavailable
from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.operation.log import Log, MistakeLog
from ua_fleet.operation.runs.away import BridgesSeen
from ua_fleet.operation.runs.carrying import OutputCarrier
from ua_fleet.operation.runs.decision_judgements import DecisionJudgements
from ua_fleet.operation.runs.finding import FaultFinder
from ua_fleet.operation.runs.holding import RobotHolds
from ua_fleet.operation.runs.kept_settings import KeptSettings
from ua_fleet.operation.runs.library import Checked, Library, Listed, ScenarioUnknown, parameters_of, read_values
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.operation.runs.requests import TaskRequests
from ua_fleet.operation.runs.restart import restore_faults, scenario_to_go_on
from ua_fleet.operation.runs.task_calls import Requests
from ua_fleet.operation.runs.values import FleetValues, fleet_view, own_fields
from ua_fleet.orchestrator import (
    DecisionChanged,
    Fault,
    FaultChanged,
    FaultForecast,
    FaultFound,
    OperatorAsked,
    Orchestrator,
    Output,
    ResilienceSettings,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TaskFollowed,
    TaskStarted,
    TaskWaiting,
)
from ua_fleet.orchestrator.dry_run import DryRun, dry_run
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.resilience import Confirmation, Judgements, Ranking
from ua_fleet.scenario import Scenario, Value
from ua_fleet.scenario.consequences import ALARM, NOT_HALTED, SILENT
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.facts import Fact, RunEnded, TaskOutcome
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId, Quality, quality_of

__all__ = ["ScenarioService", "TooManyRuns", "new_run_id"]

COALESCE_S: Final = 0.1
"""Numbers are looked at so often at most; a Boolean at once."""
NEWS_PAUSE_S: Final = 0.01
"""News of robots that follow others sooner wait for the next turn, and are taken in together."""
MOST_NAME: Final = 200
"""Characters of a reason or a name that people give."""


def new_run_id(now: float) -> str:
    """An id that is never used twice, since execution ids follow from it; `now` by the wall clock."""
    stamp = datetime.fromtimestamp(now, UTC).strftime("%Y%m%d-%H%M%S")
    return f"{stamp}-{secrets.token_hex(3)}"


class TooManyRuns(ScenarioError):
    """As many runs are under way as may be."""


class ScenarioService:
    """The orchestrator of one server. Methods that people call raise UaFleetError with the reason."""

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
            wall_s: seconds since 1970, which nobody sets.
            capacities: of robots, where data gives them some.
            mistakes: counts what has cost an output.
            log: gets the lines.
            faulted: told of robots with faults, and whether these take away all that they can do.
        """
        self._faulted = faulted
        self._config, self._journal = config, journal
        self._show, self._forgotten, self._sooner = show, forgotten, sooner
        self._clock, self._wall_s, self._capacities = clock, wall_s, capacities
        self._mistakes, self._log = mistakes, log
        self._robots = {robot.name: robot for robot in model.robots}
        self._bridges = BridgesSeen(model, self._robots, wall_s)
        self._own = own_fields(model.robots)
        self._values = FleetValues(model)
        self.fleet = fleet_view(model.robots, self._values.meanings, capacities)
        self.library = Library(folder)
        self._finder = FaultFinder(model, config.resilience.rules(), self._named_first)
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
        self._carrier = OutputCarrier(
            journal,
            self._tasks,
            self._carry_out,
            self._not_asked,
            mistakes=mistakes,
            log=log,
            clock=clock,
            sooner=sooner,
        )
        self._do = self._carrier.do
        self._orchestrator = Orchestrator(
            self._settings.current,
            self.fleet,
            self._values.look_up,
            self._carrier.note,
        )
        self._orchestrator.tell_mistakes(self._mistakes.caught)
        self._orchestrator.explain_silence(self._bridges.why_silent)
        self.holds = RobotHolds(self._orchestrator, self._carrier.do, self._robot_now, wall_s)
        self._news: list[FaultFound] = []
        """What became known of robots, and nothing has followed from yet."""
        self.carried: list[RunRecord] = []
        """Runs of the journal that bridges carry, and that have not ended."""
        self._has_fleet_changed = False
        self._moved: dict[Topic, bool] = {}
        """Likewise each SkillStatus that says something else of what its robot is at, or says nothing any more; and
        whether what it shows is to be taken in."""
        self._plain: set[NodeId] = set()
        """Nodes whose values conditions may be about, and that say nothing else of robots or bridges."""
        self._news_at: float | None = None
        self._taken_at = -inf
        """When news were taken in last."""
        self._has_dirty_values = False
        self._heard_by: float | None = None
        """When robots that were not heard since the start are silent."""
        self._dirty_at: float | None = None

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

    def _is_silent(self, robot: str) -> bool:
        return self._orchestrator.is_silent(robot)

    def _named_first(self, robot: str, text: str) -> tuple[tuple[str, ...], str]:
        return self.fleet.named_first(robot, text)

    def bridge_of(self, robot: str) -> str:
        """The bridge that a robot lives behind; raises ScenarioUnknown where there is no such robot."""
        return self._robot(robot).bridge

    # Restart.

    def restore(self) -> list[RunRecord]:
        """Go on where the journal ends; the records of all runs, to be shown before what follows.

        Raises:
            StorageUnavailable: the journal cannot be read.
        """
        now = self._wall_s()
        self._heard_by = self._clock() + max(5.0, 2 * self._config.pubsub.receive_timeout_s)
        self._journal.prune(self._config.scenarios.kept_runs)
        records: list[RunRecord] = []
        stored: list[tuple[str, Scenario, list[Fact]]] = []
        for run_id, ended in self._journal.runs():
            facts = self._journal.facts(run_id)
            record = RunRecord.of(run_id, facts)
            if not ended and record.state.carried:
                self.carried.append(record)
            elif not ended:
                scenario = scenario_to_go_on(record, facts, self.check, self._journal, log=self._log, now=now)
                if scenario is not None:
                    stored.append((run_id, scenario, facts))
            records.append(record)
        outputs = restore_faults(self._journal.faults(), self._robots, self._orchestrator, self._finder, now)
        outputs += self._orchestrator.not_heard(self._robots, now)
        going_on = {run_id for run_id, _, _ in stored}
        self._orchestrator.restore_judgements(self._judgements.restored(self.settings, going_on))
        self.holds.restore(self._journal.holds(), self._robots)
        halts = [halt for halt in self._journal.halts() if halt.robot in self._robots]
        outputs += self._orchestrator.restore_all(stored, now, halts)
        if stored:
            self._log.info("runs go on", runs=len(stored))
        self._carrier.hold(outputs)
        return records

    def must_not_begin(self) -> list[bytes]:
        """Executions that were asked for before a restart and must not begin any more: see the orchestrator."""
        return [bytes.fromhex(execution_id) for execution_id in self._orchestrator.must_not_begin()]

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

    def note(self, run_id: str, facts: Sequence[Fact]) -> None:
        """Write down and show facts of a run that is not ours to decide; later, where that is not possible now."""
        for fact in facts:
            self._carrier.note(run_id, fact)
        self._do([RunChanged(run_id, fact) for fact in facts])

    def note_first(self, run_id: str, facts: Sequence[Fact]) -> None:
        """The same for the first facts of a run; raises StorageUnavailable, and then there is no such run."""
        for fact in facts:
            self._carrier.note(run_id, fact)
        try:
            self._do([RunChanged(run_id, fact) for fact in facts], must_be_written=True)
        except StorageUnavailable:
            if self._carrier.first_unwritten(run_id) is facts[0]:
                self._carrier.drop(run_id)
                raise

    def facts_of(self, run_id: str) -> list[Fact]:
        """The facts of a run in the journal; raises StorageUnavailable."""
        return self._journal.facts(run_id)

    def show_waiting(self, run_id: str, waits: TaskWaits) -> None:
        """Show why such a run does not go on now."""
        self._do([TaskWaiting(run_id, waits)])

    def show_decision(self, changed: DecisionChanged) -> None:
        """Show what became of a decision of such a run."""
        self._do([changed])

    # People.

    def listed(self) -> list[Listed]:
        """The scenarios of the folder, with how much is wrong with each. May be called from any thread."""
        return self.library.listed(self.fleet)

    def check(self, name_or_text: str) -> Checked:
        """A scenario with its problems; nothing is started."""
        return self.library.checked(name_or_text, self.fleet)

    def valid(self, name_or_text: str) -> Scenario:
        """A scenario that can be run. May wait for the disk, and be called from any thread.

        Raises:
            ScenarioInvalid: it has problems, the first of which are said.
            ScenarioError: it is not there, or too long.
        """
        return self.library.valid(name_or_text, self.fleet)

    def start(self, scenario: Scenario, names: Sequence[str], values: Sequence[str], by: str) -> str:
        """Start a run of a valid scenario; its id.

        Raises:
            ScenarioError: a parameter does not fit, or too many runs are under way.
            StorageUnavailable: it cannot be written down, and there is no run.
        """
        self.check_room()
        self.take_news()
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
        return dry_run(scenario, self.fleet, self.settings, parameters, given, lookup=self._values.look_up)

    def pause(self, run_id: str, by: str) -> None:
        """Let a run start no further task."""
        self.take_news()
        self._do(self._orchestrator.pause(self._known(run_id), by, self._wall_s()), must_be_written=True)

    def resume(self, run_id: str, by: str) -> None:
        """Let a run go on."""
        self.take_news()
        self._do(self._orchestrator.resume(self._known(run_id), by, self._wall_s()), must_be_written=True)

    def abort(self, run_id: str, reason: str, by: str) -> None:
        """End a run."""
        self.take_news()
        reason = " ".join(reason.split())[:MOST_NAME] or f"aborted by {by}"
        self._do(self._orchestrator.abort(self._known(run_id), reason, by, self._wall_s()), must_be_written=True)

    def answer(self, run_id: str, step: str, answer: str, by: str) -> None:
        """Say what became of a task; the step may be named by its task."""
        self.take_news()
        run = self._orchestrator.runs[self._known(run_id)]
        steps = [key for key, task in run.state.tasks.items() if step in (key, task.name)]
        key = steps[-1] if steps else step
        self._do(self._orchestrator.answer(run_id, key, answer, by, self._wall_s()), must_be_written=True)

    def tell_event(self, name: str) -> None:
        """An event has happened that steps may wait for."""
        self.take_news()
        self._do(self._orchestrator.event(name[:MOST_NAME], self._wall_s()), must_be_written=True)

    def confirm(self, decision_id: str, robot: str, by: str) -> Confirmation:
        """Choose a replacement. Of two who choose at once the first decides, the other is told so."""
        self.take_news()
        self._check_decision(decision_id)
        confirmation, outputs = self._orchestrator.confirm(decision_id, robot, by, self._wall_s())
        self._do(outputs, must_be_written=True)
        return confirmation

    def preview(self, decision_id: str, judgements: Judgements | None) -> Ranking:
        """The ranking of an open decision with other judgements, which changes nothing; None: those that count.

        Raises:
            JudgementsInvalid: no weights can be made of them.
            ScenarioUnknown: there is no such decision.
        """
        self._check_decision(decision_id)
        return self._orchestrator.preview(decision_id, judgements)

    def judge(self, decision_id: str, judgements: Judgements | None, by: str) -> Ranking:
        """Rank an open decision with other judgements, also after a restart; None: with those of all.

        Raises:
            JudgementsInvalid: no weights can be made of them.
            ScenarioUnknown: there is no such decision.
            StorageUnavailable: it cannot be kept, and nothing has changed.
        """
        self.take_news()
        ranking = self.preview(decision_id, judgements)  # refuses what cannot be weighed before it is kept
        now = self._wall_s()
        if judgements is None:
            self._judgements.forget(decision_id)
        else:
            self._judgements.keep(decision_id, judgements, by, now)
        self._do(self._orchestrator.judge(decision_id, judgements, now))
        return ranking

    def _check_decision(self, decision_id: str) -> None:
        if decision_id not in self._orchestrator.decisions:
            raise ScenarioUnknown(
                f"there is no open decision {decision_id[:MOST_NAME]!r}; somebody may have decided it"
            )

    def what_if(self, robot: str) -> tuple[int, Iterator[FaultForecast]]:
        """How many tasks a robot has ahead, and who would take over each of them, one by one and without effect."""
        self._robot(robot)
        return self._orchestrator.what_if(robot)

    def set_settings(self, settings: ResilienceSettings, by: str) -> None:
        """Other judgements or modes, also after a restart; open decisions are ranked again.

        Raises:
            StorageUnavailable: it cannot be kept, and nothing has changed.
        """
        self.take_news()
        self._settings.keep(settings, by, self._wall_s())
        self._do(self._orchestrator.set_settings(settings, self._wall_s()))

    def raise_fault(self, robot: str, reason: str) -> None:
        """A robot, or somebody for it, says that it cannot work; `mobile: the drive is hot`: that it is not mobile."""
        self.take_news()
        reason = " ".join(reason.split())[:MOST_NAME] or "it says that it cannot work"
        capacities, rest = self.fleet.named_first(self._robot(robot).name, reason)
        outputs = self._orchestrator.fault_raised(robot, "robot", rest or reason, self._wall_s(), capacities)
        self._do(outputs, must_be_written=True)

    def can_do_nothing(self, robot: str) -> bool:
        """Whether its faults take all capacities of a robot away; one that names none takes all."""
        view = self.fleet.robots.get(robot)
        each = [(capacity,) for capacity in view.capacities] if view is not None else []
        faults = self._orchestrator.faults
        return bool(faults.keeping(robot, ())) or (bool(each) and all(faults.keeping(robot, one) for one in each))

    def clear_fault(self, name: str) -> None:
        """A robot, or somebody for it, says that it can work again.

        Args:
            name: of the robot, for all of its faults; or the id of one of them, `<robot>.<source>`.

        Raises:
            ScenarioUnknown: there is no such robot, or it has no such fault.
            ScenarioError: it has no other faults than those whose cause is there still.
        """
        self.take_news()
        robot, _, source = name.partition(".")
        active = self._orchestrator.faults.active(self._robot(robot).name)
        if source:
            known = ", ".join(fault.id for fault in active) or "none"
            active = [fault for fault in active if fault.source == source]
            if not active:
                raise ScenarioUnknown(f"{robot} has no fault {name[:MOST_NAME]!r}; its faults now: {known}")
        there = [fault for fault in active if self._finder.is_there(fault)]
        if active and active == there:
            causes = ", ".join(f"{fault.source} ({fault.reason})" for fault in there)
            raise ScenarioError(f"{robot} has a fault whose cause is still there: {causes}; it ends by itself")
        outputs: list[Output] = []
        for fault in active:
            if fault not in there:
                outputs += self._orchestrator.fault_cleared(robot, fault.source, self._wall_s())
        self._do(outputs, must_be_written=True)

    def acknowledge(self, fault_id: str, by: str) -> None:
        """Somebody has seen a fault."""
        self.take_news()
        self._do(self._orchestrator.acknowledge(fault_id, by, self._wall_s()), must_be_written=True)

    # Robots.

    def add_robot(self, robot: RobotModel, *, is_heard: bool) -> None:
        """A robot has come: scenarios may use it from now on."""
        self._robots[robot.name] = robot
        self._plain.clear()
        for part in (self._values, self._finder, self._tasks):
            part.add(robot)
        if is_heard:
            self._finder.heard(robot.name)
        else:
            self._do(self._orchestrator.not_heard([robot.name], self._wall_s()))
        self.fleet_changed()

    def remove_robot(self, name: str) -> None:
        """A robot that no run uses is gone, with its faults."""
        robot = self._robots[name]
        for fault in self._orchestrator.faults.active(name):
            self._do(self._orchestrator.fault_cleared(name, fault.source, self._wall_s()))
        self._do(self._orchestrator.fault_cleared(name, NOT_HALTED, self._wall_s()))  # it need not say it any more
        self.holds.forget(name)
        self._orchestrator.forget(name)
        del self._robots[name]
        self._plain.clear()
        for part in (self._values, self._finder, self._tasks):
            part.remove(robot)
        self._look_at_fleet()  # before it could be given to a task

    def users_of(self, robot: str) -> list[str]:
        """Runs with tasks that a robot is at, or has ahead."""
        return sorted(self._orchestrator.runs_with(robot))

    def fleet_changed(self) -> None:
        """Robots, skills or capacities have come or gone: it is looked at with the next news."""
        self._has_fleet_changed = True
        self._expect_news()

    def _look_at_fleet(self) -> None:
        self._has_fleet_changed = False
        self._own = own_fields(self._robots.values())
        self.fleet = fleet_view(self._robots.values(), self._values.meanings, self._capacities)
        self._do(self._orchestrator.fleet_changed(self.fleet, self._wall_s()))
        for robot in {fault.robot for fault in self._orchestrator.faults if fault.active}:
            self._faulted(robot, self.can_do_nothing(robot))  # a device that came or went may be all that it can do

    def value_changed(self, change: ValueChanged) -> None:
        """A node of the fleet has another value or status."""
        if change.key in self._plain:
            if self._values.change(change):
                self._look_again(is_urgent=change.type == BuiltinType.BOOLEAN)
        elif (bridge := self._bridges.comes_or_goes(change)) is not None:
            self._tell_of_bridge(bridge)
        elif (link := self._bridges.linked(change)) is not None:
            self._take_link(*link)
        elif self._finder.knows(change):
            self._tell_soon(self._finder.changed(change))
        elif self._values.change(change):
            self._plain.add(change.key)
            self._look_again(is_urgent=change.type == BuiltinType.BOOLEAN)

    def published(self, topic: Topic, types: Sequence[int], values: Sequence[object]) -> None:
        """Data of the server itself, which clients write, has been sent to robots."""
        for key, kind, value in zip(self._own.get(topic, ()), types, values, strict=False):
            if kind != BuiltinType.STATUS_CODE and self._values.take(key, value, 0):
                self._look_again(is_urgent=kind == BuiltinType.BOOLEAN)

    def heard(self, event: DataReceived) -> None:
        """Take a robot's SkillStatus; any other data is left alone."""
        robot = self._tasks.robot_of(event.topic)
        if robot is None:
            return
        if quality_of(event.message.status or 0) is Quality.BAD:
            self.source_lost(event.topic)
        else:
            if event.topic in self._moved:
                self.take_news()  # what it has said before is not passed over
            self._tasks.show(event)
            if self._bridges.is_apart(robot):
                self._tasks.lose(event.topic)
            self._move(event.topic, is_shown=True)

    def source_lost(self, topic: Topic) -> None:
        """A source is not heard any more, or its last value may not be of now: of a SkillStatus, nothing says any more
        what the robot is at.
        """
        if self._tasks.robot_of(topic) is not None:
            self._tasks.lose(topic)
            self._move(topic, is_shown=False)

    def source_returned(self, topic: Topic) -> None:
        """The last value of a source is of now again."""
        robot = self._tasks.robot_of(topic)
        if robot is not None and not self._bridges.is_apart(robot):
            self._tasks.find(topic)
            self._move(topic, is_shown=True)

    def _move(self, topic: Topic, *, is_shown: bool) -> None:
        self._moved[topic] = is_shown or self._moved.get(topic, False)
        self._expect_news()

    def _take_link(self, bridge: str, reaches: bool) -> None:
        """A bridge reaches its robots, or has lost one: then it says no longer what any of them is at. Those whose
        values are there are heard all the same.
        """
        if not self._bridges.set_link(bridge, reaches=reaches):
            return
        for topic in [robot.skill_status for robot in self._robots.values() if robot.bridge == bridge]:
            if topic is not None and reaches:
                self.source_returned(topic)
            elif topic is not None:
                self.source_lost(topic)

    def _tell_of_bridge(self, bridge: str) -> None:
        """A bridge has come or gone: faults of its robots that are silent say so, and runs that wait for them."""
        robots = {robot.name for robot in self._robots.values() if robot.bridge == bridge}
        silent = [one for one in self.faults if one.active and one.source == SILENT and one.robot in robots]
        silent = [one for one in silent if self._finder.is_there(one)]  # else its end is news that is not taken in yet
        self._tell_soon([FaultFound(one.robot, SILENT, True, one.reason.partition(":")[0]) for one in silent])
        self._look_again(is_urgent=True)

    def _tell_soon(self, news: Sequence[FaultFound]) -> None:
        """Have what became known of robots taken in with what comes in the same batch."""
        if news:
            self._news += news
            self._expect_news()

    def _expect_news(self) -> None:
        if self._news_at is None:
            self._news_at = self._clock()
            self._sooner()

    def alarms_found(self, found: Sequence[FaultFound]) -> None:
        """Alarms of values that are faults have become active or inactive."""
        self._finder.alarms_found(found)
        self._tell_soon(found)

    def alarms_restored(self, found: Sequence[FaultFound]) -> None:
        """How these alarms were before the restart: a fault of one that is over, or not there any more, ends."""
        active = {f"{one.robot}.{one.source}" for one in found if one.active}
        kept = [fault for fault in self.faults if fault.active and fault.source.startswith(ALARM)]
        over = [FaultFound(fault.robot, fault.source, False, "") for fault in kept if fault.id not in active]
        self.alarms_found([*over, *[one for one in found if one.active]])

    def _explained(self, found: FaultFound) -> FaultFound:
        """What was found, with why nothing is heard of a robot that is silent."""
        if found.source == SILENT and found.active and (why := self._bridges.why_silent(found.robot)):
            return replace(found, reason=f"{found.reason}: {why}")
        return found

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

    def end_batch(self) -> None:
        """A batch of news is complete: it is taken in now, or with those that follow where the last ones just were.

        So what a thousand robots say one by one is decided, and written down, a few times and not a thousand.
        """
        if not (self._has_dirty_values or self._has_fleet_changed or self._news or self._moved):
            return  # most batches are values that no run and no fault is about
        if not self._carrier.is_behind and self._clock() >= self._taken_at + NEWS_PAUSE_S:
            self.take_news()

    def take_news(self) -> None:
        """Take in all that has become known of robots, and do what follows. Who decides anything calls it before."""
        if self._has_dirty_values:
            self._has_dirty_values = False
            self._news += self._finder.check(self._values.look_up)
        self._news_at = None
        if self._has_fleet_changed:
            self._look_at_fleet()
        if not (self._news or self._moved):
            return
        news, self._news = self._news, []
        moved, self._moved = self._moved, {}
        followed = [(self._tasks.robot_of(topic) or "", self._tasks.under_way(topic)) for topic in moved]
        with self._mistakes.guard("faults"):
            self._do(self._orchestrator.told([self._explained(one) for one in news], self._wall_s(), followed))
        for topic in [topic for topic, is_shown in moved.items() if is_shown]:
            with self._mistakes.guard("tasks", topic=topic.name):
                self._tasks.take_shown(topic)  # after it is known that the robot is at it, or is not
        for robot in [one.robot for one in news if one.source == SILENT and not one.active]:
            with self._mistakes.guard("tasks", robot=robot):
                self._tasks.robot_heard(robot)
        self._taken_at = self._clock()

    # Time.

    def poll(self) -> None:
        """Do what is due."""
        now = self._clock()
        self._carrier.poll(now)
        if self._heard_by is not None and now >= self._heard_by:
            self._heard_by = None
            self._news += self._finder.not_heard()
        self.take_news()
        due = self._orchestrator.next_deadline()
        if (self._dirty_at is not None and now >= self._dirty_at) or (due is not None and self._wall_s() >= due):
            self._dirty_at = None
            self._do(self._orchestrator.poll(self._wall_s()))
        self._tasks.poll(may_begin=not self._carrier.is_behind)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, by the monotonic clock, or None."""
        due = self._orchestrator.next_deadline()
        deadlines = [self._carrier.next_deadline(), self._heard_by, self._news_at, self._dirty_at]
        deadlines.append(self._tasks.next_deadline(may_begin=not self._carrier.is_behind))
        if due is not None:
            deadlines.append(self._clock() + max(0.0, due - self._wall_s()))
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def _look_again(self, *, is_urgent: bool) -> None:
        if not (self._orchestrator.runs or self._finder.has_conditions):
            return
        self._has_dirty_values = self._finder.has_conditions
        at = self._clock() + (0.0 if is_urgent else COALESCE_S)
        if self._dirty_at is None or at < self._dirty_at:
            self._dirty_at = at
            self._sooner()

    # Carrying out.

    def _carry_out(self, output: Output, taken_back: Collection[str]) -> None:
        if isinstance(output, TaskStarted):
            self._tasks.begin(output, is_taken_back=output.execution_id in taken_back)
        elif isinstance(output, TaskCancelled):
            self._tasks.cancel(output)
        elif isinstance(output, OperatorAsked | TaskFollowed):
            self._tasks.follow(output)
        elif isinstance(output, RunBroken):
            self._mistakes.caught("runs", output.error, run_id=output.run_id)
        self._show(output)
        if isinstance(output, DecisionChanged):
            self._judgements.closed(output)
        if isinstance(output, FaultChanged):
            self._faulted(output.fault.robot, self.can_do_nothing(output.fault.robot))
        if isinstance(output, RunChanged) and isinstance(output.fact, RunEnded):
            for run_id in self._journal.prune(self._config.scenarios.kept_runs):
                self._forgotten(run_id)

    def _not_asked(self, execution_id: str, error: Exception) -> None:
        self._tasks.failed(execution_id, error)

    # Within.

    def _known(self, run_id: str) -> str:
        if run_id not in self._orchestrator.runs:
            raise ScenarioUnknown(f"there is no run {run_id[:MOST_NAME]!r} under way")
        return run_id

    def _robot_now(self, name: str) -> RobotModel:
        """A robot, with all that is known of it; raises as `_robot` does."""
        self.take_news()
        return self._robot(name)

    def _robot(self, name: str) -> RobotModel:
        robot = self._robots.get(name)
        if robot is None:
            raise ScenarioUnknown(f"there is no robot {name[:MOST_NAME]!r}")
        return robot
