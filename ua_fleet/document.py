"""A YAML file as plain values with the place of each: mappings, lists, texts, numbers, true, false, null.

What surprises people in YAML is refused: keys written twice, anchors, aliases, merge keys and tags (so nothing can grow
when it is read), several documents. Unquoted scalars follow the core schema of YAML 1.2: `on`, `yes`, `1_000` and
`2020-01-01` are texts. `${VAR}` in a value stands for an environment variable, `$${` for the characters `${`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, cast

import yaml

from ua_fleet.errors import UPGRADE, ConfigError, newer_version

__all__ = [
    "MAX_BYTES",
    "Document",
    "KeyPath",
    "MappingMark",
    "SourcePlace",
    "as_mapping",
    "key_text",
    "read_document",
    "resolve_scalar",
]

MAX_BYTES: Final = 16 * 1024 * 1024
MAX_DEPTH: Final = 24
"""Nesting of the deepest legal key is 8."""

KeyPath = tuple[str | int, ...]
"""Keys and list positions from the root of the file to a value."""

_LOADER: Final[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]+|0x[0-9a-fA-F]+|0o[0-7]+", re.ASCII)
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", re.ASCII)
_VARIABLE = re.compile(r"\$\$\{|\$\{([^}]*)\}?")
_VARIABLE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
_WORDS: Final[dict[str, bool | None]] = {
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
}


@dataclass(frozen=True, slots=True)
class SourcePlace:
    """Where a value was written: a file's line, or the name of an environment variable or option."""

    file: str
    line: int = 0
    key: str = ""
    """Replaces the path of keys, for values that stand in no file."""


@dataclass(slots=True)
class MappingMark:
    """Where a mapping stands in the text; positions count characters from the start."""

    flow: bool
    start: int
    keys: list[tuple[str, int, int]] = field(default_factory=list[tuple[str, int, int]])
    """Name, position and column of each key."""


@dataclass(slots=True)
class Document:
    """A file that could be read as YAML, with the problems that were found on the way."""

    data: dict[str, Any]
    places: dict[KeyPath, SourcePlace]
    """For a key the place of the key, for a list's item that of the item."""
    mappings: dict[KeyPath, MappingMark]
    problems: list[ConfigError]
    variables: dict[KeyPath, str] = field(default_factory=dict[KeyPath, str])
    """For a value with `${VAR}` in it what the file says in its place: the variable may be a secret."""
    texts: dict[KeyPath, str] = field(default_factory=dict[KeyPath, str])
    """For a value out of the environment that is taken for a number, true, false or nothing, the text that it was."""

    def place_of(self, path: KeyPath) -> SourcePlace:
        """The place of a value, or of the nearest one around it that is written down."""
        while path and path not in self.places:
            path = path[:-1]
        return self.places[path]

    def problem(self, path: KeyPath, message: str, suggestion: str = "") -> None:
        """Note a problem with the value at `path`."""
        place = self.place_of(path)
        key = place.key or key_text(path)
        self.problems.append(ConfigError(message, file=place.file, line=place.line, key=key, suggestion=suggestion))

    def is_newer_than(self, version: int) -> bool:
        """Whether `version` in the file is above the one that is read; then that is the only problem left.

        A newer format has unknown keys everywhere, which says nothing to anybody.
        """
        newer = newer_version(self.data.get("version"), version)
        if newer:
            self.problems.clear()
            self.problem(("version",), f"this file {newer}", UPGRADE)
        return bool(newer)


def as_mapping(value: Any) -> dict[str, Any] | None:
    """A value of the file, if it is a mapping."""
    return cast("dict[str, Any]", value) if isinstance(value, dict) else None


def key_text(path: KeyPath) -> str:
    """A path as people write it: `robots.ned.capacities[0]`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


def resolve_scalar(text: str) -> bool | int | float | str | None:
    """The value of an unquoted scalar."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text) and len(text) < 40:
        return int(text, {"0x": 16, "0o": 8}.get(text[:2], 10))
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


class _Refused(Exception):
    """The file cannot be read any further."""

    def __init__(self, message: str, line: int, suggestion: str = "") -> None:
        self.message, self.line, self.suggestion = message, line, suggestion
        super().__init__(message)


class _Reader:
    """Builds values from YAML events, one level of Python calls for each level of the file."""

    def __init__(self, document: Document, file: str, environment: Mapping[str, str] | None) -> None:
        self._document, self._file, self._environment = document, file, environment

    def value(self, event: Any, events: Iterator[Any], path: KeyPath) -> Any:
        """The value that begins with `event`."""
        line = event.start_mark.line + 1
        if len(path) > MAX_DEPTH:
            raise _Refused(f"nested deeper than {MAX_DEPTH} levels", line)
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise _Refused("anchors (&) and aliases (*) are not used in this file", line, "write the value out")
        if event.tag is not None and event.tag != "!":
            raise _Refused("tags (!) are not used in this file", line, "leave the tag out")
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, path)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(events, path)
        return self._mapping(event, events, path)

    def _scalar(self, event: Any, path: KeyPath) -> Any:
        text = self._substituted(event.value, path)
        if not event.implicit[0]:
            return text
        value = resolve_scalar(text)
        if path in self._document.variables and not isinstance(value, str):
            self._document.texts[path] = text
        return value

    def _substituted(self, text: str, path: KeyPath) -> str:
        environment = self._environment
        if environment is None or "${" not in text:
            return text

        def replace(match: re.Match[str]) -> str:
            name = match[1]
            if name is None:
                return "${"
            if not _VARIABLE_NAME.fullmatch(name) or not match[0].endswith("}"):
                self._document.problem(path, f"`{match[0]}` names no variable", "write ${NAME}, or $${ for a plain ${")
            elif name not in environment:
                self._document.problem(path, f"the environment variable {name} is not set", f"run: export {name}=...")
            else:
                self._document.variables[path] = text
                return environment[name]
            return ""

        return _VARIABLE.sub(replace, text)

    def _sequence(self, events: Iterator[Any], path: KeyPath) -> list[Any]:
        items: list[Any] = []
        for event in events:
            if isinstance(event, yaml.SequenceEndEvent):
                break
            item_path = (*path, len(items))
            self._document.places[item_path] = SourcePlace(self._file, event.start_mark.line + 1)
            items.append(self.value(event, events, item_path))
        return items

    def _mapping(self, start: Any, events: Iterator[Any], path: KeyPath) -> dict[str, Any]:
        document = self._document
        mark = MappingMark(bool(start.flow_style), start.start_mark.index)
        document.mappings.setdefault(path, mark)
        values: dict[str, Any] = {}
        for event in events:
            if isinstance(event, yaml.MappingEndEvent):
                break
            at: Any = event.start_mark
            line = at.line + 1
            if not isinstance(event, yaml.ScalarEvent):
                raise _Refused("a key must be a name", line)
            if event.anchor is not None or event.tag is not None or event.value == "<<":
                raise _Refused("anchors (&), tags (!) and merge keys (<<) are not used in this file", line)
            key = event.value
            twice = key in values
            key_path = (*path, key)
            if twice:
                first = document.places[key_path].line
                message = f"`{key}` is written twice, first in line {first}"
                document.problems.append(
                    ConfigError(
                        message, file=self._file, line=line, key=key_text(key_path), suggestion="remove one of them"
                    )
                )
                key_path = (*path, key, "second")
            document.places.setdefault(key_path, SourcePlace(self._file, line))
            mark.keys.append((key, at.index, at.column))
            value = self.value(next(events), events, key_path)
            if not twice:
                values[key] = value
        return values


def read_document(content: bytes, file: str, environment: Mapping[str, str] | None = None) -> Document:
    """Read a file's bytes.

    Args:
        content: the file.
        file: its name in problems.
        environment: values for `${VAR}`; None leaves such texts as they are.

    Returns:
        The document; when it cannot be read at all it is empty, and its problems say why.
    """
    document = Document({}, {(): SourcePlace(file)}, {}, [])
    try:
        document.data = _read(content, document, file, environment)
    except _Refused as refused:
        problem = ConfigError(refused.message, file=file, line=refused.line, suggestion=refused.suggestion)
        document.problems.append(problem)
        document.data, document.mappings = {}, {}
    return document


def _read(content: bytes, document: Document, file: str, environment: Mapping[str, str] | None) -> dict[str, Any]:
    if len(content) > MAX_BYTES:
        raise _Refused(f"larger than {MAX_BYTES // 2**20} MiB", 0)
    try:
        text = content.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise _Refused("is not UTF-8 text", line, "save the file in the encoding UTF-8") from error
    try:
        events: Iterator[Any] = iter(yaml.parse(text, Loader=_LOADER))
        next(events)  # the stream's start
        if isinstance(next(events), yaml.StreamEndEvent):
            raise _Refused("is empty", 0, "write a commented file with: ua-fleet config init FILE")
        root = next(events)
        if not isinstance(root, yaml.MappingStartEvent):
            raise _Refused("must have keys like `version: 1` at its outermost level", root.start_mark.line + 1)
        data: dict[str, Any] = _Reader(document, file, environment).value(root, events, ())
        next(events)  # the document's end
        if not isinstance(after := next(events), yaml.StreamEndEvent):
            raise _Refused("a second document (---) begins here", after.start_mark.line + 1, "remove it")
    except yaml.YAMLError as error:
        mark = cast("Any", getattr(error, "problem_mark", None) or getattr(error, "context_mark", None))
        what = str(getattr(error, "problem", None) or getattr(error, "reason", None) or "unreadable")
        line = mark.line + 1 if mark is not None else 0
        tab = mark is not None and text[mark.index : mark.index + 1] == "\t"
        hint = "indent with spaces, not with tabs" if tab else "check indentation and quotes"
        raise _Refused(f"is not YAML: {what}", line, hint) from error
    return data
