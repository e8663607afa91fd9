"""README, from `config init` to a look at the fleet."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import system
from tests.docs.walkthrough import Walk
from tests.unit.docs.pages import ROOT


@pytest.mark.timeout(300)
@pytest.mark.needs("ros2")
def test_a_fleet_of_your_own(
    folder: Path, environment: dict[str, str], processes: system.Processes, ros_domain: int
) -> None:
    environment["UA_FLEET__BRIDGES__FLOOR__SPACE"] = str(ros_domain)
    Walk(folder, processes, environment, {}).walk(ROOT / "README.md")
