"""The parts of the server that have to know of a robot, put together for the roster."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.state import FleetState
from ua_fleet.nodes.change_events import Verb, tell_model_change
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.skill_methods import SkillMethods
from ua_fleet.operation.robots.offers import ClientOffers
from ua_fleet.operation.skills.executions import SkillKeys
from ua_fleet.operation.skills.tracker import SkillTracker
from ua_fleet.server.hub import Hub
from ua_fleet.topics import Topic

__all__ = ["RobotAdmission"]


class RobotAdmission:
    """Takes robots in and lets them go; see `roster.Taking`."""

    def __init__(
        self,
        hub: Callable[[], Hub],
        state: FleetState,
        tracker: SkillTracker,
        skills: SkillMethods,
        projection: Projection,
        events: ServerEvents,
        offers: ClientOffers,
        runs_of: Callable[[str], list[str]],
        told_of: Callable[[str], list[str]],
        hears: Callable[[Topic], bool],
        wall_ticks: Callable[[], int],
    ) -> None:
        """Connect the parts.

        Args:
            hub: carries data; it is made later.
            state: of the fleet.
            tracker: knows of executions.
            skills: answers the Methods of skills.
            projection: makes the nodes.
            events: tells clients.
            offers: skills that clients do.
            runs_of: the runs that need a robot.
            told_of: what people say of a robot.
            hears: whether a source is heard now.
            wall_ticks: the wall clock.
        """
        self._hub, self._state, self._tracker = hub, state, tracker
        self._skills, self._projection, self._events = skills, projection, events
        self._offers, self._runs_of, self._told_of, self._wall_ticks = offers, runs_of, told_of, wall_ticks
        self._hears = hears

    def take_in(self, robot: RobotModel) -> None:
        """A robot has come."""
        self._hub().add_robot(robot)
        self._offers.follow(robot)
        self._skills.add(robot)
        self._projection.then(partial(tell_model_change, self._events, robot, Verb.NODE_ADDED, self._wall_ticks()))

    def let_go(self, robot: RobotModel, *, is_replaced: bool) -> None:
        """A robot that does nothing is gone; or it comes again at once, with another definition."""
        self._skills.remove(robot)
        self._offers.unfollow(robot)
        self._hub().remove_robot(robot, is_replaced=is_replaced)
        self._projection.then(partial(tell_model_change, self._events, robot, Verb.NODE_DELETED, self._wall_ticks()))

    def users_of(self, robot: RobotModel) -> list[str]:
        """What needs a robot now: executions and runs."""
        busy = [
            f"skill {skill.name} is under way"
            for skill in robot.skills
            if self._tracker.under_way(SkillKeys(robot.ns, skill.id).object)
        ]
        return [*busy, *[f"run {run_id}" for run_id in self._runs_of(robot.name)]]

    def told_of(self, robot: RobotModel) -> list[str]:
        """What people say of a robot: a hold, faults that they end."""
        return self._told_of(robot.name)

    def is_heard(self, robot: RobotModel) -> bool:
        """Whether its SkillStatus is alive."""
        return robot.skill_status is not None and self._state.is_alive(robot.skill_status)

    def hears(self, topic: Topic) -> bool:
        """Whether a source is heard now, also one that belongs to no robot."""
        return self._hears(topic)

    def stranger(self, ns: int, identifier: int) -> Topic | None:
        """The source that has an id and belongs to no robot or bridge."""
        owner = self._state.owner(ns, identifier)
        return None if owner is None or self._state.knows(owner) else owner
