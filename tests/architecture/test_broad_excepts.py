"""What catches every exception and goes on says why, on its line: else a mistake of ours would go unseen."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from tests.architecture.statements import statements
from tests.architecture.test_sizes import name_of, sources

BROAD: Final = {"Exception", "BaseException"}
FEWEST_WORDS: Final = 2
"""Of a reason; `as above` is one."""


def has_reason(line: str) -> bool:
    """Whether a comment says something, beside what it says to ruff."""
    return len(re.findall(r"\w+", line.partition("#")[2].replace("noqa: BLE001", ""))) >= FEWEST_WORDS


def is_broad(handler: ast.ExceptHandler) -> bool:
    caught = handler.type
    names = caught.elts if isinstance(caught, ast.Tuple) else [caught]
    return any(name is None or (isinstance(name, ast.Name) and name.id in BROAD) for name in names)


def broad_excepts(text: str) -> Iterator[tuple[int, str]]:
    """The lines of those that do not end with `raise`."""
    lines = text.splitlines()
    for node in statements(ast.parse(text)):
        if isinstance(node, ast.ExceptHandler) and is_broad(node) and not isinstance(node.body[-1], ast.Raise):
            yield node.lineno, lines[node.lineno - 1]


def test_a_broad_except_that_goes_on_says_why() -> None:
    found = {
        f"{name_of(path)}:{number}": line
        for path in sources()
        if "except" in (text := path.read_text("utf-8"))  # most files need not be parsed
        for number, line in broad_excepts(text)
    }
    assert len(found) > 50
    assert {place: line for place, line in found.items() if not has_reason(line)} == {}


def test_what_says_nothing_is_found() -> None:
    silent = "try:\n    run()\nexcept Exception:  # noqa: BLE001\n    pass\n"
    ((number, line),) = broad_excepts(silent)
    assert number == 3
    assert not has_reason(line)
    ((_, told),) = broad_excepts(silent.replace("BLE001", "BLE001 - the others are asked all the same"))
    assert has_reason(told)
    assert not list(broad_excepts(silent.replace("pass", "raise")))
    assert list(broad_excepts(silent.replace("Exception", "(OSError, Exception)")))
