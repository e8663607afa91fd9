"""`scripts/web.py` where it cannot build: it says so in one line, and leaves what is there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import system


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone that was never set up, with a page of before."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "web").mkdir()
    shutil.copy(system.ROOT / "scripts" / "web.py", tmp_path / "scripts")
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(system.ROOT / "web" / name, tmp_path / "web")
    return tmp_path


def built(clone: Path, *options: str, **environment: str) -> tuple[int, str]:
    """The code that it ends with, and what it says."""
    done = subprocess.run(
        [sys.executable, *options, "scripts/web.py"],
        cwd=clone,
        env=system.clean_environment(**environment),
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    return done.returncode, done.stderr


def test_without_the_wheel_of_node_it_says_so(clone: Path) -> None:
    code, said = built(clone, "-S")  # without what is installed
    assert code == 1
    assert said.count("\n") == 1
    assert said.startswith("setup: there is no wheel of Node for this machine")
    assert "the console has no page, all else works" in said


@pytest.mark.needs("npm")
def test_without_a_network_it_says_so_and_leaves_the_page_of_before(clone: Path) -> None:
    page = clone / "ua_fleet" / "console" / "page"
    page.mkdir(parents=True)
    (page / "index.html").write_text("before", encoding="utf-8")
    nowhere = f"http://127.0.0.1:{system.free_tcp_port()}/"
    cache = str(clone / "cache")
    code, said = built(clone, npm_config_registry=nowhere, npm_config_cache=cache, npm_config_fetch_retries="0")
    assert code == 1
    assert said.count("\n") == 1
    assert "npm could not install the packages of web/: " in said
    assert "the console has the page of before" in said
    assert (page / "index.html").read_text(encoding="utf-8") == "before"


@pytest.mark.needs("npm")
def test_what_is_built_costs_nothing_and_says_nothing() -> None:
    subprocess.run([sys.executable, "scripts/web.py"], cwd=system.ROOT, check=True)
    before = os.stat(system.ROOT / "ua_fleet" / "console" / "page" / "index.html").st_mtime_ns
    assert built(system.ROOT, npm_config_registry="http://127.0.0.1:9/") == (0, "")
    assert os.stat(system.ROOT / "ua_fleet" / "console" / "page" / "index.html").st_mtime_ns == before
