"""Reading in as few requests as there can be."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ua_fleet.registers import AddressSpan, DeviceLimits, Table, fits_device, plan_reads

HOLDING, COIL = Table.HOLDING, Table.COIL


def span(address: int, count: int = 1, table: Table = HOLDING) -> AddressSpan:
    return AddressSpan(table, address, count)


KNOWN = DeviceLimits(most_gap=4, ranges={HOLDING: ((0, 199), (300, 399))})


@pytest.mark.parametrize(
    ("wanted", "limits", "planned"),
    [
        ([], DeviceLimits(), []),
        ([span(1), span(0), span(2, 2)], DeviceLimits(), [span(0, 4)]),
        ([span(5), span(5), span(5)], DeviceLimits(), [span(5)]),
        ([span(0, 4), span(1, 2)], DeviceLimits(), [span(0, 4)]),
        ([span(0), span(0, table=COIL)], DeviceLimits(), [span(0, table=COIL), span(0)]),
        ([span(0), span(2)], DeviceLimits(), [span(0), span(2)]),
        ([span(0), span(5)], KNOWN, [span(0, 6)]),
        ([span(0), span(6)], KNOWN, [span(0), span(6)]),
        ([span(198), span(301)], KNOWN, [span(198), span(301)]),
        ([span(199), span(300)], DeviceLimits(most_gap=1000, ranges=KNOWN.ranges), [span(199), span(300)]),
        ([span(number) for number in range(126)], DeviceLimits(), [span(0, 125), span(125)]),
        ([span(0, 124), span(124, 2)], DeviceLimits(), [span(0, 124), span(124, 2)]),
        ([span(0, 124), span(123, 4)], DeviceLimits(), [span(0, 124), span(123, 4)]),
        ([span(n, table=COIL) for n in range(2001)], DeviceLimits(), [span(0, 2000, COIL), span(2000, table=COIL)]),
        ([span(0, 2), span(2, 2), span(4, 2)], DeviceLimits(read_words=4), [span(0, 4), span(4, 2)]),
    ],
)
def test_plan(wanted: list[AddressSpan], limits: DeviceLimits, planned: list[AddressSpan]) -> None:
    assert list(plan_reads(wanted, limits)) == planned


@pytest.mark.parametrize(
    ("wanted", "fits"),
    [
        (span(0, 200), True),
        (span(199, 2), False),
        (span(300), True),
        (span(400), False),
        (span(65535, table=COIL), True),
        (span(65535, 2, COIL), False),
    ],
)
def test_what_a_device_has(wanted: AddressSpan, fits: bool) -> None:
    assert fits_device(KNOWN, wanted) is fits


SPANS = st.lists(
    st.builds(AddressSpan, st.sampled_from([HOLDING, COIL]), st.integers(0, 60), st.integers(1, 4)),
    min_size=1,
    max_size=20,
)


@given(SPANS, st.integers(4, 12), st.integers(0, 5))
def test_everything_is_read_within_the_limits(wanted: list[AddressSpan], most: int, gap: int) -> None:
    limits = DeviceLimits(read_words=most, read_bits=most, most_gap=gap, ranges={HOLDING: ((0, 63),)})
    planned = plan_reads(wanted, limits)
    for each in wanted:
        assert any(p.table is each.table and p.address <= each.address and each.end <= p.end for p in planned)
    asked = {(each.table, address) for each in wanted for address in range(each.address, each.end)}
    for request in planned:
        assert request.count <= most
        unasked = [a for a in range(request.address, request.end) if (request.table, a) not in asked]
        assert not unasked or request.table is HOLDING, "nothing is known of the coils"
        for _, run in itertools.groupby(enumerate(unasked), lambda each: each[1] - each[0]):
            assert len(list(run)) <= gap


def _fewest(wanted: list[AddressSpan], most: int) -> int:
    """By trying all: the fewest runs of sorted spans whose ends lie within `most` of each other and that touch."""
    ordered = sorted(set(wanted))
    best = [0] + [len(ordered)] * len(ordered)
    for end in range(1, len(ordered) + 1):
        for begin in range(end):
            run = ordered[begin:end]
            covered = set(itertools.chain.from_iterable(range(each.address, each.end) for each in run))
            if len(covered) == max(covered) - min(covered) + 1 <= most:
                best[end] = min(best[end], best[begin] + 1)
    return best[-1]


@settings(max_examples=200)
@given(
    st.lists(st.builds(AddressSpan, st.just(HOLDING), st.integers(0, 30), st.integers(1, 3)), min_size=1, max_size=8)
)
def test_no_plan_has_fewer_requests(wanted: list[AddressSpan]) -> None:
    assert len(plan_reads(wanted, DeviceLimits(read_words=6))) == _fewest(wanted, 6)
