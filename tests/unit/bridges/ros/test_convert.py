from __future__ import annotations

import math
from array import array
from types import SimpleNamespace as Message
from typing import Any

import pytest
from ua_bridges.ros import (
    ConversionError,
    compile_reader,
    compile_writer,
    fields_of,
    schema_from_definition,
    schema_from_ros2,
)
from ua_bridges.ros.schema import MessageSchema

ROS2_NAMES = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}

HEADER = "===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
JOINT_STATE = "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + HEADER
TWIST = "Vector3 linear\nVector3 angular\n===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
DIAGNOSTICS = (
    "Header header\nDiagnosticStatus[] status\n" + HEADER + "===\nMSG: diagnostic_msgs/DiagnosticStatus\n"
    "byte OK=0\nbyte level\nstring name\nfloat64 load\nuint8[] raw\nint16[] numbers\ntime when\nKeyValue[] values\n"
    "===\nMSG: diagnostic_msgs/KeyValue\nstring key\nstring value\n"
)
POLYGON = "Point32[] points\nbyte[2] flags\n===\nMSG: p/Point32\nfloat32 x\nfloat32 y\nbyte quality\ntime seen\n"


def ros1(definition: str, name: str = "p/T") -> MessageSchema:
    return schema_from_definition(name, definition)


def ros2(kind: str) -> MessageSchema:
    return schema_from_ros2("p/T", {"p/T": {"data": kind}}.__getitem__)


def make(_name: str) -> Message:
    """An empty message that takes any attribute; nested messages are made on the way."""
    return Message(
        header=Message(stamp=Message(), seq=0),
        seen=Message(),
        when=Message(),
        stamp=Message(),
        linear=Message(),
        angular=Message(),
    )


def write(schema: MessageSchema, *values: Any) -> Any:
    message = make("")
    compile_writer(schema, [field.name for field in fields_of(schema, "p/T")], make)(message, values)
    return message


PRIMITIVES = [
    ("bool", (True, False)),
    ("char", (0, 255)),
    ("int8", (-128, 127)),
    ("uint8", (0, 255)),
    ("int16", (-32768, 32767)),
    ("uint16", (0, 65535)),
    ("int32", (-(2**31), 2**31 - 1)),
    ("uint32", (0, 2**32 - 1)),
    ("int64", (-(2**63), 2**63 - 1)),
    ("uint64", (0, 2**64 - 1)),
    ("float32", (-1.5, 3.4028234663852886e38, math.inf)),
    ("float64", (-1.5, 1.7e308, -math.inf)),
    ("string", ("", "Grüße \U0001f916")),
]


@pytest.mark.parametrize(("kind", "values"), PRIMITIVES)
@pytest.mark.parametrize("ros", [1, 2])
def test_every_primitive_in_both_directions(kind: str, values: tuple[Any, ...], ros: int) -> None:
    schema = ros1(f"{kind} data") if ros == 1 else ros2(ROS2_NAMES.get(kind, kind))
    read = compile_reader(schema)
    for value in values:
        message = write(schema, value)
        assert message.data == value
        assert type(message.data) is type(value)
        assert read(message) == (value,)


@pytest.mark.parametrize(("kind", "values"), [row for row in PRIMITIVES if row[0] not in ("char", "uint8")])
@pytest.mark.parametrize("ros", [1, 2])
def test_arrays_of_every_primitive_in_both_directions(kind: str, values: tuple[Any, ...], ros: int) -> None:
    schema = ros1(f"{kind}[] data") if ros == 1 else ros2(f"sequence<{ROS2_NAMES.get(kind, kind)}>")
    message = write(schema, values)
    assert tuple(message.data) == values
    assert {type(value) for value in message.data} == {type(values[0])}
    assert compile_reader(schema)(message) == (values,)
    assert compile_reader(schema)(write(schema, ())) == ((),)
    assert compile_reader(schema)(write(schema, None)) == ((),)


def test_bytes_have_another_python_type_in_each_ros() -> None:
    octets = bytes((0, 1, 127, 128, 255))
    signed = [0, 1, 127, -128, -1]
    byte1, byte2 = ros1("byte data"), ros2("octet")
    assert [write(byte1, octet).data for octet in octets] == signed
    assert [compile_reader(byte1)(Message(data=value))[0] for value in signed] == list(octets)
    assert [write(byte2, octet).data for octet in octets] == [bytes((octet,)) for octet in octets]
    assert compile_reader(byte2)(Message(data=b"\xff")) == (255,)
    assert write(ros1("byte[] data"), octets).data == signed
    assert compile_reader(ros1("byte[] data"))(Message(data=signed)) == (octets,)
    assert write(ros2("sequence<octet>"), octets).data == [bytes((octet,)) for octet in octets]
    assert compile_reader(ros2("sequence<octet>"))(Message(data=[b"\x00", b"\xff"])) == (b"\x00\xff",)


@pytest.mark.parametrize("kind", ["uint8[]", "char[]", "uint8[3]"])
def test_octets_are_one_byte_string(kind: str) -> None:
    schema = ros1(f"{kind} data")
    for message in (Message(data=b"abc"), Message(data=[97, 98, 99]), Message(data=array("B", b"abc"))):
        assert compile_reader(schema)(message) == (b"abc",)
    assert write(schema, b"abc").data == b"abc"
    assert write(schema, (97, 98, 99)).data == b"abc"
    assert write(ros2("sequence<uint8>"), b"abc").data == array("B", b"abc")
    assert write(ros2("uint8[3]"), b"abc").data == [97, 98, 99]
    assert write(ros1("uint8[] data"), None).data == b""


def test_null_string_becomes_empty() -> None:
    assert write(ros1("string data"), None).data == ""
    assert write(ros1("string[] data"), (None, "a")).data == ["", "a"]


@pytest.mark.parametrize(
    ("kind", "value", "reason"),
    [
        ("int32", math.nan, "field data: nan is not an integer"),
        ("int32", 1.5, "field data: 1.5 is not an integer"),
        ("int32", 2**31, "field data: 2147483648 is not within"),
        ("uint8", -1, "field data: -1 is not within 0..255"),
        ("uint64", 1e30, "is not within"),
        ("int8", True, "a bool is not an integer"),
        ("int8", "1", "a str is not an integer"),
        ("octet", 256, "256 is not within 0..255"),
        ("boolean", 1, "a int is not a bool"),
        ("double", "1", "a str is not a number"),
        ("double", False, "a bool is not a number"),
        ("float", 1e39, "does not fit into a float32"),
        ("string", b"a", "a bytes is not a string"),
        ("string", "a\0b", "NUL"),
        ("string<3>", "äöü", "longer than 3"),
        ("sequence<int16>", (1, math.nan), r"field data[1]: nan is not an integer"),
        ("sequence<int16>", (1, 2, 70000), r"field data[2]: 70000 is not within"),
        ("sequence<double>", (1.0, "a"), "field data[1]: a str is not a number"),
        ("sequence<float>", (1.0, math.inf, 1e39), "field data[2]: 1e+39 does not fit"),
        ("sequence<boolean>", (True, 0), "field data[1]: a int is not a bool"),
        ("sequence<string>", ("a", 1), "field data[1]: a int is not a string"),
        ("sequence<double>", 1.0, "a float is not an array"),
        ("sequence<double>", "text", "a str is not an array"),
        ("sequence<double, 2>", (1.0, 2.0, 3.0), "3 elements, the type has at most 2"),
        ("double[2]", (1.0,), "1 elements, the type has 2"),
        ("uint8[2]", b"abc", "3 elements, the type has 2"),
        ("sequence<uint8>", (1, 256), "field data: "),
        ("sequence<uint8>", "ab", "a str is not a ByteString"),
    ],
)
def test_value_that_does_not_fit_is_refused_and_nothing_is_touched(kind: str, value: Any, reason: str) -> None:
    schema = schema_from_ros2("p/T", {"p/T": {"first": "int8", "data": kind}}.__getitem__)
    message = Message()
    with pytest.raises(ConversionError) as caught:
        compile_writer(schema, ("first", "data"), make)(message, (1, value))
    assert reason in str(caught.value)
    assert vars(message) == {}


def test_integral_floats_go_into_integers() -> None:
    assert write(ros2("int32"), 3.0).data == 3
    assert type(write(ros2("int32"), 3.0).data) is int
    assert write(ros2("sequence<int32>"), (1, 3.0)).data == array("i", (1, 3))
    assert type(write(ros2("double"), 3).data) is float


def test_joint_state() -> None:
    schema = ros1(JOINT_STATE, "sensor_msgs/JointState")
    message = Message(
        header=Message(seq=7, stamp=Message(secs=5, nsecs=6), frame_id="base"),
        name=["a", "b"],
        position=(1.0, 2.0),
        velocity=[],
        effort=array("d", (3.0,)),
    )
    values = compile_reader(schema)(message)
    assert values == (5, 6, "base", ("a", "b"), (1.0, 2.0), (), (3.0,))
    written = write(schema, *values)
    assert (written.header.stamp.secs, written.header.stamp.nsecs, written.header.frame_id) == (5, 6, "base")
    assert written.header.seq == 0
    assert (written.name, written.position, written.effort) == (["a", "b"], [1.0, 2.0], [3.0])


def test_twist() -> None:
    schema = ros1(TWIST, "geometry_msgs/Twist")
    message = Message(linear=Message(x=1.0, y=2.0, z=3.0), angular=Message(x=4.0, y=5.0, z=6.0))
    assert compile_reader(schema)(message) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert write(schema, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0).angular == message.angular


def test_columns_of_an_array_of_messages() -> None:
    schema = ros1(POLYGON)
    values = ((1.0, 2.0), (3.0, 4.0), (255, 1), (5, 6), (7, 8), b"\x01\xff")
    message = write(schema, *values)
    assert [(point.x, point.y, point.quality, point.seen.secs) for point in message.points] == [
        (1.0, 3.0, -1, 5),
        (2.0, 4.0, 1, 6),
    ]
    assert message.flags == [1, -1]
    assert compile_reader(schema)(message) == values
    assert compile_reader(schema)(write(schema, (), (), (), (), (), b"\x01\xff"))[:2] == ((), ())


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        (((1.0,), (1.0, 2.0), (1, 1), (1, 1), (1, 1)), "field points.y: 2 elements, but points.x has 1"),
        (((1.0,), ("a",), (1,), (1,), (1,)), "field points.y[0]: a str is not a number"),
        (((1.0,), 1.0, (1,), (1,), (1,)), "field points.y: a float is not an array"),
        (((1.0,), (1.0,), (1,), (1,), (10**9,)), "field points.seen.nanosec[0]: 1000000000 is not within"),
    ],
)
def test_columns_that_do_not_fit(columns: tuple[Any, ...], reason: str) -> None:
    with pytest.raises(ConversionError) as caught:
        write(ros1(POLYGON), *columns, b"\x01\xff")
    assert reason in str(caught.value)


def test_fixed_array_of_messages_has_its_length() -> None:
    schema = ros1("Point[2] points\n===\nMSG: p/Point\nfloat32 x")
    with pytest.raises(ConversionError, match=r"field points\.x: 1 elements, the type has 2"):
        write(schema, (1.0,))
    with pytest.raises(ConversionError, match=r"field points\.x: 3 elements, the type has 2"):
        compile_reader(schema)(Message(points=[Message(x=1.0)] * 3))


def test_diagnostics_are_json_in_both_directions() -> None:
    schema = ros1(DIAGNOSTICS, "diagnostic_msgs/DiagnosticArray")
    status = Message(
        level=-1,
        name="motör",
        load=math.nan,
        raw=b"\x00\xff",
        numbers=[1, -2],
        when=Message(secs=1, nsecs=2),
        values=[Message(key="temperature", value="20")],
    )
    message = Message(header=Message(stamp=Message(secs=5, nsecs=6), frame_id=""), status=[status])
    values = compile_reader(schema)(message)
    text = (
        '[{"level":255,"name":"motör","load":"NaN","raw":"AP8=","numbers":[1,-2],"when":{"sec":1,"nanosec":2},'
        '"values":[{"key":"temperature","value":"20"}]}]'
    )
    assert values == (5, 6, "", text)
    (written,) = write(schema, *values).status
    assert (written.level, written.name, written.raw, written.numbers) == (-1, "motör", b"\x00\xff", [1, -2])
    assert math.isnan(written.load)
    assert (written.when.secs, written.when.nsecs) == (1, 2)
    assert [(pair.key, pair.value) for pair in written.values] == [("temperature", "20")]


PAIR = '"name":"","load":1.0,"raw":"","numbers":[],"when":{"sec":1,"nanosec":2}'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "field status: not JSON"),
        ("[" * 100_000, "field status: not JSON"),
        ("{}", "field status: the JSON has no array here"),
        ("[1]", "field status[0]: the JSON has no object here"),
        ('[{"level":0}]', "field status[0].name: missing in the JSON"),
        ('[{"level":300,' + PAIR + ',"values":[]}]', "field status[0].level: 300 is not within"),
        (
            '[{"level":0,' + PAIR + ',"values":[{"key":1,"value":""}]}]',
            "status[0].values[0].key: a int is not a string",
        ),
        ('[{"level":0,"name":"","load":1.0,"raw":"?","numbers":[]}]', "field status[0].raw"),
        (5, "a int is not a string with JSON"),
    ],
)
def test_json_that_does_not_fit(text: Any, reason: str) -> None:
    with pytest.raises(ConversionError) as caught:
        write(ros1(DIAGNOSTICS, "diagnostic_msgs/DiagnosticArray"), 5, 6, "", text)
    assert reason in str(caught.value)


def test_empty_message() -> None:
    schema = ros1("", "std_msgs/Empty")
    assert compile_reader(schema)(Message()) == (True,)
    message = Message()
    compile_writer(schema, ("empty",), make)(message, (True,))
    assert vars(message) == {}


def test_times_of_ros1_fit_only_where_both_can_hold_them() -> None:
    schema = ros1("time stamp", "p/Stamped")
    assert compile_reader(schema)(Message(stamp=Message(secs=2**31 - 1, nsecs=999_999_999))) == (2**31 - 1, 999_999_999)
    with pytest.raises(ConversionError, match=r"field stamp\.sec: 2147483648 is not within"):
        compile_reader(schema)(Message(stamp=Message(secs=2**31, nsecs=0)))
    with pytest.raises(ConversionError, match=r"field stamp\.sec: -1 is not within"):
        write(schema, -1, 0)
    negative = ros1("duration stamp", "p/Stamped")
    assert compile_reader(negative)(Message(stamp=Message(secs=-2, nsecs=5))) == (-2, 5)


def test_standalone_time_of_ros1_is_the_message_of_ros2() -> None:
    time1 = ros1("time data", "std_msgs/Time")
    time2 = schema_from_ros2("builtin_interfaces/Time", lambda _: {"sec": "int32", "nanosec": "uint32"})
    values = compile_reader(time1)(Message(data=Message(secs=1, nsecs=2)))
    message = Message()
    compile_writer(time2, ("sec", "nanosec"), make)(message, values)
    assert vars(message) == {"sec": 1, "nanosec": 2}


def test_writer_wants_the_fields_of_its_type() -> None:
    schema = ros1("int8 a\nint8 b")
    with pytest.raises(ConversionError, match="field c: p/T has no such field here"):
        compile_writer(schema, ("a", "b", "c"), make)
    with pytest.raises(ConversionError, match="field b: p/T has this field here, the source has not"):
        compile_writer(schema, ("a",), make)
    message = Message(b=7)
    compile_writer(schema, ("a",), make, partial=True)(message, (1,))
    assert vars(message) == {"a": 1, "b": 7}
    with pytest.raises(ConversionError, match="1 values for 2 fields"):
        compile_writer(schema, ("b", "a"), make)(message, (1,))


def test_message_of_another_type_names_the_field() -> None:
    with pytest.raises(ConversionError, match=r"field linear\.y: .* no attribute 'y'"):
        compile_reader(ros1(TWIST, "geometry_msgs/Twist"))(Message(linear=Message(x=1.0)))
    with pytest.raises(ConversionError, match=r"field data: 1 elements, the type has 2"):
        compile_reader(ros1("float64[2] data"))(Message(data=[1.0]))
    with pytest.raises(ConversionError, match=r"field status: "):
        compile_reader(ros1(DIAGNOSTICS, "diagnostic_msgs/DiagnosticArray"))(
            Message(header=Message(stamp=Message(secs=5, nsecs=6), frame_id=""), status=[Message(level=1)])
        )
