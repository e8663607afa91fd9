"""Key frames whose text has been seen before but for its MessageId, sequence number, time and payload.

Most messages of a DataSetWriter differ in nothing else. What stands around those four is compared as bytes, so that
only the payload is parsed, straight into its values where its fields have a plan for that. An outline is learned from a
message that was read the usual way. It is tried out first: what it says of a text has to be what the text says when it
is parsed. A text that is not of a known outline is not read here, so this reads nothing that the usual way reads
otherwise.
"""

from __future__ import annotations

from typing import Final

from orjson import loads

from ua_fleet.wire.json.data_messages import UNKNOWN_SOURCE, FieldsOf, JsonData, Source
from ua_fleet.wire.json.dates import TICKS_OF_BYTES, usual_date
from ua_fleet.wire.json.parsing import DEFAULT_LIMITS, Limits
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
_SHORTEST: Final = len('","MessageType":"ua-data","PublisherId":"","Messages":[{')
"""Bytes from the end of the MessageId to the sequence number, where that stands behind all of these."""
_UINT32: Final = 0xFFFF_FFFF
_LONGEST_NUMBER: Final = len(_NUMBER) + len(str(_UINT32)) + 1
"""With the comma behind it."""
_PROBE_TIME: Final = b"2024-01-17T21:20:00.0000001"
_BEFORE_Z: Final = len(_PROBE_TIME)
_DIGITS: Final = 7
"""Of the fraction of a time."""
_BEFORE_FRACTION: Final = _BEFORE_Z - _DIGITS
_PROBE_TICKS: Final = usual_date("2024-01-17T21:20:00.0000001Z")


_Outline = tuple[bytes, int, int, bytes, bytes, int, Source, str | None, int | None, int | None, int | None]
"""What stands between the variable parts of a text, and what it says:

* from the sequence number to the fraction of the time, with the second that was seen last, and the length of that
* the ticks of that second
* from the sequence number to the time
* from the `Z` of the time to the payload, and the length of that
* source, name of the group, status, major and minor version

No NamedTuple: Python takes a plain tuple apart in a fifth of the time.
"""

_outlines: Final[dict[bytes, _Outline]] = {}
"""By what stands from the end of the MessageId to the sequence number."""


def decode_known_text(
    text: bytes, fields_of: FieldsOf, source: Source, limits: Limits = DEFAULT_LIMITS
) -> JsonData | None:
    """A NetworkMessage of data from its text, which is not too long; None for one that is not of a known outline."""
    id_end = text.find(b'"', _ID)
    number_at = text.find(_NUMBER, id_end + _SHORTEST, id_end + _LONGEST)
    outline = _outlines.get(text[id_end:number_at])
    if outline is None:
        return None
    until_fraction, size, second, _, tail, tail_size, its_source, group, status, major, minor = outline
    number_end = text.find(b",", number_at, number_at + _LONGEST_NUMBER)  # quicker than to look for what follows it
    z_at = number_end + size + _DIGITS
    if text.startswith(until_fraction, number_end) and text.startswith(tail, z_at):
        digits = text[z_at - _DIGITS : z_at]
    else:
        found = _another_second(text, id_end, number_at, number_end, outline)
        if found is None:
            return None
        z_at, second, digits = found
    if text[:_ID] != _BEGIN or text[-3:] != _END or not digits.isdigit():
        return None
    try:
        # What stands at these places, and the payload, alone is parsed, so that what is no JSON is none here either.
        message_id = loads(text[_ID - 1 : id_end + 1])
        number = loads(text[number_at + _NUMBER_SIZE : number_end])
    except (ValueError, RecursionError):  # orjson.JSONDecodeError is a ValueError
        return None
    # A MessageId that has an escaped quotation mark ends earlier here, and is no text then.
    if number.__class__ is not int or not 0 <= number <= _UINT32 or not message_id:
        return None
    if group is None and source.writer_group_name is not None:
        its_source = its_source._replace(writer_group_name=source.writer_group_name)
    ticks, payload = second + int(digits), text[z_at + tail_size : -3]
    return data_of_key_frame(message_id, its_source, number, ticks, status, major, minor, payload, fields_of, limits)


def _another_second(
    text: bytes, id_end: int, number_at: int, number_end: int, outline: _Outline
) -> tuple[int, int, bytes] | None:
    """Where a time ends, the ticks of its second, and the seven digits of its fraction.

    For a time of another second than the one before, of which later times are more likely, or of a whole second.
    """
    middle, tail = outline[3], outline[4]
    fraction_at = number_end + len(middle) + _BEFORE_FRACTION
    second = TICKS_OF_BYTES.get(text[number_end + len(middle) : fraction_at - 1] + b".")
    if number_end < 0 or second is None or not text.startswith(middle, number_end):
        return None
    if text.startswith(b".", fraction_at - 1) and text.startswith(tail, fraction_at + _DIGITS):
        until_fraction = text[number_end:fraction_at]
        _outlines[text[id_end:number_at]] = (until_fraction, len(until_fraction), second, *outline[3:])
        return fraction_at + _DIGITS, second, text[fraction_at : fraction_at + _DIGITS]
    if text.startswith(tail, fraction_at - 1):
        return fraction_at - 1, second, b"0" * _DIGITS
    return None


def learn_text(text: bytes) -> None:
    """Learn the outline of a text that was read the usual way, if it has one."""
    id_end = text.find(b'"', _ID)
    number_at = text.find(_NUMBER, id_end + _SHORTEST, id_end + _LONGEST)
    number_end = text.find(b",", number_at, number_at + _LONGEST)
    time_at = text.find(_TIME, number_end, number_end + _LONGEST) + len(_TIME)
    payload_at = text.find(_PAYLOAD, time_at, time_at + _LONGEST) + len(_PAYLOAD)
    if not text.startswith(_BEGIN) or not _ID < id_end < number_at < number_end < time_at < payload_at:
        return
    if not text.startswith(b"Z", time_at + _BEFORE_Z):  # a time without a fraction is for the parser
        return
    head, middle, tail = text[id_end:number_at], text[number_end:time_at], text[time_at + _BEFORE_Z : payload_at]
    known = _outlines.get(head)
    if known is not None and known[3:5] == (middle, tail):
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
        until_fraction = middle + _PROBE_TIME[:_BEFORE_FRACTION]
        second, source = _PROBE_TICKS - 1, parts[0]
        _outlines[head] = (
            *(until_fraction, len(until_fraction), second, middle, tail, len(tail)),
            *(source, source.writer_group_name, *parts[1:]),
        )
