"""The robot and the skill on their page are legal definitions."""

from __future__ import annotations

from tests.unit.docs.pages import blocks
from ua_fleet.config.registration import CLIENTS, RobotText, read_robot
from ua_fleet.config.schema import FleetConfig

FLEET = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"yard": {"kind": "virtual", "space": 300, "status_id": 900}},
    }
)


def test_the_definitions_are_legal() -> None:
    robot, skill = [block for block in blocks("yml") if block.page.name == "robots.md"]
    cart = read_robot(RobotText("cart", text=robot.text), FLEET, lambda _: None).model
    assert [one.name for one in cart.skills] == ["drive"]
    said = RobotText("mechanic", CLIENTS, text=skill.text, skill="call_mechanic")
    mechanic = read_robot(said, FLEET, lambda _: None).model
    assert (mechanic.capacities, mechanic.skills[0].timeout_s) == (("repair",), 1800)
