"""In which message the data of another space reaches ROS."""

from __future__ import annotations

import json
import math

import pytest
from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.form import form_of, named_types, with_stamp
from ua_bridges.ros.installed import installed_schema
from ua_bridges.ros.schema import schema_from_definition

from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData, FieldMetaData

BELT = Topic(300, 2, 1911)
STATED = """\
version: 1
pubsub: {security: none}
bridges:
  hall: {kind: modbus, space: 300, status_id: 1, devices: {plc: {host: 127.0.0.1}}}
  floor: {kind: ros2, space: 2, status_id: 2}
robots:
  conveyor:
    bridge: hall
    data:
      belt:
        id: 1911
        ros_type: ROS_TYPE
        fields:
          voltage: {type: Float}
          present: {type: Boolean}
        source:
          registers:
            voltage: {table: holding, address: 0, type: float32}
            present: {table: coil, address: 0}
"""


def metadata(*fields: FieldMetaData) -> DataSetMetaData:
    return DataSetMetaData("belt", fields, ConfigurationVersion(1, 1))


def test_without_a_name_several_fields_are_one_text_with_json() -> None:
    kinds = {
        "runs": (BuiltinType.BOOLEAN, True, True),
        "count": (BuiltinType.UINT64, 2**60, 2**60),
        "speed": (BuiltinType.DOUBLE, math.nan, None),
        "label": (BuiltinType.STRING, "Ä\n", "Ä\n"),
        "bytes": (BuiltinType.BYTE_STRING, b"\x00\xff", "AP8="),
        "since": (BuiltinType.DATETIME, ticks_from_unix_ns(0), "1970-01-01T00:00:00+00:00"),
    }
    fields = [make_field(name, kind) for name, (kind, _, _) in kinds.items()]
    fields.append(make_field("position", BuiltinType.DOUBLE, array=True))
    form = form_of(BELT, metadata(*fields), {BELT: ""})
    values = (*[value for _, value, _ in kinds.values()], (0.5, math.inf))
    (text,) = form.values(DataSetMessage(BELT.id, values=values))
    assert (form.ros_type, form.names, form.is_whole) == ("std_msgs/String", ("data",), True)
    assert json.loads(text) == {name: wanted for name, (_, _, wanted) in kinds.items()} | {"position": [0.5, None]}


def test_a_named_type_gets_the_fields_by_their_names_and_the_time_of_the_data() -> None:
    schema = schema_from_definition(
        "robot_msgs/Belt",
        "Header header\nfloat32 speed\nbool runs\n===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n",
    )
    fields = [make_field("runs", BuiltinType.BOOLEAN), make_field("speed", BuiltinType.FLOAT)]
    form = with_stamp(form_of(BELT, metadata(*fields), {BELT: "robot_msgs/msg/Belt"}), schema)
    assert (form.ros_type, form.is_whole) == ("robot_msgs/Belt", False)
    assert form.names == ("runs", "speed", "header.stamp.sec", "header.stamp.nanosec")
    message = DataSetMessage(BELT.id, values=(True, 0.5), timestamp=ticks_from_unix_ns(5_000_000_700))
    assert form.values(message) == (True, 0.5, 5, 700)


def test_what_comes_from_ros_and_single_values_keep_their_types() -> None:
    from_ros = make_field("x", BuiltinType.DOUBLE, properties={"RosType": "geometry_msgs/Point"})
    more = [make_field(name, BuiltinType.DOUBLE) for name in "yz"]
    assert form_of(BELT, metadata(from_ros, *more), {BELT: ""}).ros_type == "geometry_msgs/Point"
    assert form_of(BELT, metadata(make_field("speed", BuiltinType.FLOAT)), {}).ros_type == "std_msgs/Float32"
    with pytest.raises(SchemaInvalid, match="several fields"):  # a bridge's status, say
        form_of(BELT, metadata(*more), {})


def test_the_file_names_types() -> None:
    config = load_content(STATED.replace("ROS_TYPE", "robot_msgs/Belt").encode(), "F", {})
    assert named_types(config) == {BELT: "robot_msgs/Belt"}


def test_a_field_that_the_named_type_has_not_is_told_with_its_line() -> None:
    if installed_schema("sensor_msgs/BatteryState") is None:
        pytest.skip("needs the package sensor_msgs of either ROS")
    content = STATED.replace("ROS_TYPE", "sensor_msgs/BatteryState")
    load_content(content.encode(), "F", {})
    with pytest.raises(ConfigInvalid) as caught:
        load_content(content.replace("voltage", "voltag").encode(), "F", {})
    (problem,) = caught.value.problems
    assert (problem.line, problem.key) == (14, "robots.conveyor.data.belt.fields.voltag")
    assert str(problem).startswith("F:14:robots.conveyor.data.belt.fields.voltag: sensor_msgs/BatteryState has no")
    assert "voltage" in problem.suggestion


def test_a_type_needs_several_fields() -> None:
    content = STATED.replace("ROS_TYPE", "robot_msgs/Belt").replace("present: {type: Boolean}\n", "")
    single = content[: content.index("        fields:")] + "        type: Float\n"
    with pytest.raises(ConfigInvalid, match="ros_type: give `fields`"):
        load_content(single.encode(), "F", {})
