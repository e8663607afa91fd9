"""The configuration as it is in force: defaults filled in, the environment's values taken in, and where each is from.

What a file takes from `${NAME}` is shown as the file has it, since it may be a secret.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

import yaml
from pydantic import BaseModel

from ua_fleet.config.schema import FleetConfig
from ua_fleet.document import Document, KeyPath, SourcePlace, as_mapping, key_text, resolve_scalar
from ua_fleet.names import closest

__all__ = ["HIDDEN", "ShownSetting", "as_tree", "as_yaml", "nearest_key", "settings"]

HIDDEN: Final = "***"
_SECRET_KEY: Final = re.compile("(password|passphrase|secret|token)(?!_file$)", re.IGNORECASE)
"""A file's name is no secret."""
_USER_OF_URL: Final = re.compile(r"(?<=://)[^/@\s]+(?=@)")


@dataclass(frozen=True, slots=True)
class ShownSetting:
    """One value in force. Lists are one value."""

    path: KeyPath
    value: Any
    """As JSON has it; secrets are hidden."""
    place: SourcePlace | None
    """Where it was written; None for a default."""

    @property
    def key(self) -> str:
        """Its key as people write it: `server.port`."""
        return key_text(self.path)

    @property
    def origin(self) -> str:
        """For people: `fleet.yaml:12`, the name of an environment variable, or `default`."""
        if self.place is None:
            return "default"
        return self.place.key or f"{self.place.file}:{self.place.line}"

    def is_below(self, key: str) -> bool:
        """Whether it is the value of a key, or one below it."""
        return any(key_text(self.path[:length]) == key for length in range(1, len(self.path) + 1))


def settings(config: FleetConfig, document: Document) -> list[ShownSetting]:
    """All values, in the order of the schema; the document is the one that the configuration was loaded from."""
    tree = config.model_dump(mode="json", exclude_none=True)
    for robot_name, robot in config.robots.items():
        mapping = config.bridges[robot.bridge].skill_mapping
        for skill_name, skill in robot.skills.items():
            if mapping is not None and skill.via:
                filled = _with_defaults(mapping, skill.via)
                tree["robots"][robot_name]["skills"][skill_name]["via"] = filled
    if (further := tree.pop("further", None)) is not None:
        tree["pubsub"] = [tree["pubsub"], *further]
    return [_setting(path, value, document) for path, value in _leaves(tree, ())]


def _with_defaults(mapping: type[BaseModel], given: dict[str, Any]) -> dict[str, Any]:
    return mapping.model_validate(given).model_dump(mode="json", exclude_none=True)


def _leaves(tree: dict[str, Any], path: KeyPath) -> Iterator[tuple[KeyPath, Any]]:
    for key, value in tree.items():
        inner = as_mapping(value)
        if inner:
            yield from _leaves(inner, (*path, key))
        else:
            yield (*path, key), value


def _setting(path: KeyPath, value: Any, document: Document) -> ShownSetting:
    return ShownSetting(path, _shown(path, value, document), document.places.get(path))


def _shown(path: KeyPath, value: Any, document: Document) -> Any:
    """A value without what nobody should read."""
    if isinstance(value, list):
        items = cast("list[object]", value)
        return [_shown((*path, index), item, document) for index, item in enumerate(items)]
    if (inner := as_mapping(value)) is not None:
        return {key: _shown((*path, key), item, document) for key, item in inner.items()}
    if path in document.variables:
        return document.variables[path]
    if isinstance(value, str) and _SECRET_KEY.search(str(path[-1])):
        return HIDDEN
    return _USER_OF_URL.sub(HIDDEN, value) if isinstance(value, str) else value


def nearest_key(key: str, found: Sequence[ShownSetting]) -> str:
    """A suggestion for a key that there is not."""
    known = {key_text(setting.path[:length]) for setting in found for length in range(1, len(setting.path) + 1)}
    return closest(key, sorted(known))


def as_tree(found: Sequence[ShownSetting]) -> dict[str, Any]:
    """The values as nested mappings."""
    tree: dict[str, Any] = {}
    for setting in found:
        section = tree
        for step in setting.path[:-1]:
            section = section.setdefault(str(step), {})
        section[str(setting.path[-1])] = setting.value
    return tree


class _Dumper(yaml.SafeDumper):
    """Writes YAML that `read_document` reads as the same values."""

    def ignore_aliases(self, data: Any) -> bool:
        """Always: anchors are not read."""
        return True


def _text(dumper: Any, text: str) -> yaml.ScalarNode:
    plain = resolve_scalar(text) == text
    node: yaml.ScalarNode = dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if plain else '"')
    return node


def _number(dumper: Any, number: float) -> yaml.ScalarNode:
    node: yaml.ScalarNode = dumper.represent_scalar("tag:yaml.org,2002:float", repr(number))
    return node


_Dumper.add_representer(str, _text)
_Dumper.add_representer(float, _number)


def as_yaml(found: Sequence[ShownSetting], variables: Sequence[str] = ()) -> str:
    """The values as a file has them: `load` reads it as the same configuration, but for what is hidden.

    Args:
        found: the values.
        variables: texts with `${NAME}` that stay as they are; in all others `${` is written `$${`.
    """
    kept = frozenset(variables)
    tree = _escaped(as_tree(found), kept)
    return yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)


def _escaped(value: Any, kept: frozenset[str]) -> Any:
    if isinstance(value, dict):
        return {key: _escaped(inner, kept) for key, inner in cast("dict[str, Any]", value).items()}
    if isinstance(value, list):
        return [_escaped(item, kept) for item in cast("list[object]", value)]
    if isinstance(value, str) and value not in kept:
        return value.replace("${", "$${")
    return value
