"""Commands of other packages, which are installed here by what their wheels would leave: modules and entry points."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from tests import command_tree, system
from tests.unit.cli.conftest import Invoke
from ua_fleet.cli.app import app

GREET = """
import typer

app = typer.Typer(add_completion=False, rich_markup_mode=None)

@app.command("other-name")
def greet(name: str = "fleet") -> None:
    "Greet somebody."
    print(f"hello, {name}")
"""


class Site:
    """A folder of installed packages."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def install(self, package: str, code: str | None, **commands: str) -> None:
        """A package with a module of its name, or without it for None, and its commands."""
        if code is not None:
            (self.folder / f"{package}.py").write_text(code)
        information = self.folder / f"{package}-1.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        entries = "\n".join(f"{name} = {value}" for name, value in commands.items())
        (information / "entry_points.txt").write_text(f"[ua_fleet.commands]\n{entries}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    """Is forgotten after the test, and what was imported from it, too."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    for name in ("acme_greet", "acme_other"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    command_tree.forget()
    yield Site(folder)
    command_tree.forget()


def test_a_command_of_another_package_is_one_of_ua_fleet(site: Site, invoke: Invoke) -> None:
    site.install("acme_greet", GREET, greet="acme_greet:app")
    assert invoke("greet", "--name", "anna").stdout == "hello, anna\n"
    assert "Usage: ua-fleet greet [OPTIONS]" in invoke("greet", "-h").stdout
    listed = invoke("--help").stdout.splitlines()
    assert [line.split() for line in listed if line.startswith("  greet ")] == [["greet", "Greet", "somebody."]]
    assert "Did you mean 'greet'?" in invoke("gret").stderr


def test_it_is_imported_when_it_is_wanted(site: Site, invoke: Invoke) -> None:
    site.install("acme_greet", GREET, greet="acme_greet:app")
    assert invoke("config", "schema").code == 0
    assert "acme_greet" not in sys.modules
    assert invoke("greet").code == 0
    assert "acme_greet" in sys.modules


@pytest.mark.parametrize(
    ("code", "value", "said"),
    [
        (None, "acme_greet:app", "needs the package acme_greet, which is not installed; install acme_greet again, "),
        ("import acme_needed", "acme_greet:app", "needs the package acme_needed, which is not installed; "),
        (
            "raise ValueError('two\\nlines')",
            "acme_greet:app",
            "cannot be loaded: ValueError: two lines; report this ",
        ),
        ("raise SystemExit(3)", "acme_greet:app", "cannot be loaded: SystemExit: 3; report this to the makers of acme"),
        (GREET, "acme_greet:nothing", "cannot be loaded: AttributeError: "),
        (GREET, "acme_greet:greet", "cannot be loaded: TypeError: acme_greet:greet is no typer.Typer; report"),
        ("import typer\napp = typer.Typer()", "acme_greet:app", "cannot be loaded: "),
    ],
)
def test_a_broken_one_says_so_in_a_line_and_costs_no_other(
    site: Site, invoke: Invoke, code: str | None, value: str, said: str
) -> None:
    site.install("acme_greet", code, greet=value)
    for arguments in ([], ["--help"], ["anna", "--loud", "-x"]):
        ended = invoke("greet", *arguments)
        assert (ended.code, ended.stdout) == (2, "")
        assert ended.stderr.startswith(f"ua-fleet: the command greet {said}")
        assert ended.stderr.count("\n") == 1
    assert "(not available) the command greet " in invoke("--help").stdout
    assert invoke("demo", "pal", "--help").code == invoke("serve", "--help").code == 0


def test_one_that_two_packages_bring_is_neither_s(site: Site, invoke: Invoke) -> None:
    site.install("acme_greet", GREET, greet="acme_greet:app")
    site.install("acme_other", GREET, greet="acme_other:app")
    said = (
        "ua-fleet: the command greet is brought by 2 packages: acme_greet, acme_other; uninstall all but one of them\n"
    )
    assert invoke("greet").stderr == said


def test_no_command_of_ua_fleet_is_replaced(site: Site, invoke: Invoke) -> None:
    site.install("acme_greet", GREET, serve="acme_greet:app")
    assert "Run the OPC UA server of a fleet" in invoke("serve", "--help").stdout
    command: Any = get_command(app)
    assert list(command.commands).count("serve") == 1
    assert len(command.commands) == len(list(command.commands))
    assert "acme_greet" not in sys.modules


@pytest.mark.parametrize("command", ["demo", "simulate", "testbed"])
def test_the_product_goes_without_demonstrations(command: str) -> None:
    folder = str(system.ROOT / "demo")
    code = f"import sys; sys.path.remove({folder!r}); from ua_fleet.cli import main; main()"
    ended = subprocess.run(
        [sys.executable, "-c", code, command, "--once"],
        env=system.clean_environment(PYTHONSAFEPATH="1"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith(f"ua-fleet: the command {command} needs the package ua_demo, ")
    assert ended.stderr.count("\n") == 1
