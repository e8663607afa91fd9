"""Plans that write the key frames of one DataSetWriter as JSON, a few times the time that `orjson` itself takes.

For the fields of one metadata, one form and one layout a function is generated that checks the values, puts them
into a message that is kept, with what is constant in its headers as text, and lets `orjson` write all of it at
once. So a plan is of one thread. What does not fit goes the general way, which says what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import orjson

from ua_fleet.wire.json.data_messages import DATA, NETWORK_MESSAGE, JsonData, Layout, Source, encode_data
from ua_fleet.wire.json.data_sets import DataSetFields
from ua_fleet.wire.json.dates import encoding_names, lines_of_encoding
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
        names: dict[str, Any] = {"GIVE_UP": GIVE_UP, "dumps": orjson.dumps, "encode_generally": self._encode_generally}
        names |= encoding_names("last")
        body, payload = write_fields(self._fields.fields, types, self._fields.writing(self._form), names)
        if self._layout.data_set_header:
            body = [
                f"if sequence_number.__class__ is not int or not 0 <= sequence_number <= {_UINT32}: raise TypeError",
                "if status: return encode_generally(message_id, sequence_number, timestamp, status, values)",
                *lines_of_encoding("timestamp", "item['Timestamp']", "last"),
                "item['SequenceNumber'] = sequence_number",
                *body,
            ]
        if self._layout.network_header:
            body = ["if message_id.__class__ is not str: raise TypeError", "tree['MessageId'] = message_id", *body]
        names["tree"] = self._tree(payload, source, names)
        lines = [
            "def encode(message_id, sequence_number, timestamp, status, values):",
            " try:",
            *(f"  {line}" for line in body),
            "  return dumps(tree)",
            " except GIVE_UP:",
            "  return encode_generally(message_id, sequence_number, timestamp, status, values)",
        ]
        exec(compile("\n".join(lines), "<json writer plan>", "exec"), names)  # noqa: S102 - made of our own words
        encode: Callable[..., bytes] = names["encode"]
        return encode

    def _tree(self, payload: dict[str, Any], source: Source, names: dict[str, Any]) -> Any:
        """The message around a payload, which every message overwrites; `names` gets the object of the DataSetMessage.

        What is constant in it is text already.
        """
        layout = self._layout
        outer = _outer_members(source)
        item: dict[str, Any] = payload
        if layout.data_set_header:
            item = {"DataSetWriterId": source.data_set_writer_id} if source.data_set_writer_id else {}
            if source.data_set_writer_name is not None:
                item["DataSetWriterName"] = source.data_set_writer_name
            if not layout.network_header:
                item |= outer
            item |= {"SequenceNumber": 0, **encode_version(self._message), "Timestamp": "", "Status": {}}
            if layout.message_type:
                item["MessageType"] = "ua-keyframe"
            item["Payload"] = payload
            item = names["item"] = _with_fragments(item, {"SequenceNumber", "Timestamp", "Payload"})
        content: Any = item if layout.single else [item]
        if not layout.network_header:
            return content
        head = {"MessageId": "", "MessageType": DATA, **outer, "Messages": content}
        return _with_fragments(head, {"MessageId", "Messages"})


def _with_fragments(members: dict[str, Any], variable: set[str]) -> dict[str, Any]:
    """The members of an object with those that are constant as text, each with all that follow it."""
    out: dict[str, Any] = {}
    texts: dict[str, bytes] = {}
    last = ""
    for name, value in members.items():
        if name in variable:
            out[name], last = value, ""
        elif last:
            texts[last] += b"," + orjson.dumps({name: value})[1:-1]
        else:
            out[name], texts[name], last = None, orjson.dumps(value), name
    return out | {name: orjson.Fragment(text) for name, text in texts.items()}


def _outer_members(source: Source) -> dict[str, str]:
    members: dict[str, str] = {}
    if source.publisher_id is not None:
        members["PublisherId"] = encode_publisher_id(source.publisher_id)
    if source.writer_group_name is not None:
        members["WriterGroupName"] = source.writer_group_name
    return members
