"""The payload of DataSetMessages, by the metadata of their DataSet.

A `DataSetFields` is made once for each version of a metadata. It matches fields by their names, never by their
position: a peer's JSON object has no order. What cannot be read without metadata stays `raw` until there is some.
"""

from __future__ import annotations

from typing import Any, Final

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, DataValue, Variant
from ua_fleet.wire.data_set_message import with_data_values
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_types import DataTypes
from ua_fleet.wire.json.field_plan import DecodePayload, FieldPlans, compile_fields
from ua_fleet.wire.json.fields import (
    NO_VALUE,
    FieldValue,
    Form,
    decode_field,
    encode_data_value_field,
    encode_field,
    planned_fields,
)
from ua_fleet.wire.json.parsing import Reading, dump, shown
from ua_fleet.wire.json.text_plan import DecodeText, compile_text_plan, decode_no_text
from ua_fleet.wire.json.variants import Writing
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldEncoding, FrameKind

__all__ = ["JSON_PAYLOAD", "DataSetFields", "decode_payload", "keep_payload"]

JSON_PAYLOAD: Final = 4
"""The `encoding` of a DataSetMessage whose `raw` is the JSON text of its payload; UADP has no such encoding."""


_NESTING: Final = (
    BuiltinType.STATUS_CODE,
    BuiltinType.LOCALIZED_TEXT,
    BuiltinType.EXTENSION_OBJECT,
    BuiltinType.DATA_VALUE,
    BuiltinType.VARIANT,
    BuiltinType.DIAGNOSTIC_INFO,
)
"""Types whose values are objects, in which values nest, or members that nobody reads."""


class DataSetFields:
    """Reads and writes the payload of the DataSetMessages of one metadata."""

    may_nest: bool
    """Whether a plan reads values that are objects. It does not look how deep they nest."""

    planned_types: tuple[int, ...]
    """The types of what `planned` returns."""
    decode_usual: DecodePayload
    """The plan that has fitted last: `planned` but for other forms. `reading` has to have spent nothing."""
    decode_text: DecodeText
    """The same of the text of a payload, where `decode_usual` has fitted and there is such a plan."""
    reading: Reading
    """Of plans, which forgive nothing."""

    __slots__ = (
        "_positions",
        "_text_plans",
        "decode_text",
        "decode_usual",
        "fields",
        "major_version",
        "may_nest",
        "metadata",
        "planned_types",
        "plans",
        "reading",
        "types",
    )

    def __init__(self, metadata: DataSetMetaData) -> None:
        """Plan the fields; raises RemoteWireError where the metadata contradicts itself."""
        self.metadata = metadata
        self.major_version = metadata.configuration_version.major
        self.types = DataTypes(metadata)
        self.fields = planned_fields(metadata, self.types)
        self.plans: FieldPlans = compile_fields(self.fields)
        self.may_nest = any(field.kind in _NESTING for field in self.fields)
        self.planned_types = tuple([field.code for field in self.fields])
        self.decode_usual = _decode_nothing
        self.decode_text = decode_no_text
        self._text_plans: dict[bool, DecodeText] = {}
        self.reading = Reading(metadata.namespaces, self.types)
        self._positions = {field.name: index for index, field in enumerate(self.fields)}

    def writing(self, form: Form) -> Writing:
        """How values are written in a form."""
        return Writing(self.metadata.namespaces, form is not Form.COMPACT, form is Form.RAW_DATA, self.types)

    def fits(self, message: DataSetMessage) -> bool:
        """Whether the metadata is of the version that the message names, if it names one."""
        version = self.metadata.configuration_version
        if message.major_version is not None:
            return message.major_version == version.major
        return message.minor_version is None or message.minor_version == version.minor

    def decode(self, reading: Reading, message: DataSetMessage, payload: Any) -> DataSetMessage:
        """The message with the fields of a parsed payload; raises RemoteWireError."""
        if payload.__class__ is not dict:
            raise RemoteWireError(JsonCause.SHAPE, f"a payload that is no object: {shown(payload)}")
        if message.kind != FrameKind.DELTA:
            planned = self.planned(payload)
            reading.spend(self.reading.packed)  # all DataSetMessages of a message have one budget
            if planned is not None:
                return message._replace(types=self.planned_types, values=planned)
        return self.decode_by_names(reading, message, payload)

    def planned(self, payload: dict[str, Any]) -> tuple[Any, ...] | None:
        """The values of a payload that has all fields, in their order and in a usual form; None for another."""
        reading = self.reading
        reading.packed = 0
        values = self.decode_usual(reading, payload)
        if values is not None:
            return values
        for plan in self.plans:
            if plan.decode is not self.decode_usual:
                values = plan.decode(reading, payload)
                if values is not None:
                    plan.names[:] = payload  # orjson gives the same texts again, which makes comparing them quick
                    self.decode_usual = plan.decode
                    self.decode_text = self._text_plans.get(plan.is_compact, self._compile_text_plan)
                    return values
        return None

    def _compile_text_plan(self, text: bytes) -> tuple[Any, ...] | None:
        """The `decode_text` of a form until the first text that might need it: most forms have none."""
        is_compact = next(plan.is_compact for plan in self.plans if plan.decode is self.decode_usual)
        self.decode_text = self._text_plans[is_compact] = compile_text_plan(self.fields, is_compact=is_compact)
        return self.decode_text(text)

    def decode_by_names(self, reading: Reading, message: DataSetMessage, payload: dict[str, Any]) -> DataSetMessage:
        """The message with the fields of a payload of any form and order, without a plan; raises RemoteWireError."""
        reading.namespaces, reading.types = self.metadata.namespaces, self.types
        found: dict[int, FieldValue] = {}
        for name, item in payload.items():
            index = self._positions.get(name)
            if index is None:
                reading.note(Leniency.UNKNOWN_FIELD)
            else:
                found[index] = decode_field(reading, self.fields[index], item)
        if message.kind == FrameKind.DELTA:
            message = message._replace(indices=tuple(found))
            values = list(found.values())
        elif not payload and message.kind == FrameKind.KEY:
            values = []  # a heartbeat (OPC 10000-14 7.2.4.5.5)
        else:  # what is absent from a key frame is null
            values = [found.get(index, NO_VALUE) for index in range(len(self.fields))]
        if any(value.data_value is not None for value in values):
            return with_data_values(message, [_as_data_value(value) for value in values])
        return message._replace(
            types=tuple([value.type for value in values]), values=tuple([value.value for value in values])
        )

    def encode(self, writing: Writing, message: DataSetMessage) -> dict[str, Any]:
        """The payload of a message; raises LocalWireError."""
        types, values, indices = message.types, message.values, message.indices
        if (indices is not None) != (message.kind == FrameKind.DELTA):
            raise LocalWireError("a delta frame has field indices, other frames have none")
        if indices is None:
            if len(types) != len(self.fields) and not (not types and message.kind == FrameKind.KEY):
                raise LocalWireError(f"{len(types)} fields, the metadata has {len(self.fields)}")
            indices = tuple(range(len(types)))
        if not len(types) == len(values) == len(indices):
            raise LocalWireError(f"{len(types)} types for {len(values)} values and {len(indices)} fields")
        if not all(0 <= index < len(self.fields) for index in indices) or len(set(indices)) != len(indices):
            raise LocalWireError("a delta frame names each field of its metadata once at most")
        if message.encoding == FieldEncoding.DATA_VALUE:
            return self._encode_data_values(writing, message, indices)
        # In the CompactEncoding null is left out, except where its absence says that nothing has changed.
        keeps_null = writing.verbose or message.kind == FrameKind.DELTA
        out: dict[str, Any] = {}
        for index, code, value in zip(indices, types, values, strict=True):
            field = self.fields[index]
            item = encode_field(writing, field, code, value)
            if item is not None or keeps_null:
                out[field.name] = item
        return out

    def _encode_data_values(
        self, writing: Writing, message: DataSetMessage, indices: tuple[int, ...]
    ) -> dict[str, Any]:
        count = len(indices)
        nothing: tuple[Any, ...] = (None,) * count
        statuses: tuple[Any, ...] = message.field_status or (0,) * count
        sides = [
            message.field_source_timestamps or nothing,
            message.field_server_timestamps or nothing,
            message.field_source_picoseconds or nothing,
            message.field_server_picoseconds or nothing,
        ]
        out: dict[str, Any] = {}
        for position, index in enumerate(indices):
            field, code = self.fields[index], message.types[position]
            variant = Variant(code, message.values[position]) if code else None
            value = DataValue(variant, statuses[position] or 0, *[side[position] for side in sides])
            out[field.name] = encode_data_value_field(writing, field, value)
        return out


def _decode_nothing(_reading: Reading, _payload: dict[str, Any]) -> tuple[Any, ...] | None:
    """What reads payloads until a plan has fitted."""
    return None


def _as_data_value(field: FieldValue) -> DataValue:
    if field.data_value is not None:
        return field.data_value
    return DataValue(Variant(field.type, field.value) if field.type else None)


def keep_payload(message: DataSetMessage, payload: Any) -> DataSetMessage:
    """The message with its payload as text, for which there is no metadata yet."""
    if payload.__class__ is not dict:
        raise RemoteWireError(JsonCause.SHAPE, f"a payload that is no object: {shown(payload)}")
    return message._replace(encoding=JSON_PAYLOAD, raw=dump(payload))


def decode_payload(reading: Reading, message: DataSetMessage, fields: DataSetFields) -> DataSetMessage:
    """The message with its kept payload decoded, now that there is metadata; raises RemoteWireError.

    A message without a kept payload is returned as it is. Whether the metadata is of the right version is the caller's
    to know (`fits`).
    """
    if message.encoding != JSON_PAYLOAD or message.raw is None:
        return message
    payload = orjson.loads(message.raw)
    return fields.decode(reading, message._replace(encoding=FieldEncoding.VARIANT.value, raw=None), payload)
