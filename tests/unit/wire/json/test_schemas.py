"""Every kind of message against JSON schemas, which are made of the DataTypes of the specification (OPC 10000-6 G.2).

The schemas of the OPC Foundation are generated from the DataTypes: an object for each structure with its members and no
others, `integer` with the range of its type, `string` for Int64, DateTime, Guid, ByteString and NodeIds, objects for
StatusCode and LocalizedText. Here the same is made of the DataTypes as asyncua has them. The messages themselves are
DataTypes of OPC 10000-14 (JsonNetworkMessage and so on), where an array of ExtensionObject has to be filled in.
"""

from __future__ import annotations

import copy
import dataclasses
from enum import IntEnum, IntFlag
from typing import Any, Final

import orjson
import pytest
from asyncua import ua as typed_ua
from jsonschema import Draft202012Validator

from tests.unit.wire.json.samples import METADATA
from tests.unit.wire.json.test_fuzz import corpus
from ua_fleet.values import BuiltinType as B
from ua_fleet.wire.json.scalars import RANGES

ua: Any = typed_ua
Schema = dict[str, Any]

TEXT: Final = {"type": ["string", "null"]}
DATE: Final = {"type": "string", "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,7})?Z$"}
NODE_ID: Final = {"type": "string", "pattern": r"^(svr=\d+;|svu=[^;]+;)?(ns=\d+;|nsu=[^;]+;)?[isgb]=.+$"}
BYTES: Final = {"type": ["string", "null"], "pattern": r"^([A-Za-z0-9+/]{4})*([A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?$"}
GUID: Final = {"type": "string", "pattern": r"^[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}$"}
NUMBER: Final = {"anyOf": [{"type": "number"}, {"enum": ["NaN", "Infinity", "-Infinity"]}]}
STATUS: Final[Schema] = {
    "type": "object",
    "properties": {"Code": {"type": "integer", "minimum": 0, "maximum": 0xFFFF_FFFF}, "Symbol": {"type": "string"}},
    "additionalProperties": False,
}
LOCALIZED_TEXT: Final[Schema] = {
    "type": "object",
    "properties": {"Locale": {"type": "string"}, "Text": {"type": "string"}},
    "additionalProperties": False,
}
VARIANT: Final[Schema] = {
    "type": ["object", "null"],
    "properties": {
        "UaType": {"type": "integer", "minimum": 0, "maximum": 25},
        "Value": {},
        "Dimensions": {"type": "array", "items": {"type": "integer", "minimum": 0}},
    },
    "additionalProperties": False,
}


def integer(kind: int) -> Schema:
    low, high = RANGES[kind]
    if kind in (B.INT64, B.UINT64):
        return {"type": "string", "pattern": r"^-?\d{1,20}$"}
    return {"type": "integer", "minimum": low, "maximum": high}


BUILT_IN: dict[int, Schema] = {
    B.BOOLEAN: {"type": "boolean"},
    **{kind: integer(kind) for kind in RANGES},
    B.FLOAT: NUMBER,
    B.DOUBLE: NUMBER,
    B.STRING: TEXT,
    B.DATETIME: DATE,
    B.GUID: GUID,
    B.BYTE_STRING: BYTES,
    B.XML_ELEMENT: TEXT,
    B.NODE_ID: NODE_ID,
    B.EXPANDED_NODE_ID: NODE_ID,
    B.STATUS_CODE: STATUS,
    B.QUALIFIED_NAME: {"type": "string"},
    B.LOCALIZED_TEXT: LOCALIZED_TEXT,
}
BY_NAME: dict[str, Schema] = {
    **{B(kind).name.replace("_", ""): schema for kind, schema in BUILT_IN.items()},
    "UTCTIME": DATE,
    "DURATION": NUMBER,
    "VERSIONTIME": integer(B.UINT32),
    "VARIANT": VARIANT,
    "BASEDATATYPE": VARIANT,
    "NUMBER": VARIANT,
    "LOCALEID": TEXT,
    "CHARARRAY": TEXT,
    "APPLICATIONINSTANCECERTIFICATE": BYTES,
    "EXTENSIONOBJECT": {"type": ["object", "null"]},
}


def schema_of(annotation: str) -> Schema:
    """The schema of a member as asyncua annotates it: `ua.String`, `list[ua.KeyValuePair]`."""
    annotation = annotation.strip("'")
    if annotation.startswith("list["):
        return {"type": ["array", "null"], "items": schema_of(annotation[5:-1])}
    if annotation.startswith("type["):  # an abstract structure, in an ExtensionObject
        return BY_NAME["EXTENSIONOBJECT"]
    if annotation.startswith("Optional["):
        return schema_of(annotation[9:-1])
    name = annotation.removeprefix("ua.")
    known = BY_NAME.get(name.upper())
    if known is not None:
        return known
    data_type = getattr(ua, name)
    if issubclass(data_type, IntFlag):
        return {"type": "integer", "minimum": 0}
    if issubclass(data_type, IntEnum):
        return {"enum": [member.value for member in data_type]}
    if dataclasses.is_dataclass(data_type):
        return structure(name)
    raise AssertionError(annotation)


def structure(name: str, **members: Schema) -> Schema:
    """The schema of a structure; `members` says what stands in its ExtensionObjects."""
    properties = {
        field.name: members.get(field.name) or schema_of(str(field.type))
        for field in dataclasses.fields(getattr(ua, name))
        if field.name not in ("Encoding", "data_type")
    }
    return {"type": "object", "properties": properties, "additionalProperties": False}


def messages(name: str, **members: Schema) -> Schema:
    return {"type": "array", "minItems": 1, "items": structure(name, **members)}


SCHEMAS: dict[str, Schema] = {
    "ua-data": structure("JsonNetworkMessage", Messages=messages("JsonDataSetMessage", Payload={"type": "object"})),
    "ua-metadata": structure("JsonDataSetMetaDataMessage"),
    "ua-status": structure("JsonStatusMessage"),
    "ua-application": structure("JsonApplicationDescriptionMessage"),
    "ua-endpoints": structure("JsonServerEndpointsMessage"),
    "ua-connection": structure("JsonPubSubConnectionMessage"),
    "ua-action-metadata": structure("JsonActionMetaDataMessage"),
    "ua-action-responder": structure("JsonActionResponderMessage"),
    "ua-action-request": structure(
        "JsonActionNetworkMessage", Messages=messages("JsonActionRequestMessage", Payload={"type": "object"})
    ),
    "ua-action-response": structure(
        "JsonActionNetworkMessage", Messages=messages("JsonActionResponseMessage", Payload={"type": "object"})
    ),
}
MANDATORY: Final = {
    "ua-data": ("Messages",),
    "ua-metadata": ("PublisherId", "DataSetWriterId", "MetaData"),
    "ua-status": ("PublisherId", "IsCyclic", "Status"),
    "ua-application": ("PublisherId", "Timestamp", "Description"),
    "ua-endpoints": ("PublisherId", "Timestamp", "Endpoints"),
    "ua-connection": ("PublisherId", "Timestamp", "Connection"),
    "ua-action-metadata": ("PublisherId", "DataSetWriterId", "ActionTargets", "Request", "Response"),
    "ua-action-responder": ("PublisherId", "Timestamp", "Connection"),
    "ua-action-request": ("PublisherId", "Timestamp", "ResponseAddress", "Messages"),
    "ua-action-response": ("PublisherId", "Timestamp", "Messages"),
}
"""Besides MessageId and MessageType (OPC 10000-14 7.2.5.3, 7.2.5.5, 7.2.5.6)."""
TREES: list[Any] = [tree for text in corpus() if "Messages" in (tree := orjson.loads(text)) or "MessageType" in tree]
NETWORK_MESSAGES = [tree for tree in TREES if tree.get("MessageType") in SCHEMAS]


def validator(kind: str) -> Any:
    schema = SCHEMAS[kind] | {"required": ["MessageId", "MessageType", *MANDATORY[kind]]}
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def test_there_is_a_message_of_each_kind() -> None:
    assert {tree["MessageType"] for tree in NETWORK_MESSAGES} == SCHEMAS.keys() == MANDATORY.keys()


@pytest.mark.parametrize("kind", SCHEMAS)
def test_messages_have_the_shape_of_their_data_types(kind: str) -> None:
    judge = validator(kind)
    for tree in NETWORK_MESSAGES:
        if tree["MessageType"] == kind:
            assert [f"{error.json_path}: {error.message}" for error in judge.iter_errors(tree)] == []


@pytest.mark.parametrize("kind", SCHEMAS)
def test_another_shape_is_noticed(kind: str) -> None:
    judge = validator(kind)
    tree = next(tree for tree in NETWORK_MESSAGES if tree["MessageType"] == kind)
    for member in tree:
        changed = copy.deepcopy(tree)
        changed[member] = {"Unknown": [1.5]}
        assert not judge.is_valid(changed), member
    assert not judge.is_valid(tree | {"Unknown": 1})
    assert not judge.is_valid({name: value for name, value in tree.items() if name != "MessageId"})


ODD = ("Nothing", "Failed")
"""Fields that have no value of their type."""


def test_fields_in_the_verbose_form_have_the_shape_of_their_types() -> None:
    """A field of a concrete type is what a member of a structure would be (OPC 10000-14 table 187)."""
    plain = {
        field.name: BUILT_IN[field.builtin_type]
        for field in METADATA.fields
        if field.builtin_type in BUILT_IN
        and field.value_rank == -1
        and field.data_type is None
        and field.name not in ODD
    }
    assert len(plain) >= len(BUILT_IN) - 2
    judges: dict[str, Any] = {name: Draft202012Validator(schema) for name, schema in plain.items()}
    seen = set[str]()
    for tree in NETWORK_MESSAGES:
        for message in tree["Messages"] if tree["MessageType"] == "ua-data" else ():
            for name, value in message.get("Payload", {}).items():
                if name in judges and not (value.__class__ is dict and "UaType" in value):
                    seen.add(name)
                    assert judges[name].is_valid(value), (name, value)
    assert seen == plain.keys()
