"""Key frames whose text has been seen before but for its MessageId, sequence number, time and payload.

Most messages of a DataSetWriter differ in nothing else. What stands around those four is compared as bytes, so that
only the payload is parsed. An outline is learned from a message that was read the usual way. It is tried out first:
what it says of a text has to be what the text says when it is parsed. A text that is not of a known outline is not read
here, so this reads nothing that the usual way reads otherwise.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from orjson import loads

from ua_fleet.wire.json.data_messages import UNKNOWN_SOURCE, FieldsOf, JsonData, Source
from ua_fleet.wire.json.dates import TICKS_OF_BYTES, usual_date
from ua_fleet.wire.json.parsing import DEFAULT_LIMITS
from ua_fleet.wire.json.usual_message import data_of_key_frame, usual_key_frame

__all__ = ["decode_known_text", "learn_text"]

_BEGIN: Final = b'{"MessageId":"'
_ID: Final = len(_BEGIN)
_NUMBER: Final = b'"SequenceNumber":'
_NUMBER_SIZE: Final = len(_NUMBER)
_TIME: Final = b'"Timestamp":"'
_PAYLOAD: Final = b'"Payload":'
_END: Final = b"}]}"

_MOST_OUTLINES: Final = 1024
_LONGEST: Final = 1024
"""Bytes of each constant part."""
_UINT32: Final = 0xFFFF_FFFF
_LONGEST_NUMBER: Final = len(_NUMBER) + len(str(_UINT32))
_PROBE_TIME: Final = b"2024-01-17T21:20:00.0000001"
_BEFORE_Z: Final = len(_PROBE_TIME)
_WHOLE_SECOND: Final = len("2024-01-17T21:20:00")
_PROBE_TICKS: Final = usual_date("2024-01-17T21:20:00.0000001Z")

_ticks_of: Final = TICKS_OF_BYTES.get


class _Outline(NamedTuple):
    """What stands between the variable parts of a text, and what it says."""

    middle: bytes
    """From the sequence number to the time."""
    middle_size: int
    tail: bytes
    """From the `Z` of the time to the payload."""
    tail_size: int
    source: Source
    status: int | None
    major_version: int | None
    minor_version: int | None


_outlines: Final[dict[bytes, _Outline]] = {}
"""By what stands from the end of the MessageId to the sequence number."""


def decode_known_text(
    text: bytes, fields_of: FieldsOf, source: Source, depth: int = DEFAULT_LIMITS.depth
) -> JsonData | None:
    """A NetworkMessage of data from its text, which is not too long; None for one that is not of a known outline."""
    id_end = text.find(b'"', _ID)
    number_at = text.find(_NUMBER, id_end, id_end + _LONGEST)
    outline = _outlines.get(text[id_end:number_at])
    if outline is None:
        return None
    middle, middle_size, tail, tail_size, its_source, status, major, minor = outline
    number_end = text.find(middle, number_at, number_at + middle_size + _LONGEST_NUMBER)
    time_at = number_end + middle_size
    z_at = time_at + _BEFORE_Z
    second, fraction = _ticks_of(text[time_at : time_at + 20]), text[time_at + 20 : z_at]
    if second is None:  # a whole second, or one that is not known
        z_at = time_at + _WHOLE_SECOND
        second, fraction = _ticks_of(text[time_at:z_at] + b"."), b"0"
    if (
        second is None
        or text[:_ID] != _BEGIN
        or text[-3:] != _END
        or number_end < 0
        or not text.startswith(tail, z_at)
        or not fraction.isdigit()
    ):
        return None
    try:
        # What stands at these three places alone is parsed, so that what is no JSON is none here either.
        message_id = loads(text[_ID - 1 : id_end + 1])
        number = loads(text[number_at + _NUMBER_SIZE : number_end])
        payload = loads(text[z_at + tail_size : -3])
    except (ValueError, RecursionError):  # orjson.JSONDecodeError is a ValueError
        return None
    # A MessageId that has an escaped quotation mark ends earlier here, and is no text then.
    if number.__class__ is not int or not 0 <= number <= _UINT32 or payload.__class__ is not dict or not message_id:
        return None
    if its_source.writer_group_name is None and source.writer_group_name is not None:
        its_source = its_source._replace(writer_group_name=source.writer_group_name)
    ticks = second + int(fraction)
    return data_of_key_frame(message_id, its_source, number, ticks, status, major, minor, payload, fields_of, depth)


def learn_text(text: bytes) -> None:
    """Learn the outline of a text that was read the usual way, if it has one."""
    id_end = text.find(b'"', _ID)
    number_at = text.find(_NUMBER, id_end, id_end + _LONGEST)
    number_end = text.find(b",", number_at, number_at + _LONGEST)
    time_at = text.find(_TIME, number_end, number_end + _LONGEST) + len(_TIME)
    payload_at = text.find(_PAYLOAD, time_at, time_at + _LONGEST) + len(_PAYLOAD)
    if not text.startswith(_BEGIN) or not _ID < id_end < number_at < number_end < time_at < payload_at:
        return
    if not text.startswith(b"Z", time_at + _BEFORE_Z):  # a time without a fraction is for the parser
        return
    head, middle, tail = text[id_end:number_at], text[number_end:time_at], text[time_at + _BEFORE_Z : payload_at]
    known = _outlines.get(head)
    if known is not None and known.middle == middle and known.tail == tail:
        return
    probe = b"".join((_BEGIN, b"?", head, _NUMBER, b"%d" % _UINT32, middle, _PROBE_TIME, tail, b'{"?":0}', _END))
    try:
        said = usual_key_frame(loads(probe), UNKNOWN_SOURCE)
    except (ValueError, RecursionError):
        return
    if said is None:
        return
    parts = said.source, said.status, said.major_version, said.minor_version
    if said == ("?", parts[0], _UINT32, _PROBE_TICKS, *parts[1:], {"?": 0}):
        if len(_outlines) >= _MOST_OUTLINES:
            _outlines.clear()
        _outlines[head] = _Outline(middle, len(middle), tail, len(tail), *parts)
