"""What stands above the file: `UA_FLEET__SERVER__PORT=4841` in the environment, then options of the command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ua_fleet.config.kinds import known_kinds, model_of_kind
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.wording import fields_at
from ua_fleet.document import Document, KeyPath, SourcePlace, as_mapping, key_text, resolve_scalar
from ua_fleet.errors import ConfigError
from ua_fleet.names import closest, listed

__all__ = ["ENVIRONMENT_PREFIX", "apply_environment", "apply_options"]

ENVIRONMENT_PREFIX: Final = "UA_FLEET__"


def _names_at(data: Mapping[str, Any], path: KeyPath) -> set[str]:
    """The keys that may stand below `path`: those of its model, and those that are there."""
    names = set(fields_at(FleetConfig, path))
    there: dict[str, Any] = dict(data)
    for step in path:
        there = as_mapping(there.get(str(step))) or {}
    names.update(there)
    if len(path) == 2 and path[0] == "bridges" and there.get("kind") in known_kinds():
        names.update(model_of_kind(there["kind"]).model_fields)
    return names


def _plain(name: str) -> str:
    return name.lower().replace("-", "_")


def _path_of(variable: str, data: Mapping[str, Any]) -> KeyPath:
    path: KeyPath = ()
    for word in variable.removeprefix(ENVIRONMENT_PREFIX).split("__"):
        names = sorted(_names_at(data, path))
        matches = [name for name in names if _plain(name) == _plain(word)]
        if len(matches) != 1:
            where = f"under `{key_text(path)}`" if path else "in the file"
            problem = f"there is no key `{word.lower()}` {where}"
            hint = closest(word, names) or (f"there are: {listed(names)}" if names else "")
            if matches:
                problem, hint = f"`{word.lower()}` may mean {listed(matches)} {where}", "rename one of them"
            raise ConfigError(problem, file="environment", key=variable, suggestion=hint)
        path = (*path, matches[0])
    return path


def _set(document: Document, path: KeyPath, value: object, place: SourcePlace) -> None:
    section = document.data
    for step in path[:-1]:
        if isinstance(section.get(str(step)), list):
            raise ConfigError(
                f"`{step}` is a list in the file", file=place.file, key=place.key, suggestion="change it there"
            )
        inner = as_mapping(section.setdefault(str(step), {}))
        if inner is None and section[str(step)] is not None:
            return  # the problem is the file's, and is told there
        section[str(step)] = section = {} if inner is None else inner
    if isinstance(section.get(str(path[-1])), dict) or fields_at(FleetConfig, path):
        raise ConfigError(
            f"`{key_text(path)}` has keys of its own", file=place.file, key=place.key, suggestion="name one of these"
        )
    section[str(path[-1])] = value
    document.places[path] = place
    document.variables.pop(path, None)
    document.texts.pop(path, None)


def apply_environment(document: Document, environment: Mapping[str, str]) -> None:
    """Put the values of `UA_FLEET__...` into the document. Names are not case-sensitive, `-` is written `_`."""
    for variable in sorted(environment):
        name = variable.upper()
        if not name.startswith(ENVIRONMENT_PREFIX):
            continue
        text = environment[variable]
        value = resolve_scalar(text) if text else text
        try:
            path = _path_of(name, document.data)
            _set(document, path, value, SourcePlace("environment", key=variable))
            if not isinstance(value, str):
                document.texts[path] = text
        except ConfigError as error:
            document.problems.append(error)


def apply_options(document: Document, options: Mapping[str, object]) -> None:
    """Put values from the command line into the document, by key paths like `server.port`."""
    for key, value in options.items():
        try:
            _set(document, tuple(key.split(".")), value, SourcePlace("option", key=key))
        except ConfigError as error:
            document.problems.append(error)
