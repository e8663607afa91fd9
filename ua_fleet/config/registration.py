"""Robots that stand in no `fleet.yaml`: registered by a client, or announced by their bridge.

What is said of one is text in the form of `fleet.yaml`: the keys of `robots.<robot>` alone, or a file with `robots` in
which the robot is one of several. The models and the checks are those of `fleet.yaml`, and all problems are told at
once with their lines.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from ua_fleet.config.alarms import alarms_of
from ua_fleet.config.base import Name
from ua_fleet.config.checks import Parts, check_robots, no_namespace
from ua_fleet.config.load import Loading
from ua_fleet.config.nodes import robot_model
from ua_fleet.config.schema import BridgeConfig, FleetConfig, RobotConfig
from ua_fleet.document import Document, KeyPath, SourcePlace, as_mapping, read_document
from ua_fleet.errors import ConfigInvalid, TopicInvalid
from ua_fleet.fleet.model import RobotModel
from ua_fleet.names import closest, listed
from ua_fleet.topics import SERVER_SPACE, Topic, check_space

__all__ = ["CLIENTS", "MOST_BYTES", "Definition", "RobotText", "announced_robots", "definition_text", "read_robot"]

MOST_BYTES: Final = 64 * 1024
"""Longest text about one robot."""
CLIENTS: Final = ""
"""In place of a bridge: the robot's skills are done by OPC UA clients."""
_FILE: Final = "definition"
_FIRST_FREE: Final = 1001
_LAST_ID: Final = 65_535
_NOWHERE: Final = "none"
"""Stands for the bridge while a robot is checked that has none in `fleet.yaml`."""
_NAME: Final[TypeAdapter[str]] = TypeAdapter(Name)


@dataclass(frozen=True, slots=True)
class RobotText:
    """What somebody says of a robot. What is empty is left to the text."""

    name: str
    bridge: str = ""
    """Name of a bridge of `fleet.yaml`, or the number of a space; empty here and in the text: CLIENTS."""
    capacities: tuple[str, ...] = ()
    description: str = ""
    text: str = ""
    file: str = _FILE
    """Names the text in problems."""
    skill: str = ""
    """The text is about this skill alone, and ..."""
    base: str = ""
    """... the rest of the robot is what this `definition_text` says."""


@dataclass(frozen=True, slots=True)
class Definition:
    """A robot that was checked."""

    config: RobotConfig
    model: RobotModel
    bridge: str
    """As it was said: a bridge's name, a space's number, or CLIENTS."""

    @property
    def text(self) -> RobotText:
        """The whole of it, to be read again after a restart."""
        name = self.model.name
        return RobotText(name, self.bridge, text=definition_text(name, self.config), file=f"robot {name}")


_ALARMS: Final = ("limits", "normal")
_OF_SERVER: Final[dict[str, Any]] = {
    **dict.fromkeys(("source", "history", *_ALARMS), True),
    "fields": {"__all__": set(_ALARMS)},
}
"""Of a data source: what is the server's own matter, or the bridge's."""


def definition_text(name: str, config: RobotConfig) -> str:
    """A robot as text for `read_robot`, without what is its bridge's own matter, or its server's."""
    own: dict[str, Any] = {"skills": {"__all__": {"via"}}, "data": {"__all__": _OF_SERVER}}
    own |= {"bridge": True, "teleoperation": True, "history": True}
    said: dict[str, Any] = config.model_dump(mode="json", exclude_defaults=True, exclude=own)
    return json.dumps({"robots": {name: said}}, ensure_ascii=False, separators=(",", ":"))


def announced_robots(fleet: FleetConfig, bridge: str) -> dict[Topic, str]:
    """What the robots of a bridge are, by the topics of their SkillStatus, for the bridge to announce."""
    space = fleet.bridges[bridge].space
    return {
        Topic(space, robot.namespace, robot.skill_status_id): definition_text(name, robot)
        for name, robot in fleet.robots.items()
        if robot.bridge == bridge and robot.skill_status_id is not None
    }


def read_robot(said: RobotText, fleet: FleetConfig, owner_of: Callable[[Topic], Topic | str | None]) -> Definition:
    """Check what is said of a robot against a fleet.

    Args:
        said: the text, with what stands beside it.
        fleet: the configuration.
        owner_of: whose a topic's id is already, in its namespace or its space; the robot's own is nobody else's.

    Raises:
        ConfigInvalid: all that is wrong, in the order of the lines.
    """
    document = _document(said)
    path: KeyPath = ("robots", said.name)
    given = as_mapping((as_mapping(document.data.get("robots")) or {}).get(said.name)) or {}
    _check_name(document, said.name, path)
    bridge, space = _bridge(document, said.bridge or str(given.get("bridge") or ""), (*path, "bridge"), fleet)
    configured = next((name for name, one in fleet.bridges.items() if one.space == space), None)
    body = {**given, "bridge": configured or _NOWHERE}
    if said.capacities:
        body["capacities"] = list(said.capacities)
    if said.description:
        body["description"] = said.description
    bridges: Mapping[str, BridgeConfig] = fleet.bridges
    robot, data = Loading(document).robot(path, body, bridges)
    if "teleoperation" in given:
        text = "only robots of fleet.yaml are driven by hand: their bridge and the server share keys for it"
        document.problem((*path, "teleoperation"), text, "remove it")
    with_history = [(*path, "history")] if "history" in given else []
    with_history += [(*path, "data", name, "history") for name, one in data.items() if one.history is not None]
    for where in with_history:
        document.problem(where, "what is kept of values is said in fleet.yaml alone", "remove it")
    for name, one in data.items():
        for where, *_ in alarms_of(one):
            document.problem((*path, "data", name, *where), "alarms are said in fleet.yaml alone", "remove it")
    if robot is not None:
        data_of = {(said.name, name): data_set for name, data_set in data.items()}
        check_robots(
            Parts(document, said.file, None, dict(bridges), {said.name: robot.bridge}, data_of, {said.name: robot})
        )
        robot = robot.model_copy(update={"data": data})
        if robot.namespace not in fleet.fleet.namespace_indices:
            document.problem((*path, "namespace"), *no_namespace(fleet.fleet.namespace_indices))
        ids = _Ids(document, path, owner_of, robot.namespace, space)
        robot = ids.fill(robot) if space == SERVER_SPACE else robot
        ids.check(robot)
        if space == SERVER_SPACE:
            _check_origin(document, path, robot)
    if document.problems or robot is None:
        raise ConfigInvalid(sorted(document.problems, key=lambda problem: problem.line))
    robot = robot.model_copy(update={"bridge": configured or ""})
    return Definition(robot, robot_model(said.name, robot, space), bridge)


def _document(said: RobotText) -> Document:
    """The text as a file with `robots`, in which every place is where it was written."""
    text = said.text if said.text.strip() else "{}"
    if len(text.encode()) > MOST_BYTES:
        document = Document({}, {(): SourcePlace(said.file)}, {}, [])
        document.problem((), f"the text is longer than {MOST_BYTES // 1024} KiB", "say less of one robot")
        return document
    document = read_document(text.encode(), said.file)
    if "robots" in document.data and not said.skill:
        robots = as_mapping(document.data["robots"]) or {}
        if said.name not in robots:
            document.problem(("robots",), f"there is no robot `{said.name}`", closest(said.name, list(robots)))
        document.data = {"robots": robots}
        return document
    above: KeyPath = ("robots", said.name)
    data = document.data
    if said.skill:
        above = (*above, "skills", said.skill)
        data = _with_skill(said, data)
    places = {(): document.places[()], **{(*above, *path): place for path, place in document.places.items()}}
    return Document({"robots": {said.name: data}}, places, {}, document.problems)


def _with_skill(said: RobotText, skill: dict[str, Any]) -> dict[str, Any]:
    """A robot with one more skill, or another one: it has what the skill needs, and keeps its id."""
    robot: dict[str, Any] = dict(json.loads(said.base)["robots"][said.name]) if said.base else {}
    skills: dict[str, Any] = dict(robot.get("skills", {}))
    before: dict[str, Any] = skills.get(said.skill, {})
    skills[said.skill] = {**({"id": before["id"]} if "id" in before else {}), **skill}
    needs: list[Any] = list(skill["needs"]) if isinstance(skill.get("needs"), list) else []
    return {**robot, "skills": skills, "capacities": list(dict.fromkeys([*robot.get("capacities", []), *needs]))}


def _check_name(document: Document, name: str, path: KeyPath) -> None:
    try:
        _NAME.validate_python(name)
    except ValidationError:
        hint = "begin with a letter; then letters, digits, _ and -, 64 at most"
        document.problem(path, f"`{name[:80]}` is not allowed as a name", hint)


def _bridge(document: Document, bridge: str, path: KeyPath, fleet: FleetConfig) -> tuple[str, int]:
    """What was said of the bridge, and its space."""
    if bridge in ("", str(SERVER_SPACE)):
        return CLIENTS, SERVER_SPACE
    if bridge in fleet.bridges:
        return bridge, fleet.bridges[bridge].space
    if bridge.isascii() and bridge.isdigit() and len(bridge) < 6:
        try:
            return bridge, check_space(int(bridge))
        except TopicInvalid as error:
            document.problem(path, error.reason)
            return bridge, SERVER_SPACE + 1
    there = f"there are: {listed(list(fleet.bridges))}; the number of a space will do, too"
    document.problem(path, f"there is no bridge `{bridge[:80]}`", closest(bridge, list(fleet.bridges)) or there)
    return bridge, SERVER_SPACE + 1


def _check_origin(document: Document, path: KeyPath, robot: RobotConfig) -> None:
    for name, data_set in robot.data.items():
        if data_set.origin == "robot":
            document.problem(
                (*path, "data", name), "a robot of clients has no space of its own", "write `origin: server`"
            )


class _Ids:
    """The ids of a robot beside those of the fleet."""

    def __init__(
        self, document: Document, path: KeyPath, owner_of: Callable[[Topic], Topic | str | None], ns: int, space: int
    ) -> None:
        self._document, self._path, self._owner_of, self._ns, self._space = document, path, owner_of, ns, space

    def fill(self, robot: RobotConfig) -> RobotConfig:
        """Give ids to what has none: nobody else needs to know those of a robot of clients."""
        taken = {number for _, _, number in _ids(robot) if number is not None}
        free = (
            number
            for number in range(_FIRST_FREE, _LAST_ID)
            if number not in taken and not self._owner_of(Topic(self._space, self._ns, number))
        )
        data = {
            name: one if one.id is not None else one.model_copy(update={"id": next(free)})
            for name, one in robot.data.items()
        }
        skills = {
            name: one if one.id is not None else one.model_copy(update={"id": next(free)})
            for name, one in robot.skills.items()
        }
        update: dict[str, Any] = {"data": data, "skills": skills}
        if skills and robot.skill_status_id is None:
            update["skill_status_id"] = next(free)
        return robot.model_copy(update=update)

    def check(self, robot: RobotConfig) -> None:
        """Each has one, and each is the robot's own."""
        for path, space, number in _ids(robot):
            where = (*self._path, *path)
            if number is None:
                hint = "write the id that its bridge uses for it"
                self._document.problem(where, f"`{path[-1]}` is missing", hint)
                continue
            own = Topic(self._space if space is None else space, self._ns, number)
            owner = self._owner_of(own)
            if owner is not None and owner != own:
                name = owner.name if isinstance(owner, Topic) else owner
                self._document.problem(where, f"{number} is in use already ({name})", "give one of them another id")


def _ids(robot: RobotConfig) -> Iterator[tuple[KeyPath, int | None, int | None]]:
    """Path, space where it is not the robot's, and id of all that has one."""
    for name, data_set in robot.data.items():
        yield ("data", name, "id"), SERVER_SPACE if data_set.origin == "server" else None, data_set.id
    for name, skill in robot.skills.items():
        yield ("skills", name, "id"), None, skill.id
    if robot.skills:
        yield ("skill_status_id",), None, robot.skill_status_id
    if robot.fault_id is not None:
        yield ("fault_id",), None, robot.fault_id
