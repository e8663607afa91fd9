"""Mutated valid messages: only RemoteWireError comes out, counted by cause, in bounded time and memory."""

from __future__ import annotations

import copy
import json
import os
import random
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import orjson
import pytest

from tests.unit.wire.json.samples import EVERYTHING, KEY, NOON, SOURCE, data
from tests.unit.wire.json.test_actions import FIELDS, REQUEST, RESPONSE
from tests.unit.wire.json.test_announcements import ANNOUNCEMENTS
from tests.unit.wire.json.test_structures import CASES
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire.json import (
    DATA_SET_MESSAGE,
    MINIMAL,
    DataSetFields,
    Form,
    JsonAction,
    JsonAnnouncement,
    JsonCause,
    Layout,
    Limits,
    Reading,
    decode_json,
    encode_action,
    encode_announcement,
    encode_data,
)
from ua_fleet.wire.json.data_messages import decode_data
from ua_fleet.wire.json.parsing import parse
from ua_fleet.wire.json.usual_message import decode_usual_message
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData, FrameKind

SHARES = 4
ALL = 200_000
MUTATIONS = ALL if os.environ.get("UA_FLEET_ALL_MUTATIONS") else 24_000
"""All of them take a minute or more: `make test-mutations`."""
MOST_GROWTH_MB = 60.0

STRUCTURES = DataSetFields(
    EVERYTHING.metadata._replace(
        fields=tuple([FieldMetaData(f"f{index}", 22, data_type=case[0].data_type) for index, case in enumerate(CASES)])
    )
)


def corpus() -> list[bytes]:
    """Every kind of message, in every form."""
    texts: list[bytes] = []
    kinds = (
        KEY,
        KEY._replace(kind=FrameKind.EVENT.value),
        KEY._replace(kind=FrameKind.DELTA.value, indices=tuple(range(len(KEY.types)))),
        DataSetMessage(1001, FrameKind.KEEP_ALIVE),
    )
    for form in Form:
        texts += [encode_data(data(kind), [EVERYTHING], form) for kind in kinds]
        texts += [encode_data(data(KEY), [EVERYTHING], form, layout) for layout in (DATA_SET_MESSAGE, MINIMAL)]
        texts.append(encode_action(JsonAction(REQUEST, "m", NOON), [FIELDS], form))
    texts.append(encode_action(JsonAction(RESPONSE, "m", NOON), [FIELDS]))
    for index, (_, _, *forms) in enumerate(CASES):
        texts += [orjson.dumps({"DataSetWriterId": 7, "Payload": {f"f{index}": form}}) for form in forms]
    texts += [encode_announcement(JsonAnnouncement(value, "m", NOON)) for value in ANNOUNCEMENTS]
    return texts


ODD: list[Any] = [
    None,
    True,
    False,
    0,
    -1,
    1,
    255,
    256,
    2**31,
    2**32,
    2**63,
    2**64,
    -(2**63) - 1,
    1e308,
    -0.0,
    0.5,
    1e-320,
    "",
    "NaN",
    "Infinity",
    "-1",
    "1e400",
    "0001-01-01T00:00:00Z",
    "9999-12-31T23:59:59.9999999Z",
    "i=1",
    "nsu=;s=",
    "ns=1;b=!",
    "svr=9;i=1",
    "Red_0",
    "_",
    "\x00",
    "\U0001f916" * 3,
    [],
    {},
    [[]],
    [[1], [2, 3]],
    [None],
    {"UaType": 6},
    {"UaType": 24, "Value": [{"UaType": 1}]},
    {"Code": -1},
    {"Value": {}},
    {"Type": 22, "Body": {}},
    {"Array": [], "Dimensions": [0]},
    {"UaTypeId": "nsu=urn:fleet;i=3006"},
    {"SwitchField": 99},
    {"EncodingMask": 4},
    {"TypeId": {"Id": 1}, "Body": {}},
]


def mutate(chance: random.Random, texts: list[bytes], trees: list[Any]) -> bytes:
    """One message with some changes: half of them in the text, half in what it says."""
    index = chance.randrange(len(texts))
    if chance.random() < 0.5:
        return _mutate_text(chance, bytearray(texts[index]))
    tree = copy.deepcopy(trees[index])
    for _ in range(chance.randrange(1, 4)):
        _mutate_tree(chance, tree)
    return json.dumps(tree).encode("utf-8", "surrogatepass")


def _mutate_text(chance: random.Random, text: bytearray) -> bytes:
    for _ in range(chance.randrange(1, 4)):
        place = chance.randrange(len(text))
        match chance.randrange(6):
            case 0:
                text[place] = chance.randrange(256)
            case 1:
                del text[place : place + chance.randrange(1, 9)]
            case 2:
                del text[place:]
            case 3:
                text[place:place] = chance.choice(
                    [b"{", b"[", b'"', b"9" * 400, b"e9999", b"\\ud800", b"\xff", b",", b"null"]
                )
            case 4:
                other = chance.randrange(len(text))
                text[place : place + 4] = text[other : other + 4]
            case _:
                text[place:place] = b"[" * chance.choice([1, 40, 2000])
        if not text:
            return b""
    return bytes(text)


def _mutate_tree(chance: random.Random, tree: Any) -> None:
    """Change, drop, repeat or rename something at a random place."""
    holder: Any = tree
    while True:
        keys: list[Any] = list(holder) if holder.__class__ is dict else list(range(len(holder)))
        if not keys:
            return
        key = chance.choice(keys)
        inner: Any = holder[key]
        if inner.__class__ not in (dict, list) or not inner or chance.random() < 0.3:
            break
        holder = inner
    match chance.randrange(5):
        case 0 | 1:
            holder[key] = copy.deepcopy(chance.choice(ODD))
        case 2:
            del holder[key]
        case 3:
            holder[key] = [copy.deepcopy(holder[key])] * chance.randrange(1, 4)
        case _:
            if holder.__class__ is dict:
                holder[chance.choice(["Value", "UaType", "Payload", "Status", "x"])] = holder.pop(key)


def fields_of(source: Any) -> DataSetFields | None:
    """Everything, structures for the writer 7, and nothing for some that mutations made."""
    number = source.data_set_writer_id
    return STRUCTURES if number == 7 else None if number in (0, 255, 256) else EVERYTHING


def action_fields_of(_publisher_id: str, _writer_id: int, _is_request: bool) -> DataSetFields:
    return FIELDS


def count(text: bytes, causes: Counter[str], layout: Layout | None = None) -> None:
    try:
        decoded = decode_json(text, fields_of, action_fields_of, SOURCE, layout)
    except RemoteWireError as error:
        causes[error.cause] += 1
    else:
        causes["decoded"] += 1
        for leniency in decoded.leniencies:
            causes[leniency] += 1


def memory_mb(name: str) -> float:
    """`VmRSS` of this process, or its `VmHWM`, the most since it was asked to forget."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{name}:"))


@pytest.mark.parametrize("share", range(SHARES))
def test_only_the_typed_remote_error_escapes(share: int) -> None:
    texts = corpus()
    trees = [orjson.loads(text) for text in texts]
    chance = random.Random(20_261_128 + share)
    causes: Counter[str] = Counter()
    for text in texts:
        count(text, causes)
    assert causes["decoded"] == len(texts)
    causes.clear()
    Path("/proc/self/clear_refs").write_text("5")
    before = memory_mb("VmRSS")
    for _ in range(MUTATIONS // SHARES):
        layout = chance.choice([None, None, None, DATA_SET_MESSAGE, MINIMAL, Layout()])
        count(mutate(chance, texts, trees), causes, layout)
    assert memory_mb("VmHWM") - before < MOST_GROWTH_MB
    refused = {cause for cause in causes if cause.startswith("json_")}
    assert refused <= set(JsonCause)
    assert len(refused) >= 11
    assert causes["decoded"] > MUTATIONS // SHARES // 10
    assert sum(causes[cause] for cause in refused) + causes["decoded"] == MUTATIONS // SHARES


def outcome(read: Callable[[], Any]) -> str:
    try:
        return repr(read()).replace("mappingproxy({})", "{}")
    except RemoteWireError as error:
        return error.cause


def test_the_usual_way_reads_what_the_general_way_reads() -> None:
    """Messages of which most go the usual way, mutated: both ways return the same, leniencies and causes included."""
    fields = (FieldMetaData("a", 11), FieldMetaData("b", 6), FieldMetaData("c", 12), FieldMetaData("d", 13))
    flat = DataSetFields(EVERYTHING.metadata._replace(fields=fields))
    values = (1.5, 2, "x", NOON)
    message = DataSetMessage(9, types=(11, 6, 12, 13), values=values, sequence_number=1, timestamp=NOON, status=0)
    message = message._replace(major_version=800_000_000, minor_version=1)
    texts = [encode_data(data(message), [flat], form) for form in (Form.COMPACT, Form.VERBOSE)]
    trees = [orjson.loads(text) for text in texts]

    def flat_fields(_source: Any) -> DataSetFields:
        return flat

    chance = random.Random(20_261_129)
    usual = Counter[bool]()
    for _ in range(4_000):
        text = mutate(chance, texts, trees)
        if b'"ua-data"' not in text:
            continue

        def general(text: bytes = text) -> Any:
            reading = Reading()
            return decode_data(reading, parse(text, reading), flat_fields, SOURCE)

        def both(text: bytes = text) -> Any:
            return decode_json(text, flat_fields, action_fields_of, SOURCE)

        assert outcome(both) == outcome(general)
        try:
            tree = parse(text, Reading())
            usual[decode_usual_message(tree, flat_fields, SOURCE) is not None] += 1
        except (RemoteWireError, AttributeError):
            continue
    assert usual[True] > 200
    assert usual[False] > 300


def test_noise() -> None:
    chance = random.Random(7)
    causes: Counter[str] = Counter()
    for _ in range(2_000):
        count(chance.randbytes(chance.randrange(80)), causes)
    assert causes["decoded"] < 20


def _deep(_size: int) -> bytes:
    return b'{"Payload":{"Any":' + b'{"UaType":24,"Value":[' * 500 + b"1" + b"]}" * 500 + b"}}"


LARGE: dict[str, Callable[[int], bytes]] = {
    "a text of 64 MB": lambda _size: b'{"Payload":{"String":"' + b"x" * 64_000_000 + b'"}}',
    "texts": lambda size: b'{"Payload":{"Texts":[' + b'"",' * (size // 3) + b'""]}}',
    "numbers": lambda size: b'{"Payload":{"Doubles":[' + b"0," * (size // 2) + b"0]}}",
    "digits": lambda size: b'{"Payload":{"Double":' + b"9" * size + b"}}",
    "objects": lambda size: b'{"Payload":{"Any":[' + b"{}," * (size // 3) + b"{}]}}",
    "members": lambda size: b'{"Payload":{' + b",".join(b'"%d":0' % i for i in range(size // 8)) + b"}}",
    "messages": lambda size: b"[" + b"{}," * (size // 3) + b"{}]",
    "depth": _deep,
    "a number as text": lambda size: b'{"Payload":{"Int64":"' + b"1" * size + b'"}}',
    "a date": lambda size: b'{"Payload":{"DateTime":"2024-01-17T21:20:00.' + b"1" * size + b'Z"}}',
    "blanks in base64": lambda size: b'{"Payload":{"ByteString":"' + b" " * size + b'"}}',
    "an enumeration": lambda size: b'{"Payload":{"Colour":"' + b"_" * size + b'"}}',
    "a name": lambda size: b'{"Payload":{"QualifiedName":"nsu=' + b"%41" * (size // 3) + b';x"}}',
    "a publisher": lambda size: b'{"MessageType":"ua-data","PublisherId":"' + b"0" * size + b'","Messages":[]}',
}


@pytest.mark.parametrize("name", LARGE)
def test_large_messages_cost_bounded_time_and_memory(name: str) -> None:
    text = LARGE[name](3_000_000)
    causes: Counter[str] = Counter()
    tracemalloc.start()
    started = time.process_time()
    count(text, causes)
    spent, (_, peak) = time.process_time() - started, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert causes.total() >= 1
    assert spent < 5
    assert peak < 100_000_000


def test_the_budget_of_elements_is_that_of_the_caller() -> None:
    text = b'{"Payload":{"Doubles":[' + b"0.5," * 1000 + b"0.5]}}"
    with pytest.raises(RemoteWireError, match=JsonCause.ELEMENTS.value):
        decode_json(text, fields_of, limits=Limits(elements=1000))
