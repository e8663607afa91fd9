"""DataSets that are read from registers: what is read together, and what a reading tells. Pure.

A value that did not change is not handed on again: the bridge attests with each keep-alive that the device was read. A
number counts as changed when it differs by more than its deadband from the one that was handed on last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ua_bridges.modbus.config import ModbusBridgeConfig, RegisterSource
from ua_fleet.bridge.configured import configured_sources
from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound, SourceLost, SourceRead
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.registers import (
    AddressSpan,
    Cell,
    DeviceLimits,
    Register,
    RegisterUnfit,
    make_cast,
    make_decoder,
    plan_reads,
)
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, Variant

__all__ = ["Answer", "Failed", "PolledSource", "ReadField", "ReadPlan", "SourceSpec", "differs", "source_specs"]


class ReadField(NamedTuple):
    """One value of a source."""

    name: str
    type: int
    """BuiltinType."""
    register: Register
    deadband: float = 0.0


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """A DataSet that is read from a device."""

    topic: Topic
    name: str
    """For people: `conveyor.speed`."""
    device: str
    period_s: float
    fields: tuple[ReadField, ...]
    is_aging: bool = False
    """Whether a reading that brings the same values counts, too."""


class Failed(NamedTuple):
    """What a request brought instead of cells."""

    status: int
    cause: Drop
    reason: str


Answer = Sequence[Cell] | Failed


def source_specs(config: FleetConfig, bridge_name: str) -> tuple[SourceSpec, ...]:
    """The DataSets that a bridge reads. One that has no id yet is left out."""
    bridge = config.bridges[bridge_name]
    assert isinstance(bridge, ModbusBridgeConfig)
    specs: list[SourceSpec] = []
    for data in configured_sources(config, bridge_name, RegisterSource):
        source = data.side
        device = bridge.device_of(source.device)
        assert device is not None, "the configuration was checked"
        order, by_field = bridge.devices[device].order, source.by_field()
        fields = tuple(
            [
                ReadField(
                    name or data.name,
                    field.type.builtin,
                    by_field[name].register(order, field.type),
                    by_field[name].deadband,
                )
                for name, field in data.config.all_fields().items()
            ]
        )
        period_s = bridge.poll_s if source.poll is None else bridge.polls[source.poll].period_s
        specs.append(SourceSpec(data.topic, data.label, device, period_s, fields, data.is_aging))
    return tuple(specs)


class ReadPlan:
    """The requests that read a set of spans; one that is refused for an address is taken apart."""

    def __init__(self, spans: Iterable[AddressSpan], limits: DeviceLimits) -> None:
        self.spans = tuple(set(spans))
        self.requests = list(plan_reads(self.spans, limits))

    @property
    def saved(self) -> int:
        """How many requests fewer than values these are."""
        return len(self.spans) - len(self.requests)

    def split(self, request: AddressSpan) -> list[AddressSpan]:
        """Read each value of a request for itself from now on; those requests, or none where it was one value."""
        within = [span for span in self.spans if _is_within(span, request)]
        alone = sorted({span for span in within if not any(_is_within(span, o) and span != o for o in within)})
        if alone == [request]:
            return []
        position = self.requests.index(request)
        self.requests[position : position + 1] = alone
        return alone

    def request_of(self, span: AddressSpan) -> AddressSpan:
        """The request that reads a span."""
        return next(request for request in self.requests if _is_within(span, request))


def _is_within(span: AddressSpan, request: AddressSpan) -> bool:
    return span.table is request.table and request.address <= span.address and span.end <= request.end


_Reader = tuple[Callable[[Sequence[Cell]], Any], Callable[[Any], Any]]


class _Place(NamedTuple):
    request: AddressSpan
    begin: int
    end: int


class PolledSource:
    """One DataSet on its way from readings to samples."""

    def __init__(self, spec: SourceSpec) -> None:
        self.spec = spec
        self._readers = [(make_decoder(field.register), make_cast(field.register, field.type)) for field in spec.fields]
        self._found = False
        self._last: list[Any] | None = None
        self._places: list[_Place] = []

    def place(self, plan: ReadPlan) -> None:
        """Note which request of a plan brings each field. Again when the plan changes."""
        self._places = []
        for field in self.spec.fields:
            span = field.register.span
            request = plan.request_of(span)
            begin = span.address - request.address
            self._places.append(_Place(request, begin, begin + span.count))

    def take(self, answers: Mapping[AddressSpan, Answer], time_ns: int) -> list[DriverEvent]:
        """What the answers to a plan's requests tell."""
        events: list[DriverEvent] = []
        if not self._found:
            fields = tuple(make_field(field.name, field.type) for field in self.spec.fields)
            events.append(SourceFound(self.spec.topic, self.spec.name, fields))
            self._found = True
        values = [
            self._value(field, reader, place, answers, events)
            for field, reader, place in zip(self.spec.fields, self._readers, self._places, strict=True)
        ]
        if self._last is None or self._has_changed(values, self._last):
            self._last = values
            events.append(SampleRead(self.spec.topic, tuple(values), time_ns))
        elif self.spec.is_aging and not all(isinstance(value, Variant) for value in values):
            events.append(SourceRead(self.spec.topic, time_ns))
        return events

    def lose(self) -> list[DriverEvent]:
        """The device is gone."""
        if not self._found:
            return []
        self._found, self._last = False, None
        return [SourceLost(self.spec.topic)]

    def _value(
        self,
        field: ReadField,
        reader: _Reader,
        place: _Place,
        answers: Mapping[AddressSpan, Answer],
        events: list[DriverEvent],
    ) -> Any:
        answer = answers[place.request]
        if isinstance(answer, Failed):
            return Variant(BuiltinType.STATUS_CODE, answer.status)
        try:
            decode, cast = reader
            return cast(decode(answer[place.begin : place.end]))
        except RegisterUnfit as unfit:
            where = f"{self.spec.name}.{field.name}" if len(self.spec.fields) > 1 else self.spec.name
            detail = f"{where} is Bad: {field.register.span.text} has no value that fits"
            events.append(Dropped(Drop.CONVERSION, 1, detail))
            return Variant(BuiltinType.STATUS_CODE, unfit.status)

    def _has_changed(self, values: Sequence[Any], last: Sequence[Any]) -> bool:
        return any(
            differs(value, before, field.deadband)
            for value, before, field in zip(values, last, self.spec.fields, strict=True)
        )


def differs(value: Any, before: Any, deadband: float) -> bool:
    """Whether a value is another one, beyond its deadband. NaN is the same as NaN."""
    if value == before or (value != value and before != before):
        return False
    if deadband and isinstance(value, float | int) and isinstance(before, float | int):
        return not abs(value - before) <= deadband
    return True
