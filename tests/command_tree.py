"""The tree of commands, which typer makes anew each time that a command is run, made once.

To make it takes 0.06 s of computing, more than most commands that tests run do with it.
"""

from __future__ import annotations

import functools
from typing import Any

import typer.main
import typer.testing

__all__ = ["forget", "keep"]

_MADE_BY: tuple[tuple[Any, str], ...] = ((typer.main, "get_command"), (typer.testing, "_get_command"))


def keep() -> None:
    """Have the tree of an application made once in this process, and be there in those that are forked off it."""
    for module, name in _MADE_BY:
        if not hasattr(getattr(module, name), "cache_info"):
            setattr(module, name, functools.cache(getattr(module, name)))


def forget() -> None:
    """Have the tree made anew when it is wanted next, since packages with commands have come or gone."""
    for module, name in _MADE_BY:
        if (clear := getattr(getattr(module, name), "cache_clear", None)) is not None:
            clear()
