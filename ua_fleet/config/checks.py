"""What one model alone cannot see: names that lead nowhere, ids used twice, values that do not fit their field."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Final

from ua_fleet.config.broker_checks import check_broker
from ua_fleet.config.json_checks import check_json
from ua_fleet.config.parts import Parts
from ua_fleet.config.resilience_checks import check_resilience
from ua_fleet.config.schema import (
    DataSetConfig,
    FieldConfig,
    ScalarType,
    value_name,
)
from ua_fleet.config.source_schema import PublishedSourceConfig
from ua_fleet.config.teleoperation_checks import check_teleoperation
from ua_fleet.config.teleoperation_schema import TELEOPERATION_IDS
from ua_fleet.document import KeyPath, key_text
from ua_fleet.errors import TopicInvalid
from ua_fleet.fleet.model import FLEET_NAMESPACE
from ua_fleet.names import closest, listed
from ua_fleet.topics import SERVER_SPACE, check_space
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.metadata import MOST_DESCRIBED

__all__ = [
    "Parts",
    "check_all",
    "check_ids_given",
    "check_namespaces",
    "check_publisher_ids",
    "check_robots",
    "no_namespace",
]

MOST_FIELDS: Final = MOST_DESCRIBED - 10
"""Of a data source: with its properties (type, definition and age of its messages) it has no more parts than are
read."""
_BITS: Final = re.compile(r"(U?)(?:Int)(\d+)")
_SHORTEST_LIFETIME_S: Final = 2.0
_MAX_FLOAT: Final = 3.4028234663852886e38


def _check_bridges_exist(parts: Parts) -> None:
    known = list(parts.mapping_at(("bridges",)))
    for robot, bridge in parts.bridge_of.items():
        if bridge not in known:
            there = f"there are: {listed(known)}" if known else "add it under `bridges`"
            parts.document.problem(
                ("robots", robot, "bridge"), f"there is no bridge `{bridge}`", closest(bridge, known) or there
            )


def _check_spaces(parts: Parts) -> None:
    first: dict[int, str] = {}
    for name, bridge in parts.bridges.items():
        other = first.setdefault(bridge.space, name)
        if other != name:
            parts.document.problem(
                ("bridges", name, "space"),
                f"bridge `{other}` stands in space {bridge.space} already, and two would forward everything twice",
                "give this bridge another space, or remove it",
            )


def check_publisher_ids(parts: Parts, sources: Mapping[str, PublishedSourceConfig]) -> None:
    """A PublisherId on the wire is that of one publisher: of a bridge, of the server (0), or of one in `sources`."""
    uint16 = int(PublisherIdType.UINT16)
    taken: dict[tuple[int, int | str], str] = {(uint16, SERVER_SPACE): "the server"}
    for name, bridge in parts.bridges.items():
        taken[uint16, bridge.space] = f"bridge `{name}`, whose space it is"
    for name, source in sources.items():
        taken.setdefault((source.type_code, source.publisher_id), f"`sources.{name}`")
    for name, bridge in parts.bridges.items():
        wire_id = bridge.wire_id
        if wire_id is None or wire_id == (uint16, bridge.space):
            continue
        other = taken.setdefault(wire_id, f"bridge `{name}`")
        if other != f"bridge `{name}`":
            parts.document.problem(
                ("bridges", name, "publisher_id"), f"it is the PublisherId of {other}", "give this bridge another one"
            )


def _id_paths(parts: Parts) -> list[KeyPath]:
    paths: list[KeyPath] = [("bridges", name, "status_id") for name in parts.mapping_at(("bridges",))]
    for robot in parts.mapping_at(("robots",)):
        paths += [("robots", robot, "data", name, "id") for name in parts.mapping_at(("robots", robot, "data"))]
        skills = parts.mapping_at(("robots", robot, "skills"))
        paths += [("robots", robot, "skills", name, "id") for name in skills]
        paths += [("robots", robot, "skill_status_id")] if skills else []
        if parts.mapping_at(("robots", robot, "teleoperation")):
            paths += [("robots", robot, "teleoperation", key) for key in TELEOPERATION_IDS]
    return paths


def _check_ids(parts: Parts) -> None:
    """An id is one in its namespace, whatever space its data comes from: it is a NodeId.

    And one in its space, whatever its namespace: a DataSetWriterId is unique for a PublisherId (OPC 10000-14 6.2.4.1).
    """
    used: dict[tuple[str, int | str, int], KeyPath] = {}
    optional: list[KeyPath] = [("robots", robot, "fault_id") for robot in parts.mapping_at(("robots",))]
    optional.append(("scenarios", "events_id"))
    for path in (*_id_paths(parts), *optional):
        number = parts.mapping_at(path[:-1]).get(str(path[-1]))
        if isinstance(number, bool) or not isinstance(number, int):
            continue
        ns, space = _home(parts, path)
        first = used.setdefault(("namespace", ns, number), path)
        if first == path:
            first = used.setdefault(("space", space, number), path)
        if first != path:
            line = parts.document.place_of(first).line
            where = f"{key_text(first)}, line {line}" if line else key_text(first)
            parts.document.problem(
                path,
                f"{number} is in use already ({where})",
                "choose another number"
                if path in optional
                else f"remove it here and run: ua-fleet config assign-ids {parts.file}",
            )


def _home(parts: Parts, path: KeyPath) -> tuple[int, str]:
    """The namespace of an id, and the space that it is published in, by its bridge's name."""
    if path[0] == "bridges":
        return FLEET_NAMESPACE, str(path[1])
    if path[0] == "scenarios":
        return FLEET_NAMESPACE, ""
    robot = parts.mapping_at(("robots", str(path[1])))
    ns = robot.get("namespace", FLEET_NAMESPACE)
    is_servers = path[2] == "data" and parts.mapping_at(path[:-1]).get("origin") == "server"
    return ns if isinstance(ns, int) else FLEET_NAMESPACE, "" if is_servers else str(robot.get("bridge"))


def no_namespace(indices: Sequence[int]) -> tuple[str, str]:
    """What is wrong with a robot's namespace that there is not, and what to do."""
    there = ", ".join(str(index) for index in indices)
    return "there is no such namespace", f"there are: {there}; add the URI of another one to fleet.namespaces"


def check_namespaces(parts: Parts, indices: Sequence[int]) -> None:
    """Each robot's namespace is one of the fleet's."""
    for name, robot in parts.robots.items():
        if robot.namespace not in indices:
            parts.document.problem(("robots", name, "namespace"), *no_namespace(indices))


def check_ids_given(parts: Parts, *, allow_missing: bool) -> None:
    """Each data source and each bridge's status must have its id; an `id:` without a value is never right."""
    remedy = f"run: ua-fleet config assign-ids {parts.file}"
    for path in _id_paths(parts):
        key, around = str(path[-1]), parts.mapping_at(path[:-1])
        if key in around:
            if around[key] is None:
                parts.document.problem(path, f"`{key}` has no value", f"remove it and {remedy}")
        elif not allow_missing:
            parts.document.problem(path, f"`{key}` is missing", remedy)


def _check_directions(parts: Parts) -> None:
    for (robot, name), dataset in parts.data.items():
        path: KeyPath = ("robots", robot, "data", name)
        if dataset.origin == "server" and dataset.source is not None:
            parts.document.problem((*path, "source"), "data of origin server has no source: clients write it")
        if dataset.origin == "robot" and dataset.sink is not None:
            text = "data of origin robot is read from the robot; a sink needs `origin: server`"
            parts.document.problem((*path, "sink"), text)


def _check_sizes(parts: Parts) -> None:
    """The server reads no description of more parts: it would have no values of such a source."""
    for (robot, name), dataset in parts.data.items():
        count = len(dataset.fields)
        if count > MOST_FIELDS:
            text = f"{count} fields; a data source has {MOST_FIELDS} at most, or the server drops its description"
            parts.document.problem(
                ("robots", robot, "data", name, "fields"), text, "spread them over several data sources"
            )


def _check_kinds(parts: Parts) -> None:
    """What each kind of bridge finds wrong between a bridge and its robots."""
    data: dict[str, dict[str, DataSetConfig]] = {robot: {} for robot in parts.robots}
    for (robot, name), dataset in parts.data.items():
        data.setdefault(robot, {})[name] = dataset
    robots = {robot: config.model_copy(update={"data": data[robot]}) for robot, config in parts.robots.items()}
    told = [problem.key for problem in parts.document.problems]
    for name, bridge in parts.bridges.items():
        for path, text, suggestion in bridge.fleet_problems(name, robots):
            key = key_text(path)
            # A `source` or `sink` with a mistake in it has been left out. It is not missing.
            if path[-1] not in ("source", "sink") or not any(f"{each}.".startswith(f"{key}.") for each in told):
                parts.document.problem(path, text, suggestion)


def _number_problem(kind: ScalarType, value: float) -> str:
    if kind is ScalarType.DOUBLE:
        return ""
    if kind is ScalarType.FLOAT:
        return "does not fit into Float" if abs(value) > _MAX_FLOAT else ""
    if not isinstance(value, int):
        return f"must be a whole number for {kind.value}"
    bits = {ScalarType.SBYTE: ("", 8), ScalarType.BYTE: ("U", 8)}.get(kind)
    if bits is None:
        match = _BITS.fullmatch(kind.value)
        assert match is not None
        bits = (match[1], int(match[2]))
    least, greatest = (0, 2 ** bits[1] - 1) if bits[0] else (-(2 ** (bits[1] - 1)), 2 ** (bits[1] - 1) - 1)
    return "" if least <= value <= greatest else f"does not fit into {kind.value}, {least} to {greatest}"


def _is_time(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _initial_problem(field: FieldConfig) -> str:
    """What is wrong with a field's initial value; the empty text where nothing is."""
    value, kind = field.initial, field.type
    if field.array:
        return "an array has no initial value"
    if kind is ScalarType.BYTE_STRING:
        return "a ByteString has no initial value"
    if kind is ScalarType.BOOLEAN:
        return "" if isinstance(value, bool) else "must be true or false for Boolean"
    if kind is ScalarType.STRING:
        return "" if isinstance(value, str) else "must be a text for String, in quotes"
    if kind is ScalarType.DATETIME:
        return "" if isinstance(value, str) and _is_time(value) else "must be a time like 2030-01-31T12:00:00Z"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"must be a number for {kind.value}"
    if (problem := _number_problem(kind, value)) != "":
        return problem
    if field.range is not None and not field.range[0] <= value <= field.range[1]:
        return f"is outside of the range {field.range[0]:g} to {field.range[1]:g}"
    return ""


def _check_initial_values(parts: Parts) -> None:
    for (robot, name), dataset in parts.data.items():
        for field_name, field in dataset.all_fields().items():
            if field.initial is None:
                continue
            inner: KeyPath = ("fields", field_name) if field_name else ()
            path: KeyPath = ("robots", robot, "data", name, *inner, "initial")
            if dataset.origin == "robot":
                parts.document.problem(
                    path, "is for data that clients write", "remove it, or set `origin: server` for this data source"
                )
            elif problem := _initial_problem(field):
                parts.document.problem(path, problem)


def _check_pubsub(parts: Parts) -> None:
    for path, pubsub in parts.connections:
        if pubsub.is_brokered:
            check_broker(parts.document, path, pubsub.url, pubsub.broker)
        elif not 1 <= int(pubsub.url.rpartition(":")[2]) <= 65535:
            parts.document.problem((*path, "url"), "a port is 1 to 65535", "the registered one is 4840")


def _check_listed_spaces(parts: Parts) -> None:
    """Spaces that are named may also be those of publishers that are no bridges of this fleet."""
    named: list[tuple[KeyPath, tuple[int, ...]]] = [
        (("bridges", name, "requestors"), bridge.requestors) for name, bridge in parts.bridges.items()
    ]
    named += [((*path, "relaxed_replay"), pubsub.relaxed_replay) for path, pubsub in parts.connections]
    for path, spaces in named:
        for position, space in enumerate(spaces):
            try:
                check_space(space)
            except TopicInvalid as error:
                parts.document.problem((*path, position), error.reason)
            else:
                if space in spaces[:position]:
                    parts.document.problem((*path, position), f"{space} is named twice", "remove one of them")


def _check_keys(parts: Parts) -> None:
    pubsub = parts.pubsub
    if pubsub is None or not any(each.is_secured for _, each in parts.connections):
        return
    path = parts.connections[0][0]
    if pubsub.keys.source == "files" and pubsub.keys.endpoint is not None:
        parts.document.problem(
            (*path, "keys", "endpoint"), "key files come from no service", "remove it, or write `source: service`"
        )
    if (pubsub.keys.source == "pushed") != (pubsub.keys.pushed_by is not None):
        parts.document.problem(
            (*path, "keys", "pushed_by"),
            "goes with `source: pushed`, which needs it",
            "name a user that `ua-fleet user add` made",
        )
    if pubsub.keys.lifetime_s < _SHORTEST_LIFETIME_S:
        parts.document.problem(
            (*path, "keys", "lifetime_s"),
            f"must be at least {_SHORTEST_LIFETIME_S:g}, since keys are fetched at half of it",
        )


def _check_skills(parts: Parts) -> None:
    given = _given(parts)
    for name, robot in parts.robots.items():
        bridge = parts.bridges.get(robot.bridge)
        carrier = robot.mounted_on
        if carrier is not None and (carrier == name or carrier not in parts.robots):
            problem = "a robot is not mounted on itself" if carrier == name else f"there is no robot `{carrier}`"
            parts.document.problem(
                ("robots", name, "mounted_on"), problem, closest(carrier, set(parts.robots) - {name})
            )
        able = {*robot.capacities, *given.get(name, ())}
        for skill_name, skill in robot.skills.items():
            path: KeyPath = ("robots", name, "skills", skill_name)
            for position, capacity in enumerate(skill.needs):
                if capacity not in able:
                    parts.document.problem(
                        (*path, "needs", position),
                        f"{name} lacks the capacity `{capacity}`",
                        closest(capacity, able) or f"add it to robots.{name}.capacities",
                    )
            if skill.via and bridge is not None and bridge.skill_mapping is None:
                parts.document.problem(
                    (*path, "via"), f"bridges of kind {bridge.kind} run no skills by configuration", "remove `via`"
                )


def _check_cards(parts: Parts) -> None:
    of_robot: dict[str, dict[str, DataSetConfig]] = {name: {} for name, robot in parts.robots.items() if robot.card}
    for (owner, data), one in parts.data.items():
        if owner in of_robot:
            of_robot[owner][data] = one
    for name, mine in of_robot.items():
        if mine.keys() != parts.mapping_at(("robots", name, "data")).keys():
            continue  # what is wrong with its data is said, and what its values are is not known
        known = {value_name(data, key): field for data, one in mine.items() for key, field in one.all_fields().items()}
        card = parts.robots[name].card
        for position, value in enumerate(card):
            path: KeyPath = ("robots", name, "card", position)
            field = known.get(value)
            if field is None:
                there = f"there are: {listed(known)}" if known else f"add it to robots.{name}.data"
                parts.document.problem(path, f"{name} has no value `{value}`", closest(value, known) or there)
            elif value in card[:position]:
                parts.document.problem(path, f"`{value}` is named twice", "remove one of them")
            elif field.array or field.type is ScalarType.BYTE_STRING:
                what = "an array" if field.array else "a ByteString"
                parts.document.problem(path, f"`{value}` is {what}, and a card has room for one value", "name another")


def _given(parts: Parts) -> dict[str, set[str]]:
    """Capacities that data gives to each robot while it is there: its own data, and that of what it carries."""
    given: dict[str, set[str]] = {}
    for (name, _), data in parts.data.items():
        robot = parts.robots.get(name)
        if data.gives and robot is not None:
            for owner in {name, robot.mounted_on} - {None}:
                given.setdefault(str(owner), set()).update(data.gives)
    return given


_CHECKS: Final[tuple[Callable[[Parts], None], ...]] = (
    _check_bridges_exist,
    _check_spaces,
    _check_ids,
    _check_directions,
    _check_initial_values,
    _check_pubsub,
    _check_listed_spaces,
    _check_keys,
    check_json,
    _check_skills,
    _check_cards,
    _check_kinds,
    _check_sizes,
    check_teleoperation,
    check_resilience,
)


def check_all(parts: Parts) -> None:
    """Note every problem between the parts."""
    for check in _CHECKS:
        check(parts)


def check_robots(parts: Parts) -> None:
    """Note the problems of robots that stand in no file: of all but what their bridges alone can know."""
    for check in (_check_ids, _check_directions, _check_initial_values, _check_skills, _check_cards):
        check(parts)
