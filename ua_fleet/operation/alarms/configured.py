"""The alarms that `fleet.yaml` asks for, and those of bridges that are away."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from ua_fleet.config.alarm_schema import AlarmConfig, LimitsConfig, NormalConfig
from ua_fleet.config.alarms import BRIDGE_AWAY, alarms_of
from ua_fleet.config.schema import FleetConfig, value_name
from ua_fleet.fleet.model import BridgeModel, FieldModel, FleetModel
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.alarms.levels import Levels
from ua_fleet.values import NodeId

__all__ = ["AWAY_SEVERITY", "alarm_definitions"]

AWAY_SEVERITY = 700
"""Of bridges that are away, as of robots that are silent."""


def alarm_definitions(config: FleetConfig, model: FleetModel) -> Iterator[AlarmDefinition]:
    """The alarms of a fleet. A robot that is silent has a fault, which is an alarm already."""
    for robot in model.robots:
        robot_config = config.robots.get(robot.name)
        if robot_config is None:
            continue
        for data_set in robot.data_sets:
            data = robot_config.data.get(data_set.name)
            fields = {field.key.identifier: field for field in data_set.fields}
            for _, name, _, alarm in alarms_of(data) if data is not None else ():
                number = data_set.topic.id
                field = fields[f"{number}.{name}" if name else number]
                yield _of_field(robot.name, value_name(data_set.name, name), field, alarm)
    # As long as robots may take to be heard after the start of the server.
    delay_s = max(5.0, 2 * config.pubsub.receive_timeout_s)
    for bridge in model.bridges:
        yield _of_bridge(bridge, delay_s)


def _of_field(robot: str, name: str, field: FieldModel, alarm: AlarmConfig) -> AlarmDefinition:
    levels, normal, kind = Levels(), False, AlarmKind.OFF_NORMAL
    if isinstance(alarm, LimitsConfig):
        kind = AlarmKind.LEVEL
        high, low = alarm.high, alarm.low
        high_high = alarm.high_high
        levels = Levels(
            inf if high is None else high,
            inf if high_high is None else high_high,
            -inf if low is None else low,
            -inf if alarm.low_low is None else alarm.low_low,
            alarm.hysteresis,
        )
    elif isinstance(alarm, NormalConfig):
        normal = alarm.value
    return AlarmDefinition(
        id=f"{robot}.{name}",
        kind=kind,
        source=field.key,
        source_name=f"{robot}.{name}",
        watched=field.key,
        levels=levels,
        normal=normal,
        delay_s=alarm.delay_s,
        severity=alarm.severity,
        needs_confirmation=alarm.confirm,
        unit=field.unit or "",
        robot=robot if alarm.fault is not False else "",
        capacities=() if isinstance(alarm.fault, bool) else alarm.fault,
    )


def _of_bridge(bridge: BridgeModel, delay_s: float) -> AlarmDefinition:
    online: NodeId = bridge.part(BRIDGE_AWAY)
    return AlarmDefinition(
        id=f"{bridge.name}.{BRIDGE_AWAY}",
        kind=AlarmKind.OFF_NORMAL,
        source=online,
        source_name=bridge.name,
        watched=online,
        normal=True,
        delay_s=delay_s,
        severity=AWAY_SEVERITY,
    )
