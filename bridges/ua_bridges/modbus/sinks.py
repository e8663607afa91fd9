"""DataSets that are written to registers: clients' data, and that of other spaces' robots. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ua_bridges.modbus.config import ModbusBridgeConfig, RegisterSink
from ua_bridges.modbus.sources import differs
from ua_fleet.bridge.configured import ConfiguredData, configured_sinks
from ua_fleet.config.schema import FleetConfig
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.registers import AddressSpan, Cell, Register, RegisterType, Table, encode
from ua_fleet.topics import Topic

__all__ = ["BitWrite", "SinkSpec", "WriteField", "Writing", "sink_specs", "writes_of"]


class WriteField(NamedTuple):
    """One value of a sink."""

    name: str
    register: Register
    deadband: float = 0.0


@dataclass(frozen=True, slots=True)
class SinkSpec:
    """A DataSet that is written to a device."""

    topic: Topic
    name: str
    """For people: `conveyor.speed`."""
    device: str
    fields: tuple[WriteField, ...]
    read_back: bool
    rewrite: bool
    order: FieldOrder
    """Puts the values of a message into the order of `fields`."""

    def is_same(self, values: Sequence[Any], before: Sequence[Any] | None) -> bool:
        """Whether nothing differs by more than its deadband, in a sink that has some."""
        if before is None or not any(field.deadband for field in self.fields):
            return False
        return not any(
            differs(value, last, field.deadband) for value, last, field in zip(values, before, self.fields, strict=True)
        )


class BitWrite(NamedTuple):
    """Bits of one word; what is beside them is not touched."""

    address: int
    mask: int
    word: int


class Writing(NamedTuple):
    """Cells side by side."""

    span: AddressSpan
    cells: tuple[Cell, ...]


def sink_specs(config: FleetConfig, bridge_name: str) -> tuple[SinkSpec, ...]:
    """The DataSets that a bridge writes. One that has no id yet is left out."""
    bridge = config.bridges[bridge_name]
    assert isinstance(bridge, ModbusBridgeConfig)
    sinks = configured_sinks(config, bridge_name, RegisterSink, mirrors=bridge.mirrors)
    return tuple([_spec(bridge, data) for data in sinks])


def _spec(bridge: ModbusBridgeConfig, data: ConfiguredData[RegisterSink]) -> SinkSpec:
    sink = data.side
    device = bridge.device_of(sink.device)
    assert device is not None, "the configuration was checked"
    order, by_field = bridge.devices[device].order, sink.by_field()
    fields = tuple(
        [
            WriteField(name or data.name, by_field[name].register(order, field.type), by_field[name].deadband)
            for name, field in data.config.all_fields().items()
        ]
    )
    return SinkSpec(data.topic, data.label, device, fields, sink.read_back, sink.rewrite, data.order)


def writes_of(
    values: Mapping[Register, Any] | Sequence[tuple[Register, Any]], most_words: int, most_bits: int
) -> list[Writing | BitWrite]:
    """The writes that put values into their registers, neighbours together. Bits of words come last.

    Raises:
        RegisterUnfit: a value that its register cannot hold; then nothing is to be written.
    """
    pairs = values.items() if isinstance(values, Mapping) else values
    whole: list[Writing] = []
    bits: dict[int, BitWrite] = {}
    for register, value in pairs:
        cells = encode(register, value)
        if register.type is RegisterType.BOOL and register.table is Table.HOLDING:
            one = encode(register, True)[0]
            before = bits.get(register.address, BitWrite(register.address, 0, 0))
            bits[register.address] = BitWrite(register.address, before.mask | one, before.word | cells[0])
        else:
            whole.append(Writing(register.span, cells))
    joined: list[Writing] = []
    for write in sorted(whole, key=lambda write: (write.span.table.value, write.span.address)):
        last = joined[-1] if joined else None
        most = most_bits if write.span.table.is_bits else most_words
        if (
            last is not None
            and last.span.table is write.span.table
            and last.span.end == write.span.address
            and last.span.count + write.span.count <= most
        ):
            span = AddressSpan(last.span.table, last.span.address, last.span.count + write.span.count)
            joined[-1] = Writing(span, last.cells + write.cells)
        else:
            joined.append(write)
    return [*joined, *bits.values()]
