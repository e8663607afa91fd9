"""The reference of the command line as Markdown, made from the application itself.

`python -m ua_fleet.cli.reference` prints it; with a file it is put between the file's two markers.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from typer.core import TyperGroup
from typer.main import get_command

from ua_fleet.cli.app import app
from ua_fleet.cli.options import ConnectionOptions, connecting
from ua_fleet.config.reference import show_or_put

__all__ = ["BEGIN", "END", "reference"]

BEGIN: Final = "<!-- reference: made by `python -m ua_fleet.cli.reference docs/command-line.md` -->"
END: Final = "<!-- end of the reference -->"

_EXAMPLES: Final = "\n\n\b\nExamples:\n"
_CONNECTION: Final = "Options of a connection"


@connecting
def _nothing(connection: ConnectionOptions) -> None:
    """Only for its options."""


_SHARED: Final = frozenset(inspect.signature(_nothing).parameters)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _prose(text: str) -> str:
    """A text in which nothing outside of `code` is taken for HTML, and no line for a heading."""
    parts = text.split("`")
    plain = "`".join(part if place % 2 else part.replace("<", "&lt;") for place, part in enumerate(parts))
    return re.sub("^#", r"\\#", plain, flags=re.MULTILINE)


def _records(command: Any) -> dict[str, tuple[str, str]]:
    """What a command tells of its parameters itself; their types are those of the help."""
    # Typed as anything: these classes are click's or, in newer releases of typer, a copy of that.
    context = command.make_context(command.name, [], resilient_parsing=True)
    told = {parameter.name: parameter.get_help_record(context) for parameter in command.params}
    return {name: record for name, record in told.items() if record is not None}


def _table(records: Iterable[tuple[str, str]]) -> str:
    lines = ["| option | |", "|---|---|"]
    for name, text in records:
        # A bar between choices would end the cell, and not everybody takes a backslash in code for an escape.
        lines.append(f"| `{_cell(name.replace('|', '/'))}` | {_prose(_cell(text))} |")
    return "\n".join(lines)


def _parts(command: Any, path: str, depth: int, shared: Mapping[str, tuple[str, str]]) -> Iterator[str]:
    text, _, examples = (command.help or "").partition(_EXAMPLES)
    yield f"{'#' * depth} `{path}`\n\n{_prose(text.strip())}"
    if isinstance(command, TyperGroup):
        for name in command.commands:
            yield from _parts(command.commands[name], f"{path} {name}", depth + 1, shared)
        return
    if examples:
        yield "```sh\n" + "\n".join(line.strip() for line in examples.splitlines()) + "\n```"
    records = _records(command)
    connects = shared.keys() <= records.keys()
    own = [record for name, record in records.items() if not connects or record != shared.get(name)]
    if own:
        yield _table(own)
    if connects:
        yield f"And the [options of a connection](#{_CONNECTION.lower().replace(' ', '-')})."


def reference() -> str:
    """All commands with their options and examples."""
    command: Any = get_command(app)
    shared = {name: record for name, record in _records(command.commands["read"]).items() if name in _SHARED}
    parts: list[str] = []
    for name in command.commands:
        parts += _parts(command.commands[name], f"ua-fleet {name}", 2, shared)
    parts.append(f"## {_CONNECTION}\n\n{_table(shared.values())}")
    return "\n\n".join(parts)


if __name__ == "__main__":
    show_or_put(sys.argv[1:], reference(), BEGIN, END)
