from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.pubsub.components import (
    CONNECTION,
    Component,
    Components,
    StateCounts,
    StateInvalid,
    parent_of,
    reader,
    reader_group,
    writer,
    writer_group,
)
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.discovered import PubSubState

GROUP, WRITER, OTHER = writer_group(2), writer(2, 1001), writer(2, 1002)
READERS, READER = reader_group(1), reader(Topic(1, 2, 7))
ALL = (CONNECTION, GROUP, WRITER, OTHER, READERS, READER)


def test_the_way_down_from_the_connection() -> None:
    assert [parent_of(each) for each in ALL] == [None, CONNECTION, GROUP, GROUP, CONNECTION, READERS]


def test_what_is_below_a_disabled_component_is_paused_and_comes_back_with_it() -> None:
    components = Components()
    were_whole = [components.is_whole]
    components.disable(GROUP)
    states = [components.state(each) for each in ALL]
    on, off, paused = PubSubState.OPERATIONAL, PubSubState.DISABLED, PubSubState.PAUSED
    assert states == [on, off, paused, paused, on, on]
    were_whole.append(components.is_whole)
    components.enable(GROUP)
    assert {components.state(each) for each in ALL} == {on}
    assert [*were_whole, components.is_whole] == [True, False, True]
    assert components.counts(GROUP) == StateCounts(operational_by_method=1, disabled_by_method=1)
    assert components.counts(WRITER) == StateCounts(operational_by_parent=1, paused_by_parent=1)


def test_enabling_below_a_disabled_parent_pauses() -> None:
    components = Components()
    components.disable(WRITER)
    components.disable(CONNECTION)
    components.enable(WRITER)
    assert components.state(WRITER) is PubSubState.PAUSED
    assert components.counts(WRITER) == StateCounts(paused_by_parent=1, disabled_by_method=1)
    components.enable(CONNECTION)
    assert components.counts(WRITER)._asdict() == {
        "operational_by_method": 0,
        "operational_by_parent": 1,
        "paused_by_parent": 1,
        "disabled_by_method": 1,
    }


def test_a_second_time_is_refused_with_the_status_of_the_standard() -> None:
    components = Components()
    with pytest.raises(StateInvalid) as enabled:
        components.enable(WRITER)
    components.disable(WRITER)
    with pytest.raises(StateInvalid) as disabled:
        components.disable(WRITER)
    assert {enabled.value.ua_status, disabled.value.ua_status} == {StatusCode.BAD_INVALID_STATE}
    assert components.counts(WRITER) == StateCounts(disabled_by_method=1)


class Naive:
    """The same, by looking at every component at each step."""

    def __init__(self) -> None:
        self.off: set[Component] = set()
        self.states = dict.fromkeys(ALL, PubSubState.OPERATIONAL)
        self.counts = {each: dict.fromkeys(StateCounts._fields, 0) for each in ALL}

    def switch(self, component: Component) -> None:
        is_disabling = component not in self.off
        self.off ^= {component}
        for each in ALL:  # parents come first
            before, above = self.states[each], parent_of(each)
            works = above is None or self.states[above] is PubSubState.OPERATIONAL
            after = PubSubState.OPERATIONAL if works else PubSubState.PAUSED
            if each in self.off:
                after = PubSubState.DISABLED
            self.states[each] = after
            own = "method" if each == component else "parent"
            if after is before:
                continue
            if after is PubSubState.DISABLED:
                self.counts[each]["disabled_by_method"] += 1
            elif after is PubSubState.PAUSED:
                self.counts[each]["paused_by_parent"] += 1
            else:
                self.counts[each][f"operational_by_{own}"] += 1
        assert is_disabling is (self.states[component] is PubSubState.DISABLED)


@given(steps=st.lists(st.sampled_from(ALL), max_size=30), looks=st.sets(st.integers(0, 30)))
def test_states_and_counts_are_those_of_looking_at_every_component(steps: list[Component], looks: set[int]) -> None:
    components, naive = Components(), Naive()
    for number, component in enumerate(steps):
        (components.disable if components.is_enabled(component) else components.enable)(component)
        naive.switch(component)
        if number in looks:  # whether somebody has looked in between changes nothing
            assert {each: components.counts(each)._asdict() for each in ALL} == naive.counts
    assert {each: components.state(each) for each in ALL} == naive.states
    assert {each: components.counts(each)._asdict() for each in ALL} == naive.counts
    assert components.is_whole is (not naive.off)
