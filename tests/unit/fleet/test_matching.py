"""Values by the names of their fields, never by their places."""

from __future__ import annotations

import pytest

from tests.unit.fleet.fleet_of import DOUBLE, metadata_of
from ua_fleet.errors import FieldMissing
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.wire.messages import DataSetMetaData


def announced(*names: str) -> DataSetMetaData:
    return metadata_of(*[make_field(name, DOUBLE) for name in names])


def test_values_come_in_the_order_of_the_file_whatever_is_announced() -> None:
    order = FieldOrder("rover.goal", [("x", None), ("y", None)])
    one, other = announced("x", "y"), announced("more", "y", "x")
    for _ in range(2):
        assert order.arranged(one, (1.0, 2.0)) == (1.0, 2.0)
        assert order.arranged(other, (3.0, 2.0, 1.0)) == (1.0, 2.0)


def test_a_mirrored_topic_names_them_by_their_paths() -> None:
    order = FieldOrder("rover.goal", [("vx", "linear.x"), ("wz", "angular.z")])
    assert order.arranged(announced("angular.z", "linear.x"), (2.0, 1.0)) == (1.0, 2.0)


def test_a_single_field_has_any_name() -> None:
    order = FieldOrder("rover.speed", [("speed", None)])
    assert order.arranged(announced("data"), (7.0,)) == (7.0,)
    assert order.arranged(announced("more", "speed"), (1.0, 7.0)) == (7.0,)


def test_a_missing_field_is_named_each_time() -> None:
    order = FieldOrder("rover.goal", [("x", None), ("y", None)])
    wrong = announced("x", "z")
    for _ in range(2):
        with pytest.raises(FieldMissing, match=r"rover\.goal: its messages have no field 'y', but x, z"):
            order.arranged(wrong, (1.0, 2.0))
    with pytest.raises(FieldMissing, match="1 values came, and 2 fields are announced"):
        order.arranged(announced("x", "y"), (1.0,))
