"""Data sources written into a file, with every other byte left alone: comments, order and layout stay."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import yaml

from ua_fleet.config.assign_ids import BOM, LINE_BREAK, insert_ids, replace_file
from ua_fleet.config.layers import ENVIRONMENT_PREFIX
from ua_fleet.config.load import load_content, read_content
from ua_fleet.config.topics_seen import Addition, quoted
from ua_fleet.document import Document, KeyPath, as_mapping, read_document
from ua_fleet.errors import ConfigInvalid

__all__ = ["add_data", "insert_data", "write"]

_STEP: Final = 2
"""Columns by which what is new is indented."""
_NOTHING: Final = re.compile(r"[ \t]*(#.*)?")
_ITEM: Final = re.compile(r"-([ \t]|$)")


def insert_data(content: bytes, file: str, bridge: str, additions: Iterable[Addition]) -> bytes:
    """The content with these data sources at the end of their robots' data; a robot that is not there is written too.

    Raises:
        ConfigInvalid: the file cannot be read, or is laid out so that there is no place.
    """
    by_robot: dict[str, list[Addition]] = {}
    for addition in additions:
        by_robot.setdefault(addition.robot, []).append(addition)
    for robot, own in by_robot.items():
        content = _insert(content, file, bridge, robot, [line for one in own for line in one.lines()])
    return content


def _insert(content: bytes, file: str, bridge: str, robot: str, lines: list[str]) -> bytes:
    document = read_document(content, file)
    if document.problems:
        raise ConfigInvalid(document.problems)
    robots = as_mapping(document.data.get("robots")) or {}
    around: list[str] = []
    path: KeyPath = ("robots", robot, "data")
    if not as_mapping((as_mapping(robots.get(robot)) or {}).get("data")):
        around, path = ["data:"], path[:-1]
    if robot not in robots:
        around, path = [f"{quoted(robot)}:", f"bridge: {bridge}", "data:"], path[:-1]
    if not robots:
        around, path = ["robots:", *around], ()
    known = _at(document.data, path)
    if path != ("robots", robot, "data") and around[0].removesuffix(":") in known:
        _no_place(document, (*path, around[0].removesuffix(":")))  # a key without a value, or `data: {}`
    new = _indented(around, lines)
    text = content.removeprefix(BOM).decode("utf-8")
    mark = document.mappings[path]
    if mark.flow or not mark.keys:
        _no_place(document, path)
    position, column, line_end = _end(text, mark.keys[-1][1], mark.keys[0][2])
    before = "" if position == 0 or text[position - 1] in "\r\n" else line_end
    piece = before + "".join(f"{' ' * column}{line}{line_end}" for line in new)
    changed = (BOM if content.startswith(BOM) else b"") + f"{text[:position]}{piece}{text[position:]}".encode()
    _check_result(document, path, new, read_document(changed, file))
    return changed


def _indented(around: list[str], lines: list[str]) -> list[str]:
    """The keys around the new data, each deeper than the one before, but for `bridge`, which stands beside `data`."""
    said: list[str] = []
    depth = 0
    for key in around:
        said.append(" " * depth + key)
        if key.endswith(":"):
            depth += _STEP
    return said + [" " * depth + line for line in lines]


def _end(text: str, last_key: int, column: int) -> tuple[int, int, str]:
    """Where a block of keys ends whose last one stands there: position, column of its keys, and how its lines end."""
    found = LINE_BREAK.search(text, last_key)
    usual = found or LINE_BREAK.search(text)
    line_end = usual[0] if usual is not None else "\n"
    end = position = found.end() if found is not None else len(text)
    while position < len(text):
        found = LINE_BREAK.search(text, position)
        following = found.end() if found is not None else len(text)
        line = text[position : found.start() if found is not None else len(text)]
        inner = len(line) - len(line.lstrip(" "))
        belongs = inner > column or (inner == column and _ITEM.match(line, inner) is not None)
        if not _NOTHING.fullmatch(line):
            if not belongs:
                break
            end = following
        elif inner > column and line.strip():
            end = following  # a comment within
        position = following
    return end, column, line_end


def _at(data: Mapping[str, Any], path: KeyPath) -> dict[str, Any]:
    value = dict(data)
    for step in path:
        value = as_mapping(value.get(str(step))) or {}
    return value


def _no_place(document: Document, path: KeyPath) -> None:
    document.problem(path, "the layout here has no place for more data", "write it as a block, one key to a line")
    raise ConfigInvalid(document.problems)


def _check_result(before: Document, path: KeyPath, new: list[str], after: Document) -> None:
    """YAML has more layouts than anyone knows: the new text must say the same and the data, or it is not written."""
    expected = before.data
    target = expected
    for step in path:
        target = target[str(step)]
    target.update(yaml.safe_load("\n".join(new)))
    if after.problems or after.data != expected:
        _no_place(before, path)


def add_data(
    path: str | Path, bridge: str, additions: Iterable[Addition], environment: Mapping[str, str] | None = None
) -> tuple[bytes, dict[str, int]]:
    """The content of a file with these data sources and all ids that were missing, and these by their keys' paths.

    It is not written: `write` does that.

    Raises:
        ConfigInvalid: the file has problems, or would have.
    """
    file, content = str(path), read_content(Path(path))
    variables = os.environ if environment is None else environment
    of_file = {name: value for name, value in variables.items() if not name.upper().startswith(ENVIRONMENT_PREFIX)}
    load_content(content, file, of_file, allow_missing_ids=True)
    changed, given = insert_ids(insert_data(content, file, bridge, additions), file)
    load_content(changed, file, of_file)
    return changed, given


def write(path: str | Path, content: bytes) -> None:
    """Put the content in the file's place, whole or not at all; raises ConfigError where it cannot be."""
    replace_file(Path(path), content)
