"""NetworkMessages of data: every layout, form and kind of frame, and from UADP to JSON and back."""

from __future__ import annotations

import json
from itertools import product
from typing import Any

import orjson
import pytest

from tests.unit.wire.json.samples import (
    EVERYTHING,
    FIELDS,
    KEY,
    METADATA,
    NOON,
    PATH,
    SOURCE,
    TYPES,
    VALUES,
    VERSION,
    data,
)
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import DataValue, Variant
from ua_fleet.wire import Codec, decode_raw_fields
from ua_fleet.wire.data_set_message import with_data_values
from ua_fleet.wire.json import (
    DATA_SET_MESSAGE,
    JSON_PAYLOAD,
    MINIMAL,
    NETWORK_MESSAGE,
    DataSetFields,
    Form,
    JsonCause,
    JsonData,
    JsonWriterPlan,
    Layout,
    Leniency,
    Reading,
    Source,
    decode_json,
    decode_payload,
    encode_data,
    publisher_id_number,
)
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FieldMetaData,
    FrameKind,
    NetworkMessage,
)

LAYOUTS = [Layout(*bits) for bits in product((False, True), repeat=3)]
FORMS = list(Form)


NOBODY = Source()


def everything(_source: Source) -> DataSetFields:
    return EVERYTHING


def decode(text: bytes, layout: Layout | None = None, fields: Any = everything, source: Source = NOBODY) -> JsonData:
    decoded = decode_json(text, fields, layout=layout, source=source)
    assert isinstance(decoded, JsonData)
    return decoded


def no_fields(_source: Source) -> None:
    return None


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_and_form_comes_back(form: Form, layout: Layout) -> None:
    text = encode_data(data(KEY), [EVERYTHING], form, layout)
    known = SOURCE if not layout.data_set_header else Source()
    back = decode(text, layout, source=known)
    (message,) = back.message.messages
    if form is Form.RAW_DATA:  # which does not say what an abstract field is
        expected = list(zip(TYPES, VALUES, strict=True))
        for index, (field, _, _) in enumerate(FIELDS):
            if field.name in ("AnyRank", "Any", "Variants"):
                continue
            assert (message.types[index], message.values[index]) == expected[index], field.name
    else:
        assert (message.types, message.values) == (TYPES, VALUES)
        assert not back.leniencies
    if layout.data_set_header:
        assert message._replace(types=(), values=()) == KEY._replace(types=(), values=())
        assert back.sources == (SOURCE,)
    if layout.network_header:
        assert (back.message_id, back.message.publisher_id, back.writer_group_name) == ("m-1", "2", "group")


@pytest.mark.parametrize("layout", [NETWORK_MESSAGE, Layout(single=True), DATA_SET_MESSAGE, MINIMAL, Layout(False)])
def test_the_layout_is_told_by_what_stands_there(layout: Layout) -> None:
    text = encode_data(data(KEY), [EVERYTHING], Form.VERBOSE, layout)
    assert decode(text).message.messages[0].values == VALUES


def test_the_three_layouts_of_the_annex_as_text() -> None:
    fields = DataSetFields(
        DataSetMetaData(
            "DataSet1",
            (FieldMetaData("Active", 1), FieldMetaData("Temperature", 11), FieldMetaData("AdditionalInfo", 12)),
            ConfigurationVersion(1, 672_341_762),
        )
    )
    message = DataSetMessage(101, types=(1, 11, 12), values=(True, 22.5, None), sequence_number=7, timestamp=NOON)
    message = message._replace(minor_version=672_341_762)
    whole = data(message, source=Source("MyPublisher", None, 101), message_id="32235546-05d9-4fd7-97df-ea3ff3408574")
    payload = {"Active": True, "Temperature": 22.5, "AdditionalInfo": None}
    part = {
        "DataSetWriterId": 101,
        "SequenceNumber": 7,
        "MinorVersion": 672_341_762,
        "Timestamp": "2024-01-17T21:20:00Z",
        "MessageType": "ua-keyframe",
        "Payload": payload,
    }
    assert json.loads(encode_data(whole, [fields], Form.VERBOSE, MINIMAL)) == payload
    single = json.loads(encode_data(whole, [fields], Form.VERBOSE, DATA_SET_MESSAGE))
    assert single == {"DataSetWriterId": 101, "PublisherId": "MyPublisher"} | part
    assert json.loads(encode_data(whole, [fields])) == {
        "MessageId": "32235546-05d9-4fd7-97df-ea3ff3408574",
        "MessageType": "ua-data",
        "PublisherId": "MyPublisher",
        "Messages": [part],
    }


def test_what_each_form_writes() -> None:
    payloads = {form: json.loads(encode_data(data(KEY), [EVERYTHING], form, MINIMAL)) for form in FORMS}
    verbose, compact, raw = payloads[Form.VERBOSE], payloads[Form.COMPACT], payloads[Form.RAW_DATA]
    assert verbose["Int64"] == "-9223372036854775808"
    assert compact["Int64"] == {"UaType": 8, "Value": "-9223372036854775808"}
    assert (verbose["Colour"], verbose["Colours"]) == ("Deep_Green_1", ["Red_0", "Deep_Green_1", "7"])
    assert compact["Colour"] == {"UaType": 6, "Value": 1}
    assert verbose["Any"] == {"UaType": 12, "Value": ["a", None]}
    assert raw["Any"] == {"Value": ["a", None]}
    assert verbose["Grid"] == {"Array": [1, 2, 3, 4, 5, 6], "Dimensions": [2, 3]}
    assert compact["Grid"] == {"UaType": 6, "Value": [1, 2, 3, 4, 5, 6], "Dimensions": [2, 3]}
    assert verbose["AnyRank"] == {"UaType": 6, "Value": [1, 2, 3, 4], "Dimensions": [2, 2]}
    assert raw["AnyRank"] == {"Value": [1, 2, 3, 4], "Dimensions": [2, 2]}
    assert verbose["Nothing"] is None
    assert "Nothing" not in compact
    bad = {"Code": 0x8031_0000, "Symbol": "BadNoCommunication"}
    assert verbose["Failed"] == {"UaType": 19, "Value": bad}
    assert compact["Failed"] == {"UaType": 19, "Value": {"Code": 0x8031_0000}}
    assert raw["Failed"] == bad


PAIR = DataSetFields(
    DataSetMetaData("pair", (FieldMetaData("a", 11), FieldMetaData("b", 6), FieldMetaData("c", 12)), VERSION)
)


def pair(_source: Source) -> DataSetFields:
    return PAIR


@pytest.mark.parametrize("form", FORMS)
def test_delta_frames_events_keep_alives_and_heartbeats(form: Form) -> None:
    messages = (
        DataSetMessage(1, FrameKind.DELTA, (12, 0), ("x", None), indices=(2, 0)),
        DataSetMessage(1, FrameKind.EVENT, (11, 6, 12), (1.5, 2, "y")),
        DataSetMessage(1, FrameKind.KEEP_ALIVE, sequence_number=5),
        DataSetMessage(1, FrameKind.KEY),
    )
    source = Source("2", "group", 1)
    text = encode_data(data(*messages, source=source), [PAIR, PAIR, None, PAIR], form)
    back = decode(text, fields=pair)
    assert back.message.messages == messages
    kinds = [part["MessageType"] for part in json.loads(text)["Messages"]]
    assert kinds == ["ua-deltaframe", "ua-event", "ua-keepalive", "ua-keyframe"]


@pytest.mark.parametrize("form", FORMS)
def test_fields_with_status_and_times_of_their_own(form: Form) -> None:
    values = [
        DataValue(Variant(11, 1.5), 0x4000_0000, NOON, NOON + 1, 3, 4),
        DataValue(None, 0x8031_0000),
        DataValue(Variant(12, "x")),
    ]
    message = with_data_values(DataSetMessage(1), values)
    back = decode(encode_data(data(message, source=Source("2", None, 1)), [PAIR], form), fields=pair)
    assert back.message.messages[0] == message
    assert not back.leniencies


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("kind", "rank"), [(24, -1), (11, -2), (11, -1), (12, -1)])
def test_a_bad_field_of_any_type_stays_bad(kind: int, rank: int, form: Form) -> None:
    field = FieldMetaData("f", kind, value_rank=rank)
    fields = DataSetFields(DataSetMetaData("bad", (field,), ConfigurationVersion(1, 1)))
    payload = fields.encode(fields.writing(form), DataSetMessage(1, types=(19,), values=(0x8031_0000,)))
    read = fields.decode(Reading(), DataSetMessage(1), orjson.loads(orjson.dumps(payload)))
    assert (read.types, read.values) == ((19,), (0x8031_0000,))


def test_old_reversible_and_non_reversible_payloads() -> None:
    reversible = b"""{"MessageId":"1","MessageType":"ua-data","PublisherId":"2","Messages":[{"DataSetWriterId":"1",
        "MetaDataVersion":{"MajorVersion":800000000,"MinorVersion":800000001},"Payload":{
        "a":{"Value":{"Type":11,"Body":1.5},"SourceTimestamp":"2024-01-17T21:20:00Z"},
        "b":{"Type":6,"Body":2},"c":{"Value":{"Type":12,"Body":"x"},"Status":2150694912}}}]}"""
    back = decode(reversible, fields=pair)
    (message,) = back.message.messages
    assert message.encoding == FieldEncoding.DATA_VALUE
    assert (message.types, message.values) == ((11, 6, 12), (1.5, 2, "x"))
    assert message.field_status == (0, 0, 0x8031_0000)
    assert {Leniency.WRITER_ID_TEXT, Leniency.OLD_VARIANT, Leniency.OLD_STATUS_CODE} == set(back.leniencies)
    bare = (
        b'{"a":{"Value":1.5,"Status":{"Code":2150694912,"Symbol":"BadNoCommunication"}},"b":2,"c":{"Code":2150694912}}'
    )
    (message,) = decode(bare, MINIMAL, fields=pair).message.messages
    assert (message.types, message.values) == ((11, 6, 19), (1.5, 2, 0x8031_0000))


def test_without_metadata_a_payload_is_kept_until_it_comes() -> None:
    text = encode_data(data(KEY), [EVERYTHING])
    back = decode(text, fields=no_fields)
    (message,) = back.message.messages
    assert (message.encoding, message.types) == (JSON_PAYLOAD, ())
    assert message.raw is not None
    assert json.loads(message.raw)["Double"] == -0.1
    assert decode_payload(Reading(), message, EVERYTHING) == KEY
    # It goes on as JSON unread, and never as bytes of UADP.
    assert orjson.loads(encode_data(back, [None])) == orjson.loads(text)
    with pytest.raises(LocalWireError):
        Codec().encode(back.message)
    assert decode_raw_fields(message, METADATA) == message


@pytest.mark.parametrize(
    ("version", "is_read"),
    [
        ({"MetaDataVersion": {"MajorVersion": 800_000_000, "MinorVersion": 900_000_000}}, True),
        ({"MetaDataVersion": {"MajorVersion": 800_000_001, "MinorVersion": 800_000_001}}, False),
        ({"MinorVersion": 800_000_001}, True),
        ({"MinorVersion": 800_000_002}, False),
        ({}, True),
    ],
)
def test_a_payload_of_another_version_is_kept(version: dict[str, Any], is_read: bool) -> None:
    text = orjson.dumps({"DataSetWriterId": 1, **version, "Payload": {"a": 1.5, "b": 2, "c": "x"}})
    (message,) = decode(text, fields=pair).message.messages
    assert (message.raw is None) is is_read


def test_fields_are_matched_by_name() -> None:
    (message,) = decode(b'{"Payload":{"c":"x","extra":1,"a":1.5}}', fields=pair).message.messages
    assert (message.types, message.values) == ((11, 0, 12), (1.5, None, "x"))
    assert decode(b'{"Payload":{"extra":1}}', fields=pair).leniencies == {Leniency.UNKNOWN_FIELD: 1}


HEADERS: list[tuple[dict[str, Any], set[Leniency]]] = [
    ({"MessageId": None}, {Leniency.MESSAGE_ID_MISSING}),
    ({"MessageId": 7}, {Leniency.MESSAGE_ID_NUMBER}),
    ({"PublisherId": 2}, {Leniency.PUBLISHER_ID_NUMBER}),
    ({"PublisherId": "0002"}, {Leniency.PUBLISHER_ID_ZEROS}),
    ({"MessageType": None}, {Leniency.MESSAGE_TYPE_MISSING}),
    ({"Messages": None}, {Leniency.MESSAGES_MISSING}),
]


@pytest.mark.parametrize(("change", "leniencies"), HEADERS)
def test_lenient_headers(change: dict[str, Any], leniencies: set[Leniency]) -> None:
    text = orjson.dumps({"MessageId": "1", "MessageType": "ua-data", "PublisherId": "2", "Messages": []} | change)
    back = decode(text)
    assert set(back.leniencies) == leniencies
    assert back.message.publisher_id == "2"


def test_a_text_as_writer_id_is_its_number_or_its_name() -> None:
    (source,) = decode(b'{"DataSetWriterId":"007","Payload":{}}').sources
    assert (source.data_set_writer_id, source.data_set_writer_name) == (7, None)
    (source,) = decode(b'{"DataSetWriterId":"arm","Payload":{}}').sources
    assert (source.data_set_writer_id, source.data_set_writer_name) == (None, "arm")


def test_the_topic_tells_what_headers_do_not() -> None:
    asked: list[Source] = []

    def fields_of(source: Source) -> DataSetFields:
        asked.append(source)
        return PAIR

    topic = Source("2", "group", 7, "arm")
    back = decode(b'{"a":1.0,"b":2,"c":"x"}', MINIMAL, fields_of, topic)
    assert asked == [topic]
    assert (back.message.publisher_id, back.message.messages[0].data_set_writer_id) == ("2", 7)


WRONG: list[tuple[Any, JsonCause]] = [
    (5, JsonCause.SHAPE),
    ([5], JsonCause.SHAPE),
    ({"MessageType": "ua-nonsense", "Messages": []}, JsonCause.MESSAGE_TYPE),
    ({"MessageId": [], "MessageType": "ua-data", "Messages": []}, JsonCause.SHAPE),
    ({"MessageId": "1", "MessageType": "ua-data", "Messages": 5}, JsonCause.SHAPE),
    ({"MessageId": "1", "MessageType": "ua-data", "PublisherId": {}, "Messages": []}, JsonCause.SHAPE),
    ({"DataSetWriterId": 1, "MessageType": "ua-keyframe"}, JsonCause.MISSING),
    ({"DataSetWriterId": 1, "MessageType": "ua-x", "Payload": {}}, JsonCause.MESSAGE_TYPE),
    ({"DataSetWriterId": 65536, "Payload": {}}, JsonCause.VALUE_RANGE),
    ({"DataSetWriterId": 1, "SequenceNumber": 2**32, "Payload": {}}, JsonCause.VALUE_RANGE),
    ({"DataSetWriterId": 1, "MetaDataVersion": 5, "Payload": {}}, JsonCause.SHAPE),
    ({"DataSetWriterId": 1, "Timestamp": "now", "Payload": {}}, JsonCause.VALUE_TEXT),
    ({"DataSetWriterId": 1, "Payload": []}, JsonCause.SHAPE),
    ({"DataSetWriterId": 1, "Payload": {"a": "fast"}}, JsonCause.VALUE_TEXT),
    ({"DataSetWriterId": 1, "Payload": {"b": 1.8446744073709552e19}}, JsonCause.VALUE_RANGE),
]


@pytest.mark.parametrize(("tree", "cause"), WRONG)
def test_what_is_refused(tree: Any, cause: JsonCause) -> None:
    with pytest.raises(RemoteWireError) as caught:
        decode(orjson.dumps(tree), fields=pair)
    assert caught.value.cause == cause


def test_metadata_that_contradicts_itself() -> None:
    double = DataSetMetaData("n", (FieldMetaData("a", 1), FieldMetaData("a", 2)), VERSION)
    with pytest.raises(RemoteWireError, match=JsonCause.METADATA.value):
        DataSetFields(double)
    with pytest.raises(RemoteWireError, match=JsonCause.METADATA.value):
        DataSetFields(DataSetMetaData("n", (FieldMetaData("a", 99),), VERSION))


def test_a_relay_makes_json_of_uadp_and_uadp_of_json() -> None:
    """The same message classes on both sides: a UADP key frame goes to JSON and comes back bit by bit."""
    codec = Codec()
    head = NetworkMessage(2, writer_group_id=2, messages=(KEY._replace(sequence_number=7),))
    datagram = codec.encode(head)
    heard = codec.decode(datagram)
    assert isinstance(heard, NetworkMessage)
    for form in (Form.COMPACT, Form.VERBOSE):
        text = encode_data(JsonData(heard, message_id="r-1"), [EVERYTHING], form)
        back = decode(text).message
        assert back.publisher_id == "2"
        number = publisher_id_number(str(back.publisher_id))
        again = head._replace(publisher_id=number, messages=back.messages)
        assert codec.encode(again) == datagram


@pytest.mark.parametrize(
    ("text", "number"), [("2", 2), ("0", 0), ("02", None), ("", None), ("x", None), ("18446744073709551616", None)]
)
def test_the_number_of_a_publisher_id(text: str, number: int | None) -> None:
    assert publisher_id_number(text) == number


# --- plans


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_plan_writes_what_the_general_way_writes(form: Form, layout: Layout) -> None:
    concrete = [
        (field, code, value) for field, code, value in FIELDS if field.name not in ("Any", "AnyRank", "Variants")
    ]
    fields = DataSetFields(METADATA._replace(fields=tuple([field for field, _, _ in concrete])))
    types = tuple([field.code for field in fields.fields])
    values = tuple([value if code == own else 1.0 for (_, code, value), own in zip(concrete, types, strict=True)])
    plan = JsonWriterPlan(fields, form, layout, SOURCE)
    message = KEY._replace(types=types, values=values)
    for status in (0, 0x8031_0000):
        expected = encode_data(data(message._replace(status=status)), [fields], form, layout)
        assert plan.encode("m-1", 70_000, NOON + 1, status, values) == expected


DOUBLES = DataSetFields(DataSetMetaData("d", tuple([FieldMetaData(f"f{i}", 11) for i in range(50)]), VERSION))


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("count", [1, 50])
def test_a_plan_writes_what_is_not_finite(wrong: float, count: int) -> None:
    fields = DataSetFields(DOUBLES.metadata._replace(fields=DOUBLES.metadata.fields[:count]))
    plan = JsonWriterPlan(fields, Form.VERBOSE, MINIMAL)
    values = (wrong,) + (1.0,) * (count - 1)
    written = json.loads(plan.encode("", 0, 0, 0, values))
    assert written["f0"] in ("NaN", "Infinity", "-Infinity")


@pytest.mark.parametrize("value", ["x", True, None, 10**400])
@pytest.mark.parametrize("count", [1, 50])
def test_a_plan_refuses_what_does_not_fit(value: Any, count: int) -> None:
    fields = DataSetFields(DOUBLES.metadata._replace(fields=DOUBLES.metadata.fields[:count]))
    with pytest.raises(LocalWireError):
        JsonWriterPlan(fields).encode("m", 0, 0, 0, (value,) * count)


def test_a_plan_writes_integers_of_doubles() -> None:
    plan = JsonWriterPlan(DOUBLES, Form.VERBOSE, MINIMAL)
    assert json.loads(plan.encode("", 0, 0, 0, (2,) * 50)) == {f"f{i}": 2.0 for i in range(50)}


@pytest.mark.parametrize(
    "payload",
    [
        {"a": 1.5, "b": 2, "c": "x"},
        {"a": 1, "b": 2, "c": None},
        {"a": None, "b": 2, "c": "x"},
        {"a": "NaN", "b": "2", "c": "x"},
        {"a": {"UaType": 11, "Value": 1.5}, "b": {"UaType": 6, "Value": 2}, "c": {"UaType": 12, "Value": "x"}},
        {"a": {"UaType": 11, "Value": 1.5}, "b": {"UaType": 19, "Value": {"Code": 5}}, "c": {"UaType": 12}},
        {"c": "x", "b": 2, "a": 1.5},
    ],
)
def test_a_plan_reads_what_the_general_way_reads(payload: dict[str, Any]) -> None:
    fields = DataSetFields(PAIR.metadata)
    for _ in range(2):  # the second time the plan that fitted is asked first
        reading, general = Reading(), Reading()
        ours = fields.decode(reading, DataSetMessage(1), payload)
        assert repr(ours) == repr(PAIR.decode_by_names(general, DataSetMessage(1), payload))
        assert reading.leniencies == general.leniencies


def test_a_plan_gives_up_on_a_value_of_too_many_levels() -> None:
    nested = '{"UaType":24,"Value":[' * 400 + "1" + "]}" * 400
    text = f"""{{"MessageId":"m","MessageType":"ua-data","PublisherId":"2","WriterGroupName":"group-2",
        "Messages":[{{"DataSetWriterId":1001,"MessageType":"ua-keyframe","Payload":{{"Path":{{"Any":{nested}}}}}}}]}}"""
    fields = DataSetFields(METADATA._replace(fields=(FieldMetaData("Path", 22, data_type=PATH.data_type),)))
    with pytest.raises(RemoteWireError) as caught:
        decode_json(text.encode(), lambda _source: fields)
    assert caught.value.cause == JsonCause.DEPTH


def test_a_message_that_is_not_put_together_right() -> None:
    with pytest.raises(LocalWireError):
        encode_data(data(KEY._replace(values=None)), [EVERYTHING])  # type: ignore[arg-type] # pyright: ignore[reportArgumentType]
    with pytest.raises(LocalWireError):
        encode_data(data(KEY._replace(timestamp="now")), [EVERYTHING])  # type: ignore[arg-type] # pyright: ignore[reportArgumentType]
