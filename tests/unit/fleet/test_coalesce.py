"""Analog values at most so often, and never none."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.fleet import Coalescer, ValueChanged
from ua_fleet.values import NodeId

KEY = NodeId(2, 1)


def change(value: object, *, can_wait: bool = True, key: NodeId = KEY) -> ValueChanged:
    return ValueChanged(key, 11, value, 0, None, can_wait)


def test_the_first_passes_at_once_and_the_last_of_a_period_after_it() -> None:
    coalescer = Coalescer(10)
    assert coalescer.offer(change(1), 0.0) == change(1)
    assert coalescer.next_deadline() is None
    assert coalescer.offer(change(2), 0.01) is None
    assert coalescer.offer(change(3), 0.02) is None
    assert coalescer.next_deadline() == 0.1
    assert coalescer.poll(0.09) == []
    assert coalescer.poll(0.1) == [change(3)]
    assert coalescer.next_deadline() is None
    assert coalescer.poll(9.0) == []
    assert coalescer.offer(change(4), 0.15) is None
    assert coalescer.offer(change(5), 9.0) is None
    assert coalescer.poll(9.0) == [change(5)]


def test_what_cannot_wait_passes_and_replaces_what_waits() -> None:
    coalescer = Coalescer(10)
    coalescer.offer(change(1), 0.0)
    coalescer.offer(change(2), 0.01)
    assert coalescer.offer(change(3, can_wait=False), 0.02) == change(3, can_wait=False)
    assert coalescer.poll(5.0) == []
    assert coalescer.offer(change(4), 0.03) is None
    assert coalescer.poll(0.1) == []
    assert coalescer.poll(0.121) == [change(4)]


def test_nodes_do_not_hold_each_other_back() -> None:
    coalescer = Coalescer(10)
    keys = [NodeId(2, 1), NodeId(2, "1.x"), NodeId(2, 2)]
    for key in keys:
        assert coalescer.offer(change(0, key=key), 0.0) is not None
        assert coalescer.offer(change(1, key=key), 0.0) is None
    assert [one.key for one in coalescer.poll(0.1)] == keys


def test_of_many_that_are_due_some_come_at_once_and_the_others_with_the_next_calls() -> None:
    coalescer = Coalescer(10)
    keys = [NodeId(2, number) for number in range(5)]
    for key in keys:
        coalescer.offer(change(0, key=key), 0.0)
        coalescer.offer(change(1, key=key), 0.0)
    assert [one.key for one in coalescer.poll(0.1, 2)] == keys[:2]
    assert coalescer.next_deadline() == 0.1
    assert coalescer.offer(change(2, key=keys[4]), 0.1) is None
    rest = coalescer.poll(0.1, 2) + coalescer.poll(0.1, 2)
    assert [(one.key, one.value) for one in rest] == [(keys[2], 1), (keys[3], 1), (keys[4], 2)]
    assert coalescer.next_deadline() is None


def test_a_node_that_is_gone_is_forgotten() -> None:
    coalescer = Coalescer(10)
    coalescer.offer(change(1), 0.0)
    coalescer.offer(change(2), 0.0)
    coalescer.forget([KEY])
    assert coalescer.poll(1.0) == []
    assert coalescer.offer(change(3), 1.0) == change(3)


@given(
    st.lists(
        st.tuples(st.floats(0, 0.3), st.integers(0, 2), st.booleans()),
        max_size=60,
    )
)
def test_order_rate_and_the_last_value_hold_for_any_traffic(offers: list[tuple[float, int, bool]]) -> None:
    coalescer = Coalescer(10)
    now = 0.0
    last: dict[NodeId, int] = {}
    passed: dict[NodeId, list[tuple[float, ValueChanged]]] = {}

    def note(when: float, *changes: ValueChanged) -> None:
        for one in changes:
            passed.setdefault(one.key, []).append((when, one))

    def poll_until(until: float) -> None:
        while (deadline := coalescer.next_deadline()) is not None and deadline <= until:
            note(deadline, *coalescer.poll(deadline))

    for number, (pause, node, can_wait) in enumerate(offers):
        now += pause
        poll_until(now)
        key = NodeId(2, node)
        last[key] = number
        ready = coalescer.offer(change(number, can_wait=can_wait, key=key), now)
        assert can_wait or ready is not None
        if ready is not None:
            note(now, ready)
    poll_until(now + 1.0)
    assert coalescer.next_deadline() is None
    for key, told in passed.items():
        numbers = [one.value for _, one in told]
        assert numbers == sorted(numbers)
        assert numbers[-1] == last[key]
        for (before, _), (after, one) in pairwise(told):
            assert not one.can_wait or after - before >= 0.1 - 1e-9
