"""Topics that a bridge's kind finds in its running space, and what `fleet.yaml` would say of them. Pure.

published by a robot                    data, `source`
only subscribed to by a robot           a command: `origin: server` and `sink`
UA topics, what is mapped already       left out, and told

Names and types are what any node of the graph has said: only those that are ROS names get into the file.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import yaml

from ua_fleet.config.base import ScalarType
from ua_fleet.config.checks import MOST_FIELDS
from ua_fleet.config.schema import FIELD_NAME, MESSAGE_TYPE, TOPIC_NAME, RobotConfig

__all__ = ["Addition", "FieldSeen", "LeftOut", "Plan", "TopicSeen", "is_name", "plan_additions", "quoted"]

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}", re.ASCII)
_TOPIC: Final = re.compile(TOPIC_NAME, re.ASCII)
_TYPE: Final = re.compile(MESSAGE_TYPE, re.ASCII)
_FIELD: Final = re.compile(FIELD_NAME, re.ASCII)
"""What the file would not take is left out by itself: with it in the file, nothing could be added."""
_UA: Final = re.compile(r"/ua_[0-9]")
_MOST_NAME: Final = 64
_WHOLE: Final = "data"
"""The path that a single field has without saying so."""


class FieldSeen(NamedTuple):
    """A value in the messages of a topic."""

    path: str
    type: ScalarType
    array: bool = False


@dataclass(frozen=True, slots=True)
class TopicSeen:
    """A topic of the running graph."""

    topic: str
    """Its full name, e.g. `/carrier/battery_state`."""
    type: str
    """`pkg/Name`."""
    is_command: bool
    """Whether a robot listens to it, and none publishes it."""
    fields: tuple[FieldSeen, ...] = ()
    is_latched: bool = False
    """Whether late subscribers get the last message too."""
    problem: str = ""
    """Why nothing can be mapped."""


class Addition(NamedTuple):
    """A data source to write down."""

    robot: str
    name: str
    seen: TopicSeen
    max_rate_hz: float | None

    def lines(self) -> list[str]:
        """As YAML, without indentation; `id` comes later."""
        seen = self.seen
        said = [f"{quoted(self.name)}:"]
        if seen.is_command:
            said.append("  origin: server")
        if len(seen.fields) == 1:
            said += [f"  {line}" for line in _single(seen.fields[0])]
        else:
            said.append("  fields:")
            said += [f"    {quoted(field.path)}: {{{_kind(field)}}}" for field in seen.fields]
        rate = "" if self.max_rate_hz is None else f", max_rate_hz: {self.max_rate_hz:g}"
        side = "sink" if seen.is_command else "source"
        return [*said, f"  {side}: {{topic: {seen.topic}, type: {seen.type}{rate}}}"]


class LeftOut(NamedTuple):
    """A topic that is not written down."""

    topic: str
    reason: str


@dataclass(frozen=True, slots=True)
class Plan:
    """What to write, and what not."""

    additions: tuple[Addition, ...]
    left_out: tuple[LeftOut, ...]


def _kind(field: FieldSeen) -> str:
    return f"type: {field.type.value}, array: true" if field.array else f"type: {field.type.value}"


def _single(field: FieldSeen) -> Iterator[str]:
    yield f"type: {field.type.value}"
    if field.array:
        yield "array: true"
    if field.path != _WHOLE:
        yield f"path: {quoted(field.path)}"


def is_name(name: str) -> bool:
    """Whether a robot may have this name."""
    return _NAME.fullmatch(name) is not None


def quoted(name: str) -> str:
    """A name as YAML takes it for one: `on`, `no` and `null` are none without quotes."""
    return name if yaml.safe_load(name) == name else f"'{name}'"


def plan_additions(
    seen: Iterable[TopicSeen],
    robots: Mapping[str, RobotConfig],
    bridge: str,
    *,
    robot: str | None = None,
    pattern: str = "*",
    max_rate_hz: float = 10.0,
) -> Plan:
    """What `fleet.yaml` would say of topics.

    Args:
        seen: those of the graph.
        robots: of the fleet.
        bridge: the bridge in whose space they are.
        robot: whose data they become; None: the robot whose name a topic begins with, or the bridge's only one.
        pattern: topics whose names match it, as in a shell.
        max_rate_hz: of what is read and not latched: the server shows an analog value no more often anyway.
    """
    here = {name: config for name, config in robots.items() if config.bridge == bridge}
    taken = {name: set(config.data) for name, config in here.items()}
    mapped = {
        topic: f"robots.{name}.data.{data_name}"
        for name, config in here.items()
        for data_name, data in config.data.items()
        for side in (data.source, data.sink)
        if side is not None and (topic := side.own_topic) is not None
    }
    additions: list[Addition] = []
    left_out: list[LeftOut] = []
    for one in sorted(seen, key=lambda each: each.topic):
        if _UA.match(one.topic) or not fnmatch.fnmatchcase(one.topic, pattern):
            continue
        whose = robot or _whose(one.topic, here)
        if (where := mapped.get(one.topic)) is not None:
            left_out.append(LeftOut(one.topic, f"mapped already: {where}"))
        elif not _TOPIC.fullmatch(one.topic):
            left_out.append(LeftOut(one.topic, "its name is no ROS name (letters, digits, _ and /)"))
        elif one.problem:
            left_out.append(LeftOut(one.topic, one.problem))
        elif not _TYPE.fullmatch(one.type):
            left_out.append(LeftOut(one.topic, f"{one.type} is no message type (pkg/Name)"))
        elif not one.fields:
            left_out.append(LeftOut(one.topic, f"{one.type} has no value that can be mapped by itself"))
        elif len(one.fields) > MOST_FIELDS:
            left_out.append(LeftOut(one.topic, f"{one.type} has {len(one.fields)} values, {MOST_FIELDS} are the most"))
        elif odd := [field.path for field in one.fields if _FIELD.fullmatch(field.path) is None]:
            reason = f"{one.type} has a field whose name fleet.yaml does not take: {odd[0]}"
            left_out.append(LeftOut(one.topic, reason))
        elif whose is None:
            there = ", ".join(here) or "none"
            left_out.append(LeftOut(one.topic, f"whose is it? give --robot; robots of this bridge: {there}"))
        else:
            names = taken.setdefault(whose, set())
            name = _name(one.topic, whose, names)
            names.add(name)
            rate = None if one.is_command or one.is_latched else max_rate_hz
            additions.append(Addition(whose, name, one, rate))
    return Plan(tuple(additions), tuple(left_out))


def _whose(topic: str, here: Mapping[str, RobotConfig]) -> str | None:
    first = topic.lstrip("/").partition("/")[0]
    named = next((name for name in here if name.replace("-", "_") == first), None)
    return named or (next(iter(here)) if len(here) == 1 else None)


def _name(topic: str, robot: str, taken: set[str]) -> str:
    """`/carrier/battery_state` of the robot carrier is `battery_state`."""
    parts = [part for part in topic.split("/") if part]
    if len(parts) > 1 and parts[0] == robot.replace("-", "_"):
        parts = parts[1:]
    name = "_".join(parts)[-_MOST_NAME:].lstrip("_-0123456789") or "topic"
    base, number = name, 2
    while name in taken or _NAME.fullmatch(name) is None:
        name = f"{base[: _MOST_NAME - 4]}_{number}"
        number += 1
    return name
