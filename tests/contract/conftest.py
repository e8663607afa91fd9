from __future__ import annotations

import importlib
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import pytest

from tests.contract.harness import DrivenSpace, MappedSpace, SkilledSpace, Space
from tests.system import Processes

DRIVERS = {
    "virtual": "tests.contract.virtual",
    "skilled": "tests.contract.skilled",
    "modbus": "tests.contract.modbus",
    "plugged": "tests.contract.plugged",
    "ros1": "tests.contract.ros1",
    "ros2": "tests.contract.ros2",
    "tcp": "tests.contract.tcp",
    "direct": "tests.contract.direct",
    "ur": "tests.contract.ur",
}
"""Modules as the package's docstring describes them."""
OPENS = ("open_space", "open_mapped_space", "open_skilled_space", "open_driven_space")
OpenSpace = Callable[[Path, Processes], AbstractAsyncContextManager[Space]]
OpenMappedSpace = Callable[[Path, Processes], AbstractAsyncContextManager[MappedSpace]]
OpenDrivenSpace = Callable[[Path, Processes], AbstractAsyncContextManager[DrivenSpace]]
OpenSkilledSpace = Callable[[Path, Processes], AbstractAsyncContextManager[SkilledSpace]]
DEFAULT = "virtual,skilled,modbus,plugged,ros2,tcp,direct,ur"
"""What can run in the main environment: rospy and rclpy cannot share one interpreter."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--drivers", default=DEFAULT, help=f"drivers to test, separated by commas: {', '.join(DRIVERS)}")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    opens = next((name for name in OPENS if name in metafunc.fixturenames), None)
    if opens is None:
        return
    chosen = str(metafunc.config.getoption("--drivers", default=DEFAULT))  # unknown when tests/ is run as a whole
    params: list[object] = []
    for name in filter(None, chosen.split(",")):
        if name not in DRIVERS:
            raise pytest.UsageError(f"--drivers: there is no driver {name!r}; there are {', '.join(DRIVERS)}")
        module = importlib.import_module(DRIVERS[name])
        if not hasattr(module, opens):
            continue
        marks = [pytest.mark.needs(part) for part in module.NEEDS]
        marks += [pytest.mark.filterwarnings(warning) for warning in module.WARNINGS]
        params.append(pytest.param(getattr(module, opens), id=name, marks=marks))
    metafunc.parametrize(opens, params)


@pytest.fixture
async def absent_space(open_space: OpenSpace, tmp_path: Path, processes: Processes) -> AsyncIterator[Space]:
    """The space of one driver, with its robots' side not up yet."""
    async with open_space(tmp_path, processes) as opened:
        yield opened


@pytest.fixture
async def space(absent_space: Space) -> Space:
    """The space of one driver, with a robot in it."""
    absent_space.appear()
    return absent_space


@pytest.fixture
async def absent_mapped_space(
    open_mapped_space: OpenMappedSpace, tmp_path: Path, processes: Processes
) -> AsyncIterator[MappedSpace]:
    """The space of a driver whose robots have no topics, with its robot not up yet."""
    async with open_mapped_space(tmp_path, processes) as opened:
        yield opened


@pytest.fixture
async def mapped_space(absent_mapped_space: MappedSpace) -> MappedSpace:
    """The same, with a robot in it."""
    absent_mapped_space.appear()
    return absent_mapped_space


@pytest.fixture
async def skilled_space(
    open_skilled_space: OpenSkilledSpace, tmp_path: Path, processes: Processes
) -> AsyncIterator[SkilledSpace]:
    """A space whose robot has a skill."""
    async with open_skilled_space(tmp_path, processes) as opened:
        yield opened


@pytest.fixture
async def driven_space(
    open_driven_space: OpenDrivenSpace, tmp_path: Path, processes: Processes
) -> AsyncIterator[DrivenSpace]:
    """A space whose robot can be driven by hand, and does not listen yet."""
    async with open_driven_space(tmp_path, processes) as opened:
        yield opened
