"""`ua-fleet history` against a server that `ua-fleet serve` runs."""

from __future__ import annotations

import csv
import io
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.integration.cli.conftest import Site

VALUES = (0.125, 0.25, 0.75)


@pytest.fixture(scope="module")
def written(site: Site) -> Site:
    """What clients write is kept."""
    for value in VALUES:
        assert site.run("write", "rover.goal", str(value)).code == 0
    assert site.run("write", "rover.name", "carrier").code == 0
    return site


def test_the_values_that_were_kept_are_printed(written: Site) -> None:
    ended = written.run("history", "rover.goal", "--since", "10m", "--json", user="olga")
    assert ended.code == 0, ended.stderr
    found = [one["value"] for one in ended.objects]
    assert found[-3:] == list(VALUES)
    assert {(one["node_id"], one["type"]) for one in ended.objects} == {("ns=2;i=1003", "Double")}
    lines = written.run("history", "rover.goal", "--newest", "2", user="olga").stdout.splitlines()
    assert [line.split("  ")[0] for line in lines] == ["rover.goal = 0.75", "rover.goal = 0.25"]


def test_as_csv(written: Site) -> None:
    ended = written.run("history", "rover.goal", "rover.speed", "--csv", user="olga")
    rows = list(csv.DictReader(io.StringIO(ended.stdout)))
    goal = [row for row in rows if row["node"] == "rover.goal"]
    assert [row["value"] for row in goal][-3:] == [str(value) for value in VALUES]
    assert goal[-1]["status"] == "Good"
    assert goal[-1]["time"].endswith("+00:00")


def test_calculated(written: Site) -> None:
    ended = written.run("history", "rover.goal", "--calculate", "maximum", "--since", "1d", "--json", user="olga")
    assert ended.code == 0, ended.stderr
    assert [one["value"] for one in ended.objects] == [0.75]
    ended = written.run("history", "rover.goal", "--calculate", "count", "--every", "1h", "--json", user="olga")
    assert sum(one["value"] or 0 for one in ended.objects) >= 3


def test_drawn(written: Site, tmp_path: Path) -> None:
    file = tmp_path / "goal.png"
    ended = written.run("history", "rover.goal", "--plot", str(file), user="olga")
    if find_spec("matplotlib") is None:
        assert (ended.code, "extra plot" in ended.stderr) == (1, True)
        return
    assert ended.code == 0, ended.stderr
    assert file.read_bytes().startswith(b"\x89PNG")
    nothing = written.run("history", "rover.goal", "--until", "2d", "--since", "3d", "--plot", str(file), user="olga")
    assert (nothing.code, "nothing to draw" in nothing.stderr) == (3, True)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("rover.goal", "--since", "yesterday"), 2, "'yesterday' is no time; give 90s, 10m, 8h, 7d"),
        (("rover.goal", "--since", "1h", "--until", "2h"), 2, "not before the end"),
        (("rover.goal", "--calculate", "median"), 2, "there are interpolated, average"),
        (("rover.goal", "--csv", "--json"), 2, "choose one"),
        (("rover.goal", "--plot", "goal.txt"), 2, "ends with .png, .svg or .pdf"),
        (("rover.goal", "--calculate", "count", "--every", "5"), 2, "'5' is no duration"),
        (("rover.nothing",), 3, "rover"),
        (("rover.State",), 1, "keeps no history"),
        (("rover.name", "--calculate", "average", "--since", "10m"), 1, "BadAggregateInvalidInputs"),
        (("rover.name", "--calculate", "average", "--until", "2d", "--since", "3d"), 0, ""),
        (("rover.goal", "--until", "2d", "--since", "3d"), 0, "nothing was kept in this time"),
    ],
)
def test_what_is_said_of_other_requests(written: Site, arguments: tuple[str, ...], code: int, says: str) -> None:
    ended = written.run("history", *arguments, user="olga")
    assert ended.code == code, ended.stderr
    assert says in ended.stderr
