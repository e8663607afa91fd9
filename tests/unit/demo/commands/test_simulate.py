from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.unit.cli.conftest import Invoke


def test_a_table_for_people(invoke: Invoke) -> None:
    ended = invoke("simulate", "--robots", "3", "--tasks", "4", "--faults", "1")
    assert (ended.code, ended.stderr) == (0, "")
    assert ended.stdout.startswith("3 robots, 4 tasks of 3 s, 1 faulty robot, seed 0: done after ")
    assert " took over" in ended.stdout
    assert "(Eq. 12)" in ended.stdout
    assert "simplified: nothing" not in ended.stdout
    assert "simplified: keep-alives each 1 s" in ended.stdout


def test_both_modes_beside_each_other(invoke: Invoke) -> None:
    ended = invoke("simulate", "--robots", "3", "--tasks", "4", "--carried")
    assert (ended.code, ended.stderr) == (0, "")
    assert ended.stdout.startswith("3 robots, 4 tasks of 3 s, carried by the bridges, seed 0: done after ")
    assert "token: parts, tokens, ends" in ended.stdout
    assert "TalkRoBots" in ended.stdout


def test_json_and_csv(invoke: Invoke, tmp_path: Path) -> None:
    ended = invoke("simulate", "--robots", "2", "--tasks", "2", "--json", "--csv", "traffic.csv")
    assert ended.code == 0
    shown = json.loads(ended.stdout)
    lines = (tmp_path / "traffic.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "second,kind,messages,bytes"
    assert len(lines) == 1 + len(shown["over_time"])


def test_figures(invoke: Invoke, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    ended = invoke("simulate", "--robots", "1", "--tasks", "1", "--plot", "a/figures")
    assert ended.code == 0
    assert ended.stderr.count("drawn: ") == 6
    assert len(list((tmp_path / "a" / "figures").iterdir())) == 6


def test_without_matplotlib_it_is_said_what_to_install(invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ended = invoke("simulate", "--robots", "1", "--tasks", "1", "--plot", "figures")
    assert ended.code == 2
    assert "--plot needs the package matplotlib" in ended.stderr
    assert "install ua-fleet with its extra plot" in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert ended.stdout == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--robots", "0", "--tasks", "9"), "0 robots: give 1 to 10,000"),
        (("--robots", "2", "--tasks", "9", "--faults", "2"), "2 faults: with 2 robots and 9 tasks give 0 to 1"),
        (("--robots", "2", "--tasks", "9", "--keep-alive", "0"), "a keep-alive period of 0 s: give 0.1 to 3600"),
        (("--robots", "2", "--tasks", "9", "--csv", "no/such/folder.csv"), "no/such/folder.csv cannot be written"),
        (("--robots", "2", "--tasks", "9", "--plot", "fleet.yaml"), "fleet.yaml cannot be written"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
    invoke: Invoke, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    (tmp_path / "fleet.yaml").touch()
    ended = invoke("simulate", *arguments)
    assert ended.code == 2
    assert said in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert ended.stdout == ""
