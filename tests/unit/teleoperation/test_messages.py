"""What travels, and what is read of what somebody else may have made."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.teleoperation.rigs import ANGULAR, LINEAR, model
from ua_fleet.pubsub.metadata import type_codes
from ua_fleet.skill.executions import pack, unpack
from ua_fleet.teleoperation import Granted, Setpoint, SetpointAddress, State, Status
from ua_fleet.teleoperation.messages import (
    ACQUIRE_RESPONSE,
    STATUS_FIELDS,
    encode_setpoint,
    read_granted,
    read_setpoint,
    read_status,
)
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import FieldEncoding, FrameKind, NetworkMessage

ADDRESS = SetpointAddress(1001, 1003)
SETPOINT = Setpoint(7, 3, 99, (0.25, -1.0))
STATUS = Status(5, State.HELD, 7, "anna", 3, "", (0.1, 0.0), (1, 2, 3, 4))


def test_a_setpoint_is_a_key_frame_of_the_servers_writer_group() -> None:
    message = Codec().decode(encode_setpoint(Codec(), ADDRESS, SETPOINT))
    assert isinstance(message, NetworkMessage)
    assert (message.publisher_id, message.writer_group_id) == (0, 1001)
    (part,) = message.messages
    assert (part.data_set_writer_id, part.kind, part.encoding) == (1003, FrameKind.KEY, FieldEncoding.VARIANT)
    assert part.timestamp is None
    assert read_setpoint(part) == SETPOINT


@pytest.mark.parametrize("values", [(), (0.5,), tuple([0.1] * 40)])
def test_any_number_of_values_arrives(values: tuple[float, ...]) -> None:
    message = Codec().decode(encode_setpoint(Codec(), ADDRESS, SETPOINT._replace(values=values)))
    assert isinstance(message, NetworkMessage)
    read = read_setpoint(message.messages[0])
    assert read is not None
    assert read.values == values


def test_what_is_no_setpoint() -> None:
    message = Codec().decode(encode_setpoint(Codec(), ADDRESS, SETPOINT))
    assert isinstance(message, NetworkMessage)
    (part,) = message.messages
    for other in (
        part._replace(kind=FrameKind.DELTA.value),
        part._replace(types=part.types[:3], values=part.values[:3]),
        part._replace(types=(*part.types[:3], 10)),
        part._replace(valid=False),
        part._replace(types=(), values=()),
    ):
        assert read_setpoint(other) is None


def test_the_grant_has_the_limits_by_the_names_of_the_axes() -> None:
    granted = Granted(7, 12, "ben", model())
    packed = pack(type_codes(ACQUIRE_RESPONSE), granted.fields())
    results = {field.name: one.value for field, one in zip(ACQUIRE_RESPONSE, unpack(packed), strict=True)}
    assert read_granted(results) == (7, 12, ("axis0", "axis1"))
    assert (results["DeadmanMs"], results["RobotTimeoutMs"], results["PeriodMs"]) == (300, 500, 20)
    assert results["StopMs"] == round(max(LINEAR.stop_s, ANGULAR.stop_s) * 1000)
    assert list(results["Speed"]) == [LINEAR.speed, ANGULAR.speed]
    assert list(results["Deceleration"]) == [LINEAR.deceleration, ANGULAR.deceleration]
    for broken in ({}, {**results, "Axes": 3}, {**results, "Axes": [1]}, {**results, "Lease": None}):
        assert read_granted(broken) is None


def test_a_status_is_read_by_the_names_of_its_fields() -> None:
    values: dict[str, Any] = {field.name: one for field, one in zip(STATUS_FIELDS, STATUS.fields(), strict=True)}
    assert read_status(values) == STATUS
    assert read_status({name: values[name] for name in reversed(values)}) == STATUS
    for broken in (
        {},
        {**values, "State": 9},
        {**values, "Counter": -1},
        {**values, "Lease": "7"},
        {**values, "Holder": 5},
        {**values, "Values": 5},
        {**values, "Drops.echo": None},
    ):
        assert read_status(broken) is None
