"""Every field of every header at its limits: what comes out is a message or the typed error, in bounded memory."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from tests.unit.wire.everything import chunked_messages, plain_messages, secured_messages
from ua_fleet.dissect.annotate import annotate
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire import Cause, Codec, decode_raw_fields
from ua_fleet.wire.chunks import read_chunk
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData, NetworkMessage
from ua_fleet.wire.security import MessageKey, SecurityMode, SecurityPolicy, read_security

KEY = MessageKey(SecurityPolicy.AES128_CTR, bytes(range(52)))

MOST_BYTES_PER_BYTE = 256
"""What a byte of a message may cost: an array of empty DataValues makes the most of each."""
MOST_BYTES_AT_ALL = 128 * 1024
"""What any message may cost besides: a compiled plan, an error with its traceback."""

HEAD = "f101 0200 01 0200 01 0900"
ONE_FIELD = HEAD + "01 0100"
SECURED = "f111 0200 01 0200 01 0900"
CHUNK = "d1 81 01 0700 0900"
ACTION = "f181 20 0200 01 0200 01 0900"
PROBE = "91 91 04 0700 00 00000000 00"
ANNOUNCEMENT = "91 91 08 0700 00 00000000 00"


def take(datagram: bytes) -> object:
    """All that is done to a datagram in this package, with a key."""
    heard = read_security(datagram)
    plain = datagram if heard.mode is SecurityMode.NONE else KEY.unprotect(heard)
    chunk = read_chunk(plain)
    return Codec().decode(plain) if chunk is None else chunk


def cause_and_cost(do: Callable[[], object]) -> tuple[str | None, int]:
    """The cause of the error that comes out, and how much memory was held at most."""
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    cause = None
    result: object = None
    try:
        result = do()
    except RemoteWireError as error:
        cause = error.cause
    cost = tracemalloc.get_traced_memory()[1] - before
    del result
    return cause, cost


@pytest.fixture(autouse=True)
def _traced() -> Iterator[None]:
    tracemalloc.start()
    yield
    tracemalloc.stop()


TABLE: list[tuple[str, Cause | None, str]] = [
    ("255 DataSetMessages in the payload header, none there", Cause.TRUNCATED, "f101 0200 01 0200 ff"),
    ("255 sizes of 65,535", Cause.TRUNCATED, "d101 0200 ff" + "0900" * 255 + "ffff" * 255 + "01 0000"),
    ("255 sizes of 0", Cause.TRUNCATED, "d101 0200 ff" + "0900" * 255 + "0000" * 255),
    ("promoted fields of 65,535 bytes", Cause.TRUNCATED, "d1 81 02 0200 01 0900 ffff 01 01"),
    ("65,535 fields", Cause.LENGTH_BEYOND_END, HEAD + "01 ffff" + "0101" * 100),
    ("65,535 delta fields", Cause.LENGTH_BEYOND_END, HEAD + "81 01 ffff 0000 0101"),
    ("65,535 Null fields, which take a byte each", None, HEAD + "01 ffff" + "00" * 65_535),
    ("65,535 empty DataValues", None, HEAD + "05 ffff" + "00" * 65_535),
    ("an array of 60,000 empty DataValues", None, ONE_FIELD + "97 60ea0000" + "00" * 60_000),
    ("an array of 60,000 empty DiagnosticInfos", None, ONE_FIELD + "99 60ea0000" + "00" * 60_000),
    ("an array of 60,000 Null Variants", None, ONE_FIELD + "98 60ea0000" + "00" * 60_000),
    ("an array of 60,000 empty LocalizedTexts", None, ONE_FIELD + "95 60ea0000" + "00" * 60_000),
    ("Variants nested 100 deep", Cause.TOO_DEEP, ONE_FIELD + "98 01000000" * 100 + "01 01"),
    ("DataValues nested 10,000 deep", Cause.TOO_DEEP, ONE_FIELD + "17 01" * 10_000 + "01 01"),
    ("DiagnosticInfos nested 60,000 deep", Cause.TOO_DEEP, ONE_FIELD + "19" + "40" * 60_000),
    ("a String of 2 GB", Cause.LENGTH_BEYOND_END, ONE_FIELD + "0c ffffff7f 61"),
    ("a ByteString of 2 GB", Cause.LENGTH_BEYOND_END, ONE_FIELD + "0f ffffff7f 61"),
    ("an array of 2 G Booleans", Cause.LENGTH_BEYOND_END, ONE_FIELD + "81 ffffff7f 01"),
    ("a matrix of 2 G by 2 G bytes", Cause.ARRAY_DIMENSIONS, ONE_FIELD + "c3 01000000 01 02000000 ffffff7f ffffff7f"),
    ("2 G dimensions", Cause.LENGTH_BEYOND_END, ONE_FIELD + "c3 01000000 01 ffffff7f 01000000"),
    ("a length of -2", Cause.NEGATIVE_LENGTH, ONE_FIELD + "0c feffffff"),
    ("a length of -2,147,483,648", Cause.NEGATIVE_LENGTH, ONE_FIELD + "0c 00000080"),
    ("a PublisherId of 2 GB", Cause.LENGTH_BEYOND_END, "d104 ffffff7f 61 01 0900 01 0000"),
    ("a NonceLength of 255, none there", Cause.TRUNCATED, SECURED + "03 01000000 ff"),
    ("a NonceLength of 255, all there", Cause.NONCE_LENGTH, SECURED + "03 01000000 ff" + "00" * 400),
    ("a NonceLength of 0 with encryption", Cause.NONCE_LENGTH, SECURED + "03 01000000 00" + "00" * 64),
    ("a NonceLength of 7 with a signature", Cause.NONCE_LENGTH, SECURED + "01 01000000 07" + "00" * 64),
    (
        "a SecurityFooterSize of 65,535",
        Cause.SECURITY_FOOTER,
        SECURED + "05 01000000 08" + "00" * 8 + "ffff" + "00" * 64,
    ),
    (
        "a footer that takes the signature",
        Cause.SECURITY_FOOTER,
        SECURED + "05 01000000 08" + "00" * 8 + "0100" + "00" * 32,
    ),
    ("no room for a signature", Cause.TRUNCATED, SECURED + "01 01000000 08" + "00" * 8 + "00" * 31),
    ("SecurityFlags 0xFF", Cause.SECURITY_FLAGS, SECURED + "ff 01000000 08" + "00" * 64),
    ("encrypted and not signed", Cause.SECURITY_FLAGS, SECURED + "02 01000000 08" + "00" * 64),
    ("a token id of 4,294,967,295", Cause.SIGNATURE, SECURED + "03 ffffffff 08" + "00" * 64),
    ("a payload of nothing", Cause.SIGNATURE, SECURED + "03 01000000 08" + "00" * 8 + "00" * 32),
    ("a chunk of 4 GB, that never ends", None, CHUNK + "0300 00000000 ffffffff 01000000 41"),
    ("the last byte of 4 GB", None, CHUNK + "0300 feffffff ffffffff 01000000 41"),
    ("a chunk behind the end", Cause.CHUNK_RANGE, CHUNK + "0300 ffffffff ffffffff 01000000 41"),
    ("a chunk that reaches beyond the end", Cause.CHUNK_RANGE, CHUNK + "0300 00000000 01000000 02000000 4142"),
    ("a chunk of 0 bytes", Cause.CHUNK_EMPTY, CHUNK + "0300 00000000 08000000 00000000"),
    ("a chunk of a message of 0 bytes", Cause.CHUNK_RANGE, CHUNK + "0300 00000000 00000000 01000000 41"),
    ("CorrelationData of 2 GB", Cause.LENGTH_BEYOND_END, ACTION + "05 ffffff7f 41"),
    ("CorrelationData of 60,000 bytes", Cause.CORRELATION_DATA, ACTION + "05 60ea0000" + "41" * 60_000),
    ("a RequestorId of 60,000 bytes", Cause.REQUESTOR_ID, ACTION + "09 0c 60ea0000" + "41" * 60_000),
    ("a RequestorId nested 100 deep", Cause.TOO_DEEP, ACTION + "09" + "98 01000000" * 100 + "01 01"),
    ("a ResponseAddress of 2 GB", Cause.LENGTH_BEYOND_END, ACTION + "03 ffffff7f 41"),
    ("a TimeoutHint of infinity", Cause.TIMEOUT_HINT, ACTION + "11 000000000000f07f"),
    ("a TimeoutHint that is no number", Cause.TIMEOUT_HINT, ACTION + "11 000000000000f87f"),
    ("a TimeoutHint below 0", Cause.TIMEOUT_HINT, ACTION + "11 000000000000f0bf"),
    ("ActionFlags 0xFF", Cause.ACTION_FLAGS, ACTION + "ff"),
    ("65,535 arguments", Cause.LENGTH_BEYOND_END, ACTION + "01 81 05 0100 0100 01 ffff 01 01"),
    ("ActionState 255", Cause.ACTION_STATE, ACTION + "01 81 05 0100 0100 ff 0000"),
    ("2 G endpoints", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "01 0000 ffffff7f"),
    ("a configuration of 2 G writers", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "03 0000 ffffff7f"),
    ("2 G connections", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "04 0000 ffffff7f"),
    ("2 G connections of a responder", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "06 0000 ffffff7f"),
    ("2 G targets of Actions", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "07 0000 0900 ffffff7f"),
    ("application information of type 65,535", None, ANNOUNCEMENT + "05 0000 ffff"),
    ("a probe for 2 G writers", Cause.LENGTH_BEYOND_END, PROBE + "01 02 ffffff7f"),
    ("a probe for 30,000 writers", None, PROBE + "01 02 30750000" + "0100" * 30_000),
    ("metadata with 2 G namespaces", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "02 0000 0900 ffffff7f"),
    ("metadata with 2 G structures", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "02 0000 0900 00000000 ffffff7f"),
    ("metadata with 2 G enumerations", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "02 0000 0900" + "00" * 8 + "ffffff7f"),
    ("metadata with 2 G simple types", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "02 0000 0900" + "00" * 12 + "ffffff7f"),
    ("metadata with 2 G fields", Cause.LENGTH_BEYOND_END, ANNOUNCEMENT + "02 0000 0900" + "00" * 21 + "ffffff7f"),
]


@pytest.mark.parametrize(("cause", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in TABLE])
def test_limit(cause: Cause | None, encoded: str) -> None:
    datagram = bytes.fromhex(encoded)
    found, cost = cause_and_cost(lambda: take(datagram))
    assert found == cause
    assert cost < MOST_BYTES_AT_ALL + MOST_BYTES_PER_BYTE * len(datagram)


@pytest.mark.parametrize("kind", ["98", "97", "99", "95", "8c ffffffff", "91"])
def test_a_message_of_megabytes_that_are_all_small_values(kind: str) -> None:
    """What chunks are put together to may be 4 MB; decoded it must not take a hundred times as much."""
    code, element = bytes.fromhex(kind[:2]), bytes.fromhex(kind[2:]) or bytes(1)
    array = code + (2_000_000 // len(element)).to_bytes(4, "little") + element * (2_000_000 // len(element))
    datagram = bytes.fromhex(ONE_FIELD) + array
    found, cost = cause_and_cost(partial(take, datagram))
    assert found in (Cause.TOO_MANY, Cause.LENGTH_BEYOND_END)
    assert cost < MOST_BYTES_AT_ALL + len(datagram)


def limits(size: int) -> list[bytes]:
    """The least, the greatest, and both sides of where a sign begins."""
    signs = [bytes(size - 1) + b"\x80", b"\xff" * (size - 1) + b"\x7f"]
    return [bytes(size), b"\xff" * size, b"\xfe" + b"\xff" * (size - 1), *(signs if size in (2, 4, 8) else [])]


def headers() -> list[tuple[str, bytes, int, int]]:
    """A message for each field that there is in the corpus: its name, the message, its place."""
    found: dict[tuple[str, str, int], tuple[str, bytes, int, int]] = {}
    for datagram in [*plain_messages(), *chunked_messages(), *secured_messages()]:
        for span in annotate(datagram):
            kind = re.sub(r"\[\d+\]", "[]", span.name)
            size = len(span.data)
            if size in (1, 2, 4, 8):
                name = f"{span.section}: {kind}"
                found.setdefault((name, span.section, size), (f"{name}, {size} bytes", datagram, span.offset, size))
    return list(found.values())


@pytest.mark.parametrize(("datagram", "offset", "size"), [pytest.param(*field[1:], id=field[0]) for field in headers()])
def test_every_field_at_its_limits(datagram: bytes, offset: int, size: int) -> None:
    for limit in limits(size):
        changed = datagram[:offset] + limit + datagram[offset + size :]
        found, cost = cause_and_cost(partial(take, changed))
        assert found is None or found in set(Cause)
        assert cost < MOST_BYTES_AT_ALL + MOST_BYTES_PER_BYTE * len(changed)


RAW: list[tuple[str, FieldMetaData, str]] = [
    ("String", FieldMetaData("f", 12), "ffffff7f"),
    ("padded String", FieldMetaData("f", 12, max_string_length=0xFFFF_FFFF), "01000000 61"),
    ("array", FieldMetaData("f", 3, value_rank=1), "ffffff7f"),
    ("padded array", FieldMetaData("f", 3, value_rank=1, array_dimensions=(0xFFFF_FFFF,)), "01000000 01"),
    ("matrix", FieldMetaData("f", 3, value_rank=2), "02000000 ffffff7f ffffff7f 01"),
    (
        "padded matrix",
        FieldMetaData("f", 3, value_rank=2, array_dimensions=(0xFFFF_FFFF,) * 2),
        "02000000 01000000 01000000 01",
    ),
    ("matrix of 16 dimensions", FieldMetaData("f", 3, value_rank=16), "10000000" + "ffffff7f" * 16),
    ("rank of 2 G", FieldMetaData("f", 3, value_rank=0x7FFF_FFFF), "01"),
]


@pytest.mark.parametrize(("field", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in RAW])
def test_raw_data_at_its_limits(field: FieldMetaData, encoded: str) -> None:
    message = Codec().decode(bytes.fromhex(HEAD + "03" + encoded))
    assert isinstance(message, NetworkMessage)
    metadata = DataSetMetaData("raw", (field,), ConfigurationVersion(1, 1))
    cause, cost = cause_and_cost(lambda: decode_raw_fields(message.messages[0], metadata))
    assert cause in set(Cause)
    assert cost < MOST_BYTES_AT_ALL


def test_plans_are_bounded_too() -> None:
    """A peer that sends another layout with each message fills a bounded cache, and no more."""
    codec = Codec()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    for writer in range(17_000):
        header = bytes.fromhex("f101 0200 01 0200 01") + (writer % 65_536).to_bytes(2, "little")
        for _ in range(2):
            codec.decode(header + bytes.fromhex("01 0100 03 07"))
    assert tracemalloc.get_traced_memory()[0] - before < 40 * 1024 * 1024
