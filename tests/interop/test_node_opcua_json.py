"""Values as JSON beside node-opcua-json: it writes them in its four schemes, and reads ours."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.interop.node import environment, node
from tests.unit.wire.json.vectors import GUID
from ua_fleet.values import DataValue, LocalizedText, Matrix, NodeId, QualifiedName, Variant
from ua_fleet.wire.json.data_types import DataTypes
from ua_fleet.wire.json.fields import decode_field, planned_fields
from ua_fleet.wire.json.parsing import Reading
from ua_fleet.wire.json.variants import Writing, decode_data_value, decode_variant, encode_variant
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData

NAMESPACES = ("urn:fleet",)
SCRIPT = Path(__file__).parent / "json_values.mjs"
NOON = 133_500_000_000_000_000

VALUES: dict[str, Variant] = {
    "Boolean": Variant(1, True),
    "SByte": Variant(2, -2),
    "Byte": Variant(3, 3),
    "Int16": Variant(4, -4),
    "UInt16": Variant(5, 5),
    "Int32": Variant(6, -6),
    "UInt32": Variant(7, 7),
    "Int64": Variant(8, -(2**63)),
    "UInt64": Variant(9, 2**64 - 1),
    "Float": Variant(10, 0.5),
    "Double": Variant(11, -0.1),
    "Zero": Variant(11, 0.0),
    "String": Variant(12, "水Boy"),
    "DateTime": Variant(13, NOON + 1_230_000),
    "Guid": Variant(14, GUID),
    "ByteString": Variant(15, b"\0\xff"),
    "NodeId": Variant(17, NodeId(1, "robot")),
    "StatusCode": Variant(19, 0x8031_0000),
    "QualifiedName": Variant(20, QualifiedName(1, "Speed")),
    "LocalizedText": Variant(21, LocalizedText("text", "en")),
    "Doubles": Variant(0x8B, (1.5, 2.5)),
    "Texts": Variant(0x8C, ("a", "b")),
    "Matrix": Variant(0xC6, Matrix((1, 2, 3, 4, 5, 6), (2, 3))),
}


def run(ours: list[Any]) -> dict[str, Any]:
    done = subprocess.run(
        [node(), str(SCRIPT)],
        input=json.dumps(ours),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=environment(),
    )
    assert done.returncode == 0, done.stderr
    report: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return report


@pytest.mark.needs("node")
def test_values_in_four_schemes_both_ways() -> None:
    ours = [encode_variant(Writing(NAMESPACES), variant) for variant in VALUES.values()]
    report = run(ours)

    for name, variant in VALUES.items():
        texts = report["written"][name]
        for scheme in ("Compact", "Verbose", "DeprecatedReversible"):
            assert decode_variant(Reading(NAMESPACES), texts[scheme]) == variant, (name, scheme)
        rank = 2 if name == "Matrix" else 1 if variant.type & 0x80 else -1
        metadata = DataSetMetaData(
            "n", (FieldMetaData(name, variant.type & 0x3F, value_rank=rank),), ConfigurationVersion(1, 1)
        )
        (field,) = planned_fields(metadata, DataTypes(metadata))
        bare = decode_field(Reading(NAMESPACES), field, texts["DeprecatedNonReversible"])
        # That scheme has the text of a LocalizedText and not its locale.
        expected = Variant(21, LocalizedText("text")) if name == "LocalizedText" else variant
        assert bare[:2] == expected, name

    value = DataValue(Variant(11, 1.5), 0x4090_0000, NOON)
    texts = report["written"]["DataValue"]
    for scheme in ("Compact", "Verbose", "DeprecatedReversible"):
        assert decode_data_value(Reading(NAMESPACES), texts[scheme]) == value, scheme

    for (name, variant), text in zip(VALUES.items(), report["read"], strict=True):
        back = decode_variant(Reading(NAMESPACES), text)
        if name == "Matrix":  # it knows `UaDimensions` alone
            assert back == Variant(0x86, variant.value.values)
        else:
            assert back == variant, name
