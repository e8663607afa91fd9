"""The pages about `fleet.yaml`: the examples are legal, and the reference is that of the schema."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
from pydantic import BaseModel
from ua_bridges.ros.topic_mapping import QosConfig, TopicMapping

from tests.unit.docs.pages import ROOT, Block, blocks
from ua_fleet.config import load
from ua_fleet.config.kinds import known_kinds, model_of_kind
from ua_fleet.config.reference import BEGIN, END, put_between, reference
from ua_fleet.config.schema import BridgeConfig, DataSetConfig, FieldConfig, FleetConfig

PAGE = ROOT / "docs" / "fleet-yaml.md"


@pytest.mark.parametrize("block", [pytest.param(block, id=block.place) for block in blocks("yaml")])
def test_example_is_a_legal_file(block: Block, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(block.text, encoding="utf-8")
    assert load(file, {}).version == 1


def test_there_are_examples() -> None:
    assert {block.page.name for block in blocks("yaml")} >= {"fleet-yaml.md", "ros.md"}


def test_reference_is_that_of_the_schema() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert put_between(text, BEGIN, END, reference()) == text, (
        "run: python -m ua_fleet.config.reference docs/fleet-yaml.md"
    )


def test_every_key_is_in_the_reference_with_a_text() -> None:
    models: list[type[BaseModel]] = [FleetConfig, DataSetConfig, FieldConfig, TopicMapping, QosConfig]
    models += [model_of_kind(kind) for kind in known_kinds()]
    for section in FleetConfig.model_fields.values():
        if isinstance(section.annotation, type) and issubclass(section.annotation, BaseModel):
            models.append(section.annotation)
    assert len(models) >= 10
    told = reference()
    for model in models:
        for name, field in model.model_fields.items():
            assert field.description, f"{model.__name__}.{name} has no text"
            assert f"| `{name}` |" in told


def test_markers_that_are_missing_are_told() -> None:
    assert put_between("a\nB\nold\nE\nz\n", "B", "E", "new") == "a\nB\n\nnew\n\nE\nz\n"
    with pytest.raises(ValueError, match="no lines B and E"):
        put_between("a\n", "B", "E", "new")


@pytest.mark.parametrize("block", [pytest.param(block, id=block.place) for block in blocks("python")])
def test_program_compiles(block: Block) -> None:
    compile(block.text, block.place, "exec")


def test_configuration_of_a_new_kind_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (text,) = [block.text for block in blocks("python") if block.page.name == "adding-a-bridge.md"]
    (tmp_path / "mybot_config_example.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr("sys.path", [str(tmp_path), *sys.path])
    module = importlib.import_module("mybot_config_example")
    made = module.MybotBridgeConfig(kind="mybot", space=300, address="10.0.0.8")
    assert isinstance(made, BridgeConfig)
    assert type(made).model_fields["address"].description == "Address of the controller."
