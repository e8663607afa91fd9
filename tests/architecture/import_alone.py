"""Imports each named module as the first of its circle of imports, and says which cannot be.

import_alone.py MODULE=FILE ...        prints a line `MODULE: reason` for each that fails

A module that is in no circle is imported once, after what it imports: for it no order can be wrong. Those of a circle
(a package and the modules that it offers are one) are imported each in a process of its own.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import os
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

SHARED = ("asyncua", "cryptography.x509", "pydantic", "rich.console", "structlog", "typer", "yaml")
"""Only our own modules are to be new in each process."""
NOT_HERE = frozenset({"rclpy", "rospy", "rosgraph", "roslib", "genpy", "genmsg"})
"""What belongs to another environment or to an extra."""


def reason_against(module: str) -> str | None:
    """Why the module cannot be imported; None when it can, or when its environment is another one."""
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        missing = (error.name or "").split(".", 1)[0]
        return None if missing in NOT_HERE else str(error)
    except Exception:  # noqa: BLE001 - whatever a module does when it is imported is what we want to know
        return traceback.format_exc().strip().splitlines()[-1]
    return None


def imports(body: Sequence[ast.AST]) -> Iterator[ast.Import | ast.ImportFrom]:
    """The imports that are carried out when a module is imported, or more."""
    for statement in body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            yield statement
        elif isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING":
            yield from imports(statement.orelse)
        elif not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from imports(list(ast.iter_child_nodes(statement)))


def with_packages(name: str) -> set[str]:
    """A module and the packages that it is in: they are imported before it."""
    parts = name.split(".")
    return {".".join(parts[:count]) for count in range(1, len(parts) + 1)}


def graph(files: Mapping[str, Path]) -> dict[str, set[str]]:
    """What each module imports of the others."""
    found: dict[str, set[str]] = {}
    for module, file in files.items():
        names = with_packages(module)
        for statement in imports(ast.parse(file.read_text(encoding="utf-8")).body):
            source = statement.module if isinstance(statement, ast.ImportFrom) else None
            for each in statement.names:
                names |= with_packages(f"{source}.{each.name}" if source else each.name)
        found[module] = (names & files.keys()) - {module}
    return found


def circles(edges: Mapping[str, set[str]]) -> list[list[str]]:
    """The modules in circles, and the others alone, each after what it imports (Tarjan's algorithm)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    path: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        number[module] = lowest[module] = len(number)
        path.append(module)
        for other in sorted(edges[module]):
            if other not in number:
                visit(other)
            if other in path:
                lowest[module] = min(lowest[module], lowest[other])
        if lowest[module] == number[module]:
            start = path.index(module)
            found.append(path[start:])
            del path[start:]

    for module in edges:
        if module not in number:
            visit(module)
    return found


def imported_by(module: str) -> set[str]:
    """Import a module in a fork of this process, and say so if that fails; the modules that it is the package of."""
    reader, writer = os.pipe()
    if os.fork() == 0:
        reason = reason_against(module)
        if reason is not None:
            print(f"{module}: {reason}", flush=True)
        os.write(writer, "\n".join(name for name in sys.modules if name.startswith(f"{module}.")).encode())
        os._exit(0)
    os.close(writer)
    with open(reader) as loaded:
        names = set(loaded.read().split())
    os.wait()
    return names


def main(files: Mapping[str, Path]) -> None:
    """Import all; a circle's modules each in a fork of this process, which has what the circle imports.

    What a package imports itself needs no fork: whoever imports it alone imports the package first.
    """
    for name in SHARED:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(name)
    for circle in circles(graph(files)):
        tried: set[str] = set()
        for module in sorted(circle) if len(circle) > 1 else ():
            if module not in tried:
                tried |= imported_by(module)
        for module in circle:
            reason = reason_against(module)
            if reason is not None and len(circle) == 1:
                print(f"{module}: {reason}", flush=True)


if __name__ == "__main__":
    main({module: Path(file) for module, _, file in (word.partition("=") for word in sys.argv[1:])})
