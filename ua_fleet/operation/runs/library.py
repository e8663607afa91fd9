"""The scenarios' files: `<name>.yaml` or `<name>.json` in one folder. May wait for the disk."""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from ua_fleet.document import resolve_scalar
from ua_fleet.errors import ConfigError, ScenarioError, ScenarioInvalid, StorageUnavailable
from ua_fleet.printing import utc_text
from ua_fleet.scenario import FleetView, Scenario, Value, read_scenario, validate
from ua_fleet.storage.files import write_whole
from ua_fleet.values import StatusCode

__all__ = [
    "MOST_NAME",
    "Checked",
    "Library",
    "Listed",
    "ScenarioChanged",
    "ScenarioUnknown",
    "StoredText",
    "parameters_of",
    "read_values",
    "version_of",
]

MOST_BYTES: Final = 256 * 1024
"""Of one scenario."""
MOST_LISTED: Final = 1000
MOST_PROBLEMS: Final = 500
"""Of one scenario that are told."""
MOST_SAID: Final = 20
"""Of these, in place of a run."""
MOST_NAME: Final = 200
"""Characters of a name or a reason that people give, and that are kept or said."""
MOST_TOLD: Final = 300
"""Characters of one problem."""
_ENDINGS: Final = (".yaml", ".yml", ".json")
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


class ScenarioUnknown(ScenarioError):
    """There is no scenario, run, decision or fault of that name."""

    ua_status = StatusCode.BAD_NODE_ID_UNKNOWN


class ScenarioChanged(ScenarioError):
    """A file of the folder is not the version that was read."""

    ua_status = StatusCode.BAD_INVALID_STATE


class StoredText(NamedTuple):
    """A scenario's file."""

    text: str
    version: str
    """Differs when the file differs."""


class Listed(NamedTuple):
    """A scenario of the folder."""

    name: str
    description: str
    problems: int
    """What is wrong with it for the fleet, as `Library.checked` tells it."""


class _Looked(NamedTuple):
    """What was found when a file was looked at last."""

    version: str
    fleet: FleetView
    listed: Listed


class Checked(NamedTuple):
    """A scenario held against a fleet."""

    scenario: Scenario
    problems: tuple[ConfigError, ...]


class Library:
    """Reads scenarios, from the folder or as they are given."""

    def __init__(self, folder: Path) -> None:
        """Use a folder; it need not be there."""
        self._folder = folder
        self._changing = threading.Lock()
        """Held from looking at the version of a file until it is another one."""
        self._looked: dict[str, _Looked] = {}
        """By name: a list is asked for each 2 s by everybody who looks at one, and most files are what they were."""

    def listed(self, fleet: FleetView) -> list[Listed]:
        """The scenarios of the folder by their names, held against a fleet. May be called from any thread."""
        names = sorted({path.stem for path in self._files() if _NAME.fullmatch(path.stem)})[:MOST_LISTED]
        looked = {name: self._look_at(name, fleet, self._looked.get(name)) for name in names}
        self._looked = looked
        return [one.listed for one in looked.values()]

    def _look_at(self, name: str, fleet: FleetView, before: _Looked | None) -> _Looked:
        try:
            text = self.text(name)
        except ScenarioError:
            return _Looked("", fleet, Listed(name, "", 1))
        version = version_of(text)
        if before is not None and before.version == version and before.fleet is fleet:
            return before
        checked = self._held(text, name, fleet)
        return _Looked(version, fleet, Listed(name, checked.scenario.description, len(checked.problems)))

    def problems(self, fleet: FleetView) -> list[ConfigError]:
        """All that is wrong with the files of the folder, by their paths."""
        found: list[ConfigError] = []
        read: dict[str, Path] = {}
        for path in sorted(self._files(), key=lambda path: (path.stem, _ENDINGS.index(path.suffix))):
            first = read.setdefault(path.stem, path)
            if not _NAME.fullmatch(path.stem):
                text = f"{path.stem!r} is no name of a scenario: letters, digits, _ and -"
                found.append(ConfigError(text, file=str(path), suggestion="rename the file"))
            elif first != path:
                text = f"it is never read, since {first.name} has the same name"
                found.append(ConfigError(text, file=str(path), suggestion="remove one of them"))
            else:
                found += self._problems_of(path, fleet)
        return found

    def _problems_of(self, path: Path, fleet: FleetView) -> Sequence[ConfigError]:
        try:
            return self._held(self.text(path.stem), str(path), fleet).problems
        except ScenarioError as error:
            return [ConfigError(str(error).removeprefix(f"{path.name}: "), file=str(path))]

    def text(self, name_or_text: str) -> str:
        """The text of a scenario: what has more than a line, or begins as JSON does, is one itself.

        Raises:
            ScenarioUnknown: the folder has none of that name.
            ScenarioError: it is too long, or cannot be read.
        """
        given = name_or_text.strip()
        if "\n" in given or given.startswith("{"):
            text = name_or_text
        elif not _NAME.fullmatch(given):
            raise ScenarioUnknown(f"{given[:80]!r} is no name of a scenario: letters, digits, _ and -")
        else:
            text = self._read(given)
        if len(text.encode()) > MOST_BYTES:
            raise ScenarioError(f"a scenario has at most {MOST_BYTES} bytes")
        return text

    def checked(self, name_or_text: str, fleet: FleetView) -> Checked:
        """A scenario held against a fleet; raises as `text` does."""
        text = self.text(name_or_text)
        return self._held(text, "" if text == name_or_text else f"{name_or_text.strip()}.yaml", fleet)

    def checked_text(self, text: str, fleet: FleetView) -> Checked:
        """The text of a run, which is never a name, held against a fleet; of any length, since it was taken before."""
        return self._held(text, "", fleet)

    def valid(self, name_or_text: str, fleet: FleetView) -> Scenario:
        """A scenario without problems.

        Raises:
            ScenarioInvalid: it has problems, the first of which are said.
            ScenarioError: as `text` does.
        """
        checked = self.checked(name_or_text, fleet)
        if checked.problems:
            first = [str(problem) for problem in checked.problems[:MOST_SAID]]
            more = len(checked.problems) - len(first)
            raise ScenarioInvalid([*first, *([f"and {more} more, which Validate tells"] if more else [])])
        return checked.scenario

    def stored(self, name: str) -> StoredText:
        """The file of a scenario.

        Raises:
            ScenarioUnknown: the folder has none of that name.
            ScenarioError: it is too long, or cannot be read.
        """
        text = self._read(_checked_name(name))
        if len(text.encode()) > MOST_BYTES:
            raise ScenarioError(f"a scenario has at most {MOST_BYTES} bytes")
        return StoredText(text, version_of(text))

    def store(self, name: str, text: str, version: str, fleet: FleetView) -> Checked:
        """Put a text into the folder, byte for byte, in the place of the version that was read.

        Args:
            name: of the scenario.
            text: of it, without problems.
            version: that was read; empty where there is to be none of that name yet.
            fleet: it is held against it.

        Returns:
            The scenario; where it has problems, nothing was written.

        Raises:
            ScenarioChanged: the file is not that version.
            ScenarioError: the name is none, the text is too long, or there are too many scenarios.
            StorageUnavailable: it cannot be written.
        """
        path = self._folder / f"{_checked_name(name)}{_ENDINGS[0]}"
        if len(text.encode()) > MOST_BYTES:
            raise ScenarioInvalid([f"a scenario has at most {MOST_BYTES} bytes"])
        checked = self._held(text, path.name, fleet)
        if checked.problems:
            return checked
        with self._changing:
            there = self._path_of(name)
            self._check_version(name, there, version)
            if there is None and len({path.stem for path in self._files()}) >= MOST_LISTED:
                raise ScenarioError(f"the folder has {MOST_LISTED} scenarios, and more may not be; delete one")
            try:
                like = there.stat() if there is not None else None
                write_whole(there or path, text.encode(), 0o644, like=like)
            except OSError as error:
                raise _not_written(there or path, error) from error
        return checked

    def delete(self, name: str, version: str) -> None:
        """Remove the file of a scenario, where it is the version that was read; raises as `store` does."""
        with self._changing:
            path = self._path_of(_checked_name(name))
            if path is None:
                raise ScenarioUnknown(f"there is no scenario {name!r} in the folder of scenarios")
            self._check_version(name, path, version)
            try:
                path.unlink()
            except OSError as error:
                raise _not_written(path, error) from error

    def _check_version(self, name: str, path: Path | None, version: str) -> None:
        if path is None:
            if version:
                raise ScenarioChanged(f"{name} was deleted since it was read; store it without a version")
            return
        if version_of(self._read(name)) == version:
            return
        changed = utc_text(path.stat().st_mtime)
        if not version:
            raise ScenarioChanged(f"there is a scenario {name} already (of {changed}); read it, and give its version")
        raise ScenarioChanged(f"{name} was changed at {changed}, since it was read; read it again")

    def _path_of(self, name: str) -> Path | None:
        paths = (self._folder / f"{name}{ending}" for ending in _ENDINGS)
        return next((path for path in paths if path.exists()), None)

    def _held(self, text: str, file: str, fleet: FleetView) -> Checked:
        reading = read_scenario(text.encode(), file)
        if not reading.scenario.body.steps:
            return Checked(reading.scenario, _told(reading.problems, file))
        validation = validate(reading.scenario, fleet, file)
        problems = sorted((*reading.problems, *validation.problems), key=lambda problem: problem.line)
        return Checked(validation.scenario, _told(problems, file))

    def _files(self) -> Sequence[Path]:
        try:
            return [path for path in self._folder.iterdir() if path.suffix in _ENDINGS]
        except OSError:
            return []

    def _read(self, name: str) -> str:
        for ending in _ENDINGS:
            path = self._folder / f"{name}{ending}"
            try:
                with path.open("rb") as file:
                    return file.read(MOST_BYTES + 1).decode("utf-8")
            except FileNotFoundError:
                continue
            except UnicodeDecodeError as error:
                raise ScenarioError(f"{path.name}: it is not UTF-8 text; save it in the encoding UTF-8") from error
            except OSError as error:
                reason = error.strerror or "it cannot be opened"
                raise ScenarioError(f"{path.name}: {reason}; look at the folder of scenarios") from error
        raise ScenarioUnknown(f"there is no scenario {name!r} in the folder of scenarios")


def _checked_name(name: str) -> str:
    """The name of a file of the folder, and of none elsewhere."""
    if not _NAME.fullmatch(name):
        raise ScenarioUnknown(f"{name[:80]!r} is no name of a scenario: at most 64 letters, digits, _ and -")
    return name


def version_of(text: str) -> str:
    """What differs when a text differs."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _not_written(path: Path, error: OSError) -> StorageUnavailable:
    reason = error.strerror or "it cannot be written"
    return StorageUnavailable(f"{path.name}: {reason}; look at the rights of the folder of scenarios")


def _told(problems: Sequence[ConfigError], file: str) -> tuple[ConfigError, ...]:
    """Problems for people: none is longer than a few lines, and there is an end to them."""
    told = [
        ConfigError(
            _short(problem.message),
            file=problem.file,
            line=problem.line,
            key=_short(problem.key),
            suggestion=_short(problem.suggestion),
        )
        for problem in problems[:MOST_PROBLEMS]
    ]
    if len(problems) > MOST_PROBLEMS:
        told.append(ConfigError(f"and {len(problems) - MOST_PROBLEMS} problems more", file=file))
    return tuple(told)


def _short(text: str) -> str:
    return text if len(text) <= MOST_TOLD else f"{text[:MOST_TOLD]}..."


def read_values(
    names: Sequence[str], values: Sequence[str], known: Mapping[str, object] | None = None
) -> dict[str, Value]:
    """Values that were given as texts: true, false, numbers as YAML has them, and all else as it stands.

    Args:
        names: of the values.
        values: their texts.
        known: values whose kind counts: where there is a text, the given one stays a text.

    Raises:
        ScenarioInvalid: there are not as many of one as of the other, or a name is there twice.
    """
    if len(names) != len(values):
        raise ScenarioInvalid([f"{len(names)} names were given with {len(values)} values"])
    if len(set(names)) != len(names):
        raise ScenarioInvalid(["a name was given twice"])
    read: dict[str, Value] = {}
    for name, text in zip(names, values, strict=True):
        value = None if isinstance((known or {}).get(name), str) else resolve_scalar(text)
        read[name] = text if value is None else value
    return read


def parameters_of(scenario: Scenario, names: Sequence[str], values: Sequence[str]) -> dict[str, Value]:
    """`read_values` for the parameters of a scenario, whose defaults say which of them are texts."""
    return read_values(names, values, {parameter.name: parameter.default for parameter in scenario.parameters})
