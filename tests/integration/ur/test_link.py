"""The way to a controller for commands, whose state may be older than it looks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from ua_bridges.ur.link import CommandLink

from tests.integration.ur.conftest import wait_until
from tests.ur_controller import UrController, dashboard
from ua_fleet.errors import SkillFailed

pytestmark = pytest.mark.needs("ur")


@pytest.fixture
def link(controller: UrController) -> Iterator[CommandLink]:
    made = CommandLink(controller.host, 5.0)
    yield made
    made.close()


@pytest.mark.parametrize("had_control", [False, True], ids=["the first time", "after its own"])
def test_a_program_that_was_begun_since_is_left_alone(
    controller: UrController, link: CommandLink, had_control: bool
) -> None:
    """A bridge on a busy machine learns late what runs: what it was told last does not count here."""
    if had_control:
        link.take_control(is_playing=False)
        dashboard(controller.host, "stop")
        wait_until(lambda: controller.state()["runtime"] == "STOPPED", "the stop")
    dashboard(controller.host, "load slow.urp", "play")
    with pytest.raises(SkillFailed, match="another program runs on the controller; stop it first"):
        link.take_control(is_playing=False)
    assert controller.state()["program"] == "slow.urp", "which may have come to its end meanwhile"
