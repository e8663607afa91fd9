"""What is disturbed, watched and asked fits the services and the fleets of `compose.yaml`."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from ua_demo.testbed.plan import OPERATOR, TESTBEDS, Options

from tests.testbed.bed import CannotStart
from tests.testbed.disturb import Deed
from tests.testbed.scenes import BROKERED, SCENES, TALKROBOTS, Scene
from tests.testbed.session import meant, with_runs
from tests.testbed.watching import addresses_of
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig

ROOT = Path(__file__).parents[3]
SERVICES = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))["services"]
each_scene = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.profile)


def fleet(scene: Scene) -> FleetConfig:
    testbed = TESTBEDS[scene.profile]
    text = testbed.files(Options())["fleet.yaml"]
    return load_content(text.encode(), "fleet.yaml", testbed.environment(OPERATOR))


@each_scene
def test_each_kind_is_a_service_of_the_profile_with_robots_of_its_fleet(scene: Scene) -> None:
    config = fleet(scene)
    for kind in scene.kinds:
        for service in (kind.service, *kind.also):
            assert scene.profile in SERVICES[service]["profiles"]
            assert "healthcheck" in SERVICES[service]
        assert {*kind.robots, *kind.silenced, *kind.spared} <= config.robots.keys()
        assert (Deed.FORGET in kind.deeds) == bool(kind.state)


@each_scene
def test_each_skill_that_is_asked_for_is_there(scene: Scene) -> None:
    config = fleet(scene)
    for robot, skills in scene.asked.items():
        for skill, arguments in skills:
            assert arguments(7).keys() <= config.robots[robot].skills[skill].arguments.keys()
    assert {*scene.controllers, *scene.telling} <= config.robots.keys()
    told = {address for addresses in scene.telling.values() for address in addresses}
    assert told <= addresses_of(config).keys()


def test_an_absence_is_longer_than_the_yard_s_skills_may_wait() -> None:
    """Otherwise nothing that the broker holds back would come too late."""
    from tests.testbed.disturb import ABSENCE_S

    skills = fleet(BROKERED).robots["quadcopter"].skills.values()
    assert max(skill.timeout_s for skill in skills) < ABSENCE_S


def test_what_is_wanted_is_chosen_by_service_deed_or_profile() -> None:
    everything = meant("")
    assert [len(everything[scene.profile]) for scene in SCENES] == [
        sum(len(kind.deeds) for kind in scene.kinds) for scene in SCENES
    ]
    chosen = meant("broker:paused server:killed")
    assert [(kind.service, deed) for kind, deed in chosen["brokered"]] == [("broker", Deed.PAUSE)]
    assert [(kind.service, deed) for kind, deed in chosen["talkrobots"]] == [("server", Deed.KILL)]
    assert meant("brokered") == {**everything, "talkrobots": []}
    assert meant("runs") == {"talkrobots": [], "brokered": []}
    assert (with_runs(TALKROBOTS, "runs"), with_runs(BROKERED, "runs"), with_runs(TALKROBOTS, "drone")) == (
        True,
        False,
        False,
    )
    with pytest.raises(CannotStart, match=r"no such disturbance; services: server, .*yard-side"):
        meant("brokerd")
