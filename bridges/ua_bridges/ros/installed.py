"""Which members installed message types have, without importing them: `config check` runs where no ROS is loaded."""

from __future__ import annotations

import ast
import contextlib
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.leaves import leaves_of
from ua_bridges.ros.schema import MessageSchema, ros1_type_name, schema_from_definition, schema_from_ros2
from ua_fleet.config.schema import RobotConfig
from ua_fleet.document import KeyPath
from ua_fleet.names import closest, listed

__all__ = ["Missing", "folders_of", "installed_schema", "look_up", "ros_type_problems", "schema_of", "types_of"]

_SYSTEM: Final[Mapping[int, tuple[str, ...]]] = {
    1: ("/usr/lib/python3/dist-packages", "/opt/ros/*/lib/python*/dist-packages"),
    2: ("/opt/ros/*/lib/python*/site-packages", "/opt/ros/*/local/lib/python*/dist-packages"),
}
"""Where Debian and the ROS distributions put the messages of each ROS, in the order in which they count."""
_ROS2_NAME = re.compile(r"^from \S+\._\w+ import (\w+)", re.MULTILINE)


class Missing(NamedTuple):
    """A message type that is not here."""

    package: str
    types: tuple[str, ...]
    """Those that the package has here, as `pkg/Name`; none where the package is not here either."""


def folders_of(ros: Literal[1, 2]) -> list[Path]:
    """Where messages of a ROS may be: this interpreter's folders, those of the environment of the other ROS beside it
    (`.venv` and `.venv-ros1`), and those of the system.
    """
    own = [Path(place) for place in sys.path if place]
    name = sys.prefix.removesuffix(_OF_ROS1)
    beside = Path(f"{name}{_OF_ROS1}" if ros == 1 else name)
    places = [*own, *beside.glob("lib/python*/site-packages")]
    for pattern in _SYSTEM[ros]:
        places += sorted(Path("/").glob(pattern.removeprefix("/")))
    return list(dict.fromkeys(places))


_OF_ROS1: Final = "-ros1"
"""What the name of the second environment ends with; see docs/install.md."""


def _modules(package: str, ros: Literal[1, 2]) -> Iterator[Path]:
    """The folders of a package's messages."""
    for place in folders_of(ros):
        folder = place / package / "msg"
        if folder.is_dir():
            yield folder


def _literal(ros_type: str, file: str, name: str, ros: Literal[1, 2]) -> Any:
    """What the generated module of a message type assigns to a name; KeyError without such a module."""
    for folder in _modules(ros_type.split("/", maxsplit=1)[0], ros):
        with contextlib.suppress(OSError, SyntaxError, ValueError):
            for node in ast.walk(ast.parse((folder / f"{file}.py").read_text(encoding="utf-8"))):
                if isinstance(node, ast.Assign) and any(
                    isinstance(to, ast.Name) and to.id == name for to in node.targets
                ):
                    return ast.literal_eval(node.value)
    raise KeyError(ros_type)


def _ros2_fields(ros_type: str) -> Mapping[str, str]:
    name = ros_type.rsplit("/", 1)[1]
    words = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", name))
    fields: dict[str, str] = _literal(ros_type, f"_{words.lower()}", "_fields_and_field_types", 2)
    return fields


@cache
def schema_of(ros_type: str, ros: Literal[1, 2]) -> MessageSchema | None:
    """A type `pkg/Name` as one ROS has it here; None where it has not, or the type has no flat form."""
    with contextlib.suppress(KeyError, SchemaInvalid):
        if ros == 2:
            return schema_from_ros2(ros_type, _ros2_fields)
        native = ros1_type_name(ros_type)
        return schema_from_definition(native, _literal(native, f"_{native.rsplit('/', 1)[1]}", "_full_text", 1))
    return None


def installed_schema(ros_type: str) -> MessageSchema | None:
    """A type `pkg/Name` as ROS 2 or ROS 1 has it here; None where neither has."""
    return schema_of(ros_type, 2) or schema_of(ros_type, 1)


@cache
def types_of(package: str, ros: Literal[1, 2]) -> tuple[str, ...]:
    """The message types that a package has here in one ROS, as `pkg/Name`, sorted; none where it is not here."""
    found: set[str] = set()
    for folder in _modules(package, ros):
        with contextlib.suppress(OSError, UnicodeDecodeError):
            made = (folder / "__init__.py").read_text(encoding="utf-8")
            if ros == 2:
                found.update(_ROS2_NAME.findall(made))
            elif "import *" in made:
                found.update(file.stem[1:] for file in folder.glob("_[A-Z]*.py"))
    return tuple(sorted(f"{package}/{name}" for name in found))


def look_up(ros_type: str, ros: Literal[1, 2]) -> MessageSchema | Missing | None:
    """A type as one ROS has it here, or what is here in its place; None for one that is here and has no flat form."""
    name = ros_type.replace("/msg/", "/")
    if (schema := schema_of(name, ros)) is not None:
        return schema
    package = name.partition("/")[0]
    types = types_of(package, ros)
    return None if name in types else Missing(package, types)


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
