from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.system import Processes
from tests.ur_controller import UrController

PICK = """def pick():
  set_standard_digital_out(5, True)
  movej([0.4, -1.5708, 0, -1.5708, 0, 0], a=2, v=1)
  set_standard_digital_out(5, False)
  write_output_integer_register(13, read_output_integer_register(13) + 1)
end
"""


def wait_until(condition: Callable[[], object], what: str, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come within {timeout_s:g} s"
        time.sleep(0.005)


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    folder = tmp_path / "programs"
    folder.mkdir()
    (folder / "pick.script").write_text(PICK)
    (folder / "slow.script").write_text(PICK.replace("pick", "slow").replace("v=1", "v=0.1"))
    return folder


@pytest.fixture
def controller(processes: Processes, programs: Path) -> UrController:
    """A controller that is ready; protective stops can be unlocked soon."""
    made = UrController(processes, "--unlock-after", "0.3", "--boot", "0.1", "--brakes", "0.1", "--programs", programs)
    made.start()
    return made
