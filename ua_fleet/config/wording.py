"""What pydantic finds wrong, in plain words, with a suggestion where there is one."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterable, Mapping
from enum import EnumMeta
from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from ua_fleet.document import KeyPath
from ua_fleet.names import closest, listed

__all__ = ["ModelFinding", "choices", "existing_path", "explain", "fields_at"]

_NAME_RULE: Final = "a name begins with a letter; then letters, digits, _ and -, 64 at most"

_WANTED: Final[dict[str, str]] = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "string_type": "a text",
    "dict_type": "keys with values",
    "model_type": "keys with values",
    "model_attributes_type": "keys with values",
    "tuple_type": "a list like [a, b]",
    "list_type": "a list like [a, b]",
}


class ModelFinding(NamedTuple):
    """One problem of a model, with its path from where the model stands."""

    path: KeyPath
    message: str
    suggestion: str = ""


def _members(annotation: Any) -> list[Any]:
    """An annotation without Annotated and Optional, as the types that it allows."""
    origin = typing.get_origin(annotation)
    if origin is Annotated:
        return _members(typing.get_args(annotation)[0])
    if origin in (typing.Union, types.UnionType):
        return [inner for part in typing.get_args(annotation) for inner in _members(part)]
    return [annotation]


def choices(annotation: Any) -> list[str]:
    """The values that an annotation allows, if they can be listed."""
    found: list[str] = []
    for member in _members(annotation):
        if typing.get_origin(member) is Literal:
            found += [str(value) for value in typing.get_args(member)]
        elif isinstance(member, EnumMeta):
            found += [str(item.value) for item in typing.cast("Iterable[Any]", member)]
    return found


def _model_of(annotation: Any) -> type[BaseModel] | None:
    for member in _members(annotation):
        if isinstance(member, type) and issubclass(member, BaseModel):
            return member
    return None


def _values_of(annotation: Any) -> Any:
    """The annotation of the values of a mapping or a list, or None."""
    for member in _members(annotation):
        arguments = typing.get_args(member)
        if typing.get_origin(member) is dict:
            return arguments[1]
        if typing.get_origin(member) in (tuple, list):
            return arguments[0]
    return None


def _walk(model: type[BaseModel], path: KeyPath) -> tuple[FieldInfo | None, Any]:
    """The field that a path leads to (None for an item of a mapping or list), and its annotation."""
    field: FieldInfo | None = None
    annotation: Any = model
    for step in path:
        inner = _model_of(annotation)
        if inner is not None:
            field = inner.model_fields.get(str(step))
            annotation = field.annotation if field is not None else None
        else:
            field, annotation = None, _values_of(annotation)
    return field, annotation


def _field_of(model: type[BaseModel], path: KeyPath) -> FieldInfo | None:
    """The field of a model, or of a model within it, that a path leads to."""
    return _walk(model, path)[0]


def fields_at(model: type[BaseModel], path: KeyPath) -> dict[str, FieldInfo]:
    """The fields of the model that a path leads to; none where it leads to a value or a mapping of names."""
    inner = _model_of(_walk(model, path)[1])
    return dict(inner.model_fields) if inner is not None else {}


def _examples(annotation: Any) -> list[Any]:
    """The examples that stand inside an annotation, as in Optional[Annotated[str, Field(examples=...)]]."""
    arguments = typing.get_args(annotation)
    if typing.get_origin(annotation) is Annotated:
        return [example for part in arguments[1:] if isinstance(part, FieldInfo) for example in part.examples or []]
    return [example for part in arguments for example in _examples(part)]


def _example(field: FieldInfo | None) -> str:
    if field is None:
        return ""
    for examples in (field.examples, _examples(field.annotation)):
        if examples:
            return f"write it like `{examples[0]}`"
    if isinstance(field.default, str) and field.default:
        return f"write it like `{field.default}`"
    return ""


def _missing(field: FieldInfo | None, key: str) -> str:
    if field is None:
        return ""
    allowed = choices(field.annotation)
    if len(allowed) == 1:
        return f"add `{key}: {allowed[0]}`"
    if allowed and field.examples:
        return f"add `{key}: {field.examples[0]}`; allowed: {listed(allowed)}"
    example = field.examples[0] if field.examples else "..."
    return f"allowed: {listed(allowed)}" if allowed else f"add `{key}: {example}`"


def _unknown(model: type[BaseModel], path: KeyPath) -> ModelFinding:
    key = str(path[-1])
    known = fields_at(model, path[:-1])
    near = closest(key, known)
    if not near:
        sections = [name for name in known if key in fields_at(model, (*path[:-1], name))]
        near = f"it belongs under `{sections[0]}`" if sections else ""
    return ModelFinding(path, f"unknown key `{key}`", near or f"known keys: {listed(known)}")


def _shown(value: Any) -> str:
    text = {True: "true", False: "false", None: "nothing"}.get(value, "") if _is_word(value) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_word(value: Any) -> bool:
    return value is None or isinstance(value, bool)


def _limit(kind: str, context: Mapping[str, Any]) -> str | None:
    words = {
        "greater_than": ("gt", "greater than"),
        "greater_than_equal": ("ge", "at least"),
        "less_than": ("lt", "less than"),
        "less_than_equal": ("le", "at most"),
    }.get(kind)
    return f"must be {words[1]} {context[words[0]]:g}" if words else None


def _not_wanted(kind: str, value: Any) -> ModelFinding | None:
    wanted = _WANTED.get(kind)
    if wanted is None:
        return None
    if kind == "string_type" and not isinstance(value, dict | list) and value is not None:
        return ModelFinding((), f"must be a text, not {_shown(value)}", f'put it in quotes: "{_shown(value)}"')
    if value is None:
        return ModelFinding((), f"has no value; it must be {wanted}", "write a value, or remove the key")
    if isinstance(value, dict | list):
        return ModelFinding((), f"must be {wanted}, not {'a list' if isinstance(value, list) else 'keys with values'}")
    hint = "remove the quotes" if isinstance(value, str) and value.isdecimal() and "number" in wanted else ""
    return ModelFinding((), f"must be {wanted}, not `{_shown(value)}`", hint)


def _value_finding(model: type[BaseModel], path: KeyPath, error: ErrorDetails) -> ModelFinding:
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    field = _field_of(model, path)
    if (finding := _not_wanted(kind, value)) is not None:
        return finding
    if (limit := _limit(kind, context)) is not None:
        return ModelFinding((), f"{limit}, not {_shown(value)}")
    if kind in ("literal_error", "enum"):
        allowed = choices(field.annotation) if field is not None else []
        near = "remove the quotes;" if value in allowed and isinstance(value, str) else closest(str(value), allowed)
        return ModelFinding((), f"`{_shown(value)}` is not allowed", f"{near} allowed: {listed(allowed)}".strip())
    if kind == "string_pattern_mismatch":
        hint = _example(field) or f"it must match {context['pattern']}"
        return ModelFinding((), f"`{_shown(value)}` is not in the right form", hint)
    if kind in ("too_short", "too_long") and isinstance(value, list):
        count = context.get("min_length", context.get("max_length"))
        return ModelFinding((), f"must have {count} values, not {context['actual_length']}")
    if kind == "string_too_short":
        return ModelFinding((), f"is too short; it needs {context['min_length']} characters")
    if kind == "value_error":
        return ModelFinding((), str(context["error"]))
    return ModelFinding((), error["msg"][:1].lower() + error["msg"][1:])


def existing_path(data: Any, path: KeyPath) -> KeyPath:
    """As much of a path as exists in the data: what follows are names that pydantic gives to branches of a union."""
    for position, step in enumerate(path):
        try:
            data = data[step]
        except (LookupError, TypeError):
            return path[:position]
    return path


def _within_union(model: type[BaseModel], data: Any, loc: KeyPath, *, is_missing: bool) -> KeyPath | None:
    """The path without the name that pydantic gives to the branch of a union; None for what is to be left out.

    Where a mapping is given and one branch is a model, that one was meant, whatever the others say.
    """
    path = existing_path(data, loc)
    rest = loc[len(path) :]
    if not rest or (is_missing and len(rest) == 1):
        return loc
    field = _field_of(model, path)
    models = [each.__name__ for each in typing.get_args(field.annotation) if _is_model(each)] if field else []
    if rest[0] in models:
        return _within_union(model, data, (*path, *rest[1:]), is_missing=is_missing)
    for step in path:
        data = data[step]
    return None if models and isinstance(data, Mapping) else loc


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def explain(model: type[BaseModel], data: Mapping[str, Any], errors: Iterable[ErrorDetails]) -> list[ModelFinding]:
    """The findings for pydantic's errors about `data`, one for each value."""
    findings: dict[KeyPath, ModelFinding] = {}
    for error in errors:
        within = _within_union(model, data, error["loc"], is_missing=error["type"] == "missing")
        if within is None:
            continue
        loc = within
        if error["type"] == "missing":
            suggestion = _missing(_field_of(model, loc), str(loc[-1]))
            finding = ModelFinding(loc, f"`{loc[-1]}` is missing", suggestion)
        elif error["type"] == "extra_forbidden":
            finding = _unknown(model, loc)
        elif loc and loc[-1] == "[key]":
            finding = ModelFinding(loc[:-1], f"`{_shown(loc[-2])}` is not allowed as a name", _NAME_RULE)
        else:
            path = existing_path(data, loc)
            if path in findings or path != loc:  # a union: each of its branches complains
                field = _field_of(model, path)
                union = ModelFinding(path, "must be a single value: true or false, a number or a text")
                finding = findings.get(path, union if field is not None else ModelFinding(path, error["msg"]))
            else:
                finding = _value_finding(model, path, error)._replace(path=path)
        findings.setdefault(finding.path, finding)
    return list(findings.values())
