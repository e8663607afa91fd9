"""A command that is printed names the configuration file that the process was started with.

In a folder with `fleet.yaml` and `hall2.yaml`, what is told without `-c hall2.yaml` is done to the other fleet.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
import typer.main

from ua_fleet.cli.app import app

ROOT: Final = Path(__file__).resolve().parents[2]
PACKAGES: Final = ("ua_fleet", "bridges/ua_bridges")
# With the first words that a command may have: `cert create`, `serve`.
COMMAND: Final = re.compile(r"(?<!`)\bua-fleet ([a-z-]+)(?: ([a-z-]+))?(?: ([a-z-]+))?")
ELSEWHERE: Final = {
    "ua_fleet/console/": "the console has a file of its own, which is not the fleet's",
    "ua_fleet/cli/app.py": "an example of `--help`",
    "ua_fleet/cli/login.py": "a client, which knows no file of the server's",
    "ua_fleet/cli/status_text.py": "a client",
    "ua_fleet/client/skills.py": "a client",
}


def commands_of_a_fleet() -> set[tuple[str, ...]]:
    """The commands that take `-c FILE`, by their words."""
    found: set[tuple[str, ...]] = set()

    def walk(command: Any, words: tuple[str, ...]) -> None:
        if any("--config" in getattr(option, "opts", ()) for option in command.params):
            found.add(words)
        for name, inner in getattr(command, "commands", {}).items():
            walk(inner, (*words, name))

    walk(typer.main.get_command(app), ())
    return found


def not_printed(tree: ast.AST) -> Iterator[ast.AST]:
    """Docstrings, examples of `--help`, subjects of certificates, and parts of texts that are looked at whole."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            yield node.value
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if getattr(target, "id", "").endswith("EXAMPLES") or getattr(target, "id", "") == "subject":
                yield from ast.walk(node.value)
        elif isinstance(node, ast.JoinedStr):
            yield from node.values


def without_a_file(path: Path, commands: set[tuple[str, ...]]) -> Iterator[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    left_out = {id(node) for node in not_printed(tree)}
    for node in ast.walk(tree):
        if id(node) in left_out or not isinstance(node, ast.Constant | ast.JoinedStr):
            continue
        text = ast.unparse(node)
        told = [match for match in COMMAND.finditer(text) if any(match.groups()[:end] in commands for end in (1, 2, 3))]
        if len(told) > text.count("config_option()") and "{option}" not in text and "{file}" not in text:
            yield f"{path.relative_to(ROOT)}:{node.lineno}: {text}"


def test_printed_commands_name_the_file() -> None:
    commands = commands_of_a_fleet()
    assert {("serve",), ("cert", "create"), ("keys", "rotate"), ("bridge",)} <= commands
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    wanted = [file for file in files if not str(file.relative_to(ROOT)).startswith(tuple(ELSEWHERE))]
    found = [line for file in wanted for line in without_a_file(file, commands)]
    assert found == []


@pytest.mark.parametrize(
    ("source", "is_found"),
    [
        ('print("run: ua-fleet cert create --renew")', True),
        ('print(f"run: ua-fleet user remove {name}")', True),
        ('print(f"run: ua-fleet user remove {name}{config_option()}")', False),
        ('print("look with: ua-fleet browse")', False),
        ('"""Made by ua-fleet cert create."""', False),
    ],
)
def test_what_lacks_it_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, is_found: bool) -> None:
    file = tmp_path / "printed.py"
    file.write_text(source, encoding="utf-8")
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    assert bool(list(without_a_file(file, commands_of_a_fleet()))) is is_found
