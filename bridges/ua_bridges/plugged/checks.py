"""What is wrong between a bridge to plugged-in devices and the data and skills of its robots. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Final

from ua_bridges.plugged.config import MESSAGE, PluggedBridgeConfig, PluggedSink, PluggedSkill, PluggedSource
from ua_fleet.bridge.templates import AnswerPattern, CommandTemplate, Language, TemplateInvalid
from ua_fleet.config.base import ScalarType
from ua_fleet.config.schema import DataSetConfig, RobotConfig, SkillConfig
from ua_fleet.document import KeyPath
from ua_fleet.names import closest

__all__ = ["problems_of"]

Problem = tuple[KeyPath, str, str]
_NO_LINES: Final = (ScalarType.DATETIME, ScalarType.BYTE_STRING)
_NUMBERS: Final = frozenset(ScalarType) - {ScalarType.BOOLEAN, ScalarType.STRING, *_NO_LINES}


def problems_of(bridge: PluggedBridgeConfig, name: str, robots: Mapping[str, RobotConfig]) -> Iterator[Problem]:
    """Every problem; see BridgeConfig.problems."""
    for robot_name, robot in robots.items():
        for data_name, data in robot.data.items():
            yield from _data(bridge, ("robots", robot_name, "data", data_name), data)
        for skill_name, skill in robot.skills.items():
            path: KeyPath = ("robots", robot_name, "skills", skill_name)
            via = _via(skill)
            if not skill.via:
                yield path, "nothing says how it is done", "give `via` with `read`, `command` or `call`"
            elif via is not None:
                yield from _skill((*path, "via"), bridge, via, skill, robot)


def _via(skill: SkillConfig) -> PluggedSkill | None:
    """How a skill is done; None where `via` has mistakes, which are told already."""
    try:
        return PluggedSkill.model_validate(skill.via)
    except ValueError:
        return None


def _device(path: KeyPath, bridge: PluggedBridgeConfig, device: str | None) -> Iterator[Problem]:
    if device is not None and device not in bridge.devices:
        there = closest(device, bridge.devices) or (
            f"there are: {', '.join(bridge.devices)}" if bridge.devices else "add it to the bridge's `devices`"
        )
        yield (*path, "device"), f"the bridge has no device `{device}`", there


def _data(bridge: PluggedBridgeConfig, path: KeyPath, data: DataSetConfig) -> Iterator[Problem]:
    side = "source" if data.origin == "robot" else "sink"
    mapping = data.source if data.origin == "robot" else data.sink
    if mapping is None:
        yield path, "nothing says how it is read or driven", f"give it a `{side}`"
        return
    for name, field in data.all_fields().items():
        key = (*path, "fields", name) if name else path
        if field.array:
            yield (*key, "array"), "plugged-in devices have no arrays", "write a field for each element"
        if field.type in _NO_LINES:
            yield (*key, "type"), f"plugged-in devices have no {field.type.value}", "a String or a number serves"
    if isinstance(mapping, PluggedSource):
        yield from _device((*path, side), bridge, mapping.device)
        yield from _source((*path, side), mapping, data.field_types())
    elif isinstance(mapping, PluggedSink):
        yield from _device((*path, side), bridge, mapping.device)
        if mapping.command is not None:
            yield from _command((*path, side, "command"), mapping.command, data.field_types())[0]


def _source(path: KeyPath, source: PluggedSource, types: Mapping[str, ScalarType]) -> Iterator[Problem]:
    if source.line is not None:
        yield from _pattern((*path, "line"), source.line, types, "field")
        return
    if source.signal is not None:
        return
    way, fitting = "attribute", _NUMBERS | {ScalarType.STRING, ScalarType.BOOLEAN}
    if source.url is not None:
        way, fitting = "url", frozenset({ScalarType.STRING})
    elif source.plugged is not None:
        way, fitting = "plugged", frozenset({ScalarType.BOOLEAN})
    if len(types) > 1:
        yield (*path, way), f"`{way}` is one value, and the data has several fields", "write one data source for each"
        return
    (kind,) = types.values()
    if kind not in fitting:
        yield (*path, way), f"`{way}` is no {kind.value}", f"its type is {' or '.join(sorted(fitting))}"
    if way == "attribute" and kind not in _NUMBERS and (source.scale, source.offset) != (1.0, 0.0):
        yield (*path, "scale"), f"a {kind.value} is not scaled", "remove `scale` and `offset`"


def _pattern(
    path: KeyPath, text: str, types: Mapping[str, ScalarType], what: str, optional: Collection[str] = ()
) -> Iterator[Problem]:
    try:
        names = AnswerPattern(text, types, Language.PLAIN).names
    except TemplateInvalid as error:
        yield path, str(error), ""
        return
    for missing in [name for name in types if name not in names and name not in optional]:
        yield path, f"the {what} `{missing}` stands nowhere in it", f"write {{{missing}}} into it"


def _command(path: KeyPath, text: str, types: Mapping[str, ScalarType]) -> tuple[list[Problem], frozenset[str]]:
    try:
        return [], CommandTemplate(text, types, Language.PLAIN).names
    except TemplateInvalid as error:
        return [(path, str(error), "")], frozenset(types)


def _skill(
    path: KeyPath, bridge: PluggedBridgeConfig, via: PluggedSkill, skill: SkillConfig, robot: RobotConfig
) -> Iterator[Problem]:
    arguments = {name: argument.type for name, argument in skill.arguments.items()}
    results = {name: result.type for name, result in skill.results.items()}
    if via.read is not None:
        yield from _read(path, via.read, results, robot)
        if arguments:
            yield (*path, "read"), "a reading has no arguments", "remove them"
        return
    yield from _device(path, bridge, via.device)
    if via.command is None:
        return
    problems, names = _command((*path, "command"), via.command, arguments)
    yield from problems
    if via.halt is not None:
        yield from _command((*path, "halt"), via.halt, arguments)[0]
    for missing in [name for name in arguments if name not in names]:
        yield (*path, "command"), f"the argument `{missing}` stands nowhere in it", f"write {{{missing}}} into it"
    if via.done is not None:
        yield from _pattern((*path, "done"), via.done, results, "result")
    elif results:
        yield path, "without `done` the device is not listened to, and there are no results", "add `done`"
    if via.failed is not None:
        yield from _pattern((*path, "failed"), via.failed, {MESSAGE: ScalarType.STRING}, "text", (MESSAGE,))
    if via.halted is not None:
        yield from _pattern((*path, "halted"), via.halted, {}, "text")


def _read(path: KeyPath, data_name: str, results: Mapping[str, ScalarType], robot: RobotConfig) -> Iterator[Problem]:
    data = robot.data.get(data_name)
    if data is None or data.origin != "robot":
        own = [name for name, each in robot.data.items() if each.origin == "robot"]
        yield (*path, "read"), f"the robot has no data `{data_name}` to read", closest(data_name, own) or ""
        return
    types = data.field_types()
    if results != types:
        wanted = ", ".join(f"{name}: {{type: {kind.value}}}" for name, kind in types.items())
        yield (*path, "read"), f"the results are not the fields of `{data_name}`", f"write results: {{{wanted}}}"
