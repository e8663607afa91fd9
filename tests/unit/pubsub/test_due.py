"""Due times, beside a search through all of them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.pubsub.due import DueTimes

KEYS = st.integers(0, 4)
TIMES = st.integers(0, 9).map(float)
STEPS = st.one_of(
    st.tuples(st.just("put"), KEYS, TIMES), st.tuples(st.just("discard"), KEYS, st.none()), st.tuples(st.just("pop"))
)


@given(st.lists(STEPS, max_size=60))
def test_the_first_is_what_a_search_finds(steps: list[tuple[str, int, float | None] | tuple[str]]) -> None:
    due = DueTimes[int]()
    model: dict[int, float] = {}
    for step in steps:
        if len(step) == 1:
            if model:
                key = due.pop()
                assert model[key] == min(model.values())
                del model[key]
            else:
                with pytest.raises(KeyError):
                    due.pop()
        elif step[2] is None:
            due.discard(step[1])
            model.pop(step[1], None)
        else:
            due.put(step[1], step[2])
            model[step[1]] = step[2]
        assert due.next() == min(model.values(), default=None)
        assert {key: due.get(key) for key in due} == model
        assert [due.is_due(now) for now in range(10)] == [any(at <= now for at in model.values()) for now in range(10)]


def test_what_is_due_at_once_comes_in_the_order_in_which_it_was_put() -> None:
    due = DueTimes[str]()
    for key in "bca":
        due.put(key, 1.0)
    assert [due.pop() for _ in range(3)] == ["b", "c", "a"]
    due.put("x", 1.0)
    due.clear()
    assert due.next() is None
