from __future__ import annotations

import re
import typing
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from ua_fleet.config.assign_ids import assign_ids
from ua_fleet.config.default_file import default_content, write_default
from ua_fleet.config.load import load, load_content
from ua_fleet.config.schema import BridgeConfig, FleetConfig, KeysConfig, PubSubConfig, ServerConfig
from ua_fleet.errors import ConfigError, ConfigInvalid


def decided() -> bytes:
    return default_content().replace(b"#security: none", b"security: none")


def keys_of(annotation: Any, seen: set[type]) -> set[str]:
    """The keys of a model and of all models in it."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation in seen:
            return set()
        seen.add(annotation)
        fields = annotation.model_fields
        return set(fields) | {key for field in fields.values() for key in keys_of(field.annotation, seen)}
    return {key for part in typing.get_args(annotation) for key in keys_of(part, seen)}


def test_the_file_says_what_has_to_be_decided_and_nothing_else() -> None:
    with pytest.raises(ConfigInvalid) as caught:
        load_content(default_content(), "f.yaml", {}, allow_missing_ids=True)
    assert [problem.key for problem in caught.value.problems] == ["pubsub.security"]


def test_its_values_are_the_defaults() -> None:
    config = load_content(decided(), "f.yaml", {}, allow_missing_ids=True)
    assert config.server == ServerConfig()
    assert config.pubsub == PubSubConfig.model_validate({"security": "none"})
    assert config.fleet == FleetConfig.model_fields["fleet"].default


def test_it_shows_every_key_there_is() -> None:
    kinds: list[type[BridgeConfig]] = [entry.load() for entry in entry_points(group="ua_fleet.bridges")]
    mappings = [kind.source_mapping for kind in kinds] + [kind.sink_mapping for kind in kinds]
    models: list[type] = [FleetConfig, *kinds, *(mapping for mapping in mappings if mapping is not None)]
    known = {key for model in models for key in keys_of(model, set())}
    shown = set(re.findall(r"(?:^|[{,#]) *([a-z_]+):", default_content().decode(), re.MULTILINE))
    assert known - shown == set()


def test_every_section_of_the_server_and_pubsub_stands_there_with_a_comment_above() -> None:
    lines = default_content().decode().splitlines()
    for key in (*ServerConfig.model_fields, *PubSubConfig.model_fields, *KeysConfig.model_fields):
        at = next(i for i, line in enumerate(lines) if re.match(rf"  (  )?#?{key}:", line))
        above = lines[at - 1].strip()
        assert above.startswith("#") or key.startswith("max_"), key


def test_from_the_new_file_to_a_valid_one(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    write_default(path)
    assert path.read_bytes() == default_content()
    with pytest.raises(ConfigError, match="exists already; choose another name"):
        write_default(path)
    path.write_bytes(decided())
    assert len(assign_ids(path, {})) == 8
    assert load(path, {}).robots["carrier"].data["battery"].id == 1006


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written: no such file or directory"):
        write_default(tmp_path / "no" / "fleet.yaml")


def test_on_a_full_disk_nothing_is_left_that_is_refused_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> bytes:
        raise OSError(28, "No space left on device")

    path = tmp_path / "fleet.yaml"
    with monkeypatch.context() as patched:
        patched.setattr("ua_fleet.config.default_file.default_content", full)
        with pytest.raises(ConfigError, match="no space left on device"):
            write_default(path)
    write_default(path)
    assert path.read_bytes() == default_content()
