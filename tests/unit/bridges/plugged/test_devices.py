"""Rules against devices."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_bridges.plugged.config import Match
from ua_bridges.plugged.devices import DeviceFacts, Plugged, Plugs, Unplugged, fits

BOX = DeviceFacts("/sys/a", "tty", "/dev/ttyACM0", "2341", "0043", "7", {"ID_PATH": "usb-1"}, {"name": "x"})


@pytest.mark.parametrize(
    ("rule", "does"),
    [
        ({"vendor": "2341"}, True),
        ({"vendor": "2341", "product": "0043", "serial": "7"}, True),
        ({"vendor": "2342"}, False),
        ({"serial": "8"}, False),
        ({"node": "/dev/ttyACM*"}, True),
        ({"node": "/dev/ttyUSB*"}, False),
        ({"properties": {"ID_PATH": "usb-1"}}, True),
        ({"properties": {"ID_PATH": "usb-2"}}, False),
        ({"properties": {"ID_MODEL": "y"}}, False),
        ({"attributes": {"name": "x"}}, True),
        ({"attributes": {"name": "y"}}, False),
        ({"vendor": "2341", "subsystem": "hwmon"}, False),
    ],
)
def test_all_that_a_rule_says_has_to_fit(rule: dict[str, Any], does: bool) -> None:
    assert fits(Match(**rule), BOX) is does


def test_hexadecimal_digits_may_be_large() -> None:
    assert fits(Match(vendor="0ABC"), DeviceFacts("/sys/a", "tty", vendor="0abc"))


def device(number: int, serial: str = "7") -> DeviceFacts:
    return DeviceFacts(f"/sys/{number}", "tty", f"/dev/tty{number}", "2341", "0043", serial)


def test_the_first_wins_and_the_second_takes_over() -> None:
    plugs = Plugs({"box": Match(vendor="2341")})
    assert plugs.appeared(device(1)) == [Plugged("box", device(1))]
    assert plugs.appeared(device(1)) == []
    assert plugs.appeared(device(2)) == []
    assert plugs.others("box") == [device(2)]
    assert plugs.vanished("/sys/1") == [Unplugged("box", device(1)), Plugged("box", device(2))]
    assert plugs.vanished("/sys/9") == []


def test_a_list_made_anew_tells_what_was_missed() -> None:
    plugs = Plugs({"one": Match(serial="1"), "two": Match(serial="2")})
    plugs.appeared(device(1, "1"))
    changes = plugs.there({"/sys/2": device(2, "2")})
    assert changes == [Unplugged("one", device(1, "1")), Plugged("two", device(2, "2"))]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 4), st.sampled_from("78"))))
def test_what_is_told_adds_up(steps: list[tuple[bool, int, str]]) -> None:
    rules = {"any": Match(vendor="2341"), "eight": Match(serial="8"), "other": Match(vendor="2341")}
    plugs, held = Plugs(rules), dict[str, DeviceFacts]()
    for comes, number, serial in steps:
        for change in plugs.appeared(device(number, serial)) if comes else plugs.vanished(f"/sys/{number}"):
            if isinstance(change, Plugged):
                assert change.rule not in held
                held[change.rule] = change.device
            else:
                assert held.pop(change.rule) == change.device
        assert len({each.id for each in held.values()}) == len(held)
        assert held == {rule: there for rule in rules if (there := plugs.device_of(rule)) is not None}
        assert all(fits(rules[rule], each) for rule, each in held.items())
