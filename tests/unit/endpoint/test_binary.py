"""Plans make of a structure what asyncua makes of it, and of an operation's bytes what the scan and asyncua do."""

from __future__ import annotations

import importlib
import os
import random
import re
from typing import Any

import pytest
from asyncua.common.utils import Buffer

from tests.attacks.bombs import BombMaker
from ua_fleet.endpoint.binary.data_values import encode_data_value, with_times
from ua_fleet.endpoint.binary.decoders import PLAIN, decode_plain
from ua_fleet.endpoint.binary.encoders import encode
from ua_fleet.endpoint.binary.history_details import decode_history_details
from ua_fleet.endpoint.binary.session_requests import decode_session_request
from ua_fleet.endpoint.chunks import HEAD, LAST, SEQUENCE, open_chunk, opening_keys, seal_chunk, sealing_keys
from ua_fleet.endpoint.convert import ExactDateTime, exact_datetime, ticks_of
from ua_fleet.endpoint.decoding import BYTES_BEFORE_SESSION, OPERATIONS_BEFORE_SESSION, decode_parameters
from ua_fleet.endpoint.monitoring import with_timestamps
from ua_fleet.endpoint.scan import Scan, step_of
from ua_fleet.endpoint.stack import DECODE_ERRORS, Refusal

ua: Any = importlib.import_module("asyncua.ua")
binary: Any = importlib.import_module("asyncua.ua.ua_binary")
ciphers: Any = importlib.import_module("cryptography.hazmat.primitives.ciphers")

STRUCTURES = 100_000 if os.environ.get("UA_FLEET_ALL_MUTATIONS") else 2_000
OPERATIONS = 6_000
MEMORY = 64 * 1024 * 1024
FINER = re.compile(r"SourcePicoseconds=\d")
"""asyncua has these in another order than the standard."""
KINDS = sorted(
    {
        *ua.extension_objects_by_typeid.values(),
        *(getattr(ua, name) for name in dir(ua) if name.endswith(("Response", "Request", "Parameters", "Result"))),
    },
    key=lambda kind: str(kind.__name__),
)


def _built(kind: Any, data: bytes) -> Any:
    """What asyncua makes of bytes that the scan lets pass; None where it does not."""
    scan = Scan(data, 0, len(data), MEMORY)
    try:
        step_of(kind).walk(scan)
        return binary.from_binary(kind, Buffer(data[: scan.position]))
    except (Refusal, *DECODE_ERRORS):
        return None


def test_each_structure_has_the_bytes_that_asyncua_makes() -> None:
    for kind in KINDS:
        try:
            made = kind()
            expected = binary.struct_to_binary(made)
        except Exception:  # noqa: BLE001 - one that asyncua cannot encode is none to compare with
            continue
        assert encode(made) == expected, kind


def test_generated_structures_have_the_bytes_that_asyncua_makes() -> None:
    maker = BombMaker(3, 20)
    compared = 0
    while compared < STRUCTURES:
        kind = maker.random.choice(KINDS)
        made = _built(kind, maker.parameters(kind))
        if made is None or FINER.search(repr(made)):
            continue
        try:
            expected = binary.struct_to_binary(made)
        except DECODE_ERRORS:
            with pytest.raises(DECODE_ERRORS):
                encode(made)
            continue
        assert encode(made) == expected, made
        compared += 1


def _operation(rng: random.Random, kind: Any) -> Any:
    number, text = rng.randrange(70_000), rng.choice(("", "x", "\u00e4" * 20, "value"))
    node = rng.choice((ua.NodeId(number, rng.randrange(300)), ua.NodeId(text, 2), ua.NodeId(b"x", 1), ua.NodeId(7)))
    value = rng.choice(
        (
            ua.Variant(1.5, ua.VariantType.Double),
            ua.Variant(number, ua.VariantType.UInt32),
            ua.Variant(True, ua.VariantType.Boolean),
            ua.Variant(text, ua.VariantType.String),
            ua.Variant(None, ua.VariantType.String),
            ua.Variant([1, 2], ua.VariantType.Int16),
            ua.Variant(),
        )
    )
    wanted = ua.ReadValueId(node, rng.randrange(30), rng.choice((None, None, "", "1:2")))
    if rng.random() < 0.1:
        wanted.DataEncoding = ua.QualifiedName("Default Binary", 0)
    if kind is ua.ReadValueId:
        return wanted
    if kind is ua.WriteValue:
        time = rng.choice((None, ua.win_epoch_to_datetime(130_000_000_000_000_000 + number * 10)))
        code = rng.choice((None, ua.StatusCode(0), ua.StatusCode(0x8000_0000)))
        return ua.WriteValue(
            node, 13, rng.choice((None, None, "1")), ua.DataValue(value, code, time, rng.choice((None, time)))
        )
    if kind is ua.CallMethodRequest:
        return ua.CallMethodRequest(node, node, rng.choice((None, [], [value], [value] * 3)))
    if kind is ua.SubscriptionAcknowledgement:
        return ua.SubscriptionAcknowledgement(number, number + 1)
    if kind is ua.HistoryReadValueId:
        point = rng.choice((None, b"", b"x" * 48, b"x" * 2_000))
        return ua.HistoryReadValueId(node, wanted.IndexRange, wanted.DataEncoding, point)
    if kind is ua.BrowseDescription:
        return ua.BrowseDescription(node, rng.randrange(3), ua.NodeId(33), rng.random() < 0.5, number, 63)
    parameters = ua.MonitoringParameters(number, 1.5, None, number, rng.random() < 0.5)
    if rng.random() < 0.4:
        filters = ua.DataChangeFilter(rng.choice(tuple(ua.DataChangeTrigger)), rng.randrange(3), rng.random())
        parameters.Filter = rng.choice((filters, filters, ua.EventFilter(), ua.AggregateFilter()))
    return ua.MonitoredItemCreateRequest(wanted, rng.choice(tuple(ua.MonitoringMode)), parameters)


def _damaged(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data))
    return rng.choice((data, data, data[:at], data[:at] + rng.randbytes(1) + data[at + 1 :]))


@pytest.mark.parametrize("kind", PLAIN, ids=lambda kind: str(kind.__name__))
def test_a_plain_operation_is_what_asyncua_builds_and_costs_what_the_scan_charges(kind: Any) -> None:
    rng = random.Random(5)
    plain = 0
    for _ in range(OPERATIONS // len(PLAIN)):
        data = _damaged(rng, binary.struct_to_binary(_operation(rng, kind)))
        found = decode_plain(kind, data, 0)
        if found is None:
            continue
        value, end, memory = found
        scan = Scan(data, 0, len(data), MEMORY)
        step_of(kind).walk(scan)
        assert (scan.position, MEMORY - scan.memory) == (end, memory), value
        expected = binary.from_binary(kind, Buffer(data))
        assert binary.struct_to_binary(value) == binary.struct_to_binary(expected)
        assert repr(value) == repr(expected)
        plain += 1
    assert plain > OPERATIONS // len(PLAIN) // 10


def _history_details(rng: random.Random) -> Any:
    def time() -> Any:
        return ua.win_epoch_to_datetime(rng.choice((0, 130_000_000_000_000_000, -5, 2**63 - 1)))

    def flag() -> bool:
        return rng.random() < 0.5

    nodes = ua.NodeId(2342), ua.NodeId("x", 2), ua.NodeId(70_000, 1), ua.NodeId(7)
    kinds = [rng.choice(nodes) for _ in range(rng.randrange(4))]
    configuration = ua.AggregateConfiguration(flag(), flag(), rng.randrange(101), rng.randrange(101), flag())
    return rng.choice(
        (
            ua.ReadRawModifiedDetails(flag(), time(), time(), rng.randrange(9), flag()),
            ua.ReadAtTimeDetails([time() for _ in range(rng.randrange(4))], flag()),
            ua.ReadProcessedDetails(time(), time(), rng.random(), kinds, configuration),
            ua.ReadAnnotationDataDetails([time()]),
            ua.ReadEventDetails(),
        )
    )


def test_plain_history_details_are_what_asyncua_builds_and_cost_what_the_scan_charges() -> None:
    rng = random.Random(7)
    plain = 0
    for _ in range(OPERATIONS):
        data = _damaged(rng, binary.extensionobject_to_binary(_history_details(rng)))
        found = decode_history_details(data, 0)
        if found is None:
            continue
        details, end, memory = found
        scan = Scan(data, 0, len(data), MEMORY)
        step_of(ua.ExtensionObject).walk(scan)
        assert (scan.position, MEMORY - scan.memory) == (end, memory), details
        said = repr(details).replace(f"{ExactDateTime.__name__}(", "datetime.datetime(")
        assert said == repr(binary.extensionobject_from_binary(Buffer(data)))
        plain += 1
    assert plain > OPERATIONS // 3


@pytest.mark.parametrize("ticks", [0, 3, 134_000_000_000_000_000, 134_000_000_000_000_007, 134_000_000_001_234_561])
def test_times_of_the_history_are_exact_to_100_ns(ticks: int) -> None:
    """Who asks for a value at the time that it has, or for what comes after it, means that very time."""
    details = ua.ReadRawModifiedDetails(False, ua.win_epoch_to_datetime(0), ua.win_epoch_to_datetime(0), 1, False)
    data = bytearray(binary.extensionobject_to_binary(details))
    data[10:18] = data[18:26] = ticks.to_bytes(8, "little")
    found = decode_history_details(bytes(data), 0)
    assert found is not None
    assert (ticks_of(found[0].StartTime), ticks_of(found[0].EndTime)) == (ticks, ticks)
    details = ua.ReadAtTimeDetails([ua.win_epoch_to_datetime(0)], True)
    data = bytearray(binary.extensionobject_to_binary(details))
    data[13:21] = ticks.to_bytes(8, "little")
    found = decode_history_details(bytes(data), 0)
    assert found is not None
    assert [ticks_of(time) for time in found[0].ReqTimes] == [ticks]


@pytest.mark.parametrize("ticks", [-5, 2**63 - 1, 2_650_467_744_000_000_005])
def test_times_that_asyncua_has_not_are_what_it_makes_of_them(ticks: int) -> None:
    assert exact_datetime(ticks) == ua.win_epoch_to_datetime(ticks)
    assert ticks_of(exact_datetime(ticks)) == ticks_of(ua.win_epoch_to_datetime(ticks))


def _session_request(rng: random.Random) -> Any:
    def text() -> Any:
        return rng.choice((None, "", "urn:x", "\u00e4" * 9))

    def signature() -> Any:
        return ua.SignatureData(text(), rng.choice((None, b"", b"s" * 256)))

    if rng.random() < 0.2:
        texts = [rng.choice((None, [], ["en", ""], [None] * 3, ["x"] * 20)) for _ in range(2)]
        return ua.GetEndpointsParameters(text(), *texts)
    if rng.random() < 0.5:
        name = ua.LocalizedText(text(), text())
        urls = rng.choice((None, [], ["opc.tcp://x"], ["x"] * 20))
        kind = rng.choice(tuple(ua.ApplicationType))
        client = ua.ApplicationDescription(text(), text(), name, kind, text(), text(), urls)
        nonce, size = rng.choice((None, b"n" * 32)), rng.randrange(1_000)
        return ua.CreateSessionParameters(client, text(), text(), text(), nonce, b"c" * size, rng.random(), size)
    token = rng.choice(
        (
            ua.AnonymousIdentityToken(text()),
            ua.UserNameIdentityToken(text(), text(), rng.choice((None, b"p" * 256)), text()),
            ua.X509IdentityToken(text(), b"c" * 900),
            ua.ExtensionObject(),
        )
    )
    certificates = [ua.SignedSoftwareCertificate(b"c", b"s")] if rng.random() < 0.1 else []
    return ua.ActivateSessionParameters(signature(), certificates, rng.choice((None, [], ["en"])), token, signature())


async def test_a_plain_request_for_a_session_is_what_asyncua_builds() -> None:
    rng = random.Random(6)
    plain = 0
    for _ in range(OPERATIONS // 2):
        made = _session_request(rng)
        data = _damaged(rng, binary.struct_to_binary(made))
        found = decode_session_request(type(made), data)
        if found is not None:
            limits: Any = {"most_operations": OPERATIONS_BEFORE_SESSION, "most_memory": BYTES_BEFORE_SESSION}
            assert repr(found) == repr(await decode_parameters(type(made), Buffer(data), **limits))
            plain += 1
    assert plain > OPERATIONS // 8


TIME = ua.win_epoch_to_datetime(133_000_000_000_000_000)
VALUES = [
    ua.DataValue(ua.Variant(1.5), ua.StatusCode(0), TIME, TIME),
    ua.DataValue(ua.Variant("x"), None, TIME, None, 7),
    ua.DataValue(ua.Variant([1, 2]), ua.StatusCode(5), TIME, TIME, 3, 9_999),
    ua.DataValue(None, ua.StatusCode(0x8000_0000), None, TIME, None, 4),
    ua.DataValue(ua.Variant(2), ua.StatusCode(0), None, None),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
@pytest.mark.parametrize("wanted", [each for each in ua.TimestampsToReturn if each.name != "Invalid"])
def test_the_times_that_a_client_asks_for_are_cut_out_of_the_bytes(value: Any, wanted: Any) -> None:
    assert with_times(encode_data_value(value), wanted) == encode_data_value(with_timestamps(value, wanted))


@pytest.mark.parametrize("encrypted", [True, False])
@pytest.mark.parametrize("size", [0, 1, 14, 15, 16, 17, 4_000])
def test_a_chunk_is_opened_by_its_keys_alone_and_only_as_it_is(size: int, encrypted: bool) -> None:
    cipher = ciphers.Cipher(ciphers.algorithms.AES(bytes(32)), ciphers.modes.CBC(bytes(16))) if encrypted else None
    keys, others = opening_keys(b"k" * 32, cipher), opening_keys(b"o" * 32, cipher)
    sequence, body = SEQUENCE.pack(5, 6), bytes(range(256)) * 16
    frame = seal_chunk(LAST, 3, 4, sequence, body[:size], sealing_keys(b"k" * 32, cipher))
    assert HEAD.unpack_from(frame) == (LAST, len(frame), 3, 4)
    assert open_chunk(frame, keys) == sequence + body[:size]
    assert open_chunk(frame, others) is None
    rng = random.Random(size)
    for at in (0, 8, 12, 16, len(frame) - 1, rng.randrange(len(frame))):
        changed = bytearray(frame)
        changed[at] ^= 1 << rng.randrange(8)
        assert open_chunk(bytes(changed), keys) is None
    for less in (frame[:-1], frame[:-16], frame[: HEAD.size], frame[: HEAD.size + 8]):
        assert open_chunk(less, keys) is None
    assert open_chunk(frame, keys) == sequence + body[:size]


@pytest.mark.parametrize("bits", [128, 256])
def test_each_chunk_is_encrypted_as_if_it_were_the_first(bits: int) -> None:
    rng = random.Random(bits)
    cipher = ciphers.Cipher(ciphers.algorithms.AES(rng.randbytes(bits // 8)), ciphers.modes.CBC(rng.randbytes(16)))
    sealing, opening = sealing_keys(b"k" * 32, cipher), opening_keys(b"k" * 32, cipher)
    for number in range(50):
        sequence, body = SEQUENCE.pack(number, number), rng.randbytes(rng.choice((0, 7, 8, 200, 60_000)))
        frame = seal_chunk(LAST, 3, 4, sequence, body, sealing)
        assert frame == seal_chunk(LAST, 3, 4, sequence, body, sealing_keys(b"k" * 32, cipher))
        plain = cipher.decryptor().update(frame[HEAD.size :])
        assert plain.startswith(sequence + body)
        # Whatever else comes meanwhile.
        assert open_chunk(frame[: HEAD.size] + rng.randbytes(rng.choice((0, 16, 48, 50))), opening) is None
        assert open_chunk(frame, opening) == sequence + body
