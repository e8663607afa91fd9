"""What docs/json.md says is what the code does."""

from __future__ import annotations

import ast
import inspect
import json
import math
import re
from enum import StrEnum
from pathlib import Path

import pytest

from ua_fleet.values import NodeId, QualifiedName
from ua_fleet.wire.descriptions import EnumerationDescription, EnumerationField
from ua_fleet.wire.json import DEFAULT_LIMITS, DataSetFields, Form, JsonCause, JsonWriterPlan, Leniency, Source
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData

PAGE = (Path(__file__).parents[4] / "docs" / "json.md").read_text()


@pytest.mark.parametrize("words", [JsonCause, Leniency])
def test_every_cause_and_leniency_has_its_row(words: type[StrEnum]) -> None:
    (definition,) = ast.parse(inspect.getsource(words)).body
    assert isinstance(definition, ast.ClassDef)
    for member, text in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(member, ast.Assign):
            assert isinstance(text, ast.Expr)
            assert isinstance(text.value, ast.Constant)
            assert isinstance(member.value, ast.Constant)
            assert f"| `{member.value.value!s}` | {' '.join(str(text.value.value).split())} |" in PAGE


def test_the_message_is_what_a_writer_writes() -> None:
    mode = EnumerationDescription(NodeId(1, 1), QualifiedName(1, "Mode"), (EnumerationField(2, "Driving"),))
    metadata = DataSetMetaData(
        "ua_2_2_1001",
        (
            FieldMetaData("speed", 11),
            FieldMetaData("odometer", 8),
            FieldMetaData("mode", 6, data_type=NodeId(1, 1)),
            FieldMetaData("ranges", 11, value_rank=1),
        ),
        ConfigurationVersion(826_000_001, 826_000_001),
        enumerations=(mode,),
    )
    plan = JsonWriterPlan(DataSetFields(metadata), Form.VERBOSE, source=Source("2", "fleet", 1001, "ua_2_2_1001"))
    values = (1.5, 2**53 + 1, 2, (0.5, math.inf, math.nan))
    text = plan.encode("32235546-05d9-4fd7-97df-000000000001", 7, 133_500_000_000_000_001, 0, values)
    shown = re.search(r"<!-- json: verbose -->\n```json\n(.*?)```", PAGE, re.DOTALL)
    assert shown is not None
    assert json.loads(text) == json.loads(shown[1])


def test_the_bounds_are_those_of_the_code() -> None:
    size, elements, depth = DEFAULT_LIMITS
    assert f"{size >> 20} MiB, {elements:,} commas and brackets, {depth} objects and arrays in each other" in PAGE
