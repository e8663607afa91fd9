"""The facts that the server fetches from a bridge."""

from __future__ import annotations

from pathlib import Path

from ua_demo.simulators.fleet.memory import MemoryDatabase

from ua_fleet.carrier.pages import PAGE_BYTES, FactPage, FactPages
from ua_fleet.scenario.facts import Fact, StepStarted, encode_fact
from ua_fleet.storage.carried_records import CARRIED_TABLES, CarriedRecords

RUN = "20260101-000001-000000"


def fact(name: str) -> Fact:
    return StepStarted(1.0, name)


def lines(*names: str) -> list[str]:
    return [encode_fact(fact(name)) for name in names]


def in_memory() -> CarriedRecords:
    return CarriedRecords(MemoryDatabase(CARRIED_TABLES))


def branches(records: CarriedRecords, *names: str) -> None:
    """Two branches at one bridge, which go on in turns; and another run, whose id begins likewise."""
    for name in names:
        records.runs.write([(f"{RUN}.{1 if name[0] == 'a' else 2}", fact(name))])
        records.runs.write([(f"{RUN}0.1", fact("other"))])


def test_pages_have_the_same_order_after_a_restart(tmp_path: Path) -> None:
    with CarriedRecords(tmp_path) as records:
        branches(records, "a1", "b1")
        first = FactPages(lambda: records).after(RUN, 0)
        assert (first.lines, first.is_last) == (lines("a1", "b1"), True)
        branches(records, "a2", "b2")
    with CarriedRecords(tmp_path) as records:
        pages = FactPages(lambda: records)
        second = pages.after(RUN, first.last)
        assert second.lines == lines("a2", "b2"), "a2 is none that the server has"
        assert pages.after(RUN, second.last) == FactPage([], second.last, True)
        branches(records, "a3")
        assert pages.after(RUN, second.last).lines == lines("a3")
        assert pages.after(RUN, 0).lines == lines("a1", "b1", "a2", "b2", "a3"), "a new server begins anew"
        assert pages.after(RUN, first.last).lines == lines("a2", "b2", "a3"), "the answer before has not arrived"
        assert pages.after(f"{RUN}0", second.last).lines == lines("other")


def test_what_one_answer_has_no_room_for_comes_in_the_next_one() -> None:
    records = in_memory()
    names = [f"a{number:04}" for number in range(1500)]
    records.runs.write([(f"{RUN}.1", fact(name)) for name in names])
    pages, found, sizes, last = FactPages(lambda: records), list[str](), list[int](), 0
    while not (page := pages.after(RUN, last)).is_last:
        found, last = found + page.lines, page.last
        sizes.append(sum(map(len, page.lines)))
    assert found + page.lines == lines(*names)
    assert all(PAGE_BYTES - 100 < size <= PAGE_BYTES for size in sizes)
    assert len(sizes) > 1


def test_one_fact_that_is_too_large_is_a_page() -> None:
    records = in_memory()
    records.runs.write([(f"{RUN}.1", fact(name)) for name in ("a", "b" * PAGE_BYTES, "c")])
    pages, last = FactPages(lambda: records), 0
    for name, is_last in (("a", False), ("b" * PAGE_BYTES, False), ("c", True)):
        page = pages.after(RUN, last)
        assert (page.lines, page.is_last) == (lines(name), is_last)
        last = page.last


def test_a_run_that_is_forgotten_has_no_facts() -> None:
    records = in_memory()
    branches(records, "a1")
    pages = FactPages(lambda: records)
    assert pages.after(RUN, 0).lines == lines("a1")
    records.forget(RUN)
    assert pages.after(RUN, 0) == FactPage([], records.last_number(), True)


def test_what_other_runs_did_is_not_gone_over_for_each_page_of_a_quiet_one() -> None:
    records = in_memory()
    records.runs.write([("quiet.0", fact("a1"))])
    pages, last = FactPages(lambda: records), 0
    assert pages.after("quiet", last) == FactPage(lines("a1"), 1, True)
    for _ in range(2):
        records.runs.write([("busy.0", fact(f"b{number}")) for number in range(1000)])
        page = pages.after("quiet", last)
        assert (page.last, page.is_last) == (records.last_number(), True), "the next one begins there"
        last = page.last
    records.runs.write([("quiet.0", fact("a2")), ("busy.0", fact("b"))])
    assert pages.after("quiet", last) == FactPage(lines("a2"), records.last_number(), True)


def test_a_page_that_is_not_the_last_one_leaves_nothing_out() -> None:
    records = in_memory()
    records.runs.write([("run.0", fact("a" * PAGE_BYTES)), ("other.0", fact("b")), ("run.0", fact("c"))])
    first = FactPages(lambda: records).after("run", 0)
    assert (first.last, first.is_last) == (1, False)
    assert FactPages(lambda: records).after("run", first.last) == FactPage(lines("c"), 3, True)
