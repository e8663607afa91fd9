"""Which robots there are, and how they came: from `fleet.yaml`, registered by a client, or announced by a bridge.

    registered   by a client with the role engineer; there again after a restart; gone when a client unregisters it
    announced    by its bridge; there again after a restart; Bad_NoCommunication, and not gone, while the bridge is away

Both are checked as `fleet.yaml` is, written down, and then taken in: nodes, skills, data and scenarios at once.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace

from ua_fleet.config.registration import CLIENTS, MOST_BYTES, Definition, RobotText, read_robot
from ua_fleet.config.schema import FleetConfig
from ua_fleet.document import as_mapping
from ua_fleet.errors import AccessRefused, ConfigInvalid, StorageUnavailable, UaFleetError
from ua_fleet.fleet.model import FleetModel, RobotModel, RobotOrigin, UnknownSources
from ua_fleet.operation.log import Log
from ua_fleet.operation.robots.taking import Taking
from ua_fleet.operation.robots.waiting import WaitingAnnouncements
from ua_fleet.storage.registry import Registry, StoredRobot
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import StatusCode

__all__ = ["RobotFixed", "RobotInUse", "RobotRegistry", "RobotUnknown", "Taking"]


class RobotUnknown(UaFleetError):
    """There is no such robot."""

    ua_status = StatusCode.BAD_NOT_FOUND
    remedy = "Take a name from `ua-fleet robot list`."


class RobotInUse(UaFleetError):
    """A robot is at work, or a run will need it."""

    ua_status = StatusCode.BAD_INVALID_STATE
    remedy = "End or abort what the robot does, and try again."


class RobotFixed(UaFleetError):
    """A robot can be changed only where it comes from."""

    ua_status = StatusCode.BAD_INVALID_STATE
    remedy = "Change it where it comes from: in fleet.yaml, or by the client that registered it."


class RobotRegistry:
    """The robots of one server. `restore` before all else, `connect` before robots come and go."""

    def __init__(
        self, config: FleetConfig, model: FleetModel, registry: Registry, wall_s: Callable[[], float], log: Log
    ) -> None:
        """Begin with the robots of a configuration.

        Args:
            config: the checked `fleet.yaml`.
            model: of it.
            registry: keeps the others.
            wall_s: the wall clock in seconds.
            log: is told of robots that come and go.
        """
        self._config, self._registry, self._wall_s, self._log = config, registry, wall_s, log
        self._model = model
        self._robots: dict[str, RobotModel] = {robot.name: robot for robot in self._model.robots}
        self._definitions: dict[str, Definition] = {}
        """Of those that are in no file."""
        self._ids: dict[int, str] = {}
        """Whose an id is, in its namespace and in its space."""
        for bridge in self._model.bridges:
            if bridge.status is not None:
                self._ids.update(dict.fromkeys(_places(bridge.status.topic), f"bridges.{bridge.name}"))
        self._by_status: dict[Topic, RobotModel] = {}
        for robot in self._model.robots:
            self._note_ids(robot)
        self._taking: Taking | None = None
        self._announced: dict[Topic, str] = {}
        """The text of each SkillStatus whose robot was taken."""
        self._waiting = WaitingAnnouncements(config.server.max_discovered_sources)
        self._is_full = False

    def __iter__(self) -> Iterator[RobotModel]:
        return iter(list(self._robots.values()))

    def find(self, name: str) -> RobotModel:
        """A robot by its name; raises RobotUnknown."""
        robot = self._robots.get(name)
        if robot is None:
            raise RobotUnknown(f"there is no robot {name[:80]!r}")
        return robot

    def restore(self) -> FleetModel:
        """All robots that there were before the restart, with those of the file.

        Raises:
            StorageUnavailable: they cannot be read.
        """
        for stored in self._registry.robots():
            if stored.name in self._robots:
                self._log.info("robot is in fleet.yaml now, which goes before", robot=stored.name, was=stored.origin)
                self._registry.remove(stored.name)
                continue
            is_announced = stored.origin == RobotOrigin.ANNOUNCED
            if is_announced and self._config.server.unknown_sources is not UnknownSources.CREATE:
                continue
            said = RobotText(stored.name, stored.bridge, text=stored.definition, file=f"robot {stored.name}")
            try:
                definition = read_robot(said, self._config, self._owner_of)
            except ConfigInvalid as error:
                self._log.error(
                    "robot does not fit fleet.yaml any more", robot=stored.name, reason=str(error.problems[0])
                )
                continue
            self._definitions[stored.name] = definition
            self._keep(replace(definition.model, origin=RobotOrigin(stored.origin)))
        return replace(self._model, robots=tuple(self._robots.values()))

    def connect(self, taking: Taking) -> None:
        """Let robots come and go from now on."""
        self._taking = taking

    # Registered by clients.

    def register(self, said: RobotText, by: str) -> RobotModel:
        """Make a robot one of the fleet. Said again, it changes nothing.

        Args:
            said: the robot.
            by: the user.

        Raises:
            ConfigInvalid: all that is wrong with it.
            RobotFixed: there is another robot of that name.
            RobotInUse: it was announced before otherwise, and is at work.
            StorageUnavailable: it cannot be written down.
        """
        known = self._robots.get(said.name)
        if known is not None and known.origin is RobotOrigin.FILE:
            raise RobotFixed(f"robot {said.name} stands in fleet.yaml; change it there, and restart the server")
        definition = read_robot(said, self._config, self._owner_but(known))
        model = replace(definition.model, origin=RobotOrigin.REGISTERED)
        if known == model:
            return model
        if known is not None and known.origin is RobotOrigin.REGISTERED:
            raise RobotFixed(f"there is another robot {said.name}, registered before; unregister that first")
        if known is not None:
            self._check_idle(known)
        self._put(definition, model, by)
        self._log.info("robot registered", robot=said.name, by=by, bridge=definition.bridge or "clients")
        return model

    def offer(self, name: str, skill: str, text: str, by: str, may_change: bool) -> RobotModel:
        """The robot of clients that has a skill; one that is made, or gets the skill, where a text says what it is.

        Args:
            name: of the robot.
            skill: name of the skill.
            text: the keys of `robots.<robot>.skills.<skill>`; empty where it is known.
            by: the user.
            may_change: whether the user may change the fleet.

        Raises:
            ConfigInvalid: all that is wrong with the text.
            RobotUnknown: without a text there is no such skill.
            RobotFixed: it is no robot of clients.
            RobotInUse: the skill would change, and the robot is at work.
            AccessRefused: the fleet would change, and the user may not change it.
            StorageUnavailable: it cannot be written down.
        """
        if not text.strip():
            return self.of_clients(name, skill)
        known = self._robots.get(name)
        before = self._definitions.get(name)
        if known is not None and (before is None or before.bridge != CLIENTS):
            raise RobotFixed(f"robot {name} is one of a bridge, and no client does its skills")
        said = RobotText(name, CLIENTS, text=text, skill=skill, base=before.text.text if before is not None else "")
        definition = read_robot(said, self._config, self._owner_but(known))
        model = replace(definition.model, origin=RobotOrigin.REGISTERED)
        if model == known:
            return model
        if not may_change:
            what = "is not registered" if known is None else "is not what it was registered as"
            reason = f"{name}.{skill} {what}, and only an engineer may change that"
            raise AccessRefused(StatusCode.BAD_USER_ACCESS_DENIED, reason)
        if known is not None:
            self._check_idle(known)
        self._put(definition, model, by)
        self._log.info("skill of clients registered", robot=name, skill=skill, by=by)
        return model

    def of_clients(self, name: str, skill: str) -> RobotModel:
        """A robot of clients that has a skill; raises RobotUnknown."""
        robot = self.find(name)
        is_theirs = robot.skill_status is not None and robot.skill_status.space == SERVER_SPACE
        if not is_theirs or skill not in [one.name for one in robot.skills]:
            raise RobotUnknown(f"robot {name} has no skill {skill[:80]!r} that clients do; say what it is")
        return robot

    def unregister(self, name: str, by: str) -> None:
        """Take a robot out of the fleet.

        Raises:
            RobotUnknown: there is none of that name.
            RobotFixed: it stands in `fleet.yaml`, or its bridge announces it still.
            RobotInUse: it is at work, or a run will need it.
            StorageUnavailable: it cannot be written down.
        """
        robot = self.find(name)
        if robot.origin is RobotOrigin.FILE:
            raise RobotFixed(f"robot {name} stands in fleet.yaml; remove it there, and restart the server")
        if robot.origin is RobotOrigin.ANNOUNCED and self._connected.is_heard(robot):
            assert robot.skill_status is not None
            raise RobotFixed(
                f"robot {name} is announced by the bridge of space {robot.skill_status.space}; stop that first"
            )
        self._check_idle(robot)
        self._registry.remove(name)
        self._drop(robot)
        self._log.info("robot unregistered", robot=name, by=by)

    # Announced by bridges.

    def announced(self, topic: Topic, text: str) -> None:
        """A bridge says in the metadata of a robot's SkillStatus what the robot is."""
        if self._config.server.unknown_sources is not UnknownSources.CREATE:
            return
        if self._announced.get(topic) == text:
            self._waiting.discard(topic)
        elif not self._waiting.waits(topic, text):  # else `tick` looks at it
            self._look_at(topic, text)

    def tick(self) -> None:
        """Look again at what could not be taken; to be called each second."""
        for topic, text in self._waiting.due(self._by_status, self._connected.hears) if self._waiting else ():
            self._look_at(topic, text)

    def _look_at(self, topic: Topic, text: str) -> None:
        known = self._by_status.get(topic)
        if known is not None and known.origin is not RobotOrigin.ANNOUNCED:
            self._waiting.discard(topic)
            return  # the server has its own word on it
        if known is None and len(self._announced) >= self._config.server.max_discovered_sources:
            self._too_many()
            self._waiting.put(topic, text, "too many", is_known=False, is_heard=self._connected.hears)
            return
        try:
            self._take_announced(topic, text, known)
        except RobotInUse as error:
            if not self._waiting.was_told(topic, text, "in use"):
                self._log.warning("what a robot is announced as now has to wait", topic=topic.name, reason=str(error))
            self._waiting.put(topic, text, "in use", is_known=True, is_heard=self._connected.hears)
        except (UaFleetError, StorageUnavailable) as error:
            reason = str(error.problems[0]) if isinstance(error, ConfigInvalid) else str(error)
            was_told = self._waiting.was_told(topic, text, reason)
            is_known = topic in self._by_status
            if not self._waiting.put(topic, text, reason, is_known=is_known, is_heard=self._connected.hears):
                self._too_many()
            elif not was_told:
                self._log.warning("a robot that is announced gets no nodes", topic=topic.name, reason=reason)
        else:
            self._announced[topic] = text
            self._waiting.discard(topic)

    def _too_many(self) -> None:
        if not self._is_full:
            self._log.warning("more robots are announced than may be; raise server.max_discovered_sources")
        self._is_full = True

    def _take_announced(self, topic: Topic, text: str, known: RobotModel | None) -> None:
        name = _named(text)
        other = self._robots.get(name)
        if other is not None and other is not known:
            raise RobotFixed(f"there is another robot {name}; give one of them another name")
        said = RobotText(name, str(topic.space), text=text, file=topic.name)
        definition = read_robot(said, self._config, self._owner_but(known))
        model = replace(definition.model, origin=RobotOrigin.ANNOUNCED)
        if model.skill_status != topic:
            raise RobotFixed(f"robot {name} announces itself by {topic.name}, which is not its SkillStatus")
        if model == known:
            return
        if known is not None:
            self._check_idle(known)
        renamed = known if known is not None and known.name != name else None
        if renamed is not None:
            self._check_nothing_told(renamed, name)
        self._put(definition, model, topic.name, renamed)
        self._log.info("robot announced, and not in fleet.yaml: it gets nodes", robot=name, topic=topic.name)

    # Within.

    @property
    def _connected(self) -> Taking:
        assert self._taking is not None, "robots come and go after `connect`"
        return self._taking

    def _put(self, definition: Definition, model: RobotModel, by: str, renamed: RobotModel | None = None) -> None:
        said = definition.text
        stored = StoredRobot(said.name, model.origin.value, definition.bridge, said.text, by, self._wall_s())
        self._registry.put(stored, was=renamed.name if renamed is not None else "")
        if renamed is not None:
            self._drop(renamed)
        before = self._robots.get(said.name)
        if before is not None:
            self._drop(before, is_replaced=True)
        self._definitions[model.name] = definition
        self._keep(model)
        self._connected.take_in(model)

    def _drop(self, robot: RobotModel, *, is_replaced: bool = False) -> None:
        del self._robots[robot.name], self._definitions[robot.name]
        for place in [place for place, owner in self._ids.items() if owner == f"robots.{robot.name}"]:
            del self._ids[place]
        if robot.skill_status is not None:
            del self._by_status[robot.skill_status]
            self._announced.pop(robot.skill_status, None)
            self._waiting.discard(robot.skill_status)
            self._is_full = False
        self._connected.let_go(robot, is_replaced=is_replaced)

    def _keep(self, robot: RobotModel) -> None:
        self._robots[robot.name] = robot
        self._note_ids(robot)

    def _note_ids(self, robot: RobotModel) -> None:
        if robot.skill_status is not None:
            self._by_status[robot.skill_status] = robot
        owner = f"robots.{robot.name}"
        for topic in (*[data_set.topic for data_set in robot.all_data_sets()], *robot.all_actions()):
            self._ids.update(dict.fromkeys(_places(topic), owner))

    def _check_idle(self, robot: RobotModel) -> None:
        users = self._connected.users_of(robot)
        if users:
            raise RobotInUse(f"robot {robot.name} is in use: {', '.join(users)}; wait for the end, or abort it")

    def _check_nothing_told(self, robot: RobotModel, name: str) -> None:
        """A robot gets no other name while people say something of it: that would be of another robot then."""
        if told := self._connected.told_of(robot):
            raise RobotInUse(f"robot {robot.name} is announced as {name}, and cannot get that name: {'; '.join(told)}")

    def _owner_of(self, topic: Topic) -> Topic | str | None:
        owner = next((owner for place in _places(topic) if (owner := self._ids.get(place)) is not None), None)
        if owner is not None or self._taking is None:
            return owner
        return self._taking.stranger(topic.ns, topic.id)

    def _owner_but(self, robot: RobotModel | None) -> Callable[[Topic], Topic | str | None]:
        """Whose an id would be without a robot."""
        own = f"robots.{robot.name}" if robot is not None else ""

        def owner_of(topic: Topic) -> Topic | str | None:
            owner = self._owner_of(topic)
            return None if owner == own else owner

        return owner_of


def _places(topic: Topic) -> tuple[int, int]:
    """Where an id has to be the only one: in its namespace, as a NodeId, and in its space, as a DataSetWriterId.

    Numbers, since a large fleet has many.
    """
    return topic.ns << 16 | topic.id, 1 << 32 | topic.space << 16 | topic.id


def _named(text: str) -> str:
    """The name of the one robot of an announcement; raises RobotFixed."""
    if len(text) <= MOST_BYTES:
        try:
            robots = as_mapping(json.loads(text).get("robots")) or {}
        except (ValueError, AttributeError, RecursionError):
            robots = {}
        if len(robots) == 1:
            return str(next(iter(robots)))
    raise RobotFixed("its announcement is no definition of one robot")
