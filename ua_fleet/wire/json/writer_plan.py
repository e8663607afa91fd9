"""Plans that write the key frames of one DataSetWriter as JSON, a few times the time that `orjson` itself takes.

For the fields of one metadata, one form and one layout a function is generated that checks the values, writes the
payload and joins it with what is constant in the headers. What does not fit goes the general way, which says what is
wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import orjson

from ua_fleet.wire.json.data_messages import DATA, NETWORK_MESSAGE, JsonData, Layout, Source, encode_data
from ua_fleet.wire.json.data_sets import DataSetFields
from ua_fleet.wire.json.dates import encode_date
from ua_fleet.wire.json.field_plan import GIVE_UP, MOST_PLANNED_FIELDS, write_fields
from ua_fleet.wire.json.fields import Form
from ua_fleet.wire.json.headers import encode_publisher_id, encode_version
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage

__all__ = ["JsonWriterPlan"]

_UINT32: Final = 0xFFFF_FFFF


class JsonWriterPlan:
    """Writes the key frames of one DataSetWriter with one version of its metadata."""

    __slots__ = ("_data", "_fields", "_form", "_layout", "_message", "encode")

    encode: Callable[[str, int, int, int, tuple[Any, ...]], bytes]
    """encode(message_id, sequence_number, timestamp, status, values) -> bytes; raises LocalWireError.

    An attribute and not a method, since it is the generated function itself. A key frame with all header fields that
    its layout has place for; the values are of the types of the metadata.
    """

    def __init__(
        self,
        fields: DataSetFields,
        form: Form = Form.VERBOSE,
        layout: Layout = NETWORK_MESSAGE,
        source: Source = Source(),  # noqa: B008 - immutable
    ) -> None:
        """Make one; `source` names the writer."""
        version = fields.metadata.configuration_version
        types = tuple([field.code for field in fields.fields])
        self._fields, self._form, self._layout = fields, form, layout
        self._message = DataSetMessage(
            source.data_set_writer_id or 0, types=types, major_version=version.major, minor_version=version.minor
        )
        self._data = JsonData(
            NetworkMessage(source.publisher_id), (source,), writer_group_name=source.writer_group_name
        )
        self.encode = self._encode_generally
        if 0 < len(types) <= MOST_PLANNED_FIELDS and not any(field.is_abstract for field in fields.fields):
            self.encode = self._generate(types, source)

    def _encode_generally(
        self, message_id: str, sequence_number: int, timestamp: int, status: int, values: tuple[Any, ...]
    ) -> bytes:
        message = self._message._replace(
            sequence_number=sequence_number, timestamp=timestamp, status=status, values=values
        )
        data = self._data._replace(message=self._data.message._replace(messages=(message,)), message_id=message_id)
        return encode_data(data, [self._fields], self._form, self._layout)

    def _generate(self, types: tuple[int, ...], source: Source) -> Callable[..., bytes]:
        names: dict[str, Any] = {
            "GIVE_UP": GIVE_UP,
            "dumps": orjson.dumps,
            "encode_date": encode_date,
            "encode_generally": self._encode_generally,
            "join": b"".join,
        }
        body = write_fields(self._fields.fields, types, self._fields.writing(self._form), names)
        payload = f"dumps({body.pop()})"
        parts = self._parts(payload, source, names)
        if self._layout.data_set_header:
            body = [
                f"if sequence_number.__class__ is not int or not 0 <= sequence_number <= {_UINT32}: raise TypeError",
                "if status: return encode_generally(message_id, sequence_number, timestamp, status, values)",
                *body,
            ]
        if self._layout.network_header:
            body.insert(0, "if message_id.__class__ is not str: raise TypeError")
        lines = [
            "def encode(message_id, sequence_number, timestamp, status, values):",
            " try:",
            *(f"  {line}" for line in body),
            f"  return join(({', '.join(parts)},))",
            " except GIVE_UP:",
            "  return encode_generally(message_id, sequence_number, timestamp, status, values)",
        ]
        exec(compile("\n".join(lines), "<json writer plan>", "exec"), names)  # noqa: S102 - made of our own words
        encode: Callable[..., bytes] = names["encode"]
        return encode

    def _parts(self, payload: str, source: Source, names: dict[str, Any]) -> list[str]:
        """Expressions of the parts of a text: what is constant in it, and between that what is not."""
        layout, parts, constant = self._layout, list[str](), b""
        outer = _outer_members(source)

        def add(before: bytes, expression: str) -> None:
            names[f"part{len(parts)}"] = before
            parts.extend([f"part{len(parts)}", expression])

        if layout.network_header:
            add(b'{"MessageId":', "dumps(message_id)")
            constant = b"," + _members({"MessageType": DATA} | outer) + b',"Messages":'
        constant += b"" if layout.single else b"["
        if layout.data_set_header:
            head: dict[str, Any] = {"DataSetWriterId": source.data_set_writer_id} if source.data_set_writer_id else {}
            if source.data_set_writer_name is not None:
                head["DataSetWriterName"] = source.data_set_writer_name
            if not layout.network_header:
                head |= outer
            add(
                constant + b"{" + (_members(head) + b"," if head else b"") + b'"SequenceNumber":',
                "b'%d' % sequence_number",
            )
            version = _members(encode_version(self._message))
            add(b"," + version + b',"Timestamp":"', "encode_date(timestamp).encode()")
            kind = b',"MessageType":"ua-keyframe"' if layout.message_type else b""
            constant = b'","Status":{}' + kind + b',"Payload":'
        add(constant, payload)
        end = (b"}" if layout.data_set_header else b"") + (b"" if layout.single else b"]")
        names["end"] = end + (b"}" if layout.network_header else b"")
        return [*parts, "end"]


def _members(values: dict[str, Any]) -> bytes:
    """The members of an object, without its braces."""
    return orjson.dumps(values)[1:-1]


def _outer_members(source: Source) -> dict[str, str]:
    members: dict[str, str] = {}
    if source.publisher_id is not None:
        members["PublisherId"] = encode_publisher_id(source.publisher_id)
    if source.writer_group_name is not None:
        members["WriterGroupName"] = source.writer_group_name
    return members
