"""What is wrong with the fleet as a Modbus device: names that lead nowhere, registers that overlap or do not fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ua_fleet.config.base import ScalarType
from ua_fleet.config.modbus_schema import CommandConfig, ModbusServerConfig
from ua_fleet.config.register_schema import RegisterConfig
from ua_fleet.config.schema import DataSetConfig, RobotConfig
from ua_fleet.document import KeyPath, key_text
from ua_fleet.names import closest, listed
from ua_fleet.registers import LAST_ADDRESS, AddressSpan, Register, RegisterType, Table, fit_problem

__all__ = ["CONTROL_WORDS", "STATUS_WORDS", "modbus_problems"]

CONTROL_WORDS = 4
STATUS_WORDS = 50
"""Lengths of the two blocks that a PLC commands by; a test compares them with `ua_fleet.modbus.words`."""

Problem = tuple[KeyPath, str, str]
Data = Mapping[tuple[str, str], DataSetConfig]


class _Use(NamedTuple):
    path: KeyPath
    span: AddressSpan
    bit: int | None
    what: str
    command: str | None = None
    """Commands take their arguments one after the other, so they may share registers."""


def modbus_problems(config: ModbusServerConfig, robots: Mapping[str, RobotConfig], data: Data) -> list[Problem]:
    """All problems, by the paths of their keys."""
    found: list[Problem] = []
    uses = [
        _Use(
            ("modbus", "control"),
            AddressSpan(Table.HOLDING, config.control, CONTROL_WORDS),
            None,
            "the words of commands",
        ),
        _Use(("modbus", "status"), AddressSpan(Table.INPUT, config.status, STATUS_WORDS), None, "the words of answers"),
    ]
    if config.values:
        span = AddressSpan(Table.DISCRETE, config.quality, len(config.values))
        uses.append(_Use(("modbus", "quality"), span, None, "the qualities"))
    for position, robot in enumerate(config.robots):
        if robot not in robots:
            found.append((("modbus", "robots", position), f"there is no robot `{robot}`", closest(robot, robots)))
        elif robot in config.robots[:position]:
            found.append((("modbus", "robots", position), f"{robot} is named twice", "remove one of them"))
    for key, nodes in (("values", config.values), ("sets", config.sets)):
        for path, register in nodes.items():
            uses += _node(config, ("modbus", key, path), path, register, robots, data, found)
    codes: dict[int, str] = {}
    for name, command in config.commands.items():
        if (other := codes.setdefault(command.code, name)) != name:
            found.append(
                (("modbus", "commands", name, "code"), f"{command.code} is that of `{other}`", "choose another number")
            )
        uses += _command(config, name, command, robots, found)
    beyond = [use for use in uses if use.span.end - 1 > LAST_ADDRESS]
    found += [(use.path, f"{use.span.text} is beyond the last address, {LAST_ADDRESS}", "") for use in beyond]
    return found + list(_overlaps(uses))


def _node(
    config: ModbusServerConfig,
    at: KeyPath,
    path: str,
    register: RegisterConfig,
    robots: Mapping[str, RobotConfig],
    data: Data,
    found: list[Problem],
) -> Iterator[_Use]:
    robot, name, *rest = path.split(".", 2)
    data_set, field_name = data.get((robot, name)), rest[0] if rest else ""
    if robot not in robots:
        found.append((at, f"there is no robot `{robot}`", closest(robot, robots)))
    elif data_set is None:
        there = [known for owner, known in data if owner == robot]
        found.append((at, f"{robot} has no data `{name}`", closest(name, there) or f"there are: {listed(there)}"))
    elif (field := data_set.all_fields().get(field_name)) is None:
        fields = [known for known in data_set.all_fields() if known]
        hint = f"name one of its fields: {listed(fields)}" if fields else "it has one value: leave out the field"
        found.append((at, f"{robot}.{name} has no field `{field_name}`", hint))
    elif field.array:
        found.append((at, "registers hold no arrays", "name another value"))
    elif at[1] == "sets" and data_set.origin != "server":
        found.append((at, f"{robot}.{name} is the robot's own", "only data of `origin: server` can be written"))
    else:
        yield from _use(config, at, register, field.type, at[1] == "sets", found)


def _use(
    config: ModbusServerConfig,
    at: KeyPath,
    register: RegisterConfig,
    kind: ScalarType,
    is_written: bool,
    found: list[Problem],
    command: str | None = None,
) -> Iterator[_Use]:
    try:
        made: Register = register.register(config.order, kind)
    except ValueError as error:
        found.append((at, str(error), ""))
        return
    if problem := fit_problem(made, kind.builtin):
        found.append((at, problem, ""))
    elif made.table.is_writable is not is_written:
        wanted = "holding or coil, which a PLC writes" if is_written else "input or discrete, which a PLC only reads"
        found.append(((*at, "table"), f"{made.table} is not for this", f"use {wanted}"))
    else:
        yield _Use(at, made.span, made.bit, key_text(at), command)


def _command(
    config: ModbusServerConfig,
    name: str,
    command: CommandConfig,
    robots: Mapping[str, RobotConfig],
    found: list[Problem],
) -> Iterator[_Use]:
    at: KeyPath = ("modbus", "commands", name)
    if command.robot is None or command.skill is None:
        for argument, register in command.arguments.items():
            yield from _use(
                config, (*at, "arguments", argument), register, _parameter_type(register), True, found, name
            )
        return
    robot = robots.get(command.robot)
    if robot is None:
        found.append(((*at, "robot"), f"there is no robot `{command.robot}`", closest(command.robot, robots)))
        return
    skill = robot.skills.get(command.skill)
    if skill is None:
        hint = closest(command.skill, robot.skills) or f"there are: {listed(robot.skills) or 'none'}"
        found.append(((*at, "skill"), f"{command.robot} has no skill `{command.skill}`", hint))
        return
    for key, named, known in (
        ("arguments", command.arguments, skill.arguments),
        ("results", command.results, skill.results),
    ):
        for argument, register in named.items():
            inner: KeyPath = (*at, key, argument)
            if argument not in known:
                found.append((inner, f"there is no {key[:-1]} `{argument}`", closest(argument, known)))
            else:
                yield from _use(config, inner, register, known[argument].type, key == "arguments", found, name)
    for argument, declared in skill.arguments.items():
        if declared.default is None and argument not in command.arguments:
            text = f"the argument `{argument}` has no register and no default"
            found.append(((*at, "arguments"), text, "add it under `arguments`"))


def _parameter_type(register: RegisterConfig) -> ScalarType:
    """A scenario's parameter is what lies in the register."""
    if register.table.is_bits or register.type is RegisterType.BOOL:
        return ScalarType.BOOLEAN
    return ScalarType.STRING if register.type is RegisterType.STRING else ScalarType.DOUBLE


def _overlaps(uses: list[_Use]) -> Iterator[Problem]:
    near: list[_Use] = []
    for use in sorted(uses, key=lambda use: (use.span.table.value, use.span.address)):
        near = [other for other in near if other.span.overlaps(use.span)]
        for other in near:
            of_other_commands = None not in (use.command, other.command) and use.command != other.command
            other_bits = use.span == other.span and use.bit is not None and other.bit not in (None, use.bit)
            if not of_other_commands and not other_bits:
                yield use.path, f"{use.span.text} overlaps {other.what}, {other.span.text}", "take another address"
                break
        near.append(use)
