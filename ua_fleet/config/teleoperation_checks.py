"""What is wrong between a robot's teleoperation, its data and its bridge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ua_fleet.config.kinds import known_kinds, model_of_kind
from ua_fleet.config.parts import Parts
from ua_fleet.config.schema import BridgeConfig, DataSetConfig, RobotConfig, ScalarType
from ua_fleet.config.teleoperation_schema import TeleoperationConfig
from ua_fleet.document import KeyPath
from ua_fleet.errors import ConfigError
from ua_fleet.names import closest, listed
from ua_fleet.topics import SERVER_SPACE

__all__ = ["check_setpoint_groups", "check_teleoperation"]

_SPEEDS: Final = (ScalarType.FLOAT, ScalarType.DOUBLE)
_FEWEST_PERIODS: Final = 3
"""Within the robot's own timeout: one lost or late message must not stop it."""
_LONGEST_STOP_S: Final = 30.0
"""A jerk or a deceleration with a digit too few would let the robot run on for minutes after its operator is gone."""


def check_teleoperation(parts: Parts) -> None:
    """Note what is wrong with the teleoperation of each robot."""
    for name, robot in parts.robots.items():
        if robot.teleoperation is not None:
            _check_robot(parts, name, robot, robot.teleoperation)


def check_setpoint_groups(parts: Parts, namespaces: Sequence[int]) -> None:
    """The WriterGroup of a bridge's setpoints is its `status_id`, which no namespace may have as its index."""
    driven = {robot.bridge for robot in parts.robots.values() if robot.teleoperation is not None}
    for name in driven & parts.bridges.keys():
        status_id = parts.bridges[name].status_id
        if status_id in namespaces:
            text = f"{status_id} is the index of a namespace, and setpoints need a WriterGroup of their own"
            parts.document.problem(
                ("bridges", name, "status_id"), text, f"choose another number, above {max(namespaces)}"
            )


def _check_robot(parts: Parts, name: str, robot: RobotConfig, said: TeleoperationConfig) -> None:
    path: KeyPath = ("robots", name, "teleoperation")
    bridge = parts.bridges.get(robot.bridge)
    if bridge is not None:
        _check_bridge(parts, path, robot.bridge, bridge)
    if said.robot_timeout_ms < _FEWEST_PERIODS * said.period_ms:
        text = f"{said.robot_timeout_ms} ms are less than {_FEWEST_PERIODS} periods of {said.period_ms} ms"
        hint = "give the robot more time, or write to it more often (`period_ms`)"
        parts.document.problem((*path, "robot_timeout_ms"), text, hint)
    known = list(parts.mapping_at(("robots", name, "data")))
    if said.data not in known:
        hint = closest(said.data, known) or "name data of origin server with a `sink`"
        parts.document.problem((*path, "data"), f"{name} has no data `{said.data}`", hint)
    elif (data := parts.data.get((name, said.data))) is not None:
        _check_data(parts, path, name, said, data)


def _check_bridge(parts: Parts, path: KeyPath, name: str, bridge: BridgeConfig) -> None:
    if not bridge.takes_setpoints:
        kinds = [kind for kind in known_kinds() if _takes_setpoints(kind)]
        text = f"robots on a bridge of kind {bridge.kind} cannot be driven by hand"
        parts.document.problem(path, text, f"those on bridges of these kinds can: {listed(kinds)}; remove it here")
    elif SERVER_SPACE not in bridge.requestors:
        text = f"the server may not command {name}, so nobody could drive the robot"
        parts.document.problem(path, text, f"add {SERVER_SPACE} to bridges.{name}.requestors")


def _takes_setpoints(kind: str) -> bool:
    try:
        return model_of_kind(kind).takes_setpoints
    except ConfigError:  # installed in part
        return False


def _check_data(parts: Parts, path: KeyPath, robot: str, said: TeleoperationConfig, data: DataSetConfig) -> None:
    problem = parts.document.problem
    own: KeyPath = ("robots", robot, "data", said.data)
    if data.origin != "server":
        problem((*path, "data"), f"`{said.data}` comes from the robot", "name data of origin server, e.g. /cmd_vel")
        return
    if not parts.mapping_at(own).get("sink"):
        text = f"`{said.data}` has no `sink`, so no setpoint reaches the robot"
        problem((*path, "data"), text, "say there where the robot takes it, e.g. `{topic: /cmd_vel, type: ...}`")
    fields = data.all_fields()
    names = {name or "value": field for name, field in fields.items()}
    for name, field in names.items():
        inner: KeyPath = (*own, "fields", name) if data.fields else own
        if field.type not in _SPEEDS or field.array:
            problem((*inner, "type"), "an axis is a single Float or Double", "choose other data for teleoperation")
        if field.initial is not None:
            problem((*inner, "initial"), "what takes setpoints has no initial value: it is zero", "remove it")
        if name not in said.axes:
            text = f"the axis `{name}` of `{said.data}` has no limits"
            problem((*path, "axes"), text, f"add `{name}: {{speed: ..., acceleration: ..., jerk: ...}}`")
    for name, axis in said.axes.items():
        axis_field = names.get(name)
        if axis_field is None:
            hint = closest(name, list(names)) or f"there are: {listed(list(names))}"
            problem((*path, "axes", name), f"`{said.data}` has no field `{name}`", hint)
        elif (stop_s := axis.model().stop_s) > _LONGEST_STOP_S:
            text = f"a stop of this axis may take {stop_s:.3g} s, at most {_LONGEST_STOP_S:g} s are legal"
            hint = "it is acceleration / jerk + speed / deceleration + deceleration / jerk; has one a digit too few?"
            problem((*path, "axes", name), text, hint)
        elif axis_field.range is not None and axis.speed > (most := min(-axis_field.range[0], axis_field.range[1])):
            text = (
                f"{axis.speed:g} is beyond the range of the field, {axis_field.range[0]:g} to {axis_field.range[1]:g}"
            )
            problem((*path, "axes", name, "speed"), text, f"write at most {most:g}, or widen the range")
