"""The documentation as files, with what its tests take out of them."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[3]
PAGES: Final = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))

_FENCE = re.compile(r"^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`([^`\n]+)`")


class Block(NamedTuple):
    """A fenced block."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def place(self) -> str:
        """Where it stands, for the name of a test."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(language: str | None = None) -> Iterator[Block]:
    """The fenced blocks of all pages, or those of one language."""
    for page in PAGES:
        content = page.read_text(encoding="utf-8")
        for match in _FENCE.finditer(content):
            if language is None or match["language"] == language:
                line = content.count("\n", 0, match.start()) + 2
                yield Block(page, line, match["language"], match["text"])


def inline_code() -> Iterator[tuple[str, str]]:
    """Each `code` in the running text, after its place."""
    for page in PAGES:
        content = _FENCE.sub(lambda match: "\n" * match[0].count("\n"), page.read_text(encoding="utf-8"))
        for number, line in enumerate(content.splitlines(), 1):
            for match in _INLINE.finditer(line):
                yield f"{page.relative_to(ROOT)}:{number}", match[1]


def script(name: str) -> ModuleType:
    """A program of scripts/, which is no package, as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up there.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
