"""What a bridge counts of its groups goes into one field and comes out again."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.pubsub.publishing import TOPIC, WALL, Writing
from ua_fleet.pubsub.components import CONNECTION, writer, writer_group
from ua_fleet.pubsub.group_figures import GroupFigures, LinkErrors, figures_of, packed, unpacked
from ua_fleet.topics import Topic

NUMBERS = st.integers(0, 2**32 - 1)
FIGURES = st.builds(GroupFigures, st.integers(0, 0xFFFF), *[NUMBERS] * (len(GroupFigures._fields) - 1))


@given(figures=st.lists(FIGURES, unique_by=lambda each: (each.connection, each.writer_group_id)))
def test_what_is_packed_is_unpacked(figures: list[GroupFigures]) -> None:
    assert list(unpacked(packed(figures)).values()) == figures


@pytest.mark.parametrize(
    "numbers", [(), (1, 2, 3), (14,), *[(14, *[one] * 14) for one in ("a", 1.5, True)], (14, *[1] * 13), (0, *[1] * 11)]
)
def test_what_is_none_of_it_tells_of_nothing(numbers: tuple[Any, ...]) -> None:
    assert unpacked(numbers) == {}


def test_one_of_another_layout_tells_of_nothing() -> None:
    """A bridge of another version: its rows have another length."""
    size, *numbers = packed([GroupFigures(2, 7)] * 7)
    assert unpacked((size - 2, *numbers)) == {}


def test_a_count_that_is_too_large_stops_at_the_largest() -> None:
    assert unpacked(packed([GroupFigures(2, 2**40)]))[0, writer_group(2)].sent == 2**32 - 1


def test_the_figures_are_those_of_the_writers_that_there_are() -> None:
    writing = Writing()
    writing.announce()
    writing.announce(Topic(1, 2, 1002))
    writing.announce(Topic(1, 3, 1003))
    writing.publisher.retire(Topic(1, 3, 1003))
    writing.publish()
    switches = writing.publisher.switches
    switches.disable(writer(2, 1002), timestamp=WALL, now=writing.now)
    switches.disable(CONNECTION, timestamp=WALL, now=writing.now)
    switches.enable(CONNECTION, now=writing.now)
    hall, site = LinkErrors(), LinkErrors()
    for problem in ("away", "", "away"):
        site.look(problem)
    made = figures_of(writing.publisher, Counter({2: 5}), Counter[int](), [hall, site])
    told = {(each.connection, each.component): each for each in made}
    assert told.keys() == {(0, CONNECTION), (1, CONNECTION), (0, writer_group(2))}
    assert [(each.errors, each.from_error, each.has_problem) for each in made[:2]] == [(0, 0, 0), (2, 1, 1)]
    assert [(each.disabled, each.by_method) for each in made[:2]] == [(1, 1)] * 2
    group = told[0, writer_group(TOPIC.ns)]
    assert group.sent == writing.publisher.sent_messages[2] > 2
    assert (group.failed, group.not_secured, group.configured, group.operational) == (5, 0, 2, 1)
    assert (group.paused, group.by_parent) == (1, 1)


def test_each_change_of_the_link_is_counted_once() -> None:
    errors = LinkErrors()
    for problem in ("", "away", "away", "", "", "away"):
        errors.look(problem)
    assert errors.counts == (2, 1)
