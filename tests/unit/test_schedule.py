"""The order of `make test`: who computes and who waits at once, the longest first, and each test once."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from xdist.remote import Producer  # type: ignore[import-untyped]

from tests import schedule, system
from tests.schedule import DurationRecorder, KindScheduling, computes, in_order, unit_of

MEASURED = schedule.durations
KNOWN = {
    "tests/console/test_drive.py": 70.0,
    "tests/console/test_map.py": 18.0,
    "tests/attacks/test_ros1.py": 168.0,
    "tests/integration/cli/": 177.0,
    "tests/attacks/test_tcp.py": 31.0,
}
FILES = (
    "tests/attacks/test_ros1.py",
    "tests/attacks/test_tcp.py",
    "tests/console/test_drive.py",
    "tests/console/test_map.py",
    "tests/integration/cli/test_login.py",
    "tests/integration/cli/test_up.py",
    "tests/integration/test_new.py",
    "tests/unit/test_a.py",
    "tests/unit/test_b.py",
)


def _two_cores(_pid: int) -> set[int]:
    return {0, 1}


@pytest.fixture(autouse=True)
def _known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedule, "durations", lambda: KNOWN)
    monkeypatch.setattr("os.sched_getaffinity", _two_cores)


class Worker:
    """A process of tests."""

    shutting_down = False

    def __init__(self, number: int) -> None:
        self.gateway = SimpleNamespace(id=f"gw{number}")
        self.queue: list[int] = []
        self.ran: list[str] = []

    def send_runtest_some(self, places: list[int]) -> None:
        self.queue += places

    def shutdown(self) -> None:
        self.shutting_down = True


def run(workers: int, nodeids: list[str]) -> list[Worker]:
    """Each process does one of its tests, in turns."""
    option = SimpleNamespace(loadscopereorder=False)
    config: Any = SimpleNamespace(getvalue={"tx": [f"{workers}*popen"]}.__getitem__, option=option)
    silent = Producer("", enabled=False)
    scheduling: Any = KindScheduling(config, silent)
    made = [Worker(number) for number in range(workers)]
    for worker in made:
        scheduling.add_node(worker)
        scheduling.add_node_collection(worker, nodeids)
    scheduling.schedule()
    while any(worker.queue for worker in made):
        for worker in made:
            if worker.queue:
                place = worker.queue.pop(0)
                worker.ran.append(unit_of(nodeids[place]))
                scheduling.mark_test_complete(worker, place)
    assert not scheduling.has_pending
    return made


def test_processes_take_what_is_of_their_kind_the_longest_first() -> None:
    nodeids = [f"{file}::test_{number}[a::b]" for file in FILES for number in range(9)]
    made = run(4, nodeids)
    orders = [list(dict.fromkeys(worker.ran)) for worker in made]
    assert [order[0] for order in orders] == [
        "tests/console/test_drive.py",
        "tests/console/test_map.py",
        "tests/integration/cli/",
        "tests/attacks/test_ros1.py",
    ]
    assert orders[3][1] == "tests/attacks/test_tcp.py"
    assert orders[0][1].startswith("tests/unit/")
    assert sorted(unit for worker in made for unit in worker.ran) == sorted(map(unit_of, nodeids))
    for unit in set(map(unit_of, nodeids)):
        assert sum(unit in order for order in orders) == 1, f"{unit} is run by one process"


def test_a_process_without_any_of_its_kind_helps_out() -> None:
    (first, second, third) = run(3, [f"tests/unit/test_{number}.py::test" for number in range(60)])
    assert len(first.ran) == len(second.ran) == len(third.ran) == 20


def test_more_processes_than_files_are_ended() -> None:
    made = run(6, [f"{file}::test" for file in FILES[:2]])
    assert sum(bool(worker.ran) for worker in made) == 2


def test_kinds_and_order() -> None:
    assert [path for path in map(unit_of, FILES) if computes(path)] == [*FILES[2:4], *FILES[7:]]
    assert in_order(["tests/unit/test_a.py", *FILES[:2], "tests/integration/test_new.py"]) == [
        *FILES[:2],
        "tests/unit/test_a.py",
        "tests/integration/test_new.py",
    ]


def test_what_changes_the_network_comes_after_browsers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedule, "durations", MEASURED)
    network = "tests/integration/transport/test_udp.py"
    assert computes(network)
    files = [str(path.relative_to(system.ROOT)) for path in (system.ROOT / "tests").rglob("test_*.py")]
    ordered = in_order(files)
    assert ordered.index(network) < len(files) / 2, "it does not stay alone at the end"
    needs = re.compile(r'needs\([^)]*"chromium"')
    browsers = [file for file in files if needs.search((system.ROOT / file).read_text(encoding="utf-8"))]
    console = [file for file in files if file.startswith("tests/console/")]
    assert len(browsers) > 3
    assert [file for file in browsers + console if ordered.index(file) > ordered.index(network)] == []


def test_what_was_run_is_recorded_and_the_rest_kept(tmp_path: Path) -> None:
    recorder = DurationRecorder(tmp_path / "durations.txt")
    for nodeid, seconds in ((f"{FILES[0]}::a", 60.0), (f"{FILES[0]}::b", 70.4), (f"{FILES[7]}::c", 2.9)):
        recorder.pytest_runtest_logreport(SimpleNamespace(nodeid=nodeid, duration=seconds))  # type: ignore[arg-type]
    recorder.pytest_sessionfinish()
    assert (tmp_path / "durations.txt").read_text().splitlines()[1:] == [
        "177 tests/integration/cli/",
        "130 tests/attacks/test_ros1.py",
        "70 tests/console/test_drive.py",
        "31 tests/attacks/test_tcp.py",
        "18 tests/console/test_map.py",
    ]


def test_all_that_was_measured_is_there() -> None:
    known = MEASURED()
    assert len(known) > 50
    assert [path for path in known if not (system.ROOT / path).exists()] == []
    assert [path for path in known if unit_of(path) != path] == []
