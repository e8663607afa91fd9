"""Patterns over names of nodes."""

from __future__ import annotations

import pytest

from ua_fleet.client.patterns import Pattern, has_wildcard


def matches(text: str, path: str) -> bool:
    pattern = Pattern(text)
    states = pattern.start
    for name in path.split("/"):
        states = pattern.feed(states, name)
    return pattern.is_match(states)


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("rover", "rover"),
        ("rover.battery", "rover/battery"),
        ("rover/battery", "rover/battery"),
        ("rover.*.battery", "rover/Data/battery"),
        ("*.battery", "rover/battery"),
        ("r*r.b*", "rover/battery"),
        ("rover-?", "rover-1"),
        ("rover.velocity.linear.x", "rover/velocity/linear.x"),
        ("rover.velocity.*", "rover/velocity/linear.x"),
        ("rover/velocity/linear.x", "rover/velocity/linear.x"),
        ("rover.linear.*", "rover/linear.x"),
        ("cell.3", "cell.3"),
        ("**.battery", "battery"),
        ("**.battery", "rover/battery"),
        ("**/battery", "rover/Data/arm/battery"),
        ("rover.**.x", "rover/x"),
        ("rover.**.x", "rover/pose/position/x"),
        ("rover.**", "rover/pose/x"),
        ("rover.**", "rover"),
        ("rover.**.**.x", "rover/x"),
        ("rover/", "rover"),
        ("a[1].b", "a[1]/b"),
    ],
)
def test_what_a_pattern_names(text: str, path: str) -> None:
    assert matches(text, path)


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("rover", "rover2"),
        ("rover", "rover/battery"),
        ("rover.*", "rover/Data/battery"),
        ("rover.*.battery", "rover/battery"),
        ("*", "rover/battery"),
        ("rover-?", "rover-12"),
        ("rover-?", "rover-/x"),
        ("rover/linear.x", "rover/linear/x"),
        ("rover/linear.x", "rover/linear-x"),
        ("Rover", "rover"),
        ("**.battery", "rover/flatbattery"),
        ("rover.**.x", "rover/pose/max"),
        ("rover.**.x", "roverx"),
    ],
)
def test_what_it_does_not_name(text: str, path: str) -> None:
    assert not matches(text, path)


def test_a_subtree_in_which_nothing_can_match_is_known_at_its_root() -> None:
    pattern = Pattern("rover-1.*.battery")
    assert pattern.feed(pattern.start, "rover-2") == frozenset()
    there = pattern.feed(pattern.start, "rover-1")
    assert there
    assert not pattern.is_match(there)


@pytest.mark.parametrize(
    ("text", "first", "ends_literally"),
    [("rover.*.battery", "rover", True), ("r*/x.y", "r*", True), ("rover.*", "rover", False), ("rover", "rover", True)],
)
def test_what_is_said_of_its_ends(text: str, first: str, ends_literally: bool) -> None:
    pattern = Pattern(text)
    assert (pattern.first, pattern.ends_literally) == (first, ends_literally)


def test_a_long_pattern_of_wildcards_takes_no_more_time_than_its_length() -> None:
    pattern = Pattern("*a" * 200)
    assert not pattern.is_match(pattern.feed(pattern.start, "a" * 1000 + "b"))


def test_wildcards() -> None:
    assert has_wildcard("rover.*")
    assert has_wildcard("rover-?")
    assert not has_wildcard("rover.battery")
