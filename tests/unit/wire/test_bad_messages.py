"""What breaks the rules gets a cause. Every place in `wire/` that raises RemoteWireError is reached from here."""

from __future__ import annotations

import ast
import hmac
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import ua_fleet.wire
from tests.unit.wire.corpus import MINIMAL_METADATA, valid_messages
from tests.unit.wire.discovery_samples import GROUP, METHOD, TARGET
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import ExtensionObject, Matrix, NodeId, Variant
from ua_fleet.wire import (
    Cause,
    Codec,
    MessageKey,
    SecuredMessage,
    SecurityPolicy,
    decode_raw_fields,
    read_chunk,
    read_security,
)
from ua_fleet.wire.announcements import encode_announcement
from ua_fleet.wire.cursor import DEEPEST_NESTING, MOST_ELEMENTS
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ConnectionsAnnouncement,
    PubSubConnection,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FieldMetaData,
    FrameKind,
    PublisherIdType,
)
from ua_fleet.wire.metadata import MOST_DESCRIBED, SMALLEST_FIELD

HEAD = "f1 01 0200 01 0200 01 0900"
ACTION = "d1 81 20 0200 01 0900"
"""The header of an Action, up to its ActionFlags."""
"""Of a NetworkMessage with one DataSetMessage."""
ONE_FIELD = HEAD + "01 0100"
PROBE = "91 91 04 0700 00 00000000 00"
ANNOUNCEMENT = "91 91 08 0700 00 00000000 00"

WRITERS = WriterConfigurationAnnouncement(7, PublisherIdType.UINT16, 0, (1, 2), GROUP, (0, 0))
ACTIONS = ActionMetaDataAnnouncement(
    7, PublisherIdType.UINT16, 0, 1, (TARGET, TARGET), MINIMAL_METADATA, MINIMAL_METADATA, (METHOD, METHOD)
)
ADDRESS = ExtensionObject(NodeId(0, 21152), b"\xff\xff\xff\xff" * 2 + b"\7")
WITH_MORE_BYTES = ConnectionsAnnouncement(
    7, PublisherIdType.UINT16, 0, (PubSubConnection("c", True, Variant(5, 7), None, ADDRESS),)
)

TABLE: list[tuple[str, Cause, str]] = [
    ("nothing", Cause.TRUNCATED, ""),
    ("another version", Cause.UADP_VERSION, "f2 01 0200 01 0200 01 0900 01 0000"),
    ("version 0", Cause.UADP_VERSION, "00"),
    *[
        (f"PublisherId type {kind}", Cause.RESERVED_PUBLISHER_ID_TYPE, f"d1 0{kind} 0200 01 0900 01 0000")
        for kind in (5, 6, 7)
    ],
    ("ExtendedFlags2 bit 6", Cause.RESERVED_EXTENDED_FLAGS, "d1 81 40 0200 01 0900 01 0000"),
    ("ExtendedFlags2 bit 7", Cause.RESERVED_EXTENDED_FLAGS, "d1 81 80 0200 01 0900 01 0000"),
    *[
        (f"NetworkMessage type {kind}", Cause.RESERVED_MESSAGE_TYPE, f"d1 81 {kind << 2:02x} 0200 01 0900 01 0000")
        for kind in range(3, 8)
    ],
    *[
        (f"GroupFlags bit {bit}", Cause.RESERVED_GROUP_FLAGS, f"f1 01 0200 {1 << bit | 1:02x} 0200 01 0900 01 0000")
        for bit in range(4, 8)
    ],
    ("security flag", Cause.SECURED, "f1 11 0200 01 0200 01 0900 00 00000000 00 01 0100 01 01"),
    ("signed discovery", Cause.SECURED, "91 91 08 0700 01 01000000 00 01 0000"),
    ("chunk", Cause.CHUNK, "d1 81 01 0700 0900 0300 00000000 08000000 4142"),
    ("secured chunk", Cause.SECURED, "d1 91 01 0700 0900 00 00000000 00"),
    ("signed discovery chunk", Cause.SECURED, "91 91 09 0700 01 01000000 00 01 0000"),
    ("discovery chunk", Cause.CHUNK, "91 91 09 0700 00 00000000 00 0300 00000000 08000000 4142"),
    ("Action request without an ActionHeader", Cause.ACTION_HEADER_MISSING, HEAD + "81 05 0000"),
    ("Action response without an ActionHeader", Cause.ACTION_HEADER_MISSING, HEAD + "81 06 0000"),
    ("reserved ActionFlags", Cause.ACTION_FLAGS, ACTION + "20"),
    ("data behind an ActionHeader", Cause.ACTION_KIND, ACTION + "01 01 0000"),
    ("Action request that the header calls a response", Cause.ACTION_KIND, ACTION + "00 81 05 0100 0200 01 0000"),
    ("Action that is not valid", Cause.ACTION_KIND, ACTION + "01 80"),
    ("Action with RawData", Cause.ACTION_ENCODING, ACTION + "01 83 05 0100 0200 01 0000"),
    ("Action with DataValues", Cause.ACTION_ENCODING, ACTION + "01 85 05 0100 0200 01 0000"),
    ("ActionState 3", Cause.ACTION_STATE, ACTION + "01 81 05 0100 0200 03 0000"),
    ("RequestorId that is a UInt16", Cause.REQUESTOR_ID, ACTION + "09 05 0700"),
    ("RequestorId that is too long", Cause.REQUESTOR_ID, ACTION + "09 0c 00010000" + "61" * 256),
    ("CorrelationData that is too long", Cause.CORRELATION_DATA, ACTION + "05 01010000" + "00" * 257),
    ("TimeoutHint NaN", Cause.TIMEOUT_HINT, ACTION + "11 000000000000f87f"),
    ("TimeoutHint below 0", Cause.TIMEOUT_HINT, ACTION + "11 000000000000f0bf"),
    ("payload header with count 0", Cause.NO_DATA_SET_MESSAGE, "f1 01 0200 01 0200 00 01 0000"),
    (
        "promoted fields of two messages",
        Cause.PROMOTED_COUNT,
        "d1 81 02 0200 02 0900 0800 0200 01 01 0300 0300 01 0000 01 0000",
    ),
    ("promoted size inside a field", Cause.PROMOTED_SIZE, "d1 81 02 0200 01 0900 0100 01 01 01 0000"),
    ("encoding 3", Cause.RESERVED_FIELD_ENCODING, HEAD + "07 0000"),
    ("DataSetFlags2 bit 6", Cause.RESERVED_DATA_SET_FLAGS, HEAD + "81 40 0000"),
    ("DataSetFlags2 bit 7", Cause.RESERVED_DATA_SET_FLAGS, HEAD + "81 80 0000"),
    *[
        (f"DataSetMessage type {kind}", Cause.RESERVED_FRAME_KIND, HEAD + f"81 {kind:02x} 0000")
        for kind in (4, *range(7, 16))
    ],
    ("event as DataValues", Cause.EVENT_ENCODING, HEAD + "85 02 0100 01 01 01"),
    ("event as RawData", Cause.EVENT_ENCODING, HEAD + "83 02 01"),
    ("index used twice", Cause.REPEATED_FIELD_INDEX, HEAD + "81 01 0200 0100 01 01 0100 01 01"),
    ("too many fields", Cause.LENGTH_BEYOND_END, HEAD + "01 ffff 01 01"),
    ("too many delta fields", Cause.LENGTH_BEYOND_END, HEAD + "81 01 0200 0000 01 01"),
    ("bytes behind the fields", Cause.TRAILING_BYTES, ONE_FIELD + "01 01 07"),
    ("bytes behind a keep-alive", Cause.TRAILING_BYTES, HEAD + "81 03 07"),
    ("bytes behind the last message", Cause.TRAILING_BYTES, "d1 01 0200 02 0900 0800 0300 0300 01 0000 01 0000 07"),
    ("a size beyond the end", Cause.TRUNCATED, "d1 01 0200 02 0900 0800 0300 ffff 01 0000 01 0000"),
    ("a size of 0", Cause.TRUNCATED, "d1 01 0200 02 0900 0800 0000 0600 01 0000 01 0000"),
    ("unknown type", Cause.VARIANT_TYPE, ONE_FIELD + "20 00"),
    ("array of null", Cause.VARIANT_TYPE, ONE_FIELD + "80 00000000"),
    ("dimensions of null", Cause.VARIANT_TYPE, ONE_FIELD + "40"),
    ("Variant in a Variant", Cause.VARIANT_IN_VARIANT, ONE_FIELD + "18 01 01"),
    ("dimensions without an array", Cause.DIMENSIONS_WITHOUT_ARRAY, ONE_FIELD + "43 07"),
    ("dimensions that do not fit", Cause.ARRAY_DIMENSIONS, ONE_FIELD + "c3 02000000 0102 02000000 02000000 02000000"),
    ("negative dimensions", Cause.ARRAY_DIMENSIONS, ONE_FIELD + "c3 01000000 01 02000000 ffffffff ffffffff"),
    ("length below null", Cause.NEGATIVE_LENGTH, ONE_FIELD + "0c feffffff 61"),
    ("array length below null", Cause.NEGATIVE_LENGTH, ONE_FIELD + "83 00000080"),
    ("a String of 2 GB", Cause.LENGTH_BEYOND_END, ONE_FIELD + "0c ffffff7f 61"),
    ("an array of 2 G Variants", Cause.LENGTH_BEYOND_END, ONE_FIELD + "98 ffffff7f 00"),
    ("no UTF-8", Cause.INVALID_UTF8, ONE_FIELD + "0c 02000000 c328"),
    ("half of a character", Cause.INVALID_UTF8, ONE_FIELD + "0c 02000000 e6b0"),
    ("a surrogate", Cause.INVALID_UTF8, ONE_FIELD + "0c 03000000 eda080"),
    ("NodeId encoding 6", Cause.NODE_ID_ENCODING, ONE_FIELD + "11 06 00"),
    ("NodeId with the flags of an ExpandedNodeId", Cause.NODE_ID_ENCODING, ONE_FIELD + "11 80 05 ffffffff"),
    ("ExtensionObject encoding 3", Cause.EXTENSION_OBJECT_ENCODING, ONE_FIELD + "16 00 05 03"),
    ("LocalizedText mask", Cause.RESERVED_MASK_BITS, ONE_FIELD + "15 04"),
    ("DataValue mask", Cause.RESERVED_MASK_BITS, ONE_FIELD + "17 40"),
    ("DiagnosticInfo mask", Cause.RESERVED_MASK_BITS, ONE_FIELD + "19 80"),
    ("Variants nested 100 deep", Cause.TOO_DEEP, ONE_FIELD + "98 01000000" * 100 + "01 01"),
    ("DataValues nested 100 deep", Cause.TOO_DEEP, ONE_FIELD + "17 01" * 100 + "01 01"),
    ("DiagnosticInfos nested 100 deep", Cause.TOO_DEEP, ONE_FIELD + "19" + "40" * 100 + "00"),
    ("probe with a group header", Cause.DISCOVERY_FLAGS, "b1 91 04 0700 01 0200 00 00000000 00 01 01"),
    ("probe with a payload header", Cause.DISCOVERY_FLAGS, "d1 91 04 0700 01 0100 00 00000000 00 01 01"),
    ("probe without a PublisherId", Cause.DISCOVERY_FLAGS, "81 91 04 00 00000000 00 01 01"),
    ("probe with a timestamp", Cause.DISCOVERY_FLAGS, "91 b1 04 0700 0000000000000000 00 00000000 00 01 01"),
    ("announcement with promoted fields", Cause.DISCOVERY_FLAGS, "91 91 0a 0700 0000 00 00000000 00 01 0000"),
    ("a probe of type 0", Cause.PROBE_TYPE, PROBE + "00"),
    ("a probe of type 3", Cause.PROBE_TYPE, PROBE + "03"),
    ("information of type 0", Cause.PROBE_TYPE, PROBE + "01 00"),
    ("information of type 6", Cause.PROBE_TYPE, PROBE + "01 06"),
    ("bytes behind a probe", Cause.TRAILING_BYTES, PROBE + "01 02 00000000 07"),
    ("a probe for too many writers", Cause.LENGTH_BEYOND_END, PROBE + "01 02 ffffff7f"),
    ("announcement of type 0", Cause.ANNOUNCEMENT_TYPE, ANNOUNCEMENT + "00 0000"),
    ("announcement of type 8", Cause.ANNOUNCEMENT_TYPE, ANNOUNCEMENT + "08 0000"),
    (
        "more namespaces than there can be",
        Cause.TOO_MANY,
        ANNOUNCEMENT
        + "02 0000 0900"
        + (MOST_ELEMENTS + 1).to_bytes(4, "little").hex()
        + "ff" * 4 * (MOST_ELEMENTS + 1),
    ),
    (
        "metadata of more fields than there can be",
        Cause.TOO_MANY,
        ANNOUNCEMENT
        + "02 0000 0900"
        + "ffffffff" * 5
        + "00"
        + (MOST_DESCRIBED + 1).to_bytes(4, "little").hex()
        + "00" * SMALLEST_FIELD * (MOST_DESCRIBED + 1),
    ),
    ("a StatusCode too few", Cause.ANNOUNCEMENT_COUNTS, encode_announcement(WRITERS._replace(statuses=(0,))).hex()),
    ("a Method too few", Cause.ANNOUNCEMENT_COUNTS, encode_announcement(ACTIONS._replace(methods=(METHOD,))).hex()),
    ("bytes behind a structure", Cause.TRAILING_BYTES, encode_announcement(WITH_MORE_BYTES).hex()),
    (
        "metadata with 2 G fields",
        Cause.LENGTH_BEYOND_END,
        ANNOUNCEMENT + "02 0000 0900" + "00" * 16 + "00000000 00 ffffff7f",
    ),
]


def metadata(*fields: FieldMetaData) -> DataSetMetaData:
    return DataSetMetaData("raw", fields, ConfigurationVersion(1, 1))


RAW = DataSetMessage(1, encoding=FieldEncoding.RAW_DATA)
TWO_BYTES = FieldMetaData("f", 12, max_string_length=2)
MATRIX = FieldMetaData("f", 3, value_rank=2, array_dimensions=(2, 2))

RAW_TABLE: list[tuple[Cause, FieldMetaData, str]] = [
    (Cause.RAW_TYPE, FieldMetaData("f", 17), "00 05"),
    (Cause.RAW_RANK, FieldMetaData("f", 3, value_rank=-2), "05"),
    (Cause.RAW_TOO_LONG, TWO_BYTES, "03000000 616263"),
    (Cause.RAW_TOO_LONG, MATRIX, "02000000 03000000 01000000 010203"),
    (Cause.RAW_PADDING, TWO_BYTES, "01000000 6107"),
    (Cause.ARRAY_DIMENSIONS, MATRIX, "03000000 01000000 01000000 01000000 07"),
]


SECURED = "f1 11 0200 01 0200 01 0900"
"""Of a NetworkMessage with one DataSetMessage, up to the SecurityHeader."""
NONCE = "08 0102030405060708"
SIGNATURE = "00" * 32
CHUNK = "d1 81 01 0700 0900"


def signed(encoded: str) -> str:
    return encoded + hmac.digest(bytes(32), bytes.fromhex(encoded), "sha256").hex()


def unprotect(datagram: bytes) -> object:
    return MessageKey(SecurityPolicy.AES128_CTR, bytes(52)).unprotect(read_security(datagram))


OPENING_TABLE: list[tuple[str, Cause, Callable[[bytes], object], str]] = [
    ("no count of writers", Cause.NO_DATA_SET_MESSAGE, read_security, "f1 11 0200 01 0200 00"),
    *[
        (f"SecurityFlags {flags:02x}", Cause.SECURITY_FLAGS, read_security, f"{SECURED} {flags:02x} 01000000 {NONCE}")
        for flags in (0x02, 0x04, 0x08, 0x06, 0x11, 0x23, 0x41, 0x81, 0x10, 0x80)
    ],
    *[
        (f"nonce of {size}", Cause.NONCE_LENGTH, read_security, f"{SECURED} {flags} 01000000 {size:02x}" + "07" * 300)
        for flags, size in (("03", 0), ("03", 7), ("03", 9), ("03", 255), ("01", 7), ("01", 255))
    ],
    ("a nonce that is not there", Cause.TRUNCATED, read_security, SECURED + "03 01000000 ff 00"),
    ("half a signature", Cause.TRUNCATED, read_security, SECURED + "01 01000000 00" + SIGNATURE[2:]),
    ("a footer of 65,535", Cause.SECURITY_FOOTER, read_security, SECURED + "05 01000000 00 ffff" + SIGNATURE),
    (
        "a footer too large by one",
        Cause.SECURITY_FOOTER,
        read_security,
        SECURED + "05 00000000 00 0300 0102" + SIGNATURE,
    ),
    ("promoted fields beyond the end", Cause.TRUNCATED, read_security, "91 91 02 0700 ffff 00"),
    ("another signature", Cause.SIGNATURE, unprotect, SECURED + "01 01000000" + NONCE + SIGNATURE),
    ("no signature", Cause.SIGNATURE, unprotect, HEAD + "01 0000"),
    ("a signature without a SecurityHeader", Cause.SIGNATURE, unprotect, signed(HEAD + "01 0000")),
    ("a secured chunk", Cause.SECURED, read_chunk, "d1 91 01 0700 0900 00 00000000 00" + SIGNATURE),
    ("a secured discovery chunk", Cause.SECURED, read_chunk, "91 91 09 0700 01 01000000 08" + SIGNATURE),
    ("half a chunk's fields", Cause.TRUNCATED, read_chunk, CHUNK + "0300 00000000 080000"),
    ("a chunk of nothing", Cause.CHUNK_EMPTY, read_chunk, CHUNK + "0300 00000000 00000000 00000000"),
    ("a chunk without data", Cause.CHUNK_EMPTY, read_chunk, CHUNK + "0300 05000000 08000000 ffffffff"),
    ("a chunk beyond the end", Cause.CHUNK_RANGE, read_chunk, CHUNK + "0300 07000000 08000000 02000000 0102"),
    ("a chunk of less than it says", Cause.TRUNCATED, read_chunk, CHUNK + "0300 00000000 08000000 03000000 0102"),
    ("a chunk of more than it says", Cause.TRAILING_BYTES, read_chunk, CHUNK + "0300 00000000 08000000 01000000 0102"),
    ("a chunk at the end of 4 GiB", Cause.CHUNK_RANGE, read_chunk, CHUNK + "0300 ffffffff ffffffff 01000000 01"),
    ("a chunk of a total of 0", Cause.CHUNK_RANGE, read_chunk, CHUNK + "0300 00000000 00000000 01000000 01"),
]
"""What is refused before there is a message to decode."""


def decode(encoded: str) -> object:
    return Codec().decode(bytes.fromhex(encoded))


@pytest.mark.parametrize(("cause", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in TABLE])
def test_cause(cause: Cause, encoded: str) -> None:
    with pytest.raises(RemoteWireError) as caught:
        decode(encoded)
    assert caught.value.cause == cause
    assert isinstance(caught.value, SecuredMessage) == (cause == Cause.SECURED)
    assert str(caught.value).startswith(cause)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("cause", "opened", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in OPENING_TABLE])
def test_cause_of_what_is_not_opened(cause: Cause, opened: Callable[[bytes], object], encoded: str) -> None:
    with pytest.raises(RemoteWireError) as caught:
        opened(bytes.fromhex(encoded))
    assert caught.value.cause == cause
    assert "\n" not in str(caught.value)


def test_nesting_up_to_the_limit_is_read() -> None:
    decode(ONE_FIELD + "98 01000000" * DEEPEST_NESTING + "01 01")


def test_a_frame_that_is_not_valid_is_not_looked_into() -> None:
    decode(HEAD + "86 ff ff")


def _all_bad() -> Iterator[Callable[[], object]]:
    for _, _, encoded in TABLE:
        yield partial(decode, encoded)
    for _, _, opened, encoded in OPENING_TABLE:
        yield partial(opened, bytes.fromhex(encoded))
    for data in valid_messages():
        for size in range(0, len(data), 3):
            yield partial(Codec().decode, data[:size])
    for _, of, encoded in RAW_TABLE:
        yield partial(decode_raw_fields, RAW._replace(raw=bytes.fromhex(encoded)), metadata(of))
    delta = RAW._replace(kind=FrameKind.DELTA, raw=bytes.fromhex("0100 0500"))
    yield partial(decode_raw_fields, delta, metadata(TWO_BYTES))


def _places() -> set[tuple[str, int, int]]:
    """Every statement of the package that raises a RemoteWireError: file, first and last line."""
    return {
        (str(path), node.lineno, node.end_lineno or node.lineno)
        for path in Path(ua_fleet.wire.__file__).parent.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise)
        and isinstance(node.exc, ast.Call)
        and ast.unparse(node.exc.func) in ("RemoteWireError", "SecuredMessage")
    }


RAISED_WHERE_CHUNKS_ARE_PUT_TOGETHER = {Cause.CHUNK_CONTRADICTS, Cause.CHUNK_OVERLAPS, Cause.CHUNK_TOO_LARGE}
"""By `ua_fleet.pubsub.security`, whose tests reach them."""


def test_every_place_that_raises_is_reached() -> None:
    places = _places()
    assert len(places) > 30
    files = {path for path, _, _ in places}
    lines: set[tuple[str, int]] = set()
    causes: set[str] = set()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if frame.f_code.co_filename not in files:
            return None
        if event == "line":
            lines.add((frame.f_code.co_filename, frame.f_lineno))
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        for bad in _all_bad():
            try:
                bad()
            except RemoteWireError as error:
                causes.add(error.cause)
    finally:
        sys.settrace(before)
    missed = {
        (Path(path).name, first)
        for path, first, last in places
        if not any((path, line) in lines for line in range(first, last + 1))
    }
    assert not missed
    assert causes == set(Cause) - RAISED_WHERE_CHUNKS_ARE_PUT_TOGETHER


def test_announced_sizes_allocate_nothing() -> None:
    """A matrix of 2**31 elements of nothing is as good as none."""
    field = FieldMetaData("f", 3, value_rank=2)
    decoded = decode_raw_fields(RAW._replace(raw=bytes.fromhex("02000000 ffffff7f 00000000")), metadata(field))
    assert decoded.values == (Matrix((), (0x7FFF_FFFF, 0)),)
