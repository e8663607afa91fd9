"""What all tests share: parts of the system that may be missing, and ports that no other run uses."""

from __future__ import annotations

import gc
import logging
import os
import resource
import signal
import sys
import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
import structlog

from tests import command_tree, crashes, known_keys, system
from tests.fresh_modules import FreshModules
from tests.postgres import Postgres
from ua_fleet.printing import config_option

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

command_tree.keep()
known_keys.keep()
# What is logged before a program sets its logs up: rich took 0.1 s for each traceback, with all that is in its frames.
structlog.get_config()["processors"][-1].exception_formatter = structlog.dev.plain_traceback

# What tests make mostly ends with them: to look for cycles in it after each 700 objects is computing for nothing.
gc.set_threshold(10_000, 20, 20)

# A shell has what it starts in the background ignore SIGINT, and so would all programs that tests end by it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# nohup does the same to SIGHUP, which a terminal sends that is closed.
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

_FILES: Final = 20_000
"""So many a process of tests may have open, if it can: a user has 1,024 at first, and a flood needs more."""
# Where Debian has mosquitto and ip, which a user's PATH does not name.
os.environ["PATH"] = os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])
_few, _most = resource.getrlimit(resource.RLIMIT_NOFILE)
if 0 <= _few < _FILES and (_most < 0 or _most > _few):
    resource.setrlimit(resource.RLIMIT_NOFILE, (_FILES if _most < 0 else min(_FILES, _most), _most))

CHILDREN: Final = "Child processes of "
"""A report's section."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--require",
        default="",
        help="comma-separated parts of the system whose absence fails the tests that need them, e.g. ros1,ros2",
    )
    parser.addoption(
        "--record-durations", action="store_true", help="write to tests/durations.txt what the files of tests take"
    )
    parser.addoption("--computing", action="store_true", help="show the seconds that each file of tests computes")


def _required(config: pytest.Config) -> set[str]:
    return {part for part in str(config.getoption("--require")).split(",") if part}


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    if unknown := _required(config) - system.PARTS.keys():
        raise pytest.UsageError(
            f"--require: no part of the system is called {', '.join(sorted(unknown))}; "
            f"there are {', '.join(sorted(system.PARTS))}"
        )
    if config.getoption("--record-durations") and not hasattr(config, "workerinput"):
        from tests.schedule import DurationRecorder

        config.pluginmanager.register(DurationRecorder())
    if not hasattr(config, "workerinput") and len(config.getoption("tx", None) or ()) > 1:
        from tests.forked_workers import ForkedWorkers

        config.pluginmanager.register(ForkedWorkers())
    if hasattr(config, "workerinput"):
        gc.disable()
    crashes.ask_less(config)
    config.pluginmanager.register(FreshModules())
    if config.getoption("--computing"):
        from tests import computing

        config.pluginmanager.register(computing.ComputingMeter())
        if not hasattr(config, "workerinput"):
            config.pluginmanager.register(computing.ComputingTable())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """`--dist loadfile` gives out files as `schedule` has it. xdist is not beside rospy."""
    from tests.schedule import KindScheduling

    return KindScheduling(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_collection_finish(session: pytest.Session) -> None:
    """In a process that runs tests garbage collection looks at none of the 16,000 and their modules, nor meanwhile."""
    if hasattr(session.config, "workerinput"):
        gc.freeze()
        gc.enable()


def pytest_runtest_setup(item: pytest.Item) -> None:
    required = _required(item.config)
    for marker in item.iter_markers("needs"):
        for part in marker.args:
            reason = system.missing(part)
            if reason is None:
                continue
            if part in required:
                pytest.fail(f"{part} is required and missing: {reason}", pytrace=False)
            pytest.skip(f"{part}: {reason}")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any]:
    """Whoever reads of a failure reads what the programs said that were at work then."""
    outcome = yield
    report: pytest.TestReport = outcome.get_result()
    if report.failed:
        lines = [line for processes in system.Processes.at_work for line in processes.said_last()]
        if lines:
            report.sections.append((f"{CHILDREN}{item.name}", "\n".join(lines)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """A test that passed when it was repeated is to be mended too: why it failed is told."""
    for report in terminalreporter.stats.get("rerun", []):
        terminalreporter.section(f"{report.nodeid} failed first", sep="_")
        terminalreporter.write_line("\n".join(report.longreprtext.splitlines()[-20:]))
        for name, text in report.sections:
            if name.startswith(CHILDREN):
                terminalreporter.write_line(text)


@pytest.fixture(autouse=True)
def _commands_of_no_file() -> Iterator[None]:
    """A command that a test runs in this process sets which file commands that are printed are about."""
    yield
    config_option(Path(), Path())


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


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL that no test stops; for tests with `needs("postgres")`."""
    with Postgres() as started:
        yield started
