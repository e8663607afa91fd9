"""The teleoperation of a fleet from its `fleet.yaml`: what the server and the bridges both have to know."""

from __future__ import annotations

from ua_fleet.config.schema import FleetConfig, RobotConfig
from ua_fleet.teleoperation.messages import datagram_heads
from ua_fleet.teleoperation.model import SetpointAddress, TeleoperationModel
from ua_fleet.topics import SERVER_SPACE, Topic

__all__ = ["setpoint_groups", "setpoint_heads", "teleoperation_model", "teleoperations"]


def setpoint_groups(config: FleetConfig) -> dict[int, int]:
    """The spaces of the bridges whose robots can be driven by hand, by the WriterGroup of their setpoints.

    These WriterGroups are the server's, and are secured with the keys of commands of those spaces.
    """
    driven = {robot.bridge for robot in config.robots.values() if robot.teleoperation is not None}
    bridges = [config.bridges[name] for name in driven]
    return {bridge.status_id: bridge.space for bridge in bridges if bridge.status_id is not None}


def setpoint_heads(config: FleetConfig, space: int) -> frozenset[bytes]:
    """How the datagrams with setpoints for the robots of a space begin, which go before all values."""
    return frozenset(
        head for group, driven in setpoint_groups(config).items() if driven == space for head in datagram_heads(group)
    )


def teleoperation_model(name: str, robot: RobotConfig, space: int, status_id: int | None) -> TeleoperationModel | None:
    """How a robot is driven by hand; None where it is not, or an id is missing.

    Args:
        name: of the robot.
        robot: what `fleet.yaml` says of it.
        space: of its bridge.
        status_id: of its bridge.
    """
    said = robot.teleoperation
    if said is None or status_id is None:
        return None
    data, ns = robot.data[said.data], robot.namespace
    status, acquire, renew, release = said.ids
    if data.id is None or status is None or acquire is None or renew is None or release is None:
        return None
    return TeleoperationModel(
        name,
        Topic(SERVER_SPACE, ns, data.id),
        tuple([(field, said.axes[field].model()) for field in data.field_types()]),
        Topic(space, ns, status),
        SetpointAddress(status_id, status),
        Topic(space, ns, acquire),
        Topic(space, ns, renew),
        Topic(space, ns, release),
        said.deadman_ms / 1000,
        said.robot_timeout_ms / 1000,
        said.period_ms / 1000,
        tuple([field.unit for field in data.all_fields().values()]),
    )


def teleoperations(config: FleetConfig, bridge_name: str) -> tuple[TeleoperationModel, ...]:
    """The robots behind a bridge that are driven by hand."""
    bridge = config.bridges[bridge_name]
    found = [
        teleoperation_model(name, robot, bridge.space, bridge.status_id)
        for name, robot in config.robots.items()
        if robot.bridge == bridge_name
    ]
    return tuple([each for each in found if each is not None])
