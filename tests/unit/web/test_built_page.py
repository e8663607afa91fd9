"""The page that `scripts/web.py` builds: its size, what its files hold, and that sdist and wheel have it."""

from __future__ import annotations

import gzip
import json
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Final

import pytest

from tests import system

PAGE: Final = system.ROOT / "ua_fleet" / "console" / "page"
MOST_BYTES: Final = 250_000
"""Script of the first page, compressed."""

pytestmark = pytest.mark.needs("npm")


@pytest.fixture(scope="module", autouse=True)
def _built() -> None:
    subprocess.run([sys.executable, "scripts/web.py"], cwd=system.ROOT, check=True)


def first_scripts() -> set[str]:
    """What is loaded until the first page is there: the entry, the Fleet page, and what they import."""
    manifest = json.loads((PAGE / ".vite" / "manifest.json").read_text(encoding="utf-8"))
    found: set[str] = set()
    waiting = ["index.html", "src/pages/fleet/Fleet.svelte"]
    while waiting:
        chunk = manifest[waiting.pop()]
        if chunk["file"] not in found:
            found.add(chunk["file"])
            waiting += chunk.get("imports", [])
    return found


def test_the_first_page_s_script_is_small() -> None:
    sizes = {name: len(gzip.compress((PAGE / name).read_bytes())) for name in first_scripts()}
    assert len(sizes) >= 2
    assert sum(sizes.values()) <= MOST_BYTES, sizes


def test_each_file_of_text_is_there_compressed() -> None:
    for path in (path for path in PAGE.rglob("*") if path.suffix in (".js", ".css") and path.stat().st_size >= 1024):
        assert gzip.decompress(Path(f"{path}.gz").read_bytes()) == path.read_bytes()
        assert Path(f"{path}.br").stat().st_size < path.stat().st_size


def test_the_page_has_neither_inline_code_nor_foreign_addresses() -> None:
    html = (PAGE / "index.html").read_text(encoding="utf-8")
    assert re.findall(r"<script(?![^>]*\ssrc=)[^>]*>|<style|\son\w+=|\sstyle=", html) == []
    addresses = re.findall(r"(?:src|href)=\"([^\"]*)\"", html)
    assert addresses
    assert [one for one in addresses if not one.startswith("./")] == []
    for sheet in PAGE.rglob("*.css"):
        assert re.findall(r"url\((?!\./)[^)]*\)|@import", sheet.read_text(encoding="utf-8")) == []


def _build(folder: Path, *arguments: str) -> None:
    """Build sdist or wheel with the build system alone: with no Node in reach."""
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", *arguments],
        cwd=folder,
        env=system.clean_environment(PATH="/nowhere"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def _page_of(names: list[str]) -> set[str]:
    return {name.partition("ua_fleet/console/page/")[2] for name in names if "ua_fleet/console/page/" in name}


def test_sdist_and_wheel_have_the_page_and_the_demonstrations_and_need_no_node(tmp_path: Path) -> None:
    wanted = {path.relative_to(PAGE).as_posix() for path in PAGE.rglob("*") if path.is_file()}
    demo = system.ROOT / "demo"
    demonstrations = {
        path.relative_to(demo).as_posix() for path in demo.rglob("*.*") if path.suffix in (".py", ".yaml")
    }
    _build(system.ROOT, "--target", "sdist", "--directory", str(tmp_path))
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = archive.getnames()
    # `extractall` takes a filter in some releases of Python 3.11 only, and must have one in later ones.
    subprocess.run(["tar", "-xzf", sdist, "-C", tmp_path], check=True)
    assert _page_of(names) == wanted
    assert [name for name in names if "node_modules" in name] == []
    (source,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert (source / "web" / "package-lock.json").exists()
    _build(source, "--target", "wheel", "--directory", str(tmp_path))
    (wheel,) = tmp_path.glob("*.whl")
    built = zipfile.ZipFile(wheel)
    assert _page_of(built.namelist()) == wanted
    assert "ua_demo/talkrobots/fleet.template.yaml" in demonstrations
    assert demonstrations <= set(built.namelist())
    (joined,) = (name for name in built.namelist() if name.endswith(".dist-info/entry_points.txt"))
    assert "[ua_fleet.commands]\ndemo = ua_demo.commands.demo:app\n" in built.read(joined).decode()
