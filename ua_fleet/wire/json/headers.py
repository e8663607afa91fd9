"""What the headers of JSON messages share: ids, names and versions."""

from __future__ import annotations

import uuid
from typing import Any

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.parsing import Reading, shown
from ua_fleet.wire.json.scalars import SCALAR_DECODERS, SCALAR_ENCODERS, decode_integer
from ua_fleet.wire.messages import DataSetMessage

__all__ = [
    "decode_class_id",
    "decode_message_id",
    "decode_publisher_id",
    "decode_text",
    "decode_version",
    "decode_writer_id",
    "encode_publisher_id",
    "encode_version",
    "publisher_id_number",
]


def decode_text(value: Any, name: str) -> str:
    """A mandatory text."""
    if value.__class__ is not str:
        cause = JsonCause.MISSING if value is None else JsonCause.SHAPE
        raise RemoteWireError(cause, f"{name} is no text: {shown(value)}")
    text: str = value
    return text


def decode_message_id(reading: Reading, value: Any) -> str | None:
    """A MessageId; without one a message is read all the same."""
    if value.__class__ is str and value:
        text: str = value
        return text
    if value is None or value == "":
        reading.note(Leniency.MESSAGE_ID_MISSING)
        return None
    if value.__class__ in (int, float):
        reading.note(Leniency.MESSAGE_ID_NUMBER)
        return str(value)
    raise RemoteWireError(JsonCause.SHAPE, f"MessageId is no text: {shown(value)}")


def decode_publisher_id(reading: Reading, value: Any) -> str:
    """A PublisherId as text without leading zeros (OPC 10000-14 7.2.5.3)."""
    if value.__class__ is int and 0 <= value <= 0xFFFF_FFFF_FFFF_FFFF:
        reading.note(Leniency.PUBLISHER_ID_NUMBER)
        return str(value)
    text = decode_text(value, "PublisherId")
    if text[:1] == "0" and text.isascii() and text.isdigit() and len(text) > 1:
        reading.note(Leniency.PUBLISHER_ID_ZEROS)
        return text.lstrip("0") or "0"
    return text


def encode_publisher_id(value: Any) -> str:
    """The text of a PublisherId."""
    if isinstance(value, str):
        return value
    return str(SCALAR_ENCODERS[BuiltinType.UINT64]((), False, value))


def publisher_id_number(text: str) -> int | None:
    """The number that a PublisherId stands for, or None: JSON does not tell the number 2 from the String "2"."""
    if not text.isascii() or not text.isdigit() or len(text) > 20 or (text[0] == "0" and len(text) > 1):
        return None
    number = int(text)
    return number if number <= 0xFFFF_FFFF_FFFF_FFFF else None


def decode_writer_id(reading: Reading, value: Any, name: str | None) -> tuple[int | None, str | None]:
    """DataSetWriterId and DataSetWriterName from a DataSetWriterId of whatever form."""
    if value.__class__ is str:
        reading.note(Leniency.WRITER_ID_TEXT)
        if not (value.isascii() and value.isdigit() and len(value) <= 6):  # edition 1.04 has a String
            return None, value if name is None else name
        value = int(value)
    return decode_integer(reading, BuiltinType.UINT16, value), name


def decode_class_id(reading: Reading, value: Any) -> uuid.UUID | None:
    """A DataSetClassId, None for null."""
    if value is None or value == "":
        return None
    class_id: uuid.UUID = SCALAR_DECODERS[BuiltinType.GUID](reading, value)
    return class_id


def decode_version(reading: Reading, item: dict[str, Any]) -> tuple[int | None, int | None]:
    """Major and minor version that a message names, in `MetaDataVersion` or `MinorVersion`."""
    version = item.get("MetaDataVersion")
    if version is None:
        minor = item.get("MinorVersion")
        return None, None if minor is None else decode_integer(reading, BuiltinType.UINT32, minor)
    if version.__class__ is not dict:
        raise RemoteWireError(JsonCause.SHAPE, f"MetaDataVersion is no object: {shown(version)}")
    major, minor = version.get("MajorVersion", 0), version.get("MinorVersion", 0)
    return decode_integer(reading, BuiltinType.UINT32, major), decode_integer(reading, BuiltinType.UINT32, minor)


def encode_version(message: DataSetMessage) -> dict[str, Any]:
    """The member that names the version of a message, if one is known."""
    major, minor = message.major_version, message.minor_version
    encode = SCALAR_ENCODERS[BuiltinType.UINT32]
    if major is not None:
        if minor is None:
            raise LocalWireError("a MetaDataVersion has a major and a minor version")
        version = {"MajorVersion": encode((), False, major), "MinorVersion": encode((), False, minor)}
        return {"MetaDataVersion": version}
    return {} if minor is None else {"MinorVersion": encode((), False, minor)}
