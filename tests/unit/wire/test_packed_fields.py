from __future__ import annotations

from typing import Any, Final

import pytest

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, Matrix, Variant
from ua_fleet.wire.actions import ActionMessage, ActionState, encode_action
from ua_fleet.wire.generic import decode_message
from ua_fleet.wire.packed_fields import PackedFields, pack_fields, unpack_fields

B = BuiltinType
CONTENT: Final = bytes.fromhex("06 2a000000 0c 02000000 6869")
"""An Int32 of 42, and the String "hi" (OPC 10000-6 5.2.2.16)."""
TYPES: Final = (int(B.INT32), int(B.STRING))
KEPT: Final[dict[str, tuple[int, Any]]] = {
    "number": (B.DOUBLE, 0.5),
    "text": (B.STRING, "hi"),
    "null text": (B.STRING, None),
    "bytes": (B.BYTE_STRING, b"\0\1"),
    "time": (B.DATETIME, 1),
    "numbers": (B.FLOAT | ARRAY, (1.0, 2.0)),
    "texts": (B.STRING | ARRAY, ("a", None)),
    "null array": (B.INT32 | ARRAY, None),
}
OTHERS: Final[dict[str, tuple[int, Any]]] = {
    "matrix": (B.INT32 | ARRAY | DIMENSIONS, Matrix((1, 2, 3, 4), (2, 2))),
    "nested": (B.VARIANT | ARRAY, (Variant(B.INT32, 1),)),
}


def request(types: tuple[int, ...], values: tuple[Any, ...]) -> ActionMessage:
    return ActionMessage(2, 2, 1400, 1, 1, ActionState.EXECUTING, is_request=True, types=types, values=values)


def decoded(datagram: bytes) -> ActionMessage:
    message = decode_message(datagram)
    assert isinstance(message, ActionMessage)
    return message


def test_fields_are_the_bytes_of_variants_one_after_the_other() -> None:
    fields = pack_fields(TYPES, (42, "hi"))
    assert (fields, fields.types, fields.content) == ((42, "hi"), TYPES, CONTENT)
    read = unpack_fields(CONTENT)
    assert (read, read.types, read.content) == ((42, "hi"), TYPES, CONTENT)
    assert unpack_fields(b"") == ()


def test_what_is_packed_is_not_packed_again_unless_its_types_are_others() -> None:
    fields = pack_fields((int(B.INT32),), (42,))
    assert pack_fields((int(B.INT32),), fields) is fields
    assert pack_fields((int(B.INT16),), fields).content == bytes.fromhex("04 2a00")
    with pytest.raises(LocalWireError):
        pack_fields((int(B.BYTE),), pack_fields((int(B.INT32),), (300,)))


def test_bytes_that_are_no_variants_are_refused() -> None:
    with pytest.raises(RemoteWireError):
        unpack_fields(CONTENT[:-1])


def test_a_message_has_the_bytes_that_its_fields_have_already() -> None:
    marked = PackedFields((int(B.INT32),), (42,), bytes.fromhex("06 2b000000"))
    assert decoded(encode_action(request(marked.types, marked))).values == (43,), "its bytes, and not its values"
    # With other types the bytes are not these.
    assert decoded(encode_action(request((int(B.INT16),), marked))).values == (42,)


@pytest.mark.parametrize("which", KEPT)
def test_decoded_fields_keep_their_bytes(which: str) -> None:
    code, value = KEPT[which]
    datagram = encode_action(request((int(code),), (value,)))
    fields = decoded(datagram).values
    assert isinstance(fields, PackedFields)
    assert (fields, fields.types) == ((value,), (code,))
    assert datagram.endswith(fields.content)
    assert fields.content == pack_fields((int(code),), (value,)).content


@pytest.mark.parametrize("which", OTHERS)
def test_what_may_have_other_bytes_than_ours_does_not(which: str) -> None:
    code, value = OTHERS[which]
    fields = decoded(encode_action(request((int(code),), (value,)))).values
    assert fields == (value,)
    assert not isinstance(fields, PackedFields)


def test_a_reserved_type_has_no_bytes_of_ours() -> None:
    datagram = bytearray(encode_action(request((int(B.BYTE_STRING),), (b"x",))))
    datagram[-6] = 27
    fields = decoded(bytes(datagram)).values
    assert fields == (b"x",)
    assert not isinstance(fields, PackedFields)
