"""What all tests share: parts of the system that may be missing, and ports that no other run uses."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import structlog

from tests import system

try:
    import hypothesis
except ImportError:  # beside rospy no property is tested
    pass
else:
    # How long an example takes says how busy the machine is, and nothing of what is tested.
    hypothesis.settings.register_profile(
        "untimed", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
    )
    hypothesis.settings.load_profile("untimed")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--require",
        default="",
        help="comma-separated parts of the system whose absence fails the tests that need them, e.g. ros1,ros2",
    )


def pytest_runtest_setup(item: pytest.Item) -> None:
    required = {part for part in str(item.config.getoption("--require")).split(",") if part}
    for marker in item.iter_markers("needs"):
        for part in marker.args:
            reason = system.missing(part)
            if reason is None:
                continue
            if part in required:
                pytest.fail(f"{part} is required and missing: {reason}", pytrace=False)
            pytest.skip(f"{part}: {reason}")


@pytest.fixture(autouse=True)
def _logs_of_one_test(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A command that a test runs in this process sets logs up for its own stderr, and none may outlive that."""
    configure: Any = structlog.configure

    def configure_uncached(**setup: Any) -> None:
        configure(**setup | {"cache_logger_on_first_use": False})

    monkeypatch.setattr(structlog, "configure", configure_uncached)
    for module in (sys, threading):
        monkeypatch.setattr(module, "excepthook", module.excepthook)
    handlers, level = logging.root.handlers[:], logging.root.level
    yield
    structlog.reset_defaults()
    logging.captureWarnings(False)
    logging.root.handlers[:] = handlers
    logging.root.setLevel(level)
    for name in ("ua_fleet", "ua_bridges"):
        logging.getLogger(name).setLevel(logging.NOTSET)


@pytest.fixture
def udp_url() -> str:
    """A PubSub multicast address that no other test uses."""
    return system.free_multicast_url()


@pytest.fixture
def tcp_port() -> int:
    """A free TCP port on loopback."""
    return system.free_tcp_port()


@pytest.fixture
def ros_domain() -> Iterator[int]:
    """A ROS 2 domain id that no other test run on this machine uses at the same time."""
    with system.ros_domain() as domain:
        yield domain


@pytest.fixture
def processes() -> Iterator[system.Processes]:
    """Starts child processes and ends those, and only those, when the test is over."""
    with system.Processes() as started:
        yield started
