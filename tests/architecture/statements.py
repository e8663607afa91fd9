"""The statements of a file, without the expressions in them, which are most of its tree."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final, cast

__all__ = ["statements"]

_BODIES: Final = ("body", "orelse", "finalbody", "handlers", "cases")
"""What holds statements, or clauses with statements of their own."""


def statements(parent: ast.AST) -> Iterator[ast.AST]:
    """All statements beneath this one at any depth, with the clauses of `try` and `match`."""
    for name in _BODIES:
        held: object = getattr(parent, name, None)
        for node in cast("list[ast.AST]", held) if isinstance(held, list) else ():  # a lambda's `body` is an expression
            yield node
            yield from statements(node)
