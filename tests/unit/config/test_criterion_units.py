"""The unit of a criterion: its own, or that of the values that it is made of."""

from __future__ import annotations

import pytest

from ua_fleet.config.criterion_units import settings_with_units
from ua_fleet.config.load import load_content

FLEET = """\
version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1}
robots:
  one:
    bridge: floor
    data:
      battery: {id: 11, type: Double, unit: "%"}
      load: {id: 12, type: Double, unit: kg}
      speed: {id: 13, type: Double, unit: m/s}
      pose: {id: 14, fields: {x: {type: Double, unit: m}, y: {type: Double, unit: m}}}
      cells: {id: 15, type: Double, array: true, unit: V}
  two:
    bridge: floor
    data:
      load: {id: 22, type: Double, unit: kg}
      speed: {id: 23, type: Double, unit: km/h}
      pose: {id: 24, fields: {x: {type: Double, unit: m}, y: {type: Double, unit: m}}}
      plain: {id: 25, type: Double}
resilience:
  criteria:
    one: {kind: benefit, range: [0, 100], CRITERION}
"""


@pytest.mark.parametrize(
    ("criterion", "unit"),
    [
        ("unit: lb, value: load", "lb"),
        ("value: load", "kg"),
        ("value: battery", "%"),  # the other robot has none
        ("value: speed", ""),  # one has m/s, the other km/h
        ('value: "cells[0]"', "V"),
        ("value: plain", ""),
        ("distance: {x: pose.x, y: pose.y}", "m"),
        ("distance: {x: pose.x, y: speed}", ""),
        ("tasks_ahead: true", ""),
    ],
)
def test_a_criterion_has_its_own_unit_or_that_which_all_its_values_have(criterion: str, unit: str) -> None:
    config = load_content(FLEET.replace("CRITERION", criterion).encode(), "f.yaml", {})
    settings = settings_with_units(config)
    assert [one.unit for one, _ in settings.criteria] == [unit]
    assert [one for _, one in settings.criteria] == [one for _, one in config.resilience.settings().criteria]
