"""SkillStatus: what is shown of the last executions, and the packing of values."""

from __future__ import annotations

import pytest

from ua_fleet.errors import LocalWireError
from ua_fleet.skill import ExecutionState, pack, unpack
from ua_fleet.skill.status import (
    MOST_SHOWN,
    SKILL_STATUS_FIELDS,
    ExecutionStatus,
    SkillStatus,
    read_result,
    read_status,
    result_text,
)
from ua_fleet.values import ARRAY, BuiltinType, StatusCode, Variant
from ua_fleet.wire.variant import encode_typed


def test_an_end_is_not_overwritten_by_the_next_start() -> None:
    status = SkillStatus()
    assert status.fields()[1] == ((),) * 7
    for number in range(MOST_SHOWN + 2):
        assert status.show(ExecutionStatus(bytes([number]), "move", ExecutionState.RUNNING))
    done = ExecutionStatus(bytes([3]), "move", ExecutionState.DONE, 1.0, result_text({"x": 1.5}), "there")
    assert status.show(done)
    assert not status.show(done)
    assert status.get(bytes([3])) == done
    assert status.get(bytes([1])) is None
    types, values = status.fields()
    ids, skills, states, progress, results, messages, statuses = values
    assert ids == tuple([bytes([number]) for number in range(2, MOST_SHOWN + 2)])
    assert set(skills) == {"move"}
    assert states[:3] == (2, 3, 2)
    assert (progress[1], results[1], messages[1]) == (1.0, '{"x":1.5}', "there")
    assert statuses == (), "what is Good at the end is left out"
    assert types == tuple([field.builtin_type | ARRAY for field in SKILL_STATUS_FIELDS])
    for code, value in zip(types, values, strict=True):
        encode_typed(bytearray(), code, value)


def test_results_as_text() -> None:
    assert read_result(result_text({"x": 1, "name": "ü"})) == {"x": 1, "name": "ü"}
    assert result_text({}) == ""
    for text in ("", "[1]", "{", "1", "[" * 50_000):
        assert read_result(text) == {}


def test_packed_values() -> None:
    types = (BuiltinType.INT32, BuiltinType.STRING | ARRAY, BuiltinType.NULL)
    values = (1, ("a", None), None)
    assert unpack(pack(types, values)) == tuple(Variant(*part) for part in zip(types, values, strict=True))
    assert unpack(b"") == ()
    with pytest.raises(LocalWireError):
        pack((BuiltinType.INT32,), ("x",))


def test_what_was_shown_is_read() -> None:
    status = SkillStatus()
    shown = [
        ExecutionStatus(b"a", "move", ExecutionState.DONE, 1.0, result_text({"x": 1.5}), "there"),
        ExecutionStatus(b"b", "turn", ExecutionState.FAILED, 0.5, "", "slipped", int(StatusCode.BAD_TIMEOUT)),
        ExecutionStatus(b"c", "turn", ExecutionState.RUNNING, 0.5),
    ]
    for one in shown:
        status.show(one)
    values = status.fields()[1]
    assert list(read_status(SKILL_STATUS_FIELDS, values)) == shown
    assert values[-1] == (0, StatusCode.BAD_TIMEOUT)
    before = [one._replace(status=0) for one in shown]
    assert list(read_status(SKILL_STATUS_FIELDS[:-1], values[:-1])) == before, "of a bridge that does not tell it"


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("ExecutionId", (4_000_000_000,)),
        ("ExecutionId", ("a",)),
        ("ExecutionId", b"a"),
        ("ExecutionId", None),
        ("Skill", (1,)),
        ("State", (99,)),
        ("State", ("DONE",)),
        ("State", ((3,),)),
        ("Progress", ("half",)),
        ("Result", (1,)),
        ("Message", (b"x",)),
        ("Message", "x"),
    ],
)
def test_a_row_that_is_no_execution_is_left_out(column: str, value: object) -> None:
    names = [field.name for field in SKILL_STATUS_FIELDS]
    values: list[object] = [(b"a",), ("move",), (3,), (1.0,), ("",), (None,)]
    assert len(list(read_status(SKILL_STATUS_FIELDS, values))) == 1
    values[names.index(column)] = value
    assert list(read_status(SKILL_STATUS_FIELDS, values)) == []
    assert list(read_status(SKILL_STATUS_FIELDS[:3], values)) == []
