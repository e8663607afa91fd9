"""Pyright is strict in all of the product but where a package without types is touched: these are its files."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from tests.architecture.statements import statements
from tests.architecture.test_sizes import name_of, sources

UNTYPED: Final = frozenset(
    {"asyncpg", "asyncua", "dbus_fast", "matplotlib", "pymodbus", "pyudev", "serial"}
    | {"actionlib", "rclpy", "rosgraph", "rospy"}
    | {"dashboard_client", "rtde_control", "rtde_io", "rtde_receive", "script_client"}
)
"""Packages without types, or with some that are not known."""
OF_ROS: Final = ("bridges/ua_bridges/ros1/", "bridges/ua_bridges/ros2/")
"""Where objects of ROS, which has no types, are handed on."""
RELAXED: Final = re.compile(r"^# pyright: (?:basic|.*reportUnknown)", re.MULTILINE)


def imported(tree: ast.Module) -> Iterator[str]:
    for node in statements(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def test_only_what_touches_a_package_without_types_is_not_strict() -> None:
    product = [path for path in sources() if name_of(path).startswith(("ua_fleet/", "bridges/"))]
    texts = {name_of(path): path.read_text("utf-8") for path in product}
    relaxed = {name: text for name, text in texts.items() if RELAXED.search(text) and not name.startswith(OF_ROS)}
    assert relaxed
    packages = {name: {each.partition(".")[0] for each in imported(ast.parse(text))} for name, text in relaxed.items()}
    assert {name for name, imports in packages.items() if not imports & UNTYPED} == set()
