"""Plans that write the key frames of one DataSetWriter as JSON, a few times the time that `orjson` itself takes.

For the fields of one metadata, one form and one layout a function is generated that checks the values and fills in one
dictionary display, with all that is constant in it. What does not fit goes the general way, which says what is wrong.
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
from ua_fleet.wire.json.headers import encode_publisher_id
from ua_fleet.wire.json.scalars import encode_status
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
            "encode_status": encode_status,
            "encode_generally": self._encode_generally,
            "GOOD": {},
        }
        body = write_fields(self._fields.fields, types, self._fields.writing(self._form), names)
        content = body.pop()
        if self._layout.data_set_header:
            body += [
                f"if sequence_number.__class__ is not int or not 0 <= sequence_number <= {_UINT32}: raise TypeError",
                f"coded = encode_status((), {self._form is not Form.COMPACT}, status) if status else GOOD",
            ]
            content = self._message_display(source, content, names)
        content = content if self._layout.single else f"[{content}]"
        if self._layout.network_header:
            body.append("if message_id.__class__ is not str: raise TypeError")
            content = self._network_display(source, content, names)
        lines = [
            "def encode(message_id, sequence_number, timestamp, status, values):",
            " try:",
            *(f"  {line}" for line in body),
            f"  return dumps({content})",
            " except GIVE_UP:",
            "  return encode_generally(message_id, sequence_number, timestamp, status, values)",
        ]
        exec(compile("\n".join(lines), "<json writer plan>", "exec"), names)  # noqa: S102 - made of our own words
        encode: Callable[..., bytes] = names["encode"]
        return encode

    def _message_display(self, source: Source, payload: str, names: dict[str, Any]) -> str:
        """The DataSetMessage; what is constant in it is taken from what the general way writes."""
        names["version"] = {
            "MajorVersion": self._message.major_version,
            "MinorVersion": self._message.minor_version,
        }
        members: list[str] = []
        if source.data_set_writer_id:
            members.append(f'"DataSetWriterId": {int(source.data_set_writer_id)}')
        if source.data_set_writer_name is not None:
            names["writer_name"] = source.data_set_writer_name
            members.append('"DataSetWriterName": writer_name')
        if not self._layout.network_header:
            members += _outer_members(source, names)
        members += [
            '"SequenceNumber": sequence_number',
            '"MetaDataVersion": version',
            '"Timestamp": encode_date(timestamp)',
            '"Status": coded',
        ]
        if self._layout.message_type:
            members.append('"MessageType": "ua-keyframe"')
        return "{" + ", ".join([*members, f'"Payload": {payload}']) + "}"

    def _network_display(self, source: Source, content: str, names: dict[str, Any]) -> str:
        members = ['"MessageId": message_id', f'"MessageType": "{DATA}"', *_outer_members(source, names)]
        return "{" + ", ".join([*members, f'"Messages": {content}']) + "}"


def _outer_members(source: Source, names: dict[str, Any]) -> list[str]:
    members: list[str] = []
    if source.publisher_id is not None:
        names["publisher_id"] = encode_publisher_id(source.publisher_id)
        members.append('"PublisherId": publisher_id')
    if source.writer_group_name is not None:
        names["group_name"] = source.writer_group_name
        members.append('"WriterGroupName": group_name')
    return members
