"""`ua-fleet completion`: what a shell needs to complete the commands, their options and the names of contexts."""

from __future__ import annotations

import importlib
import os
import sys
from enum import StrEnum
from typing import Annotated, Any, Final

import typer

__all__ = ["EXAMPLES", "completion", "prepare_completion"]

EXAMPLES = (
    'eval "$(ua-fleet completion bash)"',
    "ua-fleet completion bash > ~/.local/share/bash-completion/completions/ua-fleet",
    "ua-fleet completion zsh > ~/.zfunc/_ua-fleet",
    "ua-fleet completion fish > ~/.config/fish/completions/ua-fleet.fish",
)
_typer: Any = importlib.import_module("typer.completion")
"""Its functions are there for others too, but it declares none."""
_VARIABLE: Final = "_UA_FLEET_COMPLETE"
"""By it the script asks; the framework looks for it under this name."""


class Shell(StrEnum):
    """Shells that have a script."""

    BASH = "bash"
    ZSH = "zsh"
    FISH = "fish"


def completion(shell: Annotated[Shell, typer.Argument(help="The shell.")]) -> None:
    """Print a script by which a shell completes commands, options and the names of contexts.

    Load it in each shell with eval, or put it where the shell looks for it. For zsh, that folder has to be in fpath
    before compinit is called.
    """
    script = _typer.get_completion_script(prog_name="ua-fleet", complete_var=_VARIABLE, shell=shell.value)
    sys.stdout.write(f"{script}\n")


def prepare_completion() -> None:
    """Let the framework answer, where a shell asks."""
    if _VARIABLE in os.environ:
        _typer.completion_init()
