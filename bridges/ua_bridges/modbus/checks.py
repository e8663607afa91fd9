"""What is wrong between a Modbus bridge and the registers that its robots name: for `ua-fleet config check`. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from pydantic import ValidationError

from ua_bridges.modbus.config import (
    DeviceConfig,
    HandshakeSkill,
    ModbusBridgeConfig,
    RegisterMapping,
    RegisterSink,
    RegisterSource,
)
from ua_fleet.config.base import ScalarType
from ua_fleet.config.register_schema import RegisterConfig
from ua_fleet.config.schema import DataSetConfig, FieldConfig, RobotConfig
from ua_fleet.config.skill_schema import SkillConfig
from ua_fleet.document import KeyPath, key_text
from ua_fleet.names import closest, listed
from ua_fleet.registers import (
    LAST_ADDRESS,
    Register,
    RegisterType,
    RegisterUnfit,
    Table,
    encode,
    fit_problem,
    fits_device,
)

__all__ = ["fleet_problems"]

Problem = tuple[KeyPath, str, str]


@dataclass(frozen=True, slots=True)
class _Use:
    """A register that something names."""

    path: KeyPath
    device: str
    config: RegisterConfig
    register: Register
    writes: bool
    handshake: int | None = None
    """Address of the request of a skill; skills with the same one are done one at a time, and share registers."""


def fleet_problems(config: ModbusBridgeConfig, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[Problem]:
    """See `BridgeConfig.fleet_problems`."""
    found: list[Problem] = []
    uses: list[_Use] = []
    skills: dict[tuple[str, int], list[tuple[KeyPath, HandshakeSkill]]] = {}
    for robot, robot_config in robots.items():
        if robot_config.bridge != name:
            continue
        for data, data_set in robot_config.data.items():
            path: KeyPath = ("robots", robot, "data", data)
            if data_set.origin == "robot" and data_set.source is None:
                text = "say which registers it is read from: source: {at: ...}"
                found.append(((*path, "source"), "`source` is missing", text))
            for side, mapping in (("source", data_set.source), ("sink", data_set.sink)):
                if isinstance(mapping, RegisterMapping):
                    uses += _mapped(config, (*path, side), mapping, data_set, found)
        for skill, skill_config in robot_config.skills.items():
            uses += _skill(config, ("robots", robot, "skills", skill), skill_config, skills, found)
    uses += _mirrors(config, name, robots, found)
    for use in uses:
        found += _outside(config.devices[use.device], use)
    return [*found, *_overlaps(uses), *_without_command(skills)]


def _device(config: ModbusBridgeConfig, path: KeyPath, name: str | None, found: list[Problem]) -> str | None:
    device = config.device_of(name)
    if device is None:
        if name is None:
            text = f"`device` is missing; there are {listed(config.devices)}"
            found.append((path, text, "say which one"))
        else:
            hint = closest(name, config.devices) or f"there are: {listed(config.devices)}"
            found.append(((*path, "device"), f"there is no device `{name}`", hint))
    return device


def _use(
    config: ModbusBridgeConfig,
    device: str,
    path: KeyPath,
    register: RegisterConfig,
    field: ScalarType,
    writes: bool,
    found: list[Problem],
    handshake: int | None = None,
) -> Iterator[_Use]:
    """A register whose type fits the value's, or the problem."""
    try:
        made = register.register(config.devices[device].order, field)
    except ValueError as error:
        found.append((path, str(error), ""))
        return
    if problem := fit_problem(made, field.builtin):
        found.append((path, problem, ""))
        return
    if writes and not made.table.is_writable:
        found.append(((*path, "table"), f"{made.table} registers cannot be written", "use holding or coil"))
        return
    yield _Use(path, device, register, made, writes, handshake)


def _mapped(
    config: ModbusBridgeConfig, path: KeyPath, mapping: RegisterMapping, data_set: DataSetConfig, found: list[Problem]
) -> list[_Use]:
    uses: list[_Use] = []
    device = _device(config, path, mapping.device, found)
    if isinstance(mapping, RegisterSource) and mapping.poll is not None and mapping.poll not in config.polls:
        hint = closest(mapping.poll, config.polls) or f"there are: {listed(config.polls) or 'none; add it to `polls`'}"
        found.append(((*path, "poll"), f"there is no poll group `{mapping.poll}`", hint))
    fields = data_set.all_fields()
    if ("" in fields) is not (mapping.at is not None):
        wanted = "`at`, since it has a `type`" if "" in fields else "`registers`, since it has `fields`"
        found.append((path, f"the data needs {wanted}", ""))
        return uses
    missing = [field_name for field_name in fields if field_name and field_name not in mapping.registers]
    found += [(path, f"the field `{field_name}` has no register", "add it under `registers`") for field_name in missing]
    for field_name, register in mapping.by_field().items():
        at: KeyPath = (*path, "registers", field_name) if field_name else (*path, "at")
        field: FieldConfig | None = fields.get(field_name)
        if field is None:
            found.append((at, f"there is no field `{field_name}`", closest(field_name, fields)))
        elif field.array:
            found.append((at, "registers hold no arrays", "name each value as a field of its own"))
        elif device is not None:
            uses += _use(config, device, at, register, field.type, isinstance(mapping, RegisterSink), found)
    return uses


def _mirrors(
    config: ModbusBridgeConfig, name: str, robots: Mapping[str, RobotConfig], found: list[Problem]
) -> list[_Use]:
    uses: list[_Use] = []
    for named, sink in config.mirrors.items():
        path: KeyPath = ("bridges", name, "mirrors", named)
        robot, _, data = named.partition(".")
        if robot not in robots:
            found.append((path, f"there is no robot `{robot}`", closest(robot, robots)))
        elif data not in robots[robot].data:
            found.append((path, f"{robot} has no data `{data}`", closest(data, robots[robot].data)))
        elif robots[robot].bridge == name:
            text = f"{robot} is a robot of this bridge"
            found.append((path, text, "data that clients write has a `sink`; data that is read from it stays in it"))
        else:
            uses += _mapped(config, path, sink, robots[robot].data[data], found)
    return uses


_WORD = (("request", True), ("accepted", False), ("halt", True))
_FLAGS = ("busy", "done", "error")
_SIGNALS = frozenset({*(key for key, _ in _WORD), *_FLAGS})


def _skill(
    config: ModbusBridgeConfig,
    path: KeyPath,
    skill: SkillConfig,
    skills: dict[tuple[str, int], list[tuple[KeyPath, HandshakeSkill]]],
    found: list[Problem],
) -> list[_Use]:
    if not skill.via:
        found.append((path, "`via` is missing", "say how the device does it; see docs/plc.md"))
        return []
    try:
        via = HandshakeSkill.model_validate(skill.via)
    except ValidationError:
        return []  # which has been said
    path = (*path, "via")
    uses: list[_Use] = []
    device = _device(config, path, via.device, found)
    if device is None:
        return uses
    handshake = via.request.address
    skills.setdefault((device, handshake), []).append((path, via))

    def use(key: str, register: RegisterConfig | None, field: ScalarType, writes: bool) -> None:
        if register is not None:
            uses.extend(_use(config, device, (*path, key), register, field, writes, found, handshake))

    for key, writes in _WORD:
        register: RegisterConfig | None = getattr(via, key)
        if register is not None and (register.type not in (None, RegisterType.UINT16) or register.is_scaled):
            found.append(((*path, key), "the number of an execution is a whole word", "write `type: uint16`"))
        else:
            use(key, register, ScalarType.UINT16, writes)
    for key in _FLAGS:
        use(key, getattr(via, key), ScalarType.BOOLEAN, False)
    use("error_text", via.error_text, ScalarType.STRING, False)
    use("error_code", via.error_code, ScalarType.INT64, False)
    use("progress", via.progress, ScalarType.DOUBLE, False)
    use("command", via.command, ScalarType.INT64, True)
    if uses and uses[-1].path[-1] == "command" and via.code is not None:
        try:
            encode(uses[-1].register, via.code)
        except RegisterUnfit as unfit:
            found.append(((*path, "code"), unfit.reason, ""))
    for key, named, known in (
        ("arguments", via.arguments, skill.arguments),
        ("results", via.results, skill.results),
    ):
        missing = [name for name in known if name not in named]
        found += [
            ((*path, key), f"the {key[:-1]} `{name}` has no register", f"add it under `{key}`") for name in missing
        ]
        for name, register in named.items():
            at: KeyPath = (*path, key, name)
            if name not in known:
                found.append((at, f"there is no {key[:-1]} `{name}`", closest(name, known)))
            else:
                uses += _use(config, device, at, register, known[name].type, key == "arguments", found, handshake)
    found += _shared_signals(path, uses)
    return uses


def _shared_signals(path: KeyPath, uses: Sequence[_Use]) -> Iterator[Problem]:
    """Registers of one handshake in which the bridge would take one signal for another, or what it wrote for an answer.

    What the bridge writes for two purposes is a matter of `_overlaps`.
    """
    said = [use for use in uses if use.writes or use.path[len(path)] in _SIGNALS]
    for other, use in combinations(said, 2):
        bits = {use.register.bit, other.register.bit}
        if use.register.span != other.register.span or (None not in bits and len(bits) == 2):
            continue
        if not (use.writes and other.writes):
            bit = "" if use.register.bit is None else f" bit {use.register.bit}"
            text = f"{use.register.span.text}{bit} is `{other.path[-1]}` of this handshake already"
            yield use.path, text, "one of the two addresses or bits is wrong"


def _without_command(skills: Mapping[tuple[str, int], Sequence[tuple[KeyPath, HandshakeSkill]]]) -> Iterator[Problem]:
    """Skills for which the program would do what another one with the same `request` has left in `command`."""
    for sharing in skills.values():
        having = next((path for path, via in sharing if via.command is not None), None)
        for path, via in sharing:
            if having is not None and via.command is None:
                text = f"`command` is missing; {key_text(having)} has the same `request` and leaves its code there"
                yield path, text, "give each of them its `code`"


def _outside(device: DeviceConfig, use: _Use) -> Iterator[Problem]:
    span, limits = use.register.span, device.limits
    if not fits_device(limits, span):
        there = limits.ranges.get(span.table, [(0, LAST_ADDRESS)])
        names = ", ".join(f"{first} to {last}" for first, last in there) or "none"
        yield use.path, f"{span.text} is outside of the device {use.device}", f"its {span.table} addresses: {names}"
        return
    most = limits.most_written(span.table) if use.writes else limits.most_read(span.table)
    if span.count > most:
        text = f"{span.text} takes {span.count} addresses, and a request to {use.device} at most {most}"
        yield use.path, text, "make it shorter"


def _overlaps(uses: list[_Use]) -> Iterator[Problem]:
    """Values that share addresses: they do only where they are the same addresses, and one alone writes them."""
    lanes: dict[tuple[str, Table], list[_Use]] = {}
    for use in uses:
        lanes.setdefault((use.device, use.register.table), []).append(use)
    for lane in lanes.values():
        near: list[_Use] = []
        for use in sorted(lane, key=lambda use: use.register.address):
            near = [other for other in near if other.register.span.end > use.register.address]
            text = next(filter(None, (_clash(other, use) for other in near)), "")
            if text:
                yield use.path, text, "one of the two addresses or types is wrong"
            near.append(use)


def _clash(other: _Use, use: _Use) -> str:
    """Why two values cannot share addresses; empty where they can, or share none."""
    span, others = use.register.span, other.register.span
    if not span.overlaps(others) or _share_handshake(other, use):
        return ""
    if span != others:
        return f"{span.text} overlaps {others.text} of {key_text(other.path)}"
    bits = {use.register.bit, other.register.bit}
    if use.writes and other.writes and (None in bits or len(bits) == 1):
        return f"{span.text} is written by {key_text(other.path)} already"
    return ""


def _share_handshake(other: _Use, use: _Use) -> bool:
    """Whether two skills are done one at a time, so that each has the registers to itself meanwhile."""
    return use.handshake is not None and use.handshake == other.handshake and use.path[:4] != other.path[:4]
