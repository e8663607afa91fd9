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
        pages = FactPages(lambda: records)
        assert pages.after(RUN, 0) == FactPage(lines("a1", "b1"), True)
        branches(records, "a2", "b2")
    with CarriedRecords(tmp_path) as records:
        pages = FactPages(lambda: records)
        assert pages.after(RUN, 2) == FactPage(lines("a2", "b2"), True), "a2 is none that the server has"
        assert pages.after(RUN, 4) == FactPage([], True)
        branches(records, "a3")
        assert pages.after(RUN, 4) == FactPage(lines("a3"), True)
        assert pages.after(RUN, 0) == FactPage(lines("a1", "b1", "a2", "b2", "a3"), True), "a new server begins anew"
        assert pages.after(RUN, 3) == FactPage(lines("b2", "a3"), True), "the answer before has not arrived"
        assert pages.after(f"{RUN}0", 4) == FactPage(lines("other"), True)


def test_what_one_answer_has_no_room_for_comes_in_the_next_one() -> None:
    records = in_memory()
    names = [f"a{number:04}" for number in range(1500)]
    records.runs.write([(f"{RUN}.1", fact(name)) for name in names])
    pages, found, sizes = FactPages(lambda: records), list[str](), list[int]()
    while not (page := pages.after(RUN, len(found))).is_last:
        found += page.lines
        sizes.append(sum(map(len, page.lines)))
    assert found + page.lines == lines(*names)
    assert all(PAGE_BYTES - 100 < size <= PAGE_BYTES for size in sizes)
    assert len(sizes) > 1


def test_one_fact_that_is_too_large_is_a_page() -> None:
    records = in_memory()
    records.runs.write([(f"{RUN}.1", fact(name)) for name in ("a", "b" * PAGE_BYTES, "c")])
    pages = FactPages(lambda: records)
    assert pages.after(RUN, 0) == FactPage(lines("a"), False)
    assert pages.after(RUN, 1) == FactPage(lines("b" * PAGE_BYTES), False)
    assert pages.after(RUN, 2) == FactPage(lines("c"), True)


def test_a_run_that_is_forgotten_has_no_facts() -> None:
    records = in_memory()
    branches(records, "a1")
    pages = FactPages(lambda: records)
    assert pages.after(RUN, 0) == FactPage(lines("a1"), True)
    records.forget(RUN)
    pages.forget(RUN)
    assert pages.after(RUN, 0) == FactPage([], True)
