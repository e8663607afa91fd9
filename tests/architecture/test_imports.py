from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.system import ROOT

ROOTS = {"ua_fleet": ROOT, "ua_bridges": ROOT / "bridges", "ua_demo": ROOT / "demo"}
PATHS = f"import sys; sys.path[:0] = {[str(path) for path in ROOTS.values()]!r}"


def modules() -> dict[str, Path]:
    """All our modules but programs (`__main__`, and the demonstration's robots, which run when they are imported)."""
    found: dict[str, Path] = {}
    for package, root in ROOTS.items():
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if parts[-1] != "__main__" and "robots" not in parts:
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def refused(files: dict[str, Path], *roots: Path) -> list[str]:
    """What cannot be imported alone, with the reason."""
    program = Path(__file__).with_name("import_alone.py")
    environment = {"PYTHONPATH": ":".join(map(str, roots)), "PATH": "/usr/bin:/bin"}
    words = [f"{module}={file}" for module, file in files.items()]
    run = subprocess.run([sys.executable, program, *words], capture_output=True, text=True, check=True, env=environment)
    return run.stdout.splitlines()


@pytest.mark.timeout(300)  # a busy machine needs minutes
def test_each_module_can_be_imported_alone() -> None:
    assert refused(modules(), *ROOTS.values()) == []


def test_a_module_that_cannot_be_the_first_of_its_circle_is_found(tmp_path: Path) -> None:
    package = {"__init__": "", "front": "from acme.back import X", "back": "import acme.front\nX = 1"}
    package["broken"] = "from acme.front import Y"
    files = {f"acme.{name}".removesuffix(".__init__"): tmp_path / "acme" / f"{name}.py" for name in package}
    (tmp_path / "acme").mkdir()
    for name, text in package.items():
        (tmp_path / "acme" / f"{name}.py").write_text(text)
    assert [line.partition(":")[0] for line in refused(files, tmp_path)] == ["acme.back", "acme.broken"]


UNWANTED = {
    "ua_fleet.wire": "asyncua pydantic structlog asyncio socket",
    "ua_fleet.pubsub": "asyncua pydantic structlog asyncio socket",
    "ua_fleet.registers": "pydantic pymodbus asyncio",
    "ua_bridges.ros": "asyncua rclpy rospy genpy numpy asyncio",
    "ua_demo.commands.demo": "asyncua pydantic yaml cryptography rclpy structlog",
    "ua_demo.commands.simulate": "asyncua pydantic yaml cryptography rclpy structlog",
    "ua_demo.commands.testbed": "asyncua pydantic yaml cryptography rclpy structlog",
    "ua_fleet.config.schema": "asyncua rclpy rospy structlog",
    "ua_fleet.bridge": "asyncua rclpy rospy",
    "ua_fleet.bridge.runner": "asyncua rclpy rospy",
    "ua_bridges.ros1.config": "asyncua rclpy rospy genpy",
    "ua_bridges.ros2.config": "asyncua rclpy rospy",
    "ua_bridges.ros2.driver": "asyncua rclpy rospy",
    "ua_bridges.modbus.config": "asyncua pymodbus serial rclpy",
    "ua_fleet.modbus.gateway": "pymodbus",
}
"""Of modules: those that import least come first."""


def imported_with(modules: Iterable[str]) -> list[list[str]]:
    """What each brings of what it must not, imported one after the other in one process."""
    code = "".join(
        f"import {module}; print(*(name for name in {UNWANTED[module].split()!r} if name in sys.modules))\n"
        for module in modules
    )
    run = subprocess.run([sys.executable, "-c", f"{PATHS}\n{code}"], capture_output=True, text=True, check=True)
    return [line.split() for line in run.stdout.splitlines()]


@pytest.fixture(scope="module")
def imported_together() -> dict[str, list[str]]:
    return dict(zip(UNWANTED, imported_with(UNWANTED), strict=True))


@pytest.mark.parametrize("module", UNWANTED)
def test_heavy_packages_stay_where_they_are_needed(module: str, imported_together: dict[str, list[str]]) -> None:
    # What is not there after others were imported too is not there without them. What is may be of one before it.
    assert not imported_together[module] or imported_with([module]) == [[]]


def test_rooms_depend_downwards_only() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    if not linter.exists():
        pytest.skip("import-linter is not installed; run: make setup-test")
    run = subprocess.run([linter, "--no-cache"], capture_output=True, text=True, check=False, cwd=ROOT)
    assert run.returncode == 0, run.stdout
