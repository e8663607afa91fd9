"""The index of messages: what is printed, its cause, its remedy.

`python scripts/troubleshooting.py docs/troubleshooting.md` puts it into the page. It is read out of the source:
each error class (its docstring is the cause, its `remedy` the remedy) with the texts that it is raised with, and each
warning or error of the logs. A text's own remedy, after a semicolon, goes first.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final

from ua_fleet.config.reference import show_or_put
from ua_fleet.drop_meanings import drop_meanings, is_loss

ROOT: Final = Path(__file__).resolve().parents[1]
BEGIN: Final = "<!-- index: made by `python scripts/troubleshooting.py docs/troubleshooting.md` -->"
END: Final = "<!-- end of the index -->"

_PACKAGES: Final = ("ua_fleet", "bridges/ua_bridges")
_ROOT_ERROR: Final = "UaFleetError"
_GAP: Final = "…"
_FEWEST_LETTERS: Final = 10
# A peer's bytes and our own encoder: what is printed of the first is the cause of a drop, which has a table of its own.
_NOT_PRINTED: Final = ("LocalWireError", "RemoteWireError")
# The robots and machines of tests and demonstrations.
_NOT_OURS: Final = re.compile(r"simulator|/demo/|ua_demo")
# Where pydantic makes a problem of fleet.yaml or of a scenario out of a ValueError, and what notes one.
_SCHEMAS: Final = re.compile(r"^ua_fleet/(config|scenario)/|/config\.py$")
_NOTING: Final = ("problem", "_problem")
_LEVELS: Final = ("warning", "error")


@dataclass(frozen=True, order=True)
class Message:
    """What may be printed, with gaps where values stand."""

    text: str
    remedy: str
    error: str
    """The class's name."""


@dataclass(frozen=True, order=True)
class LogLine:
    """An event of a log that is worth a look."""

    text: str
    remedy: str
    level: str
    fields: tuple[str, ...]


@dataclass
class Error:
    """A class of the error tree."""

    name: str
    bases: tuple[str, ...]
    cause: str
    own_remedy: str


@dataclass
class Module:
    """A file, with what its texts need."""

    path: str
    constants: dict[str, str]
    classes: list[ast.ClassDef] = field(default_factory=list[ast.ClassDef])
    calls: list[ast.Call] = field(default_factory=list[ast.Call])


def _name_of(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _shape(text: str) -> str:
    """A text in one line, in which gaps beside each other are one."""
    return re.sub(rf"{_GAP}[\s{_GAP}]*{_GAP}", _GAP, " ".join(text.split()))


class Sources:
    """All modules of the product."""

    def __init__(self, root: Path = ROOT) -> None:
        files = [file for package in _PACKAGES for file in sorted((root / package).rglob("*.py"))]
        self.modules = [_read(file, str(file.relative_to(root))) for file in files]
        # Constants of the errors' own module stand in texts everywhere.
        self.shared = next(one.constants for one in self.modules if one.path == "ua_fleet/errors.py")

    @cached_property
    def errors(self) -> dict[str, Error]:
        """The classes of the tree, by name; of two with the same name, which share their meaning, the first."""
        found: dict[str, Error] = {}
        for module in self.modules:
            for node in module.classes:
                if node.name not in found:
                    bases = tuple(map(_name_of, node.bases))
                    cause = (ast.get_docstring(node) or "").split("\n\n")[0]
                    own = dict(_constants(node)).get("remedy", "")
                    found[node.name] = Error(node.name, bases, " ".join(cause.split()), own)
        return {name: error for name, error in found.items() if _ROOT_ERROR in (name, *_ancestors(error, found))}

    def remedy(self, error: str) -> str:
        """That of the class, or of the nearest one above."""
        lineage = [self.errors[error], *(self.errors[name] for name in _ancestors(self.errors[error], self.errors))]
        return next((one.own_remedy for one in lineage if one.own_remedy), "")

    def is_printed(self, error: str) -> bool:
        """Whether its texts are worth a line."""
        return not {error, *_ancestors(self.errors[error], self.errors)} & set(_NOT_PRINTED)

    def messages(self) -> list[Message]:
        """All texts of all errors."""
        found: set[Message] = set()
        for module in self.modules:
            if not _NOT_OURS.search(module.path):
                for node in module.calls:
                    if error := self._error_of(node, module):
                        for text in _texts_of(node, module.constants | self.shared):
                            found |= set(self._message(text, error))
        # A text that is raised with a remedy of its own elsewhere has that one.
        helped = {(one.text, one.error) for one in found if one.remedy != self.remedy(one.error)}
        general = {one for one in found if one.remedy == self.remedy(one.error) and (one.text, one.error) in helped}
        return sorted(found - general)

    def log_lines(self) -> list[LogLine]:
        """All warnings and errors of the logs."""
        found: set[LogLine] = set()
        for module in self.modules:
            if not _NOT_OURS.search(module.path):
                for node in module.calls:
                    if _is_logged(node):
                        assert isinstance(node.func, ast.Attribute)
                        fields = tuple(keyword.arg for keyword in node.keywords if keyword.arg)
                        for text in _variants(node.args[0], module.constants | self.shared):
                            event, _, remedy = _shape(text).partition("; ")
                            if _is_greppable(event):
                                found.add(LogLine(event, remedy, node.func.attr, fields))
        return sorted(found)

    def _error_of(self, call: ast.Call, module: Module) -> str:
        name = _name_of(call.func)
        if name in self.errors and self.is_printed(name):
            return name
        notes = isinstance(call.func, ast.Attribute) and name in _NOTING and len(call.args) > 1
        is_schema = name == "ValueError" and _SCHEMAS.search(module.path)
        return "ConfigError" if notes or is_schema else ""

    def _message(self, text: str, error: str) -> Iterator[Message]:
        said, _, remedy = _shape(text).partition("; ")
        if _is_greppable(said):
            yield Message(said, remedy if _is_greppable(remedy) else self.remedy(error), error)


def _read(file: Path, path: str) -> Module:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    module = Module(path, dict(_constants(tree)))
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            module.classes.append(node)
        elif isinstance(node, ast.Call):
            module.calls.append(node)
    return module


def _ancestors(error: Error, classes: dict[str, Error]) -> list[str]:
    """Names of the classes above, nearest first."""
    found: list[str] = []
    for base in error.bases:
        if base in classes and base != error.name:
            found += [base, *_ancestors(classes[base], classes)]
    return found


def _constants(node: ast.Module | ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Names that stand for one text."""
    for statement in node.body:
        target = statement.target if isinstance(statement, ast.AnnAssign) else None
        if isinstance(statement, ast.Assign) and len(statement.targets) == 1:
            target = statement.targets[0]
        value = statement.value if isinstance(statement, ast.Assign | ast.AnnAssign) else None
        if isinstance(target, ast.Name) and isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield target.id, value.value


def _variants(node: ast.expr, constants: dict[str, str]) -> list[str]:
    """The texts that an expression can be, with gaps for what is not known; none where it is no text at all."""
    if isinstance(node, ast.Constant):
        return [node.value] if isinstance(node.value, str) else []
    if isinstance(node, ast.Call) and _name_of(node.func) == "config_option":
        return [""]  # ` -c FILE` where the process was started so
    if isinstance(node, ast.Name):
        return [constants[node.id]] if node.id in constants else []
    if isinstance(node, ast.IfExp):
        return _variants(node.body, constants) + _variants(node.orelse, constants)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        sides = [_variants(side, constants) or [_GAP] for side in (node.left, node.right)]
        return [left + right for left in sides[0] for right in sides[1]]
    if isinstance(node, ast.JoinedStr):
        texts = [""]
        for part in node.values:
            inner = part.value if isinstance(part, ast.FormattedValue) else part
            texts = [text + piece for text in texts for piece in _variants(inner, constants) or [_GAP]]
        return texts
    return []


def _texts_of(call: ast.Call, constants: dict[str, str]) -> list[str]:
    """What an error is made with: its text, and the suggestion where that is given apart."""
    positional = [_variants(argument, constants) for argument in call.args if not isinstance(argument, ast.Starred)]
    named = {word.arg: _variants(word.value, constants) for word in call.keywords}
    if _name_of(call.func) in _NOTING:
        # Where it is, what is wrong, and what to do.
        texts, suggestions = positional[1] if len(positional) > 1 else [], positional[2] if len(positional) > 2 else []
    else:
        texts = next((found for found in positional if found), named.get("message", []))
        suggestions = named.get("suggestion", [])
    return [f"{text}; {suggestion}" for text in texts for suggestion in suggestions] if suggestions else texts


def _is_logged(call: ast.Call) -> bool:
    is_ours = isinstance(call.func, ast.Attribute) and call.func.attr in _LEVELS and bool(call.args)
    return is_ours and _name_of(call.func.value) in ("_log", "log", "_logger", "logger")  # type: ignore[attr-defined]


def _is_greppable(text: str) -> bool:
    return sum(character.isalpha() for character in text) >= _FEWEST_LETTERS


def _code(text: str) -> str:
    """As code in a cell: a text that has backticks itself stands between two of them."""
    fence = "``" if "`" in text else "`"
    space = " " if fence == "``" else ""
    return f"{fence}{space}{text}{space}{fence}".replace("|", "\\|")


def _prose(text: str) -> str:
    """A text in which nothing outside of `code` is taken for HTML, and no bar ends the cell."""
    parts = text.replace("|", "\\|").split("`")
    return "`".join(part if place % 2 else part.replace("<", "&lt;") for place, part in enumerate(parts))


def index(sources: Sources) -> str:
    """The index as Markdown: a section for each class that is printed, then the lines of the logs."""
    parts = ["## Messages of commands, Methods and logs\n"]
    messages = sources.messages()
    for name in sorted({message.error for message in messages}, key=lambda name: name.strip("_").lower()):
        cause = sources.errors[name].cause
        parts.append(f"### {name.strip('_')}\n\n{_prose(cause)} {_prose(sources.remedy(name))}\n")
        parts.append("| message | cause | remedy |\n|---|---|---|")
        parts += [
            f"| {_code(message.text)} | {_prose(cause)} | {_prose(message.remedy)} |"
            for message in messages
            if message.error == name
        ]
        parts.append("")
    parts.append("## Lines of logs\n\n| line | level | what it names | remedy |\n|---|---|---|---|")
    for line in sources.log_lines():
        fields = ", ".join(f"`{one}`" for one in line.fields)
        parts.append(f"| {_code(line.text)} | {line.level} | {fields} | {_prose(line.remedy)} |")
    parts.append("\n## Causes of dropped messages\n\n| cause | meaning | is something lost |\n|---|---|---|")
    for drop, meaning in drop_meanings().items():
        parts.append(f"| `{drop}` | {_prose(meaning)} | {'yes' if is_loss(drop) else 'no'} |")
    return "\n".join(parts)


if __name__ == "__main__":
    show_or_put(sys.argv[1:], index(Sources()), BEGIN, END)
