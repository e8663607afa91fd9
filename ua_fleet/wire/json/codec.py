"""One entry for every JSON message: what it is, is told by its MessageType."""

from __future__ import annotations

from typing import Any

from ua_fleet.errors import RemoteWireError
from ua_fleet.wire.json.actions import REQUEST, RESPONSE, ActionFieldsOf, JsonAction, decode_action
from ua_fleet.wire.json.announcements import ANNOUNCEMENTS, JsonAnnouncement, decode_announcement
from ua_fleet.wire.json.causes import JsonCause
from ua_fleet.wire.json.data_messages import DATA, UNKNOWN_SOURCE, FieldsOf, JsonData, Layout, Source, decode_data
from ua_fleet.wire.json.data_sets import DataSetFields
from ua_fleet.wire.json.known_text import decode_known_text, learn_text
from ua_fleet.wire.json.parsing import BYTE_ORDER_MARK, DEFAULT_LIMITS, Limits, Reading, check_depth, load, parse, shown
from ua_fleet.wire.json.usual_message import decode_usual_message

__all__ = ["JsonDecoded", "decode_json"]

JsonDecoded = JsonData | JsonAnnouncement | JsonAction


def _no_fields(_source: Source) -> DataSetFields | None:
    return None


def _no_action_fields(_publisher_id: str, _writer_id: int, _is_request: bool) -> DataSetFields | None:
    return None


def decode_json(
    text: bytes,
    fields_of: FieldsOf = _no_fields,
    action_fields_of: ActionFieldsOf = _no_action_fields,
    source: Source = UNKNOWN_SOURCE,
    layout: Layout | None = None,
    limits: Limits = DEFAULT_LIMITS,
) -> JsonDecoded:
    """Decode one JSON message; raises RemoteWireError and nothing else.

    Args:
        text: the message as it came.
        fields_of: tells the fields of a DataSetWriter; payloads of one for which it returns None stay text. It may be
            asked more than once for one message.
        action_fields_of: the same for Actions.
        source: what is known of the sender without the headers, from the topic for example.
        layout: which headers data has; without it they are told by what stands there.
        limits: what a message may have at most.
    """
    if layout is None and len(text) <= limits.elements:  # neither its bytes nor its elements can be too many
        known = decode_known_text(text, fields_of, source, limits)
        if known is not None:
            return known
    if layout is None and not text.startswith(BYTE_ORDER_MARK):
        tree = load(text, limits)
        if tree.__class__ is dict and tree.get("MessageType") == DATA:
            usual = decode_usual_message(tree, fields_of, source, limits)
            if usual is not None:
                learn_text(text)
                return usual
        reading = Reading()
        check_depth(text, tree, limits)
    else:
        reading = Reading()
        tree = parse(text, reading, limits)
    if tree.__class__ is dict and (layout is None or layout.network_header):
        kind = tree.get("MessageType")
        if kind in (REQUEST, RESPONSE) and not _is_data_set_message(tree):
            return decode_action(reading, tree, action_fields_of)
        if kind.__class__ is str and kind in ANNOUNCEMENTS:
            return decode_announcement(reading, tree)
        if kind.__class__ is str and layout is not None and kind != DATA:
            raise RemoteWireError(JsonCause.MESSAGE_TYPE, f"{shown(kind)}")
    return decode_data(reading, tree, fields_of, source, layout)


def _is_data_set_message(tree: dict[str, Any]) -> bool:
    return "Payload" in tree and "Messages" not in tree and "Message" not in tree
