"""What is named as required and is no part of the system."""

from __future__ import annotations

import subprocess
import sys

from tests.system import ROOT


def test_a_part_that_there_is_not_is_refused_before_any_test() -> None:
    """With a mistake in its name nothing would be required."""
    command = (sys.executable, "-m", "pytest", "--require=ros1,mosquito,", "tests/unit/test_topics.py")
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 4, ended.stdout
    assert "no part of the system is called mosquito; there are chromium, compiler," in ended.stderr
    assert "passed" not in ended.stdout
