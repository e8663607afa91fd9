"""Loading `fleet.yaml`: defaults < file < environment < options, with all problems at once.

Each bridge, robot and data source is validated by itself, so that one mistake hides no other.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from ua_fleet.config.alarms import check_alarms
from ua_fleet.config.base import Name
from ua_fleet.config.checks import Parts, check_all, check_ids_given, check_namespaces, check_publisher_ids
from ua_fleet.config.connection_checks import check_connections, check_list
from ua_fleet.config.connections import OF_ALL, FleetOfConnections
from ua_fleet.config.history import check_history
from ua_fleet.config.kinds import known_kinds, model_of_kind
from ua_fleet.config.layers import apply_environment, apply_options
from ua_fleet.config.modbus_checks import modbus_problems
from ua_fleet.config.namespace_checks import check_namespace
from ua_fleet.config.relay_checks import check_relays
from ua_fleet.config.relay_schema import RelayConfig
from ua_fleet.config.resilience_schema import CriterionConfig, FaultConditionConfig
from ua_fleet.config.schema import (
    BridgeConfig,
    DataMapping,
    DataSetConfig,
    FleetConfig,
    PubSubConfig,
    ResilienceConfig,
    RobotConfig,
    SkillConfig,
)
from ua_fleet.config.source_schema import source_problems
from ua_fleet.config.teleoperation_checks import check_setpoint_groups
from ua_fleet.config.typed_texts import validated
from ua_fleet.config.wording import explain
from ua_fleet.document import MAX_BYTES, Document, KeyPath, as_mapping, key_text, read_document
from ua_fleet.errors import ConfigError, ConfigInvalid
from ua_fleet.names import closest, listed

__all__ = ["VERSION", "Loading", "load", "load_content", "load_document", "read_content"]

VERSION: Final = 1
"""The version of the format that this code reads."""

_NAME: Final[TypeAdapter[str]] = TypeAdapter(Name)
_SIDES: Final = ("source", "sink")
"""Of a data source: what stands there depends on the bridge's kind."""
_SECTIONS: Final = ("fleet", "server", "pubsub", "bridges", "robots", "resilience")
_Model = TypeVar("_Model", bound=BaseModel)


def read_content(path: Path) -> bytes:
    """The bytes of a configuration file; raises ConfigInvalid when it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        problem = ConfigError(
            "there is no such file", file=str(path), suggestion=f"write a commented one: ua-fleet config init {path}"
        )
        raise ConfigInvalid([problem]) from error
    except OSError as error:
        reason = (error.strerror or "it").lower()
        raise ConfigInvalid([ConfigError(f"cannot be read: {reason}", file=str(path))]) from error


class Loading:
    """One file on its way into the models; problems go to the document."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._told = {problem.key for problem in document.problems}

    def mapping(self, path: KeyPath, value: Any) -> dict[str, Any]:
        """The mapping at `path`; a key without a value counts as an empty one."""
        if value is not None and not isinstance(value, dict):
            self._document.problem(path, "must have keys with values")
        return as_mapping(value) or {}

    def model(self, model: type[_Model], data: Mapping[str, Any], path: KeyPath) -> _Model | None:
        """`data` as a model, or None after its problems were noted."""
        try:
            return validated(model, data, path, self._document)
        except ValidationError as error:
            for finding in explain(model, data, error.errors(include_url=False)):
                where = (*path, *finding.path)
                if key_text(where) not in self._told:
                    self._document.problem(where, finding.message, finding.suggestion)
            return None

    def named(self, path: KeyPath, value: Any) -> dict[str, Any]:
        """The mapping at `path`, whose keys are names that users give."""
        mapping = self.mapping(path, value)
        for name in mapping:
            try:
                _NAME.validate_python(name)
            except ValidationError:
                self._document.problem(
                    (*path, name),
                    f"`{name}` is not allowed as a name",
                    "begin with a letter; then letters, digits, _ and -, 64 at most",
                )
        return mapping

    def bridge(self, name: str, value: Any) -> BridgeConfig | None:
        """A bridge, validated by the model of its kind."""
        path: KeyPath = ("bridges", name)
        data = self.mapping(path, value)
        kind, kinds = data.get("kind"), known_kinds()
        there = f"there are: {listed(kinds)}"
        if kind is None:
            self._document.problem((*path, "kind"), "`kind` is missing", there)
        elif kind not in kinds:
            hint = f"{closest(str(kind), kinds)} {there}".strip()
            self._document.problem((*path, "kind"), f"no bridge of kind `{kind}` is installed", hint)
        else:
            try:
                return self.model(model_of_kind(kind), data, path)
            except ConfigError as error:
                self._document.problem((*path, "kind"), error.message)
        return None

    def skills(self, robot: KeyPath, given: Mapping[str, Any], bridge: BridgeConfig | None) -> dict[str, SkillConfig]:
        """A robot's skills; how they are done is validated by the model of the bridge's kind."""
        skills: dict[str, SkillConfig] = {}
        path: KeyPath = (*robot, "skills")
        for name, value in self.named(path, given.get("skills")).items():
            inner = (*path, name)
            if (skill := self.model(SkillConfig, self.mapping(inner, value), inner)) is None:
                continue
            skills[name] = skill
            if skill.via and bridge is not None and bridge.skill_mapping is not None:
                self.model(bridge.skill_mapping, skill.via, (*inner, "via"))
        return skills

    def robot(
        self, path: KeyPath, value: Any, bridges: Mapping[str, BridgeConfig]
    ) -> tuple[RobotConfig | None, dict[str, DataSetConfig]]:
        """A robot with its skills, and apart from it its data."""
        given = self.mapping(path, value)
        robot = self.model(RobotConfig, {**given, "data": {}, "skills": {}}, path)
        bridge = None if robot is None else bridges.get(robot.bridge)
        if robot is not None:
            robot = robot.model_copy(update={"skills": self.skills(path, given, bridge)})
        data: dict[str, DataSetConfig] = {}
        for name, data_value in self.named((*path, "data"), given.get("data")).items():
            inner = (*path, "data", name)
            if (valid := self.data_set(inner, self.mapping(inner, data_value), bridge)) is not None:
                data[name] = valid
        return robot, data

    def data_set(self, path: KeyPath, given: Mapping[str, Any], bridge: BridgeConfig | None) -> DataSetConfig | None:
        """A data source; what it is read from and written to is validated by the models of the bridge's kind."""
        sides = {side: given[side] for side in _SIDES if given.get(side) is not None}
        data_set = self.model(DataSetConfig, {key: value for key, value in given.items() if key not in sides}, path)
        mappings: dict[str, DataMapping] = {}
        for side, value in sides.items():
            if bridge is None:
                continue  # that is a problem already, and nobody knows what should stand here
            model = bridge.source_mapping if side == "source" else bridge.sink_mapping
            if model is None:
                kind = bridge.kind
                self._document.problem((*path, side), f"bridges of kind {kind} have no `{side}`", f"remove `{side}`")
            elif (mapping := self.model(model, self.mapping((*path, side), value), (*path, side))) is not None:
                mappings[side] = mapping
        return data_set.model_copy(update=mappings) if data_set is not None and mappings else data_set

    def connections(self, items: list[Any]) -> list[PubSubConfig | None]:
        """The PubSub connections of a list; what holds for all is that of the first one."""
        found: list[PubSubConfig | None] = []
        for number, item in enumerate(items):
            path: KeyPath = ("pubsub", number)
            found.append(self.model(PubSubConfig, self.mapping(path, item), path))
        check_list(self._document, items, found)
        first = found[0] if found else None
        if first is None:
            return found
        of_all = {key: getattr(first, key) for key in OF_ALL}
        return [each and each.model_copy(update=of_all) for each in found]

    def relays(self, value: Any) -> dict[str, RelayConfig]:
        """The relays that are valid by themselves."""
        found: dict[str, RelayConfig] = {}
        for name, given in self.named(("relays",), value).items():
            path: KeyPath = ("relays", name)
            if (relay := self.model(RelayConfig, self.mapping(path, given), path)) is not None:
                found[name] = relay
        return found

    def resilience(self, given: Mapping[str, Any]) -> ResilienceConfig:
        """The section with those of its criteria and faults that are valid."""
        path: KeyPath = ("resilience",)
        names = {key: self.named((*path, key), given.get(key)) for key in ("criteria", "faults")}
        rest = {key: value for key, value in given.items() if key not in names or value == {}}
        shell = self.model(ResilienceConfig, rest, path)
        criteria: dict[str, CriterionConfig] = {}
        for name, value in names["criteria"].items():
            inner = (*path, "criteria", name)
            if (criterion := self.model(CriterionConfig, self.mapping(inner, value), inner)) is not None:
                criteria[name] = criterion
        faults: dict[str, FaultConditionConfig] = {}
        for name, value in names["faults"].items():
            inner = (*path, "faults", name)
            if (fault := self.model(FaultConditionConfig, self.mapping(inner, value), inner)) is not None:
                faults[name] = fault
        changed = {"criteria": criteria, "faults": faults} if names["criteria"] else {"faults": faults}
        return (shell or ResilienceConfig()).model_copy(update=changed)


def _read(document: Document, file: str, allow_missing_ids: bool) -> FleetConfig | None:
    root, loading = document.data, Loading(document)
    listed_items: list[Any] | None = root["pubsub"] if isinstance(root.get("pubsub"), list) else None
    sections = {
        name: _SOME_CONNECTION if name == "pubsub" and listed_items is not None else loading.mapping((name,), value)
        for name, value in ((name, root.get(name)) for name in _SECTIONS)
    }
    shell = loading.model(
        FleetConfig, {**root, **{name: sections[name] for name in ("fleet", "server", "pubsub")}, **_NO_NAMES}, ()
    )
    connections: tuple[tuple[KeyPath, PubSubConfig], ...] = () if shell is None else ((("pubsub",), shell.pubsub),)
    if listed_items is not None:
        found = loading.connections(listed_items)
        connections = tuple([(("pubsub", number), each) for number, each in enumerate(found) if each is not None])
        if shell is not None and connections:
            shell = _over(shell, [each for _, each in connections])
    resilience = loading.resilience(sections["resilience"])
    bridges: dict[str, BridgeConfig] = {}
    for name, value in loading.named(("bridges",), sections["bridges"]).items():
        if (bridge := loading.bridge(name, value)) is not None:
            bridges[name] = bridge
    robots: dict[str, RobotConfig] = {}
    data: dict[tuple[str, str], DataSetConfig] = {}
    for name, value in loading.named(("robots",), sections["robots"]).items():
        robot, data_sets = loading.robot(("robots", name), value, bridges)
        if robot is not None:
            robots[name] = robot
        data |= {(name, data_name): data_set for data_name, data_set in data_sets.items()}
    bridge_of = {name: robot.bridge for name, robot in robots.items()}
    pubsub = shell.pubsub if shell else None
    parts = Parts(document, file, pubsub, bridges, bridge_of, data, robots, resilience, connections)
    check_all(parts)
    if shell is not None:
        shell = _checked(shell, parts, loading.relays(root.get("relays")), robots, data)
    check_ids_given(parts, allow_missing=allow_missing_ids)
    if shell is None or document.problems:
        return None
    of_robot: dict[str, dict[str, DataSetConfig]] = {name: {} for name in robots}
    for (robot_name, data_name), dataset in data.items():
        of_robot[robot_name][data_name] = dataset
    whole = {name: robot.model_copy(update={"data": of_robot[name]}) for name, robot in robots.items()}
    return shell.model_copy(update={"bridges": bridges, "robots": whole, "resilience": resilience})


def _checked(
    shell: FleetConfig,
    parts: Parts,
    relays: dict[str, RelayConfig],
    robots: Mapping[str, RobotConfig],
    data: Mapping[tuple[str, str], DataSetConfig],
) -> FleetConfig:
    """What is not of a bridge or a robot, after noting what is wrong with it; with its relays."""
    check_connections(parts, shell.server, relays)
    check_relays(parts, relays, shell.server, shell.sources)
    if relays:
        shell = shell.model_copy(update={"relays": relays})
    check_namespaces(parts, shell.fleet.namespace_indices)
    check_setpoint_groups(parts, shell.fleet.namespace_indices)
    check_publisher_ids(parts, shell.sources)
    check_history(parts, shell.history)
    check_alarms(parts)
    if shell.unified_namespace is not None:
        check_namespace(parts, shell.unified_namespace, shell.fleet.name)
    if shell.modbus is not None:
        for where, text, suggestion in modbus_problems(shell.modbus, robots, data):
            parts.document.problem(where, text, suggestion)
    if shell.sources:
        origins = {name: (one.origin, one.source is not None) for name, one in data.items()}
        for where, text, suggestion in source_problems(shell.sources, origins, is_secured=shell.is_secured):
            parts.document.problem(where, text, suggestion)
    return shell


def _over(shell: FleetConfig, connections: Sequence[PubSubConfig]) -> FleetConfig:
    """A fleet over these connections."""
    given: dict[str, Any] = {name: getattr(shell, name) for name in shell.model_fields_set}
    given.update(pubsub=connections[0], further=tuple(connections[1:]))
    return FleetOfConnections.model_construct(**given)


_SOME_CONNECTION: Final[dict[str, Any]] = {"security": "none"}
"""In place of a list, each item of which is validated by itself."""
_NO_NAMES: Final[dict[str, Any]] = {"bridges": {}, "robots": {}, "relays": {}, "resilience": {}}


def load(
    path: str | Path,
    environment: Mapping[str, str] | None = None,
    *,
    overrides: Mapping[str, object] | None = None,
    allow_missing_ids: bool = False,
) -> FleetConfig:
    """Load a configuration file.

    Args:
        path: the file.
        environment: values for `${VAR}` and `UA_FLEET__...`; by default those of the process.
        overrides: values that come last, by key paths like `server.port`.
        allow_missing_ids: data without an id is no problem, since it is about to get one.

    Raises:
        ConfigInvalid: with all problems, in the order of their lines.
    """
    variables = os.environ if environment is None else environment
    content = read_content(Path(path))
    return load_content(content, str(path), variables, overrides=overrides, allow_missing_ids=allow_missing_ids)


def load_content(
    content: bytes,
    file: str,
    environment: Mapping[str, str],
    *,
    overrides: Mapping[str, object] | None = None,
    allow_missing_ids: bool = False,
) -> FleetConfig:
    """`load` for bytes that were read already; `file` names them in problems."""
    return load_document(content, file, environment, overrides=overrides, allow_missing_ids=allow_missing_ids)[0]


def load_document(
    content: bytes,
    file: str,
    environment: Mapping[str, str],
    *,
    overrides: Mapping[str, object] | None = None,
    allow_missing_ids: bool = False,
) -> tuple[FleetConfig, Document]:
    """`load_content`, with the document that says where each value comes from."""
    document = read_document(content, file, environment)
    if document.is_newer_than(VERSION):
        raise ConfigInvalid(document.problems)
    config = None
    if document.data:
        apply_environment(document, environment)
        apply_options(document, overrides or {})
        config = _read(document, file, allow_missing_ids)
    if config is None or document.problems:
        raise ConfigInvalid(sorted(document.problems, key=lambda problem: (problem.file != file, problem.line)))
    return config, document
