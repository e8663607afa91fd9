"""Fields as bytes, however TCP merges and splits them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_bridges.tcp.config import Framing, InterpreterLink
from ua_bridges.tcp.framing import FieldReader, FieldWriter, FramingBroken

from ua_fleet.errors import SkillRejected


def link(framing: Framing, **more: object) -> InterpreterLink:
    return InterpreterLink.model_validate({"connect": "127.0.0.1:1", "framing": framing, "length": 20, **more})


FIELDS = st.lists(st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=20), max_size=10)


@given(fields=FIELDS, cuts=st.lists(st.integers(1, 30), max_size=40))
@pytest.mark.parametrize("framing", [Framing.TERMINATOR, Framing.LENGTH])
def test_fields_arrive_as_they_were_sent(framing: Framing, fields: list[str], cuts: list[int]) -> None:
    writer, reader = FieldWriter(link(framing)), FieldReader(link(framing))
    data = b"".join(writer.encode(field) for field in fields)
    if fields:
        assert b"".join(writer.encode_all(fields)) == data
    read: list[str] = []
    for cut in cuts:
        read += reader.feed(data[:cut])
        data = data[cut:]
    read += reader.feed(data)
    assert read == fields
    assert not reader.is_within


def test_bytes_of_each_framing() -> None:
    assert FieldWriter(link(Framing.TERMINATOR, terminator="\r\n")).encode("ab") == b"ab\r\n"
    assert FieldWriter(link(Framing.LENGTH, length=8)).encode("ab") == b"ab      "
    assert FieldWriter(link(Framing.ACKNOWLEDGED)).encode("ab") == b"ab"
    assert FieldWriter(link(Framing.ACKNOWLEDGED)).encode("") == b" "


@pytest.mark.parametrize(
    ("framing", "field", "reason"),
    [
        (Framing.TERMINATOR, "a\nb", "control characters"),
        (Framing.TERMINATOR, "a;b", "ends a field"),
        (Framing.LENGTH, "x" * 21, "21 bytes"),
        (Framing.ACKNOWLEDGED, "x" * 300, "300 bytes"),
        (Framing.ACKNOWLEDGED, "\x00", "control characters"),
        (Framing.TERMINATOR, "Grüße", "cannot be written in ascii"),
    ],
)
def test_a_field_that_cannot_be_sent_is_refused(framing: Framing, field: str, reason: str) -> None:
    writer = FieldWriter(link(framing, terminator=";"))
    with pytest.raises(SkillRejected, match=reason):
        writer.encode(field)
    with pytest.raises(SkillRejected, match=reason):
        writer.encode_all(["a", field])


@pytest.mark.parametrize(
    ("framing", "data", "reason"),
    [
        (Framing.TERMINATOR, b"x" * 300, "more than 255 bytes"),
        (Framing.TERMINATOR, b"x" * 300 + b"\n", "more than 255 bytes"),
        (Framing.TERMINATOR, b"\xff\n", "not ascii"),
        (Framing.TERMINATOR, b"a\x07b\n", "control characters"),
        (Framing.LENGTH, b"\x00" * 20, "control characters"),
    ],
)
def test_rubbish_breaks_the_connection(framing: Framing, data: bytes, reason: str) -> None:
    with pytest.raises(FramingBroken, match=reason):
        FieldReader(link(framing)).feed(data)


@given(data=st.binary(max_size=2000))
@pytest.mark.parametrize("framing", list(Framing))
def test_any_bytes_are_fields_or_broken(framing: Framing, data: bytes) -> None:
    reader = FieldReader(link(framing))
    try:
        fields = reader.feed(data)
    except FramingBroken:
        return
    assert all(field.isprintable() for field in fields if field)
