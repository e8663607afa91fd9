"""The two ways into `ua-fleet healthcheck`: at once, and by the whole command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.unit.cli.conftest import Invoke
from ua_fleet.cli import health, healthcheck
from ua_fleet.cli.health import HealthQuestion, HealthVerdict, quick


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[HealthQuestion]:
    """What was asked for."""
    found: list[HealthQuestion] = []

    def check(asked: HealthQuestion) -> HealthVerdict:
        found.append(asked)
        return HealthVerdict(True, "well")

    for module in (health, healthcheck):
        monkeypatch.setattr(module, "check", check)
    return found


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], HealthQuestion()),
        (["--state-dir", "state/bridges/cell", "--live"], HealthQuestion(state_dir="state/bridges/cell", live=True)),
        (["--at", "[::1]:9464", "--timeout", "0.5"], HealthQuestion(at="[::1]:9464", timeout_s=0.5)),
        (["--tcp", "a:1", "--heartbeat", "f", "--within", "5"], HealthQuestion(tcp="a:1", heartbeat="f", within_s=5.0)),
        (["--json"], HealthQuestion()),
    ],
)
def test_both_ask_for_the_same(
    words: list[str], wanted: HealthQuestion, asked: list[HealthQuestion], invoke: Invoke
) -> None:
    assert quick(words) == 0
    ended = invoke("healthcheck", *words)
    assert ended.code == 0
    assert asked == [wanted, wanted]
    assert json.loads(ended.stdout) == {"well": True, "text": "well"} if "--json" in words else ended.stdout == "well\n"


@pytest.mark.parametrize(
    "words",
    [["--help"], ["--att", "x"], ["--at"], ["--at", "--live"], ["--within", "soon"], ["--timeout", "-1"], ["here"]],
)
def test_what_is_not_plain_is_left_to_the_whole_command_line(words: list[str], asked: list[HealthQuestion]) -> None:
    assert quick(words) is None
    assert asked == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--att", "x"], "No such option"),
        (["--within", "soon"], "Invalid value for '--within'"),
        (["--timeout", "0"], "0.001"),
    ],
)
def test_it_says_what_is_wrong(words: list[str], said: str, invoke: Invoke, asked: list[HealthQuestion]) -> None:
    ended = invoke("healthcheck", *words)
    assert ended.code == 2
    assert said in ended.stderr
    assert asked == []


def test_unwell_is_1_by_both(tmp_path: Path, invoke: Invoke, capsys: Any) -> None:
    words = ["--heartbeat", str(tmp_path / "none")]
    assert quick(words) == 1
    assert invoke("healthcheck", *words).code == 1
    assert "no such file or directory; check that the program has started" in capsys.readouterr().out
