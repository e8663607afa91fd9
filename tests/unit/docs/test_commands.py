"""Every `ua-fleet ...` that the pages show is a command that exists, with options that it has."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any, Final

import pytest
import typer
from typer.core import TyperGroup
from typer.main import get_command

from tests.unit.docs.pages import blocks, inline_code
from ua_fleet.cli.app import app

COMMAND: Final[Any] = get_command(app)
"""Typed as anything: its class is click's or, in newer releases of typer, a copy of that."""
USAGE_ERROR = typer.BadParameter.__mro__[1]
_SHELL = {"", "sh", "bash", "console"}
_PROGRAM = re.compile(r"^(\S*/)?ua-fleet$")


def _words(line: str) -> list[str]:
    """The arguments of a line that runs `ua-fleet`; none for other lines."""
    words = shlex.split(line.removeprefix("$ "), comments=True)
    while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
        del words[0]
    # What the shell does with the output is no argument.
    end = next((at for at, word in enumerate(words) if word in (">", "|")), len(words))
    return words[1:end] if words and _PROGRAM.match(words[0]) else []


def shown() -> Iterator[tuple[str, list[str], bool]]:
    """Place, arguments, and whether it is a whole command line."""
    for block in blocks():
        for offset, line in enumerate(block.text.splitlines()):
            if block.language in _SHELL and "ua-fleet" in line and (words := _words(line)):
                yield f"{block.page.name}:{block.line + offset}", words, True
    for place, code in inline_code():
        if code.startswith("ua-fleet ") and (words := _words(code)):
            yield place, words, False


def check(command: Any, words: list[str], *, is_whole: bool) -> None:
    """Raise USAGE_ERROR, or fail, where the words are no legal use of the command."""
    path = "ua-fleet"
    while isinstance(command, TyperGroup) and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"{path} has no command {words[0]!r}, but {', '.join(command.commands)}"
        path += f" {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    if isinstance(command, TyperGroup):
        assert not is_whole or words == ["--help"], f"{path} needs a command"
        return
    # In running text a command may be named without its arguments.
    words = [word for word in words if word != "--help"]
    context = command.make_context(path, words, resilient_parsing=not is_whole)
    assert not context.args


@pytest.mark.parametrize(("words", "is_whole"), [pytest.param(*rest, id=place) for place, *rest in shown()])
def test_command_exists(words: list[str], is_whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("UA_FLEET_CONFIG", "UA_FLEET_ENDPOINT", "UA_FLEET_USER"):
        monkeypatch.delenv(variable, raising=False)
    check(COMMAND, words, is_whole=is_whole)


def test_commands_are_found() -> None:
    lines = [words for _, words, _ in shown()]
    assert ["user", "add", "anna", "--role", "operator"] in lines
    assert any(words[:2] == ["user", "add"] for words in lines)


@pytest.mark.parametrize("words", [["no-such-command"], ["serve", "--no-such-option"], ["bridge"], ["demo", "nothing"]])
def test_mistakes_are_seen(words: list[str]) -> None:
    with pytest.raises((USAGE_ERROR, AssertionError)):
        check(COMMAND, words, is_whole=True)
