"""Inserting missing ids into a file, with every other byte left alone.

An id becomes the first key of its mapping, in the mapping's own style. It is never one that the file has, or
below one that it has: an id that was removed belongs to something that is gone, and clients may remember it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, Final

from ua_fleet.config.layers import ENVIRONMENT_PREFIX
from ua_fleet.config.load import load_content, read_content
from ua_fleet.config.teleoperation_schema import TELEOPERATION_IDS
from ua_fleet.document import Document, KeyPath, as_mapping, key_text, read_document
from ua_fleet.errors import ConfigError, ConfigInvalid
from ua_fleet.fleet.model import FLEET_NAMESPACE
from ua_fleet.storage.files import write_whole

__all__ = ["BOM", "FIRST_ID", "LINE_BREAK", "assign_ids", "insert_ids", "replace_file"]

FIRST_ID: Final = 1001
LAST_ID: Final = 65_535

LINE_BREAK: Final = re.compile("\r\n|[\r\n\x85\u2028\u2029]")
"""All that YAML 1.1, which the parser follows, takes for the end of a line."""
BOM: Final = b"\xef\xbb\xbf"


def _owners(document: Document) -> list[tuple[KeyPath, str]]:
    """The mappings that must have an id, in the order of the file, each with the name of that key."""
    owners: list[tuple[KeyPath, str]] = []
    for path in document.mappings:  # in the order in which they begin
        if len(path) == 2 and path[0] == "bridges":
            owners.append((path, "status_id"))
        elif len(path) == 4 and path[0] == "robots" and path[2] in ("data", "skills"):
            owners.append((path, "id"))
        elif len(path) == 2 and path[0] == "robots" and as_mapping(_at(document.data, path).get("skills")):
            owners.append((path, "skill_status_id"))
        elif len(path) == 3 and path[0] == "robots" and path[2] == "teleoperation":
            owners += [(path, key) for key in TELEOPERATION_IDS]
    return owners


class _Highest:
    """The highest id of each namespace, and of each space that publishes: an id is one in both."""

    def __init__(self) -> None:
        self._numbers: dict[Hashable, int] = {}

    def note(self, home: tuple[Hashable, Hashable], number: object) -> None:
        """An id that the file has."""
        if isinstance(number, int):
            for place in home:
                self._numbers[place] = max(self._numbers.get(place, 0), number)

    def next(self, home: tuple[Hashable, Hashable]) -> int:
        """An id above all of both."""
        number = max(FIRST_ID - 1, *(self._numbers.get(place, 0) for place in home)) + 1
        self.note(home, number)
        return number


def _home(document: Document, path: KeyPath) -> tuple[Hashable, Hashable]:
    """The namespace of a mapping's id, and the bridge that publishes under it; see `checks`."""
    if path[0] == "bridges":
        return ("namespace", FLEET_NAMESPACE), ("bridge", path[1])
    robot = as_mapping(_at(document.data, ("robots",)).get(str(path[1]))) or {}
    ns = robot.get("namespace", FLEET_NAMESPACE)
    is_servers = path[2:3] == ("data",) and _at(document.data, path).get("origin") == "server"
    publisher = "" if is_servers else str(robot.get("bridge"))
    return ("namespace", ns if isinstance(ns, int) else FLEET_NAMESPACE), ("bridge", publisher)


def _at(data: dict[str, Any], path: KeyPath) -> dict[str, Any]:
    for step in path:
        data = as_mapping(data[str(step)]) or {}
    return data


def _insertion(text: str, document: Document, path: KeyPath, key: str, number: int) -> tuple[int, str]:
    """Where to insert what, in characters."""
    mark = document.mappings[path]
    _, position, column = mark.keys[0]
    if mark.flow:
        return position, f"{key}: {number}, "
    # Straight under the line of the mapping's own name, so that a comment stays with the key that follows it.
    name = next(start for name, start, _ in document.mappings[path[:-1]].keys if name == path[-1])
    line_end = LINE_BREAK.search(text, name)
    if line_end is None or line_end.end() > position - column:
        return position, f"{key}: {number}, "  # no layout that takes an id: the check below says so
    return line_end.end(), f"{text[position - column : position]}{key}: {number}{line_end[0]}"


def insert_ids(content: bytes, file: str) -> tuple[bytes, dict[str, int]]:
    """The content with the missing ids, and these by the path of their keys.

    Raises:
        ConfigInvalid: the file cannot be read, or has no place for an id.
    """
    document = read_document(content, file)
    if document.problems:
        raise ConfigInvalid(document.problems)
    owners = _owners(document)
    highest = _Highest()
    for path, key in owners:
        highest.note(_home(document, path), _at(document.data, path).get(key))
    for name, robot in (as_mapping(document.data.get("robots")) or {}).items():
        highest.note(_home(document, ("robots", name)), (as_mapping(robot) or {}).get("fault_id"))
    text = content.removeprefix(BOM).decode("utf-8")
    given: dict[KeyPath, int] = {}
    insertions: list[tuple[int, str]] = []
    for path, key in owners:
        if key in _at(document.data, path) or not document.mappings[path].keys:
            continue
        number = highest.next(_home(document, path))
        given[(*path, key)] = number
        insertions.append(_insertion(text, document, path, key, number))
    if given and (largest := max(given.values())) > LAST_ID:
        owner = key_text(next(path for path, number in given.items() if number == largest))
        problem = ConfigError(
            f"no id is left for {owner}: they are counted upward from the highest one of a namespace, and of a bridge, "
            f"and end at {LAST_ID}",
            file=file,
            suggestion="give robots another `namespace` (fleet.namespaces), and another bridge where one has too many",
        )
        raise ConfigInvalid([problem])
    pieces: list[str] = []
    done = 0
    for position, piece in sorted(insertions, key=lambda insertion: insertion[0]):
        pieces += (text[done:position], piece)
        done = position
    byte_order_mark = BOM if content.startswith(BOM) else b""
    changed = byte_order_mark + "".join((*pieces, text[done:])).encode()
    _check_result(document, read_document(changed, file), given)
    return changed, {key_text(path): value for path, value in given.items()}


def _check_result(before: Document, after: Document, given: dict[KeyPath, int]) -> None:
    """YAML has more layouts than anyone knows: the new text must say the same and the ids, or it is not written."""
    for path, number in given.items():
        _at(before.data, path[:-1])[str(path[-1])] = number
    if after.problems or after.data != before.data:
        path = next(iter(given))
        before.problem(path, "the layout here has no place for an id", "write the ids of this file by hand")
        raise ConfigInvalid(before.problems)


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, with its mode and, where we may, its owner."""
    try:
        target = path.resolve(strict=True)
        write_whole(target, content, like=target.stat())
    except OSError as error:
        reason = (error.strerror or "it").lower()
        raise ConfigError(f"cannot be written: {reason}", file=str(path)) from error


def assign_ids(path: str | Path, environment: Mapping[str, str] | None = None) -> dict[str, int]:
    """Give each data source, skill and bridge of a file without an id the next one; those given, by their keys' paths.

    Raises:
        ConfigInvalid: the file has other problems; then it is left alone.
        ConfigError: it cannot be written.
    """
    file, content = str(path), read_content(Path(path))
    variables = os.environ if environment is None else environment
    of_file = {name: value for name, value in variables.items() if not name.upper().startswith(ENVIRONMENT_PREFIX)}
    load_content(content, file, of_file, allow_missing_ids=True)
    changed, given = insert_ids(content, file)
    if given:
        replace_file(Path(path), changed)
    return given
