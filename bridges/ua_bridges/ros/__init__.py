"""What the ROS 1 and the ROS 2 bridge share: message types as flat fields. Pure, imports no ROS.

Use it in this order:

    schema = schema_from_definition("pkg/Name", text)            ROS 1, the text of the connection header
    schema = schema_from_ros2("pkg/Name", field_types)           ROS 2, dictionaries of get_fields_and_field_types()
    fields_of(schema, canonical_type_name(...), definition)      for SourceFound
    read = compile_reader(schema); read(message)                 for SampleRead, in the order of fields_of
    ros_type, definition, names = ros_type_of(metadata.fields)   the type to publish another space's data as, or None
    ros1_type_name(ros_type)                                     its name in ROS 1
    write = compile_writer(schema, names, make); write(message, values)
    write = compile_sink(schema, [(name, path), ...])            mapped topics; reading them: `mapping.MappedSource`

`make(name)` gives an empty message of a type by its own ROS's name (`time` and `duration` in ROS 1 too). Data of space
0 has no RosType; compile its writer with `partial=True`, since the std_msgs for arrays also have a layout.
Errors: SchemaInvalid (count TYPE_MISSING), ConversionError (count CONVERSION); both name their place.

Fields. Names are those of ROS 2; where ROS 1 has capital letters, they are small on the wire.

    scalar                                       linear.x
    array of a primitive                         position           an array
    array of messages whose leaves are scalars   points.x           an array for each leaf, all of one length
    array of other messages                      status             a String with JSON
    message without members                      empty              Boolean, true
    std_msgs/Float64                             data

Types.

    ROS 1         ROS 2                          on the wire
    bool          bool                           Boolean
    byte (int8)   byte (one octet)               Byte, the same 8 bits
    char (uint8)  char (uint8)                   Byte
    int8          int8                           SByte
    uint8         uint8                          Byte
    int16..uint64 int16..uint64                  Int16..UInt64
    float32/64    float32/64                     Float, Double
    string        string, wstring, string<=N     String; null becomes empty
    T[], T[N]     T[], T[N], T[<=N]              array of T; of another length than N, or longer: ConversionError
    uint8[], char[], byte[] and with N           ByteString
    time          builtin_interfaces/Time        stamp.sec Int32, stamp.nanosec UInt32; in ROS 1 until 2038, as in ROS 2
    duration      builtin_interfaces/Duration    the same two
    std_msgs/Time      builtin_interfaces/Time   sec, nanosec (RosType builtin_interfaces/Time)
    std_msgs/Duration  builtin_interfaces/Duration
    Header, roslib/Header  std_msgs/Header       header.seq is left out; ROS 1 gets 0
    pkg/Name      pkg/msg/Name                   property RosType `pkg/Name`

A constant of a definition is no field. A float goes into an integer only when it has no fraction and is in range.
"""

from ua_bridges.ros.convert import Make, Reader, Writer, compile_reader, compile_writer
from ua_bridges.ros.errors import ConversionError, SchemaInvalid
from ua_bridges.ros.fields import fields_of, ros_type_of, std_type_for
from ua_bridges.ros.schema import (
    Member,
    MessageSchema,
    canonical_type_name,
    compact_definition,
    ros1_type_name,
    schema_from_definition,
    schema_from_ros2,
)
from ua_bridges.ros.sink import compile_sink

__all__ = [
    "ConversionError",
    "Make",
    "Member",
    "MessageSchema",
    "Reader",
    "SchemaInvalid",
    "Writer",
    "canonical_type_name",
    "compact_definition",
    "compile_reader",
    "compile_sink",
    "compile_writer",
    "fields_of",
    "ros1_type_name",
    "ros_type_of",
    "schema_from_definition",
    "schema_from_ros2",
    "std_type_for",
]
