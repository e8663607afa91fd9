"""`sources`: what does not fit together is a problem with its line."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid

OVEN: dict[str, Any] = {"publisher_id": 2234, "data_set_writer_id": 9, "robot": "press", "data": "temperature"}


def problems(security: str = "none", **sources: Any) -> list[tuple[str, str]]:
    fleet = {
        "version": 1,
        "pubsub": {"security": security},
        "bridges": {"cell": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": {
            "press": {
                "bridge": "cell",
                "data": {
                    "temperature": {"id": 1, "type": "Double"},
                    "level": {"id": 2, "type": "Double"},
                    "goal": {"id": 3, "type": "Double", "origin": "server"},
                    "own": {"id": 4, "type": "Double", "source": {"topic": "/x", "type": "std_msgs/Float64"}},
                },
            }
        },
        "sources": sources,
    }
    try:
        load_content(yaml.safe_dump(fleet).encode(), "f.yaml", {})
    except ConfigInvalid as invalid:
        return [(problem.key or "", problem.message) for problem in invalid.problems]
    return []


def test_a_source_that_fits() -> None:
    assert problems(oven=OVEN) == []
    assert problems("sign", oven=OVEN, other={**OVEN, "data_set_writer_id": 10, "data": "level"}) == []
    assert problems(oven={**OVEN, "publisher_id": "oven 7", "fields": {"a b": {"type": "Double"}}}) == []


@pytest.mark.parametrize(
    ("changes", "key", "said"),
    [
        ({"robot": "pres"}, "sources.oven.robot", "there is no robot"),
        ({"data": "temp"}, "sources.oven.data", "has no data"),
        ({"data": "goal"}, "sources.oven.data", "clients write"),
        ({"data": "own"}, "sources.oven.data", "has a `source`"),
        ({"publisher_id": 70_000}, "sources.oven", "0 to 65535"),
        ({"publisher_id": "x", "publisher_id_type": "UInt32"}, "sources.oven", "is no UInt32"),
        ({"publisher_id": 5, "publisher_id_type": "String"}, "sources.oven", "is no String"),
        ({"data_set_writer_id": 0}, "sources.oven.data_set_writer_id", ""),
        ({"fields": {"a": {"type": "Doubl"}}}, "sources.oven.fields.a.type", ""),
        ({"writer": 1}, "sources.oven.writer", ""),
    ],
)
def test_a_source_that_does_not_fit(changes: dict[str, Any], key: str, said: str) -> None:
    [(where, text)] = problems(oven={**OVEN, **changes})
    assert where.startswith(key)
    assert said in text


def test_two_sources_are_two_writers_and_two_nodes() -> None:
    assert [key for key, _ in problems(a={**OVEN}, b={**OVEN})] == ["sources.b.data", "sources.b.data_set_writer_id"]


def test_messages_that_are_signed_have_a_publisher_with_keys() -> None:
    [(key, text)] = problems("sign", oven={**OVEN, "publisher_id": "oven"})
    assert key == "sources.oven.publisher_id"
    assert "has no SecurityGroup" in text
