"""Units beside numbers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.fleet.quantities import UNITS, UnitsDiffer, convert


@pytest.mark.parametrize(
    ("value", "unit", "wanted", "expected"),
    [
        (180, "deg", "rad", 3.14159265),
        (1, "rad", "°", 57.2957795),
        (20, "°C", "K", 293.15),
        (68, "°F", "°C", 20),
        (0, "K", "°F", -459.67),
        (36, "km/h", "m/s", 10),
        (1500, "mm", "m", 1.5),
        (2, "min", "s", 120),
        (60, "rpm", "rad/s", 6.28318531),
        (50, "%", "1", 0.5),
        (7, "furlong", "furlong", 7),
    ],
)
def test_one_unit_in_another(value: float, unit: str, wanted: str, expected: float) -> None:
    assert convert(value, unit, wanted) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("unit", "wanted", "said"),
    [
        ("m", "deg", "m measures length, and deg measures angle"),
        ("meter", "m", "the unit 'meter' is not known"),
        ("m", "furlong", "the unit 'furlong' is not known"),
        ("degs", "deg", "did you mean `deg"),
    ],
)
def test_units_that_do_not_fit(unit: str, wanted: str, said: str) -> None:
    with pytest.raises(UnitsDiffer, match=said):
        convert(2, unit, wanted)


@given(st.sampled_from(sorted(UNITS)), st.sampled_from(sorted(UNITS)), st.floats(-1e6, 1e6))
def test_there_and_back(unit: str, wanted: str, value: float) -> None:
    if UNITS[unit][0] != UNITS[wanted][0]:
        with pytest.raises(UnitsDiffer):
            convert(value, unit, wanted)
    else:
        assert convert(convert(value, unit, wanted), wanted, unit) == pytest.approx(value, rel=1e-9, abs=1e-6)
