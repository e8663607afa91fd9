"""Scenarios that clients write into the folder: whole, checked, and over nothing that they have not read."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from tests.unit.operation.runs.world import ONE, World
from ua_fleet.errors import ScenarioError, ScenarioInvalid, StorageUnavailable
from ua_fleet.operation.runs.library import (
    MOST_BYTES,
    MOST_LISTED,
    Library,
    ScenarioChanged,
    ScenarioUnknown,
    version_of,
)

NOTED = ONE.replace("steps:", "# what follows was tried on Monday\nsteps:   # in this order")


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


@pytest.fixture
def library(world: World, tmp_path: Path) -> Library:
    del world
    return Library(tmp_path / "scenarios")


def test_what_is_stored_is_read_as_it_was_written(world: World, library: Library, tmp_path: Path) -> None:
    fleet = world.service.fleet
    assert library.store("one", NOTED, "", fleet).problems == ()
    assert (tmp_path / "scenarios" / "one.yaml").read_bytes() == NOTED.encode()
    text, version = library.stored("one")
    assert (text, version) == (NOTED, version_of(NOTED))
    library.store("one", ONE, version, fleet)
    assert library.stored("one").text == ONE
    assert [path.name for path in (tmp_path / "scenarios").iterdir()] == ["one.yaml"]
    library.delete("one", library.stored("one").version)
    assert list((tmp_path / "scenarios").iterdir()) == []


def test_what_somebody_else_has_stored_is_not_lost(world: World, library: Library) -> None:
    fleet = world.service.fleet
    library.store("one", ONE, "", fleet)
    mine = library.stored("one").version
    library.store("one", NOTED, mine, fleet)
    for version, why in ((mine, r"one was changed at \d{4}-.* UTC, since it was read; read it again"), ("", "already")):
        with pytest.raises(ScenarioChanged, match=why):
            library.store("one", ONE, version, fleet)
        with pytest.raises(ScenarioChanged, match=why):
            library.delete("one", version)
    assert library.stored("one").text == NOTED
    library.delete("one", version_of(NOTED))
    with pytest.raises(ScenarioChanged, match="was deleted since it was read"):
        library.store("one", ONE, version_of(NOTED), fleet)
    with pytest.raises(ScenarioUnknown, match="there is no scenario 'one'"):
        library.delete("one", version_of(NOTED))


def test_of_many_who_store_at_once_one_does(world: World, library: Library) -> None:
    library.store("one", ONE, "", world.service.fleet)
    version, ready, done = library.stored("one").version, threading.Barrier(8), list[int]()

    def store(number: int) -> None:
        ready.wait()
        try:
            library.store("one", f"{ONE}# {number}\n", version, world.service.fleet)
            done.append(number)
        except ScenarioChanged:
            pass

    threads = [threading.Thread(target=store, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (number,) = done
    assert library.stored("one").text == f"{ONE}# {number}\n"


@pytest.mark.parametrize(
    "name", ["", "../one", "/etc/one", "a/b", "one.yaml", ".hidden", "1st", "a\0b", "one\n", "a" * 65, "é", "a b"]
)
def test_no_name_leaves_the_folder(world: World, library: Library, tmp_path: Path, name: str) -> None:
    (tmp_path / "one.yaml").write_text(ONE)
    for work in (
        lambda: library.stored(name),
        lambda: library.store(name, ONE, "", world.service.fleet),
        lambda: library.delete(name, version_of(ONE)),
    ):
        with pytest.raises(ScenarioUnknown, match="is no name of a scenario"):
            work()
    assert (tmp_path / "one.yaml").exists()
    assert not (tmp_path / "scenarios").exists()


def test_a_link_is_replaced_and_what_it_leads_to_stays(world: World, library: Library, tmp_path: Path) -> None:
    (tmp_path / "scenarios").mkdir()
    outside, link = tmp_path / "outside.yaml", tmp_path / "scenarios" / "one.yaml"
    outside.write_text(ONE)
    link.symlink_to(outside)
    library.store("one", NOTED, version_of(ONE), world.service.fleet)
    assert (outside.read_text(), link.read_text(), link.is_symlink()) == (ONE, NOTED, False)


def test_what_has_problems_is_not_stored(world: World, library: Library, tmp_path: Path) -> None:
    checked = library.store("one", ONE.replace("left", "lefd"), "", world.service.fleet)
    assert [(problem.line, problem.file) for problem in checked.problems] == [(4, "one.yaml")]
    one_line = library.store("one", "one", "", world.service.fleet)
    assert one_line.problems
    with pytest.raises(ScenarioInvalid, match=f"at most {MOST_BYTES} bytes"):
        library.store("one", f"{ONE}# {'é' * (MOST_BYTES // 2)}", "", world.service.fleet)
    assert not (tmp_path / "scenarios").exists()


def test_the_file_keeps_its_ending_and_its_rights(world: World, library: Library, tmp_path: Path) -> None:
    path = tmp_path / "scenarios" / "one.yml"
    path.parent.mkdir()
    path.write_text(ONE)
    path.chmod(0o640)
    library.store("one", NOTED, version_of(ONE), world.service.fleet)
    assert [one.name for one in path.parent.iterdir()] == ["one.yml"]
    assert path.stat().st_mode & 0o777 == 0o640


def test_there_is_an_end_to_how_many_there_may_be(world: World, library: Library, tmp_path: Path) -> None:
    folder = tmp_path / "scenarios"
    folder.mkdir()
    for number in range(MOST_LISTED):
        (folder / f"s{number}.yaml").write_text(ONE)
    with pytest.raises(ScenarioError, match="more may not be; delete one"):
        library.store("one", ONE, "", world.service.fleet)
    library.store("s0", NOTED, version_of(ONE), world.service.fleet)


def test_what_cannot_be_written_is_said(world: World, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageUnavailable, match=r"one\.yaml: .*look at the rights of the folder of scenarios"):
        Library(tmp_path / "file").store("one", ONE, "", world.service.fleet)


def test_a_run_keeps_its_text(world: World, tmp_path: Path) -> None:
    library = world.service.library
    library.store("one", ONE, "", world.service.fleet)
    world.service.runs.start(world.service.runs.valid("one"), (), (), "anna")
    library.delete("one", version_of(ONE))
    (_, _, execution_id) = world.robots.asked[0]
    world.journal.close()
    robots = world.robots
    again = World(tmp_path, robots)
    assert again.service.run_ids
    assert [asked[2] for asked in robots.asked] == [execution_id]
