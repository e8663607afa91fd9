"""Commands and groups of them, all in the same form: without colours, with their examples at the end of their help."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup

__all__ = ["add_command", "command_group"]


def command_group(help_text: str = "", *, cls: type[TyperGroup] = TyperGroup) -> typer.Typer:
    """A group without commands; one that stays with a single command is that command."""
    return typer.Typer(
        cls=cls,
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["--help", "-h"]},
        help=help_text,
    )


def add_command(group: typer.Typer, name: str, command: Callable[..., Any], examples: tuple[str, ...]) -> None:
    """Add a command, whose docstring is its help."""
    shown = "\n".join(f"  {example}" for example in examples)
    group.command(name, help=f"{inspect.getdoc(command)}\n\n\b\nExamples:\n{shown}")(command)
