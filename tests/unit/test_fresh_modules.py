"""After a test that failed, the fixtures of its module are new ones."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests import system

CONFTEST = """
from tests.fresh_modules import FreshModules
def pytest_configure(config):
    config.pluginmanager.register(FreshModules())
"""
TESTS = """
import pytest
import pytest_asyncio
ended = []
@pytest.fixture(scope="session")
def house():
    yield []
    ended.append("house")
@pytest.fixture(scope="module")
def hall(house):
    yield []
    ended.append("hall")
@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot(hall):
    yield []
    ended.append("robot")
@pytest.mark.asyncio(loop_scope="module")
async def test_spoilt(house, hall, robot):
    for one in (house, hall, robot):
        one.append("spoilt")
    assert len(hall) + len(robot) == 2 and len(house) == 2
@pytest.mark.asyncio(loop_scope="module")
async def test_next(hall, robot):
    assert (hall, robot) == (["spoilt"], ["spoilt"]), "what passed leaves all as it is"
    pytest.skip("nothing to see")
def test_last(hall, robot):
    assert (hall, robot) == (["spoilt"], ["spoilt"]), "and so does what was skipped"
    assert ended == ["robot", "hall"], "what stands on another ends before it"
"""


def test_a_test_that_is_repeated_begins_with_new_fixtures(tmp_path: Path) -> None:
    for name, text in {"conftest": CONFTEST, "test_all": TESTS}.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    options = ("-p", "no:cacheprovider", "--reruns", "1", "-o", "asyncio_mode=strict", ".")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=tmp_path,
        env=system.clean_environment(PYTHONPATH=str(system.ROOT)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert "2 passed, 1 skipped, 1 rerun" in done.stdout, done.stdout + done.stderr
