"""The robot and the skill on their page are legal definitions."""

from __future__ import annotations

from tests.unit.docs.pages import blocks
from ua_fleet.client.positions import find_position
from ua_fleet.config.load import load_content
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
    robot, skill, _ = [block for block in blocks("yml") if block.page.name == "robots.md"]
    cart = read_robot(RobotText("cart", text=robot.text), FLEET, lambda _: None).model
    assert [one.name for one in cart.skills] == ["drive"]
    said = RobotText("mechanic", CLIENTS, text=skill.text, skill="call_mechanic")
    mechanic = read_robot(said, FLEET, lambda _: None).model
    assert (mechanic.capacities, mechanic.skills[0].timeout_s) == (("repair",), 1800)


def test_a_machine_that_stands_still_says_where() -> None:
    *_, block = [block for block in blocks("yml") if block.page.name == "robots.md"]
    tcp = "{kind: tcp, space: 300, status_id: 900, interpreter: {connect: '127.0.0.1:7000'}}"
    bridges = f"version: 1\npubsub: {{security: none}}\nbridges: {{hall: {tcp}}}\n"
    fleet = load_content(f"{bridges}{block.text}".encode(), "fleet.yaml", {})
    pose = fleet.robots["press"].data["pose"]
    x, y, heading, _, _ = find_position([("pose", name) for name in pose.fields])
    assert (x, y, heading) == (("pose", "x"), ("pose", "y"), ("pose", "heading"))
