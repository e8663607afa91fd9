"""Part 14 messages as JSON (OPC 10000-14 7.2.5, OPC 10000-6 5.4): pure, no I/O.

    fields = DataSetFields(metadata)                       # once for each version of a metadata
    decode_json(text, fields_of, ...)     -> JsonData | JsonAnnouncement | JsonAction
                                             or raises RemoteWireError(JsonCause), nothing else
    encode_data(json_data, [fields], form, layout)         -> bytes, or raises LocalWireError
    encode_announcement(json_announcement)                 -> bytes
    encode_action(json_action, [fields], form)             -> bytes
    decode_payload(reading, message, fields)               -> the DataSetMessage, once there is metadata for its `raw`

The messages in them are those of UADP (`ua_fleet.wire.messages`, `discovered`, `actions`), so that one encoding can be
made of the other. What a peer does wrong and is read all the same is counted in `leniencies`, by name.

A writer that sends one key frame after the other is faster with a plan, bound once:

    plan = JsonWriterPlan(fields, form, layout, source)
    plan.encode(message_id, sequence_number, timestamp, status, values)     -> bytes
"""

from ua_fleet.wire.json.actions import ActionFieldsOf, JsonAction, encode_action
from ua_fleet.wire.json.announcements import JsonAnnouncement, encode_announcement
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.codec import JsonDecoded, decode_json
from ua_fleet.wire.json.data_messages import (
    DATA_SET_MESSAGE,
    MINIMAL,
    NETWORK_MESSAGE,
    FieldsOf,
    JsonData,
    Layout,
    Source,
    encode_data,
)
from ua_fleet.wire.json.data_sets import JSON_PAYLOAD, DataSetFields, decode_payload
from ua_fleet.wire.json.fields import Form
from ua_fleet.wire.json.headers import publisher_id_number
from ua_fleet.wire.json.parsing import DEFAULT_LIMITS, Limits, Reading
from ua_fleet.wire.json.structures import JsonBody
from ua_fleet.wire.json.writer_plan import JsonWriterPlan

__all__ = [
    "DATA_SET_MESSAGE",
    "DEFAULT_LIMITS",
    "JSON_PAYLOAD",
    "MINIMAL",
    "NETWORK_MESSAGE",
    "ActionFieldsOf",
    "DataSetFields",
    "FieldsOf",
    "Form",
    "JsonAction",
    "JsonAnnouncement",
    "JsonBody",
    "JsonCause",
    "JsonData",
    "JsonDecoded",
    "JsonWriterPlan",
    "Layout",
    "Leniency",
    "Limits",
    "Reading",
    "Source",
    "decode_json",
    "decode_payload",
    "encode_action",
    "encode_announcement",
    "encode_data",
    "publisher_id_number",
]
