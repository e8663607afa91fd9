"""How deep values nest is looked at in each way of reading a key frame, also in members that nobody reads."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.wire.json.samples import METADATA
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.json import DataSetFields, decode_json
from ua_fleet.wire.messages import FieldMetaData

TYPES = [kind for kind in BuiltinType if 1 <= kind <= 25]
ITEMS = [
    "{deep}",
    '{{"Text":"x","a":{deep}}}',
    '{{"Locale":"en","Text":"x","a":{deep}}}',
    '{{"Code":5,"a":{deep}}}',
    '{{"Code":5,"Symbol":{deep}}}',
    '{{"Name":"x","a":{deep}}}',
    '{{"Id":5,"a":{deep}}}',
    '{{"UaTypeId":"i=5","a":{deep}}}',
    '{{"Value":1,"a":{deep}}}',
]


def nested(levels: int) -> str:
    return '{"a":' * levels + "1" + "}" * levels


def read(fields: DataSetFields, item: str, headers: str = "") -> Any:
    """The values and what was forgiven; or why it is refused."""
    version = fields.metadata.configuration_version
    headers = headers or f'"MetaDataVersion":{{"MajorVersion":{version.major},"MinorVersion":{version.minor}}}'
    text = (
        '{"MessageId":"m","MessageType":"ua-data","PublisherId":"p","Messages":[{"DataSetWriterId":3,'
        f'{headers},"MessageType":"ua-keyframe","Payload":{{"f":{item}}}}}]}}'
    )
    try:
        data: Any = decode_json(text.encode(), lambda _source: fields)
    except RemoteWireError as error:
        return str(error)
    [message] = data.message.messages
    return message.types, repr(message.values), message.status, dict(data.leniencies)


def both_ways(kind: int, rank: int = -1) -> tuple[DataSetFields, DataSetFields]:
    """Fields that are read by their plans, and without any."""
    planned, general = (
        DataSetFields(METADATA._replace(fields=(FieldMetaData("f", kind, value_rank=rank),))) for _ in range(2)
    )
    general.plans = ()
    return planned, general


@pytest.mark.parametrize("levels", [20, 60, 900])
@pytest.mark.parametrize("kind", TYPES)
def test_what_nests_too_deep_in_a_value_is_refused_whatever_its_type(kind: BuiltinType, levels: int) -> None:
    for rank in (-1, 1):
        planned, general = both_ways(kind, rank)
        for form in ITEMS:
            item = form.format(deep=nested(levels))
            for each in (item, f'{{"UaType":{int(kind)},"Value":{item}}}', f"[{item}]"):
                assert read(planned, each) == read(general, each), each[:60]


@pytest.mark.parametrize(
    "headers",
    [
        '"Status":{{"Code":5,"x":{deep}}}',
        '"Status":{{"Code":5,"Symbol":{deep}}}',
        '"Status":{{"Code":5,"Symbol":"Bad","x":{deep}}}',
        '"MetaDataVersion":{{"MajorVersion":MAJOR,"MinorVersion":MINOR,"x":{deep}}}',
    ],
)
def test_what_nests_too_deep_in_a_header_is_refused(headers: str) -> None:
    fields = both_ways(BuiltinType.DOUBLE)[0]
    version = fields.metadata.configuration_version
    headers = headers.replace("MAJOR", str(version.major)).replace("MINOR", str(version.minor))
    assert read(fields, "1.5", headers.format(deep=nested(3)))[1] == "(1.5,)"
    assert "json_depth" in read(fields, "1.5", headers.format(deep=nested(100)))
