"""What lies at which address: one list for the server and for `ua-fleet modbus map`. Pure.

The list is made of the words of the protocol and of what `fleet.yaml` maps, in the order of the addresses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ua_fleet.config.base import ScalarType
from ua_fleet.config.modbus_schema import CommandConfig, ModbusServerConfig
from ua_fleet.config.register_schema import RegisterConfig
from ua_fleet.config.schema import DataSetConfig, FieldConfig, FleetConfig
from ua_fleet.modbus.words import CONTROL, STATUS
from ua_fleet.registers import Register, RegisterType, Table

__all__ = [
    "ArgumentRegisters",
    "Command",
    "MapRow",
    "MappedValue",
    "map_rows",
    "markdown",
    "modbus_commands",
    "modbus_values",
]


@dataclass(frozen=True, slots=True)
class MappedValue:
    """A node that has a register."""

    path: str
    node_id: str
    register: Register
    type: ScalarType
    unit: str | None
    is_written: bool
    quality: Register | None
    """The discrete input that says whether it is Good; None of what is written."""
    description: str = ""


@dataclass(frozen=True, slots=True)
class ArgumentRegisters:
    """An argument or a result in a register."""

    name: str
    register: Register
    type: ScalarType
    unit: str | None = None


@dataclass(frozen=True, slots=True)
class Command:
    """What a PLC can start."""

    name: str
    config: CommandConfig
    arguments: tuple[ArgumentRegisters, ...]
    results: tuple[ArgumentRegisters, ...]


@dataclass(frozen=True, slots=True)
class MapRow:
    """One line of the table."""

    register: Register
    name: str
    text: str
    is_written: bool
    """By the PLC."""
    unit: str | None = None


def _modbus(config: FleetConfig) -> ModbusServerConfig:
    assert config.modbus is not None, "asked for only where there is one"
    return config.modbus


def _field(config: FleetConfig, path: str) -> tuple[DataSetConfig, FieldConfig, str]:
    robot, data, *rest = path.split(".", 2)
    data_set = config.robots[robot].data[data]
    name = rest[0] if rest else ""
    number = f"ns={config.namespace_of(robot)};"
    return data_set, data_set.all_fields()[name], number + (f"s={data_set.id}.{name}" if name else f"i={data_set.id}")


def modbus_values(config: FleetConfig) -> tuple[MappedValue, ...]:
    """The nodes that have registers."""
    modbus = _modbus(config)
    found: list[MappedValue] = []
    for place, (path, register) in enumerate(modbus.values.items()):
        data_set, field, node_id = _field(config, path)
        quality = Register(Table.DISCRETE, modbus.quality + place, RegisterType.BOOL)
        made = register.register(modbus.order, field.type)
        found.append(MappedValue(path, node_id, made, field.type, field.unit, False, quality, data_set.description))
    for path, register in modbus.sets.items():
        data_set, field, node_id = _field(config, path)
        made = register.register(modbus.order, field.type)
        found.append(MappedValue(path, node_id, made, field.type, field.unit, True, None, data_set.description))
    return tuple(found)


def modbus_commands(config: FleetConfig) -> dict[int, Command]:
    """What can be started, by its code."""
    modbus = _modbus(config)
    found: dict[int, Command] = {}
    for name, command in modbus.commands.items():
        skill = config.robots[command.robot].skills[command.skill] if command.robot and command.skill else None
        arguments: list[ArgumentRegisters] = []
        results: list[ArgumentRegisters] = []
        for argument, register in command.arguments.items():
            known = skill.arguments[argument] if skill is not None else None
            kind = known.type if known is not None else _parameter_type(register)
            unit = known.unit if known is not None else None
            arguments.append(ArgumentRegisters(argument, register.register(modbus.order, kind), kind, unit))
        if skill is not None:
            for result, register in command.results.items():
                declared = skill.results[result]
                made = register.register(modbus.order, declared.type)
                results.append(ArgumentRegisters(result, made, declared.type, declared.unit))
        found[command.code] = Command(name, command, tuple(arguments), tuple(results))
    return found


def _parameter_type(register: RegisterConfig) -> ScalarType:
    """A scenario's parameter has no type of its own: it is what lies in the register."""
    if register.table.is_bits or register.type is RegisterType.BOOL:
        return ScalarType.BOOLEAN
    if register.type is RegisterType.STRING:
        return ScalarType.STRING
    return ScalarType.DOUBLE


def map_rows(config: FleetConfig) -> list[MapRow]:
    """All registers, by table and address."""
    modbus = _modbus(config)
    rows = [MapRow(word.at(Table.HOLDING, modbus.control), word.name, word.text, True) for word in CONTROL]
    rows += [MapRow(word.at(Table.INPUT, modbus.status), word.name, word.text, False) for word in STATUS]
    rows += _value_rows(config)
    for command in modbus_commands(config).values():
        what = command.config.scenario or f"{command.config.robot}.{command.config.skill}"
        code = f"command {command.config.code}, {what}"
        for argument in command.arguments:
            rows.append(MapRow(argument.register, argument.name, f"Argument of {code}", True, argument.unit))
        for result in command.results:
            rows.append(MapRow(result.register, result.name, f"Result of {code}", False, result.unit))
    order = list(Table)
    rows.sort(key=lambda row: (order.index(row.register.table), row.register.address, row.register.bit or 0))
    return rows


def _value_rows(config: FleetConfig) -> Iterator[MapRow]:
    for value in modbus_values(config):
        yield MapRow(value.register, value.path, value.description, value.is_written, value.unit)
        if value.quality is not None:
            yield MapRow(value.quality, f"{value.path} is Good", "Otherwise its register has an old value", False)


_HEADS = ("table", "address", "type", "PLC", "name", "unit", "meaning")


def markdown(config: FleetConfig) -> str:
    """The table as Markdown; after it the numbers of robots and commands."""
    rows = [_HEADS, tuple("---" for _ in _HEADS)]
    rows += [_cells(row) for row in map_rows(config)]
    modbus = _modbus(config)
    lines = [_line(row) for row in rows]
    if modbus.robots:
        lines += ["", "| robot | number |", "| --- | --- |"]
        lines += [f"| {robot} | {number} |" for number, robot in enumerate(modbus.robots, start=1)]
    if modbus.commands:
        lines += ["", "| command | code | starts |", "| --- | --- | --- |"]
        for name, command in modbus.commands.items():
            what = f"scenario {command.scenario}" if command.scenario else f"{command.robot}.{command.skill}"
            lines.append(f"| {name} | {command.code} | {what} |")
    return "\n".join(lines)


def _cells(row: MapRow) -> tuple[str, ...]:
    register = row.register
    kind: str = register.type.value
    if register.bit is not None:
        kind = f"bit {register.bit}"
    if register.is_scaled:
        kind += f" x {register.scale:g}" + (f" {register.offset:+g}" if register.offset else "")
    last = register.span.end - 1
    addresses = str(register.address) if last == register.address else f"{register.address} to {last}"
    return (
        register.table.value,
        addresses,
        kind,
        "writes" if row.is_written else "reads",
        row.name,
        row.unit or "",
        row.text,
    )


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
