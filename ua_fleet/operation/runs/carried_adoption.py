"""A bridge of a carried run is off, as a person has said: what the others get, so that one of them goes on for it.

The plan is the one with which the run began, as it was written down: then segments have the numbers that the bridges
know, whatever has changed in fleet.yaml since. Where another version of ua-fleet began the run, the plan is made anew
from the text of the run, and its hash has to be the same.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

from ua_fleet.carrying import Part, Plan, PlanView, parts_of, split
from ua_fleet.carrying.adoption import (
    adopted_places,
    begun_slots,
    heir_of,
    may_be_heir,
    plan_without_all,
    results_heard,
)
from ua_fleet.carrying.named_rounds import NO_ROUND, example_of, rounds_begun
from ua_fleet.carrying.part import PartInvalid, decode_part
from ua_fleet.carrying.whole_plan import plan_of
from ua_fleet.carrying.whole_repeats import whole_repeats
from ua_fleet.config.connections import connection_numbers
from ua_fleet.config.relays import speakers_on
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ScenarioError
from ua_fleet.operation.log import Log
from ua_fleet.operation.runs.adopting import Adopting, UnknownRounds
from ua_fleet.operation.runs.carried_state import BridgeNames, CarriedPhase, FollowedRun
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.operation.runs.values import names_of
from ua_fleet.scenario import Scenario
from ua_fleet.scenario.facts import AdoptionTold, Fact, RunAdopted, RunCarried, RunCreated, encode_fact
from ua_fleet.scenario.model import BranchPoint
from ua_fleet.scenario.state import RunState
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.values import StatusCode

__all__ = ["Adoptions", "plan_view"]


def plan_view(config: FleetConfig, service: ScenarioService) -> PlanView:
    """What splitting needs to know of the fleet now."""
    bridges, model = config.bridges, service.robots.values()
    spaces: dict[str, int] = {}
    read_on_demand: set[str] = set()
    declared = config.robots.values()
    demanding = {
        name
        for name, bridge in bridges.items()
        if bridge.reads_on_demand([robot for robot in declared if robot.bridge == name])
    }
    for robot in model:
        for data_set in robot.data_sets:
            names = names_of(robot, data_set)
            spaces |= dict.fromkeys(names, data_set.topic.space)
            if robot.bridge in demanding and data_set.topic.space != SERVER_SPACE:
                read_on_demand.update(names)
    return PlanView(
        service.fleet,
        {robot.name: bridges[robot.bridge].space for robot in model if robot.bridge in bridges},
        {bridge.space: frozenset(bridge.requestors) for bridge in bridges.values()},
        frozenset([name for name, space in spaces.items() if space == SERVER_SPACE]),
        spaces,
        {bridge.space: _heard_by(config, bridge.space) for bridge in bridges.values()},
        frozenset(read_on_demand),
    )


def _heard_by(config: FleetConfig, space: int) -> frozenset[int]:
    """The spaces whose values come to the bridge of one: over its connections, also by relays."""
    own = connection_numbers(config, space)
    heard = {one.space for one in config.bridges.values() if set(own) & set(connection_numbers(config, one.space))}
    for number in own:
        for origins in speakers_on(config, number).values():
            heard |= origins.publishers
    return frozenset(heard)


def _before(facts: Sequence[Fact], also: Collection[int]) -> list[Fact]:
    """Facts without those that bridges were left out of which not all others knew."""
    return [fact for fact in facts if not (isinstance(fact, RunAdopted) and fact.space in also)]


class DoneUnclear(ScenarioError):
    """A person has named a task that was done in a way that cannot be taken."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT


class RoundsUnknown(ScenarioError):
    """A bridge may have done rounds that nobody has heard of: its heir would have robots do them again."""

    ua_status = StatusCode.BAD_INVALID_STATE

    def __init__(self, run_id: str, bridge: str, doers: str, unknown: UnknownRounds) -> None:
        """Say what a person has to see, and how to say it.

        Args:
            run_id: the run.
            bridge: that is off, as the person has said.
            doers: the names of the bridges that may have done these rounds.
            unknown: the repetition.
        """
        known = f"round {unknown.heard} was heard of last" if unknown.heard else "no round was heard of"
        names = list(dict.fromkeys([task.name or task.key for task in unknown.tasks]))
        last = " ".join(dict.fromkeys([f"--done {example_of(task)}" for task in unknown.tasks]))
        none = " ".join([f"--done {name}@{NO_ROUND}" for name in names])
        is_one = len(names) == 1
        see = "round they have done last" if is_one else "round of each task they have done last"
        super().__init__(
            f"{doers} may have done more rounds of {' and '.join(names)} alone: {known}, and a bridge that is"
            f" silent may go on; see at the robots which {see}, counted from 0, and name {'it' if is_one else 'each'}:"
            f" ua-fleet scenario adopt {run_id} {shlex.quote(bridge)} --off {last}; where they have done no more:"
            f" {none}"
        )


class Adoptions:
    """What can be adopted of carried runs, and what the bridges are told then."""

    def __init__(
        self,
        config: FleetConfig,
        service: ScenarioService,
        *,
        clock: Callable[[], float],
        wall_s: Callable[[], float],
        log: Log,
    ) -> None:
        """Connect the parts; `clock` is monotonic, `wall_s` the wall clock, both in seconds."""
        self._config, self._service, self._clock, self._wall_s, self._log = config, service, clock, wall_s, log
        self._names = BridgeNames({bridge.space: name for name, bridge in config.bridges.items()})
        self._after_s = config.scenarios.adopt_after_s
        self._began = clock()

    def begin(self, run: FollowedRun, bridge: str, done: Sequence[str], by: str) -> Adopting:
        """A person says that a bridge of a run is off, of which all that was fetched is in the journal.

        Where others are told of one that was left out before, this one is left out with it.

        Raises:
            ScenarioError: the bridge has answered a moment ago, none can go on, or the plan is another one.
        """
        before = run.adopting if run.phase is CarriedPhase.ADOPTING else None
        is_possible = run.phase is CarriedPhase.FOLLOWING or before is not None
        space = self.silent(run, bridge, is_possible=is_possible and run.closed is None)
        if before is not None and not self._is_silent(run, space):  # one that knows it already is not asked now
            raise ScenarioError(f"{bridge} knows that another one is off; see whether it answers once all others do")
        facts = self._service.facts_of(run.run_id)
        also = () if before is None else before.gone
        said_before = () if before is None else before.said.done
        heir = self._heir(facts, run, (*also, space))
        said = RunAdopted(self._wall_s(), space, heir, (*said_before, *done), by, also)
        made = self._made(run.run_id, facts, said)
        fetched = [one for one, asked in run.bridges.items() if asked.is_caught_up and not asked.is_away]
        begun = rounds_begun(facts)
        if why := made.why_unclear(done, {key: begun.get(key, ()) for key, at in made.heads.items() if at in fetched}):
            raise DoneUnclear(why)
        if (unknown := made.unknown_rounds()) is not None:
            doers = " and ".join([self._names[one] for one in unknown.spaces])
            raise RoundsUnknown(run.run_id, bridge, doers, unknown)
        for one in made.parts:
            made.content_for(one)  # refuses what is too large, before anything is written down
        return made

    def silent(self, run: FollowedRun, bridge: str, *, is_possible: bool = True) -> int:
        """The space of a bridge that has not answered for long; raises ScenarioError where it has."""
        there = (*run.bridges, *self.removed(run))
        space = next((space for space in there if self._names[space] == bridge), None)
        if space is None or not is_possible:
            raise ScenarioError(f"run {run.run_id} is {run.phase.value}, and {bridge[:80]!r} cannot be left out")
        if run.phase is CarriedPhase.ADOPTING and space in run.bridges and run.bridges[space].is_done:
            raise ScenarioError(f"{bridge} knows that another one is off; see whether it answers once all others do")
        silent_s = self._silent_s(run, space)
        if silent_s < self._after_s and space not in run.bridges:
            raise ScenarioError(
                f"{bridge} is not in fleet.yaml any more, and can be left out {self._after_s:g} s after the server"
                " began"
            )
        if silent_s < self._after_s:
            raise ScenarioError(
                f"{bridge} has answered {silent_s:.0f} s ago, and can be left out after {self._after_s:g} s"
            )
        return space

    def again(self, run_id: str, facts: Sequence[Fact]) -> Adopting | None:
        """After a restart: what bridges are to be told last, which may know it; None where none was left out.

        Nor is any told once more of what all of them have known: the run has gone on since, and one may be off.
        """
        numbers = [number for number, fact in enumerate(facts) if isinstance(fact, RunAdopted) and fact.heir]
        if not numbers or any(isinstance(fact, AdoptionTold) for fact in facts[numbers[-1] :]):
            return None
        said = facts[numbers[-1]]
        assert isinstance(said, RunAdopted)
        try:
            return self._made(run_id, facts[: numbers[-1]], said)
        except ScenarioError as error:
            self._log.error("bridges cannot be told that one of them is left out", run_id=run_id, reason=str(error))
            return None

    def offer(self, run: FollowedRun, space: int) -> str:
        """What a person can do about a bridge that has not answered for long; empty while there is nothing."""
        silent, name = f", nor has it answered for {self._after_s:g} s", self._names[space]
        abort = f"ua-fleet scenario abort {run.run_id}"
        if self._is_silent(run, space) and self._is_lost(run):
            return f"{silent}, and another one has waited for the run for too long: abort it: {abort}"
        if not self.can_leave_out(run, space):
            return ""
        if run.phase is CarriedPhase.ADOPTING and run.adopting is not None:
            gone = " and ".join([self._names[one] for one in run.adopting.gone])
            return (
                f"{silent}; the run goes on without {gone} once {name} knows it: start {name}, or abort it: {abort}; if"
                f" it is off for good too: ua-fleet scenario adopt {run.run_id} {name} --off"
            )
        if run.needs_nobody:
            leave = f"ua-fleet scenario adopt {run.run_id} {name} --off"
            return f"{silent}; if it is off for good, have the run end without it: {leave}"
        return (
            f"{silent}; if it is off for good, see what its robots have done, and"
            f" have another bridge go on: ua-fleet scenario adopt {run.run_id} {name} --off"
        )

    def can_leave_out(self, run: FollowedRun, space: int) -> bool:
        """Whether a person may say that a bridge is off: `begin` says what is wrong otherwise."""
        if not self._is_silent(run, space):
            return False
        if space not in run.bridges:
            return bool(run.bridges) and run.phase is not CarriedPhase.ASKING
        if run.phase is CarriedPhase.FOLLOWING:
            return len(run.bridges) > 1 and not self._is_lost(run)
        return not run.bridges[space].is_done and (run.phase is CarriedPhase.CLOSING or run.adopting is not None)

    @staticmethod
    def _is_lost(run: FollowedRun) -> bool:
        """Whether a bridge has given the run up, whose robots are free for others: nobody goes on with it."""
        return run.phase is CarriedPhase.FOLLOWING and run.closed is not None and not run.needs_nobody

    def removed(self, run: FollowedRun) -> list[int]:
        """The bridges of a run that are not in fleet.yaml any more, and that it does not end without already."""
        # While it is asked whether the run has begun, that one bridge has waited too long does not end it.
        is_over = run.closed is not None and run.phase is not CarriedPhase.ASKING
        if run.phase is CarriedPhase.CLOSING or is_over:
            return []
        return [space for space in run.late if space not in self._names]

    def why_removed(self, run: FollowedRun, space: int) -> str:
        """What to do about one of them, which cannot be asked: the token may be there, and then nothing goes on."""
        name = self._names[space]
        if run.phase is CarriedPhase.ASKING:
            return (
                "it is not in fleet.yaml any more, and whether the run has begun is not known: declare it again and"
                f" restart the server, or abort the run: ua-fleet scenario abort {run.run_id}"
            )
        said = (
            "it is not in fleet.yaml any more, and what it has of the run does not go on: declare it again and restart"
            f" the server, or abort the run: ua-fleet scenario abort {run.run_id}"
        )
        if not run.bridges:
            return said
        when = "" if self._is_silent(run, space) else f" {self._after_s:g} s after the server began"
        return (
            f"{said}; if it is off for good, see what its robots have done, and have another bridge go on{when}:"
            f" ua-fleet scenario adopt {run.run_id} {shlex.quote(name)} --off"
        )

    def _silent_s(self, run: FollowedRun, space: int) -> float:
        asked = run.bridges.get(space)  # one that is not in fleet.yaml is not asked at all
        return self._clock() - (self._began if asked is None else asked.answered_at)

    def _is_silent(self, run: FollowedRun, space: int) -> bool:
        """Whether a bridge of a run has not answered for long, though it was asked, or cannot be asked."""
        asked = run.bridges.get(space)
        return (asked is None or asked.is_away) and self._silent_s(run, space) >= self._after_s

    def _scenario(self, facts: Sequence[Fact]) -> Scenario:
        """The scenario of a run, from its own text."""
        text = next(fact.text for fact in facts if isinstance(fact, RunCreated))
        return self._service.check_text(text).scenario

    @staticmethod
    def _first_parts(facts: Sequence[Fact]) -> list[Part]:
        """What the bridges got, as it was written down; nothing where another version of ua-fleet began the run."""
        carried = next(fact for fact in facts if isinstance(fact, RunCarried))
        try:
            return [decode_part(bytes.fromhex(content)) for content in carried.parts]
        except (PartInvalid, ValueError):
            return []

    def _first_plan(self, facts: Sequence[Fact]) -> Plan:
        """With which the run began: as it was written down, else as the scenario is split now."""
        carried = next(fact for fact in facts if isinstance(fact, RunCarried))
        if given := self._first_parts(facts):
            return plan_of(dict(zip(carried.spaces, given, strict=True)))
        plan, problems = split(self._scenario(facts), plan_view(self._config, self._service))
        if plan is None:
            raise ScenarioError(f"the fleet has changed since the run began: {problems[0]}")
        return plan

    @staticmethod
    def _plan_now(plan: Plan, facts: Sequence[Fact]) -> tuple[Plan, int]:
        """What has become of it with each bridge that was left out since, and the epoch."""
        adopted = [fact for fact in facts if isinstance(fact, RunAdopted) and fact.heir]
        for each in adopted:
            plan = plan_without_all(plan, (*each.also, each.space), each.heir)
        return plan, 1 + len(adopted)

    def _heir(self, facts: Sequence[Fact], run: FollowedRun, gone: tuple[int, ...]) -> int:
        """Who goes on for bridges: none of those that do not answer."""
        plan, _ = self._plan_now(self._first_plan(facts), _before(facts, gone[:-1]))
        view, name = plan_view(self._config, self._service), " and ".join([self._names[one] for one in gone])
        removed = [one for one in self.removed(run) if one not in gone]
        # Others of these are to be left out as well: what they are allowed now is of no account.
        allowed = {one: spaces.union(removed) for one, spaces in view.requestors.items()}
        view = replace(view, requestors=allowed | dict.fromkeys(removed, frozenset(plan.spaces)))
        away = [*[one for one, asked in run.bridges.items() if asked.is_away], *removed]
        if run.adopting is not None and len(gone) > 1 and (said := run.adopting.said.heir) not in gone:
            # It may know already that it goes on for those before.
            if may_be_heir(plan, gone, said, view):
                return said
            raise ScenarioError(
                f"{self._names[said]} goes on for those before, and may not take the place of {name}: see `requestors`;"
                f" start {self._names[gone[-1]]}, or abort it: ua-fleet scenario abort {run.run_id}"
            )
        if (heir := heir_of(plan, gone, view, away)) is not None:
            return heir
        if (late := heir_of(plan, gone, view, removed)) is not None:
            raise ScenarioError(
                f"{self._names[late]} could take the place of {name}, and does not answer now; start it, or abort it:"
                f" ua-fleet scenario abort {run.run_id}"
            )
        raise ScenarioError(
            f"no other bridge of the run may take the place of {name}: see `requestors` of all, or abort it:"
            f" ua-fleet scenario abort {run.run_id}"
        )

    def _made(self, run_id: str, facts: Sequence[Fact], said: RunAdopted) -> Adopting:
        """What the bridges are told; `facts` are those before it was said."""
        plan, written = self._first_plan(facts), self._first_parts(facts)
        name = written[0].scenario if written else self._scenario(facts).name
        adopt_after_s = written[0].adopt_after_s if written else self._after_s
        created = next(fact for fact in facts if isinstance(fact, RunCreated))
        carried = next(fact for fact in facts if isinstance(fact, RunCarried))

        def parts(of_plan: Plan, epoch: int) -> dict[int, Part]:
            given, by = created.parameters, created.by
            return parts_of(of_plan, run_id, name, given, by, adopt_after_s=adopt_after_s, epoch=epoch)

        if any(part.plan_hash.hex() != carried.plan_hash for part in parts(plan, 1).values()):
            raise ScenarioError(f"the fleet has changed since run {run_id} began, so that its plan is another one now")
        first, gone, (_, epoch) = plan, (*said.also, said.space), self._plan_now(plan, facts)
        plan, _ = self._plan_now(plan, _before(facts, said.also))
        before = parts(plan, epoch)
        # Of segments that were adopted before, facts may be of a bridge that is off.
        others = [one for space, part in before.items() if space not in gone for one in part.segments.values()]
        own = [one for one in others if first.segments[one.number].space == plan.segments[one.number].space]
        state = RunState()
        for fact in facts:
            state.apply(fact)
        segments = {number: one for space in gone for number, one in before[space].segments.items()}
        homes = {number: space for space in gone for number in before[space].segments}
        places = {
            place: adopted
            for one in segments.values()
            for place, adopted in adopted_places(one, facts, said.done, said.at, said.by).items()
        }
        known = {place: tuple([encode_fact(fact) for fact in adopted]) for place, adopted in places.items()}
        results = {f"{task}.{name}": value for task, given in state.results.items() for name, value in given.items()}
        results = results_heard(segments, places, results)
        new = parts(plan_without_all(plan, gone, said.heir), epoch + 1)
        repeats = [repeat for one in segments.values() for repeat in whole_repeats(one, facts)]
        heads = {
            point.key: first.segments[one.number].space
            for one in own
            if one.body.steps and isinstance(point := one.body.steps[-1], BranchPoint) and point.is_loop
        }
        begun = begun_slots(own, facts)
        return Adopting(said, new, results, segments, known, begun, state.stand_ins, homes, repeats, heads)
