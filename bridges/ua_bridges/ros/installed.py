"""Which members installed message types have, without importing them: `config check` runs where no ROS is loaded."""

from __future__ import annotations

import ast
import contextlib
import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.leaves import leaves_of
from ua_bridges.ros.schema import MessageSchema, ros1_type_name, schema_from_definition, schema_from_ros2
from ua_fleet.config.schema import RobotConfig
from ua_fleet.document import KeyPath
from ua_fleet.names import closest, listed

__all__ = ["installed_schema", "ros_type_problems"]


def _literal(ros_type: str, file: str, name: str) -> Any:
    """What the generated module of a message type assigns to a name; KeyError without such a module."""
    package = ros_type.split("/", maxsplit=1)[0]
    spec = PathFinder.find_spec(package)
    for place in (spec.submodule_search_locations if spec is not None else None) or ():
        path = Path(place) / "msg" / f"{file}.py"
        with contextlib.suppress(OSError, SyntaxError, ValueError):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Assign) and any(
                    isinstance(to, ast.Name) and to.id == name for to in node.targets
                ):
                    return ast.literal_eval(node.value)
    raise KeyError(ros_type)


def _ros2_fields(ros_type: str) -> Mapping[str, str]:
    name = ros_type.rsplit("/", 1)[1]
    words = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", name))
    fields: dict[str, str] = _literal(ros_type, f"_{words.lower()}", "_fields_and_field_types")
    return fields


@cache
def installed_schema(ros_type: str) -> MessageSchema | None:
    """A type `pkg/Name` as ROS 2 or ROS 1 has it here; None where neither has."""
    with contextlib.suppress(KeyError, SchemaInvalid):
        return schema_from_ros2(ros_type, _ros2_fields)
    with contextlib.suppress(KeyError, SchemaInvalid):
        native = ros1_type_name(ros_type)
        return schema_from_definition(native, _literal(native, f"_{native.rsplit('/', 1)[1]}", "_full_text"))
    return None


def ros_type_problems(robots: Mapping[str, RobotConfig], bridge: str) -> Iterator[tuple[KeyPath, str, str]]:
    """Fields of data that reaches a bridge's space as a `ros_type` which has no member of their name.

    Nothing is said of a type that is not installed here: the bridge may run on another machine.
    """
    for robot_name, robot in robots.items():
        for name, data in robot.data.items():
            comes_from_here = robot.bridge == bridge and data.origin == "robot"
            if data.ros_type is None or comes_from_here:
                continue
            schema = installed_schema(data.ros_type.replace("/msg/", "/"))
            if schema is None:
                continue
            there = [leaf.name for leaf in leaves_of(schema)]
            for field in data.fields:
                if field not in there:
                    text = f"{schema.name} has no member `{field}`, so `ros_type` cannot carry it"
                    hint = f"{closest(field, there)} it has: {listed(there)}".strip()
                    yield ("robots", robot_name, "data", name, "fields", field), text, hint
