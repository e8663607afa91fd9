"""The JSON Schema (2020-12) of `fleet.yaml`, for editors: the shapes that `load` takes, as far as a schema can say it.

Which of the installed kinds a robot's bridge has stands elsewhere in the file, so `source`, `sink` and `via` have the
shape of any of them; `ua-fleet config check` knows which. A value may be `${NAME}` wherever something else than any
text is wanted, since the environment's text is read as if it stood there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final, cast

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from ua_fleet.config.kinds import known_kinds, model_of_kind
from ua_fleet.config.schema import BridgeConfig, DataMapping, FleetConfig

__all__ = ["SCHEMA_FILE", "fleet_schema", "schema_text"]

SCHEMA_FILE: Final = "fleet.schema.json"
"""Beside `fleet.yaml`, whose first line names it."""
DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]

_NOTES: Final = ("description", "default", "examples", "title")
"""Keywords that assert nothing."""
_SCALARS: Final = ("integer", "number", "boolean")
_VARIABLE: Final = "Variable"
_NO_VALUE: Final[Schema] = {"type": "null"}

_MAY_BE_EMPTY: Final[tuple[tuple[str, tuple[str, ...]], ...]] = (
    ("FleetConfig", ("fleet", "server", "bridges", "robots", "resilience")),
    ("RobotConfig", ("data", "skills")),
    ("ResilienceConfig", ("criteria", "faults")),
)
"""Keys that may stand there without a value, as in `robots:`; they count as empty then."""
_NEVER_NULL: Final = ("id", "status_id", "skill_status_id", "acquire_id", "renew_id", "release_id")
"""Ids are left out until they are assigned; one without a value is a mistake."""


class _Generator(GenerateJsonSchema):
    """Pydantic's generator without titles, which only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Never; see the base class."""
        return False


def fleet_schema() -> Schema:
    """The schema, with the keys of every kind of bridge that is installed."""
    kinds = {kind: model_of_kind(kind) for kind in known_kinds()}
    models: list[type[BaseModel]] = list(dict.fromkeys([FleetConfig, *_models(kinds.values())]))
    references, generated = models_json_schema([(model, "validation") for model in models], schema_generator=_Generator)
    definitions: dict[str, Schema] = generated["$defs"]
    refs = {model: references[model, "validation"] for model in models}

    for name, keys in _MAY_BE_EMPTY:
        for key in keys:
            _put(definitions[name]["properties"], key, [_NO_VALUE])
    pubsub = definitions["FleetConfig"]["properties"]["pubsub"]
    one = {name: pubsub.pop(name) for name in list(pubsub) if name not in _NOTES}
    many = {"type": "array", "minItems": 1, "items": {"allOf": [one, {"required": ["name"]}]}}
    pubsub.update({"if": {"type": "array"}, "then": many, "else": one})  # so that an editor says what is wrong in one
    skill = definitions["RobotConfig"]["properties"]["skills"]["anyOf"][0]["patternProperties"]
    skill.update({pattern: {"anyOf": [shape, _NO_VALUE]} for pattern, shape in skill.items()})
    for definition in definitions.values():
        for key, shape in definition.get("properties", {}).items():
            if key in _NEVER_NULL:
                definition["properties"][key] = _without_null(shape)

    definitions["BridgeConfig"] = _bridge({kind: refs[model] for kind, model in kinds.items()})
    data = definitions["DataSetConfig"]["properties"]
    data["source"]["anyOf"] = [*_of_kinds(refs, [kind.source_mapping for kind in kinds.values()]), _NO_VALUE]
    data["sink"]["anyOf"] = [*_of_kinds(refs, [kind.sink_mapping for kind in kinds.values()]), _NO_VALUE]
    via = definitions["SkillConfig"]["properties"]["via"]
    definitions["SkillConfig"]["properties"]["via"] = {
        "description": via["description"],
        "anyOf": [
            *_of_kinds(refs, [kind.skill_mapping for kind in kinds.values()]),
            {"type": "object", "maxProperties": 0},
        ],
    }
    definitions = {name: _finished(schema) for name, schema in definitions.items() if name != DataMapping.__name__}
    definitions[_VARIABLE] = {
        "description": "The value of an environment variable.",
        "type": "string",
        "pattern": r"\$\{[A-Za-z_][A-Za-z0-9_]*\}",
        "examples": ["${NAME}"],
    }
    root = definitions.pop(FleetConfig.__name__)
    root["description"] = "A fleet of robots: its OPC UA server, UA bridges, robots, and who takes over for whom."
    used = sorted(_reachable(root, definitions))
    return {"$schema": DIALECT, "title": "fleet.yaml", **root, "$defs": {name: definitions[name] for name in used}}


def schema_text(schema: Schema) -> str:
    """A schema as a file has it."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _models(kinds: Any) -> Iterator[type[BaseModel]]:
    for kind in kinds:
        yield kind
        for mapping in (kind.source_mapping, kind.sink_mapping, kind.skill_mapping):
            if mapping is not None:
                yield mapping


def _of_kinds(refs: dict[type[BaseModel], Schema], mappings: list[Any]) -> list[Schema]:
    """What the kinds have there, each shape once."""
    return [refs[mapping] for mapping in dict.fromkeys(mappings) if mapping is not None]


def _bridge(of_kind: dict[str, Schema]) -> Schema:
    """A bridge: what its keys are depends on its `kind`."""
    kind = BridgeConfig.model_fields["kind"].description
    return {
        "type": "object",
        "description": "One UA bridge, with the keys of its kind.",
        "required": ["kind"],
        "properties": {"kind": {"description": kind, "enum": list(of_kind)}},
        "allOf": [
            {"if": {"properties": {"kind": {"const": kind}}, "required": ["kind"]}, "then": reference}
            for kind, reference in of_kind.items()
        ],
    }


def _put(properties: dict[str, Schema], key: str, further: list[Schema]) -> None:
    """Let a key have `further` shapes besides its own; what is said about it stays outside."""
    shape = properties[key]
    notes: Schema = {name: shape.pop(name) for name in _NOTES if name in shape}
    properties[key] = {**notes, "anyOf": [*(shape.get("anyOf") or [shape]), *further]}


def _without_null(shape: Schema) -> Schema:
    (wanted,) = [part for part in shape["anyOf"] if part != _NO_VALUE]
    notes: Schema = {name: shape[name] for name in _NOTES if name in shape and shape[name] is not None}
    return {**notes, **wanted}


def _takes_variables(shape: Schema) -> bool:
    """Whether it is a scalar that not any text serves for."""
    if shape.get("type") in _SCALARS or "enum" in shape or "const" in shape:
        return True
    return shape.get("type") == "string" and bool(shape.keys() & {"pattern", "minLength", "maxLength", "format"})


def _finished(shape: Schema) -> Schema:
    """A shape with plain descriptions, names that are checked, pairs that all editors know, and `${NAME}`."""
    shape = dict(shape)
    if isinstance(text := shape.get("description"), str):
        shape["description"] = " ".join(text.split())
    if shape.get("default", "") in (None, "", [], {}) or isinstance(shape.get("default"), dict):
        shape.pop("default", None)
    shape.pop("title", None)
    if "patternProperties" in shape:
        shape["additionalProperties"] = False
    pair = shape.get("prefixItems")
    if pair and all(item == pair[0] for item in pair):
        del shape["prefixItems"]
        shape["items"] = pair[0]
    for key in ("properties", "patternProperties"):
        if key in shape:
            shape[key] = {
                name: inner if name in ("kind", "version") and "const" in inner else _finished(inner)
                for name, inner in shape[key].items()
            }
    for key in ("items", "additionalProperties"):
        if isinstance(shape.get(key), dict):
            shape[key] = _finished(shape[key])
    if "anyOf" in shape and not _is_rule(shape["anyOf"]):
        return _union(shape)
    if not _takes_variables(shape):
        return shape
    notes: Schema = {name: shape.pop(name) for name in _NOTES if name in shape}
    return {**notes, "anyOf": [shape, _reference(_VARIABLE)]}


def _is_rule(parts: list[Schema]) -> bool:
    """Whether it is a rule between keys, of `shapes.py`, and not a choice of types."""
    return all(part.keys() <= {"required", "properties"} for part in parts)


def _union(shape: Schema) -> Schema:
    parts: list[Schema] = []
    for part in shape["anyOf"]:
        finished = _finished(part)
        parts += finished["anyOf"] if finished.keys() == {"anyOf"} else [finished]
    parts = [part for position, part in enumerate(parts) if part not in parts[:position]]
    if {"type": "string"} in parts:
        parts = [part for part in parts if part != _reference(_VARIABLE)]
    return {**shape, "anyOf": parts}


def _reference(name: str) -> Schema:
    return {"$ref": f"#/$defs/{name}"}


def _reachable(shape: Any, definitions: dict[str, Schema], found: set[str] | None = None) -> set[str]:
    found = set() if found is None else found
    if isinstance(shape, dict):
        name = str(cast("Schema", shape).get("$ref", "")).removeprefix("#/$defs/")
        if name and name not in found:
            found.add(name)
            _reachable(definitions[name], definitions, found)
        for part in cast("Schema", shape).values():
            _reachable(part, definitions, found)
    elif isinstance(shape, list):
        for part in cast("list[object]", shape):
            _reachable(part, definitions, found)
    return found
