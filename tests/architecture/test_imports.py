from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.system import ROOT

ROOTS = {"ua_fleet": ROOT, "ua_bridges": ROOT / "bridges"}
PATHS = f"import sys; sys.path[:0] = {[str(path) for path in ROOTS.values()]!r}"


def modules() -> list[str]:
    """All our modules but programs (`__main__`, and the demonstration's robots, which run when they are imported)."""
    found: list[str] = []
    for package, root in ROOTS.items():
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if parts[-1] != "__main__" and "robots" not in parts:
                found.append(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return found


@pytest.mark.timeout(300)  # a process for each module: a busy machine needs minutes
def test_each_module_can_be_imported_alone() -> None:
    program = Path(__file__).with_name("import_alone.py")
    environment = {"PYTHONPATH": ":".join(str(path) for path in ROOTS.values()), "PATH": "/usr/bin:/bin"}
    run = subprocess.run(
        [sys.executable, program, *modules()], capture_output=True, text=True, check=True, env=environment
    )
    assert run.stdout.splitlines() == []


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("ua_fleet.bridge", "asyncua rclpy rospy"),
        ("ua_fleet.bridge.runner", "asyncua rclpy rospy"),
        ("ua_bridges.ros", "asyncua rclpy rospy genpy numpy asyncio"),
        ("ua_bridges.ros1.config", "asyncua rclpy rospy genpy"),
        ("ua_bridges.ros2.config", "asyncua rclpy rospy"),
        ("ua_bridges.ros2.driver", "asyncua rclpy rospy"),
        ("ua_bridges.modbus.config", "asyncua pymodbus serial rclpy"),
        ("ua_fleet.registers", "pydantic pymodbus asyncio"),
        ("ua_fleet.modbus.gateway", "pymodbus"),
        ("ua_fleet.config.schema", "asyncua rclpy rospy structlog"),
        ("ua_fleet.wire", "asyncua pydantic structlog asyncio socket"),
        ("ua_fleet.pubsub", "asyncua pydantic structlog asyncio socket"),
    ],
)
def test_heavy_packages_stay_where_they_are_needed(module: str, unwanted: str) -> None:
    code = f"{PATHS}; import {module}; print(*(name for name in {unwanted.split()!r} if name in sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def test_rooms_depend_downwards_only() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    if not linter.exists():
        pytest.skip("import-linter is not installed; run: make setup-test")
    run = subprocess.run([linter, "--no-cache"], capture_output=True, text=True, check=False, cwd=ROOT)
    assert run.returncode == 0, run.stdout
