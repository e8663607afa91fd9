from __future__ import annotations

import importlib
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import pytest

from tests.contract.harness import Space
from tests.system import Processes

DRIVERS = {
    "virtual": "tests.contract.virtual",
    "skilled": "tests.contract.skilled",
    "ros1": "tests.contract.ros1",
    "ros2": "tests.contract.ros2",
}
"""Modules as the package's docstring describes them."""
OpenSpace = Callable[[Path, Processes], AbstractAsyncContextManager[Space]]
DEFAULT = "virtual,skilled,ros2"
"""What can run in the main environment: rospy and rclpy cannot share one interpreter."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--drivers", default=DEFAULT, help=f"drivers to test, separated by commas: {', '.join(DRIVERS)}")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "open_space" not in metafunc.fixturenames:
        return
    chosen = str(metafunc.config.getoption("--drivers", default=DEFAULT))  # unknown when tests/ is run as a whole
    params: list[object] = []
    for name in filter(None, chosen.split(",")):
        if name not in DRIVERS:
            raise pytest.UsageError(f"--drivers: there is no driver {name!r}; there are {', '.join(DRIVERS)}")
        module = importlib.import_module(DRIVERS[name])
        marks = [pytest.mark.needs(part) for part in module.NEEDS]
        marks += [pytest.mark.filterwarnings(warning) for warning in module.WARNINGS]
        params.append(pytest.param(module.open_space, id=name, marks=marks))
    metafunc.parametrize("open_space", params)


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
