"""The reference of `fleet.yaml` as Markdown tables, made from its schema.

`python -m ua_fleet.config.reference` prints it; with a file it is put between the file's two markers.
"""

from __future__ import annotations

import json
import re
import sys
import typing
from collections.abc import Iterator, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ua_fleet.config.alarm_schema import LimitsConfig, NormalConfig
from ua_fleet.config.audit_schema import AuditConfig, SyslogConfig
from ua_fleet.config.broker_schema import BrokerConfig, BrokerLogin
from ua_fleet.config.history_schema import HistoryConfig, ValueHistoryConfig
from ua_fleet.config.kinds import known_kinds, model_of_kind
from ua_fleet.config.modbus_schema import CommandConfig, ModbusServerConfig
from ua_fleet.config.relay_schema import RelayConfig, RelayedConfig
from ua_fleet.config.resilience_schema import CriterionConfig, DistanceConfig, FaultConditionConfig
from ua_fleet.config.schema import (
    BridgeConfig,
    DataSetConfig,
    FieldConfig,
    FleetConfig,
    FleetInfo,
    KeysConfig,
    MonitoringConfig,
    PubSubConfig,
    ResilienceConfig,
    RobotConfig,
    ScenariosConfig,
    ServerConfig,
    UnifiedNamespaceConfig,
)
from ua_fleet.config.skill_schema import ArgumentConfig, SkillConfig, SkillLimitsConfig
from ua_fleet.config.source_schema import PublishedFieldConfig, PublishedSourceConfig
from ua_fleet.config.teleoperation_schema import AxisConfig, TeleoperationConfig
from ua_fleet.config.wording import choices
from ua_fleet.document import as_mapping

__all__ = ["BEGIN", "END", "put_between", "reference", "show_or_put"]

BEGIN: Final = "<!-- reference: made by `python -m ua_fleet.config.reference docs/fleet-yaml.md` -->"
END: Final = "<!-- end of the reference -->"

_SECTIONS: Final[tuple[tuple[str, type[BaseModel]], ...]] = (
    ("Outermost keys", FleetConfig),
    ("`fleet`", FleetInfo),
    ("`server`", ServerConfig),
    ("`server.audit`", AuditConfig),
    ("`server.audit.syslog`", SyslogConfig),
    ("`pubsub`", PubSubConfig),
    ("`pubsub.keys`", KeysConfig),
    ("`pubsub.broker`", BrokerConfig),
    ("`bridges.<name>`, whatever its kind", BridgeConfig),
    ("`robots.<name>`", RobotConfig),
    ("`robots.<name>.data.<name>`", DataSetConfig),
    ("`robots.<name>.data.<name>.fields.<name>`", FieldConfig),
    ("`limits` of a data source or a field", LimitsConfig),
    ("`normal` of a data source or a field", NormalConfig),
    ("`robots.<name>.skills.<name>`", SkillConfig),
    ("`arguments.<name>` and `results.<name>` of a skill", ArgumentConfig),
    ("`limits` of a skill", SkillLimitsConfig),
    ("`robots.<name>.teleoperation`", TeleoperationConfig),
    ("`axes.<name>` of a teleoperation", AxisConfig),
    ("`resilience`", ResilienceConfig),
    ("`resilience.criteria.<name>`", CriterionConfig),
    ("`resilience.faults.<name>`", FaultConditionConfig),
    ("`distance` of a criterion", DistanceConfig),
    ("`scenarios`", ScenariosConfig),
    ("`monitoring`", MonitoringConfig),
    ("`history`", HistoryConfig),
    ("`history` of a robot or a data source", ValueHistoryConfig),
    ("`sources.<name>`", PublishedSourceConfig),
    ("`sources.<name>.fields.<name>`", PublishedFieldConfig),
    ("`relays.<name>`", RelayConfig),
    ("`relays.<name>.forwards`, each of the list", RelayedConfig),
    ("`modbus`", ModbusServerConfig),
    ("`modbus.commands.<name>`", CommandConfig),
    ("`unified_namespace`", UnifiedNamespaceConfig),
    ("`unified_namespace.broker`", BrokerLogin),
)
_WORDS: Final = {bool: "true or false", int: "whole number", float: "number", str: "text", type(None): ""}
_BOUNDS: Final = (("ge", "at least {:g}"), ("gt", "above {:g}"), ("le", "at most {:g}"), ("lt", "below {:g}"))


def _words(annotation: Any) -> Iterator[str]:
    """The kinds of value that an annotation allows, in plain words."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        yield from _words(arguments[0])
    elif listed := choices(annotation):
        yield ", ".join(f"`{choice}`" for choice in listed)
    elif origin is tuple:
        yield "list" if len(arguments) == 2 and arguments[1] is ... else f"list of {len(arguments)} numbers"
    elif origin is dict or (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
        yield "keys"
    elif arguments:
        for argument in arguments:
            yield from _words(argument)
    elif word := _WORDS[annotation]:
        yield word


def _bounds(field: FieldInfo) -> str:
    """`, 0 to 65535`, or what there is of it."""
    found = {name: getattr(item, name) for item in field.metadata for name, _ in _BOUNDS if hasattr(item, name)}
    if not found and len(arguments := typing.get_args(field.annotation)) == 2 and arguments[1] is type(None):
        inner = [part for part in typing.get_args(arguments[0]) if isinstance(part, FieldInfo)]
        return _bounds(inner[0]) if inner else ""
    if "ge" in found and "le" in found:
        return f", {found['ge']} to {found['le']}"
    return "".join(f", {text.format(found[name])}" for name, text in _BOUNDS if name in found)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**needed**"
    value = field.default
    if isinstance(value, BaseModel) or value is None or value in ("", (), {}):
        return ""
    if (named := as_mapping(value)) is not None:
        return ", ".join(f"`{name}`" for name in named)
    return f"`{value.value if isinstance(value, Enum) else value if isinstance(value, str) else json.dumps(value)}`"


def _table(model: type[BaseModel], left_out: Sequence[str] = ()) -> str:
    rows = ["| key | value | default | |", "|---|---|---|---|"]
    for name, field in model.model_fields.items():
        if name in left_out:
            continue
        value = " or ".join(dict.fromkeys(_words(field.annotation))) + _bounds(field)
        text = " ".join((field.description or "").split())
        cells = (f"`{name}`", value, _default(field), text)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def _inner(model: type[BaseModel], path: str) -> Iterator[tuple[str, type[BaseModel]]]:
    """The models of a model's values, with the paths of their keys."""
    for name, field in model.model_fields.items():
        for inner, below in _models_in(field.annotation):
            at = f"{path}.{name}{below}".removeprefix(".")
            yield at, inner
            yield from _inner(inner, at)


def _models_in(annotation: Any) -> Iterator[tuple[type[BaseModel], str]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, ""
        return
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    below = ".<name>" if origin is dict else "[]" if origin in (tuple, list) else ""
    for argument in arguments:
        for model, further in _models_in(argument):
            yield model, below + further


def _mappings(model: type[BridgeConfig]) -> Iterator[tuple[str, type[BaseModel]]]:
    """What stands below the robots of a kind of bridge, by its key."""
    mappings = (("source", model.source_mapping), ("sink", model.sink_mapping), ("via", model.skill_mapping))
    yield from [(key, mapping) for key, mapping in mappings if mapping is not None]


def _title(mapping: type[BaseModel], path: str = "") -> str:
    """Where a model of `_mappings`, or what is at a path in it, stands: several kinds may share it."""
    found = [(key, kind) for kind in known_kinds() for key, each in _mappings(model_of_kind(kind)) if each is mapping]
    keys = " and ".join(f"`{key}{path and f'.{path}'}`" for key in dict.fromkeys(key for key, _ in found))
    kinds = " or ".join(f"`{kind}`" for kind in dict.fromkeys(kind for _, kind in found))
    return f"{keys} on a bridge of kind {kinds}"


def _of_kind(kind: str, shared: Sequence[str], told: set[type[BaseModel]]) -> Iterator[str]:
    """What the configuration of a kind of bridge has besides; each model that was not told of, where it comes first."""
    model = model_of_kind(kind)
    yield f"### `bridges.<name>` of kind `{kind}`, besides\n\n{_table(model, shared)}"
    tables: list[tuple[str, type[BaseModel]]] = []
    for _, mapping in _mappings(model):
        tables.append((_title(mapping), mapping))
        tables += [(_title(mapping, path), inner) for path, inner in _inner(mapping, "")]
    tables += [(f"`{path}` of kind `{kind}`", inner) for path, inner in _inner(model, "")]
    for title, inner in tables:
        if inner not in told:
            told.add(inner)
            yield f"### {title}\n\n{_table(inner)}"


def reference() -> str:
    """All keys, section by section; those of the installed kinds of bridges too."""
    parts: list[str] = []
    told: set[type[BaseModel]] = {model for _, model in _SECTIONS}
    for title, model in _SECTIONS:
        parts.append(f"### {title}\n\n{_table(model)}")
        if model is BridgeConfig:
            shared = [name for name in BridgeConfig.model_fields if name != "space"]
            for kind in known_kinds():
                parts += _of_kind(kind, shared, told)
    return "\n\n".join(parts)


def put_between(text: str, begin: str, end: str, content: str) -> str:
    """`text` with `content` in place of what stands between two markers; raises ValueError without them."""
    pattern = re.compile(rf"({re.escape(begin)}\n).*?(\n?{re.escape(end)})", re.DOTALL)
    if pattern.search(text) is None:
        raise ValueError(f"no lines {begin} and {end}")
    return pattern.sub(lambda match: f"{match[1]}\n{content}\n\n{end}", text, count=1)


def show_or_put(arguments: Sequence[str], made: str, begin: str, end: str) -> None:
    """Print what was made, or put it between its markers into the file that is named."""
    if not arguments:
        sys.stdout.write(f"{made}\n")
        return
    path = Path(arguments[0])
    path.write_text(put_between(path.read_text(encoding="utf-8"), begin, end, made), encoding="utf-8")


if __name__ == "__main__":
    show_or_put(sys.argv[1:], reference(), BEGIN, END)
