"""The tutorial, from its fleet.yaml to the scenario."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import system
from tests.docs.walkthrough import Walk
from tests.unit.docs.pages import ROOT


@pytest.mark.timeout(300)
@pytest.mark.needs("ros2")
def test_a_reader_gets_to_the_end(
    folder: Path, environment: dict[str, str], processes: system.Processes, ros_domain: int
) -> None:
    instead = {
        "space: 2\n": f"space: {ros_domain}\n",
        "space=2)": f"space={ros_domain})",
        "ROS_DOMAIN_ID=2 ": f"ROS_DOMAIN_ID={ros_domain} ",
    }
    Walk(folder, processes, environment, instead).walk(ROOT / "docs" / "tutorial.md")
