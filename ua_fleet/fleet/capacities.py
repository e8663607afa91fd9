"""What each robot can do in kind: always, or only while a data source is there that gives it. Pure.

Data gives its capacities to its own robot, and to the robot that this one is mounted on: a thermometer that is plugged
into the computer of a rover makes the rover one that can measure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ua_fleet.fleet.changes import CapacitiesChanged
from ua_fleet.fleet.model import RobotModel
from ua_fleet.topics import Topic

__all__ = ["Capacities"]


class Capacities:
    """The capacities of all robots now."""

    def __init__(self, robots: Iterable[RobotModel] = ()) -> None:
        self._robots: dict[str, RobotModel] = {}
        self._given: dict[str, list[tuple[str, str, Topic]]] = {}
        """What data gives to a robot, by its name: capacity, name of the data, and its topic."""
        self._owner: dict[Topic, RobotModel] = {}
        """Of the data that gives any."""
        self._there: set[Topic] = set()
        for robot in robots:
            self._take_in(robot)

    def add(self, robot: RobotModel) -> list[CapacitiesChanged]:
        """A robot has come; what changes for others."""
        self._take_in(robot)
        return self._carrier_changed(robot)

    def _take_in(self, robot: RobotModel) -> None:
        self._robots[robot.name] = robot
        for data_set in robot.data_sets:
            for capacity in data_set.gives:
                self._owner[data_set.topic] = robot
                given = (capacity, f"{robot.name}.{data_set.name}", data_set.topic)
                for name in dict.fromkeys((robot.name, robot.mounted_on)):
                    self._given.setdefault(name, []).append(given)

    def remove(self, robot: RobotModel) -> list[CapacitiesChanged]:
        """A robot is gone; what changes for others."""
        before = self.of(robot.mounted_on)
        del self._robots[robot.name]
        topics = {data_set.topic for data_set in robot.data_sets}
        self._there -= topics
        for topic in topics:
            self._owner.pop(topic, None)
        for name in (robot.name, robot.mounted_on):
            given = [one for one in self._given.pop(name, ()) if one[2] not in topics]
            if given:
                self._given[name] = given
        return self._carrier_changed(robot) if self.of(robot.mounted_on) != before else []

    def _carrier_changed(self, robot: RobotModel) -> list[CapacitiesChanged]:
        gives = any(data_set.gives for data_set in robot.data_sets)
        return [self._told(self._robots[robot.mounted_on])] if gives and robot.mounted_on in self._robots else []

    def source_changed(self, topic: Topic, is_there: bool) -> list[CapacitiesChanged]:
        """A source that gives capacities is there, or not any more; what each robot can do then."""
        (self._there.add if is_there else self._there.discard)(topic)
        owner = self._owner.get(topic)
        if owner is None:
            return []
        return [self._told(self._robots[name]) for name in (owner.name, owner.mounted_on) if name in self._robots]

    def of(self, name: str) -> tuple[str, ...]:
        """What a robot can do now, in the order of the file; nothing where there is no such robot."""
        robot = self._robots.get(name)
        if robot is None:
            return ()
        given = [capacity for capacity, _, topic in self._given.get(name, ()) if topic in self._there]
        return tuple(dict.fromkeys((*robot.capacities, *given)))

    def lacking(self, name: str) -> Mapping[str, str]:
        """What a robot cannot do now but could, with the reason."""
        given = self._given.get(name)
        if not given:
            return {}
        held = self.of(name)
        return {capacity: f"{source} is not there" for capacity, source, _ in given if capacity not in held}

    def _told(self, robot: RobotModel) -> CapacitiesChanged:
        return CapacitiesChanged(robot, self.of(robot.name), self.lacking(robot.name))
