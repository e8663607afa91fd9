from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from ua_fleet.config.typed_texts import validated
from ua_fleet.console.load import load_settings
from ua_fleet.document import read_document


class Inner(BaseModel):
    names: tuple[str, ...] = ()
    limit: float | None = None


class Outer(BaseModel):
    folder: Path
    any_value: bool | int | float | str
    inner: Inner


CONTENT = b"a:\n  folder: ${N}\n  any_value: ${N}\n  inner:\n    names:\n      - x\n      - ${N}\n    limit: ${N}\n"


def test_each_field_takes_what_it_wants_and_the_data_has_it() -> None:
    """Data that is validated once more later, as that of skills, has what was taken."""
    document = read_document(CONTENT, "f.yaml", {"N": "0123"})
    data: dict[str, Any] = document.data["a"]
    model = validated(Outer, data, ("a",), document)
    assert (str(model.folder), model.any_value) == ("0123", 123)
    assert model.inner == Inner(names=("x", "0123"), limit=123.0)
    assert data == {"folder": "0123", "any_value": 123, "inner": {"names": ["x", "0123"], "limit": 123}}


def test_what_the_file_says_without_quotes_is_still_no_text() -> None:
    document = read_document(CONTENT.replace(b"${N}", b"0123"), "f.yaml", {})
    with pytest.raises(ValidationError):
        validated(Outer, document.data["a"], ("a",), document)


def test_settings_of_the_console_take_texts_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HALL", "1e5")
    file = tmp_path / "console.yaml"
    file.write_text("version: 1\nfleets:\n  hall:\n    endpoint: opc.tcp://127.0.0.1:4840\n    title: ${HALL}\n")
    assert load_settings(file, {}).fleets["hall"].title == "1e5"
