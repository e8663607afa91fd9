"""The site as `make docs` builds it, elsewhere."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from tests import system
from tests.unit.docs.pages import ROOT


def _built(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict"],
        cwd=folder,
        env=system.clean_environment(),
        capture_output=True,
        text=True,
        check=False,
    )


def build(folder: Path) -> Path:
    """Build the site of a copy of all pages: the generator has no option for where to, and leaves a cache."""
    shutil.copytree(ROOT / "docs", folder / "docs")
    shutil.copy(ROOT / "mkdocs.yml", folder)
    built = _built(folder)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "build" / "site"


def build_fails(folder: Path) -> str:
    """What is said of the pages of a folder that cannot be built."""
    built = _built(folder)
    assert built.returncode != 0
    return built.stdout + built.stderr
