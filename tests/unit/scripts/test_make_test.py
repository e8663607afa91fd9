"""`make test` by the exit codes of its two runs of pytest; 5 is that of a run without a test."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests import system


@pytest.mark.parametrize(
    ("arguments", "main", "ros1", "passes"),
    [
        ("", 0, 0, True),
        ("", 1, 0, False),
        ("", 0, 1, False),
        ("", 5, 0, False),
        ("", 0, 5, False),
        ("-k some", 0, 0, True),
        ("-k some", 0, 5, True),
        ("-k some", 5, 0, True),
        ("-k some", 5, 5, False),
        ("-k some", 5, None, False),
        ("-k some", 0, None, True),
        ("-k some", 1, 0, False),
        ("-k some", 0, 1, False),
        ("-k some", 5, 1, False),
    ],
)
def test_one_of_the_two_may_have_none_of_the_chosen_tests(
    tmp_path: Path, arguments: str, main: int, ros1: int | None, passes: bool
) -> None:
    for name, code in (("main", main), ("ros1", ros1)):
        if code is not None:
            (tmp_path / name).write_text(f'#!/bin/sh\necho "{name} $*"\nexit {code}\n', encoding="utf-8")
            (tmp_path / name).chmod(0o755)
    environment = system.clean_environment()
    for inherited in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "ARGS", "REQUIRE"):
        environment.pop(inherited, None)
    done = subprocess.run(
        ["make", "-o", "setup-test", "test", f"PYTHON={tmp_path / 'main'}", f"PYTHON_ROS1={tmp_path / 'ros1'}"]
        + ([f"ARGS={arguments}"] if arguments else []),
        cwd=system.ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode == 0) == passes, done.stderr
    ran = [line for line in done.stdout.splitlines() if line.startswith(("main ", "ros1 "))]
    assert all(arguments in line for line in ran)
    assert len(ran) == (1 if ros1 is None else 2)  # they run beside each other
