"""The scenarios' files, and values given as texts."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

import ua_fleet.operation.runs.library as library_module
from ua_fleet.errors import ScenarioError, ScenarioInvalid
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.operation.runs.library import MOST_BYTES, Library, Listed, ScenarioUnknown, read_values
from ua_fleet.scenario import FleetView, RobotView, Scenario, Validation, validate

GOOD = "version: 1\nname: good\ndescription: waits\nsteps:\n  - {wait: 1}\n"
FLEET = FleetView({})


def test_scenarios_are_listed_with_what_is_wrong_with_them_for_the_fleet(tmp_path: Path) -> None:
    (tmp_path / "good.yaml").write_text(GOOD)
    (tmp_path / "bad.json").write_text('{"version": 1, "name": "bad"}')
    (tmp_path / "bytes.yaml").write_bytes(b"\xff")
    (tmp_path / "lost.yaml").write_text("version: 1\nname: lost\nsteps:\n  - {task: a, skill: go, robot: arm}\n")
    (tmp_path / "notes.txt").write_text("nothing")
    (tmp_path / "no name.yaml").write_text(GOOD)
    library = Library(tmp_path)
    (tells,) = library.checked("lost", FLEET).problems
    assert "there is no robot 'arm'" in str(tells)
    bad, bytes_, good = Listed("bad", "", 1), Listed("bytes", "", 1), Listed("good", "waits", 0)
    assert library.listed(FLEET) == [bad, bytes_, good, Listed("lost", "", 1)]
    assert Library(tmp_path / "not_there").listed(FLEET) == []


def test_a_list_has_what_is_so_now(tmp_path: Path) -> None:
    """Of files that change without another size, and of a fleet that changes."""
    file, library = tmp_path / "go.yaml", Library(tmp_path)
    text = "version: 1\nname: go\nsteps:\n  - {task: a, skill: go, robot: arm}\n"
    file.write_text(text)
    assert library.listed(FLEET) == [Listed("go", "", 1)]
    arm = RobotView("arm", skills={"go": SkillModel(1, "go")})
    fleet = FleetView({"arm": arm})
    assert library.listed(fleet) == [Listed("go", "", 0)]
    times = file.stat()
    file.write_text(text.replace("go, robot", "og, robot"))
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert library.listed(fleet) == [Listed("go", "", 1)]
    file.unlink()
    assert library.listed(fleet) == []


def test_a_list_checks_again_only_what_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[str] = []

    def noted(scenario: Scenario, fleet: FleetView, file: str = "") -> Validation:
        checked.append(scenario.name)
        return validate(scenario, fleet, file)

    monkeypatch.setattr(library_module, "validate", noted)
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(GOOD.replace("good", name))
    library = Library(tmp_path)
    for _ in range(3):
        assert [one.problems for one in library.listed(FLEET)] == [0, 0]
    assert checked == ["one", "two"]
    (tmp_path / "two.yaml").write_text(GOOD.replace("good", "two") + "  - {wait: 2}\n")
    library.listed(FLEET)
    assert checked == ["one", "two", "two"]
    library.listed(FleetView({}))
    assert checked == ["one", "two", "two", "one", "two"]


def test_a_scenario_is_a_name_or_a_text(tmp_path: Path) -> None:
    (tmp_path / "good.yaml").write_text(GOOD)
    library = Library(tmp_path)
    assert library.text("good") == GOOD
    assert library.checked(GOOD, FLEET).problems == ()
    (problem,) = library.checked("version: 1\nname: s\nsteps:\n  - {task: a, skill: x, robot: y}\n", FLEET).problems
    assert problem.line == 4


@pytest.mark.parametrize("name", ["../good", "/etc/passwd", "", "good.yaml", "a" * 65, "missing"])
def test_what_is_no_name_leads_nowhere(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "good.yaml").write_text(GOOD)
    with pytest.raises(ScenarioUnknown):
        Library(tmp_path / "folder").text(name)


def test_a_scenario_that_is_too_long_is_refused(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text("#" * (MOST_BYTES + 1))
    for given in ("long", "a: 1\n" * MOST_BYTES):
        with pytest.raises(ScenarioError, match="at most"):
            Library(tmp_path).text(given)


def test_values_are_read_as_in_yaml() -> None:
    given = ["20", "2.5", "true", "left", "", "7"]
    read = read_values(["a", "b", "c", "d", "e", "f"], given, {"f": "text"})
    assert read == {"a": 20, "b": 2.5, "c": True, "d": "left", "e": "", "f": "7"}
    with pytest.raises(ScenarioError, match="1 names were given with 0 values"):
        read_values(["a"], [])
    with pytest.raises(ScenarioError, match="twice"):
        read_values(["a", "a"], ["1", "2"])


def test_all_files_of_the_folder_are_held_against_the_fleet(tmp_path: Path) -> None:
    (tmp_path / "good.yaml").write_text(GOOD)
    (tmp_path / "good.json").write_text("{}")
    (tmp_path / "a b.yaml").write_text(GOOD)
    (tmp_path / "bytes.yml").write_bytes(b"\xff")
    (tmp_path / "lost.json").write_text('{"version": 1, "name": "lost",\n"steps": [{"task": "a", "robot": "x"}]}')
    (tmp_path / "folder.yaml").mkdir()
    said = [str(problem).removeprefix(f"{tmp_path}/") for problem in Library(tmp_path).problems(FLEET)]
    assert said == [
        "a b.yaml: 'a b' is no name of a scenario: letters, digits, _ and -; rename the file",
        "bytes.yml: it is not UTF-8 text; save it in the encoding UTF-8",
        "folder.yaml: Is a directory; look at the folder of scenarios",
        "good.json: it is never read, since good.yaml has the same name; remove one of them",
        "lost.json:2:steps[0].skill: `skill` is missing",
        "lost.json:2: task 'a': there is no robot 'x'; known robots: none",
    ]


def test_problems_have_an_end_and_are_found_in_time(tmp_path: Path) -> None:
    """Thousands of mistakes against a thousand robots, whose names are all alike."""
    robots = {f"robot{number}": RobotView(f"robot{number}") for number in range(1000)}
    fleet = FleetView(robots, {f"{robot}.battery": 1 for robot in robots})
    head, library = "version: 1\nname: a\nsteps:\n", Library(tmp_path)
    for step in (
        "  - {if: robot1.batery > 1, then: [{wait: 1}]}\n",
        "  - {task: t, skill: go, robt: robot1}\n",
        "  - {task: t, skill: go, capacity: mobile}\n",
        f"  - {{task: '{'x' * 1000}', skill: go, robot: robot}}\n",
    ):
        began = time.monotonic()
        problems = library.checked(head + step * (200_000 // len(step)), fleet).problems
        assert time.monotonic() - began < 20
        assert all(len(str(problem)) < 1000 for problem in problems)
        if len(problems) > 500:
            assert len(problems) == 501
            assert str(problems[-1]).startswith("and ")
    with pytest.raises(ScenarioInvalid) as caught:
        library.valid(head + "  - a\n" * 100, fleet)
    assert (len(caught.value.problems), caught.value.problems[-1]) == (21, "and 80 more, which Validate tells")
