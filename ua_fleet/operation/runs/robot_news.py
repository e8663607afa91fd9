"""What becomes known of robots: taken in together, at most every `NEWS_PAUSE_S`, and then decided on.

    value, SkillStatus, bridge, alarm, condition -> news -- end_batch or poll --> take_news -> orchestrator -> outputs

Everything here runs in the server's event loop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Final

from ua_fleet.fleet.capacities import Capacities
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.operation.log import MistakeLog
from ua_fleet.operation.runs.away import BridgesSeen
from ua_fleet.operation.runs.carrying import OutputCarrier
from ua_fleet.operation.runs.finding import FaultFinder
from ua_fleet.operation.runs.requests import TaskRequests
from ua_fleet.operation.runs.values import FleetValues, fleet_view, own_fields
from ua_fleet.orchestrator import FaultFound, FaultRule, Orchestrator
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.scenario import FleetView
from ua_fleet.scenario.consequences import ALARM, SILENT
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId, Quality, quality_of

__all__ = ["RobotNews"]

COALESCE_S: Final = 0.1
"""Numbers are looked at so often at most; a Boolean at once."""
NEWS_PAUSE_S: Final = 0.01
"""News of robots that follow others sooner wait for the next turn, and are taken in together."""


class RobotNews:
    """What is known of the robots of one fleet, and what is new of it."""

    def __init__(
        self,
        model: FleetModel,
        robots: Mapping[str, RobotModel],
        fleet: FleetView,
        rules: Sequence[FaultRule],
        values: FleetValues,
        tasks: TaskRequests,
        orchestrator: Orchestrator,
        carrier: OutputCarrier,
        *,
        capacities: Capacities | None,
        faulted: Callable[[str], None],
        sooner: Callable[[], None],
        clock: Callable[[], float],
        wall_s: Callable[[], float],
        mistakes: MistakeLog,
    ) -> None:
        """Connect the parts; no robot has been heard yet.

        Args:
            model: the fleet's.
            robots: by name; those that come and go later are seen in it.
            fleet: what they can do.
            rules: conditions that are faults.
            values: of robots.
            tasks: what robots are at.
            orchestrator: decides on what is new.
            carrier: carries out what follows.
            capacities: of robots, where data gives them some.
            faulted: told of robots with faults when what they can do may have changed.
            sooner: called when `next_deadline` may have come nearer.
            clock: monotonic seconds.
            wall_s: seconds since 1970, which nobody sets.
            mistakes: counts what has cost a piece of news.
        """
        self._robots, self._values, self._tasks = robots, values, tasks
        self._orchestrator, self._carrier, self._do = orchestrator, carrier, carrier.do
        self._capacities, self._faulted, self._sooner = capacities, faulted, sooner
        self._clock, self._wall_s, self._mistakes = clock, wall_s, mistakes
        self._bridges = BridgesSeen(model, robots, wall_s)
        orchestrator.explain_silence(self._bridges.why_silent)
        self._own = own_fields(model.robots)
        self.fleet = fleet
        """What robots can do now."""
        self.finder = FaultFinder(model, rules, self._named_first)
        self._news: list[FaultFound] = []
        """What became known of robots, and nothing has followed from yet."""
        self._moved: dict[Topic, bool] = {}
        """Likewise each SkillStatus that says something else of what its robot is at, or says nothing any more; and
        whether what it shows is to be taken in."""
        self._plain: dict[NodeId, bool] = {}
        """Nodes that say nothing else of robots or bridges: whether conditions may be about their values. They are not
        about what bridges count, for example."""
        self._news_at: float | None = None
        self._taken_at = -inf
        """When news were taken in last."""
        self._has_fleet_changed = self._has_dirty_values = False
        self._heard_by: float | None = None
        """When robots that were not heard since the start are silent."""
        self._dirty_at: float | None = None

    def _named_first(self, robot: str, text: str) -> tuple[tuple[str, ...], str]:
        return self.fleet.named_first(robot, text)

    def wait_for_robots(self, seconds: float) -> None:
        """Robots that are not heard within so long are silent."""
        self._heard_by = self._clock() + seconds

    # Robots that come and go.

    def add(self, robot: RobotModel, *, is_heard: bool) -> None:
        """A robot has come."""
        self._plain.clear()
        self._values.add(robot)
        self.finder.add(robot)
        if is_heard:
            self.finder.heard(robot.name)
            self._tell_soon([FaultFound(robot.name, SILENT, False, "")])  # its silence, where it is a robot anew
        else:
            self._do(self._orchestrator.not_heard([robot.name], self._wall_s()))
        self.fleet_changed()

    def replace(self, robot: RobotModel) -> None:
        """A robot comes again at once, with another definition; nothing is decided before."""
        self._plain.clear()
        self._values.remove(robot)
        self.finder.remove(robot)

    def remove(self, robot: RobotModel) -> None:
        """A robot that no run uses is gone; so is what has become known of it, and nothing has followed from yet."""
        self.replace(robot)
        self.finder.forget(robot.name)
        self._news = [one for one in self._news if one.robot != robot.name]
        if robot.skill_status is not None:
            self._moved.pop(robot.skill_status, None)
        self._look_at_fleet()  # before it could be given to a task

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
            self._faulted(robot)  # a device that came or went may be all that it can do

    # What comes.

    def value_changed(self, change: ValueChanged) -> None:
        """A node of the fleet has another value or status."""
        if (is_used := self._plain.get(change.key)) is not None:
            if is_used and self._values.change(change):
                self._look_again(is_urgent=change.type == BuiltinType.BOOLEAN)
        elif (bridge := self._bridges.comes_or_goes(change)) is not None:
            self._tell_of_bridge(bridge)
        elif (link := self._bridges.linked(change)) is not None:
            self._take_link(*link)
        elif self.finder.knows(change):
            self._tell_soon(self.finder.changed(change))
        else:
            self._plain[change.key] = is_used = self._values.change(change)
            if is_used:
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
        self._orchestrator.silence_explained()
        for topic in [robot.skill_status for robot in self._robots.values() if robot.bridge == bridge]:
            if topic is not None and reaches:
                self.source_returned(topic)
            elif topic is not None:
                self.source_lost(topic)

    def _tell_of_bridge(self, bridge: str) -> None:
        """A bridge has come or gone: faults of its robots that are silent say so, and runs that wait for them."""
        robots = {robot.name for robot in self._robots.values() if robot.bridge == bridge}
        silent = [
            one for one in self._orchestrator.faults if one.active and one.source == SILENT and one.robot in robots
        ]
        silent = [one for one in silent if self.finder.is_there(one)]  # else its end is news that is not taken in yet
        self._orchestrator.silence_explained()
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
        self.finder.alarms_found(found)
        self._tell_soon(found)

    def alarms_restored(self, found: Sequence[FaultFound]) -> None:
        """How these alarms were before the restart: a fault of one that is over, or not there any more, ends."""
        active = {f"{one.robot}.{one.source}" for one in found if one.active}
        kept = [fault for fault in self._orchestrator.faults if fault.active and fault.source.startswith(ALARM)]
        over = [FaultFound(fault.robot, fault.source, False, "") for fault in kept if fault.id not in active]
        self.alarms_found([*over, *[one for one in found if one.active]])

    def _explained(self, found: FaultFound) -> FaultFound:
        """What was found, with why nothing is heard of a robot that is silent."""
        if found.source == SILENT and found.active and (why := self._bridges.why_silent(found.robot)):
            return replace(found, reason=f"{found.reason}: {why}")
        return found

    # Taking it in.

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
            self._news += self.finder.check(self._values.look_up)
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

    def poll(self, now: float) -> None:
        """Take in what waits, and decide what is due."""
        if self._heard_by is not None and now >= self._heard_by:
            self._heard_by = None
            self._news += self.finder.not_heard()
        self.take_news()
        due = self._orchestrator.next_deadline()
        if (self._dirty_at is not None and now >= self._dirty_at) or (due is not None and self._wall_s() >= due):
            self._dirty_at = None
            self._do(self._orchestrator.poll(self._wall_s()))

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, by the monotonic clock, or None."""
        due = self._orchestrator.next_deadline()
        deadlines = [self._heard_by, self._news_at, self._dirty_at]
        if due is not None:
            deadlines.append(self._clock() + max(0.0, due - self._wall_s()))
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def _look_again(self, *, is_urgent: bool) -> None:
        if not (self._orchestrator.runs or self.finder.has_conditions):
            return
        self._has_dirty_values = self.finder.has_conditions
        at = self._clock() + (0.0 if is_urgent else COALESCE_S)
        if self._dirty_at is None or at < self._dirty_at:
            self._dirty_at = at
            self._sooner()
