"""What comes from the environment is a text, and its field says what it means: `0123` is a password, and no port.

A value of the file says by its quotes whether it is a text. One out of `${VAR}` or `UA_FLEET__...` has none.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ValidationError

from ua_fleet.config.wording import existing_path
from ua_fleet.document import Document, KeyPath

__all__ = ["validated"]

_Model = TypeVar("_Model", bound=BaseModel)

_WANTS_TEXT: Final = ("string_type", "path_type", "literal_error", "enum")


def validated(model: type[_Model], data: Mapping[str, Any], path: KeyPath, document: Document) -> _Model:
    """`data`, which stands at `path` of the document, as a model; texts of the environment as its fields want them.

    These texts take their place in `data`.

    Raises:
        ValidationError: for what is wrong then.
    """
    words = {where: text for where, value, text in _given(data, path, document) if value is None and text}
    for where, text in words.items():  # a user may be called null; what is no text is nothing, as it was
        _put(data, where, text)
    try:
        return _checked(model, data)
    except ValidationError as error:
        said = [(existing_path(data, one["loc"]), one["type"]) for one in error.errors(include_url=False)]
    for where, kind in said:
        if where in words:
            _put(data, where, None)
        elif kind in _WANTS_TEXT and (*path, *where) in document.texts:
            _put(data, where, document.texts[(*path, *where)])
    return _checked(model, data)


def _checked(model: type[_Model], data: Mapping[str, Any]) -> _Model:
    # JSON is pydantic's one mode that is strict about scalars and yet takes lists and names of enumerations.
    return model.model_validate_json(json.dumps(data), strict=True)


def _given(data: Mapping[str, Any], path: KeyPath, document: Document) -> Iterator[tuple[KeyPath, Any, str]]:
    """Where values of the environment are in the data, and their texts."""
    for place, text in document.texts.items():
        where = place[len(path) :]
        if where and place[: len(path)] == path and existing_path(data, where) == where:
            value: Any = data
            for step in where:
                value = value[step]
            yield where, value, text


def _put(data: Any, where: KeyPath, value: str | None) -> None:
    for step in where[:-1]:
        data = data[step]
    data[where[-1]] = value
