"""What `fleet.yaml` marks for the card of a robot."""

from __future__ import annotations

import pytest

from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import fleet_model
from ua_fleet.errors import ConfigInvalid
from ua_fleet.values import NodeId

FLEET = """\
version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1}
robots:
  rover:
    bridge: floor
    data:
      battery: {id: 5, type: Double}
      pose: {id: 6, fields: {x: {type: Double}, y: {type: Double}}}
      camera: {id: 7, type: ByteString}
      joints: {id: 8, type: Double, array: true}
    card: CARD
"""


def test_a_card_names_values_in_its_order() -> None:
    config = load_content(FLEET.replace("CARD", "[pose.y, battery]").encode(), "f.yaml", {})
    (robot,) = fleet_model(config).robots
    assert robot.card == (NodeId(2, "6.y"), NodeId(2, 5))


@pytest.mark.parametrize(
    ("card", "said"),
    [
        ("[pose.z]", "f.yaml:13:robots.rover.card[0]: rover has no value `pose.z`; did you mean `pose."),
        ("[pose]", "rover has no value `pose`"),
        ("[battery, battery]", "robots.rover.card[1]: `battery` is named twice; remove one of them"),
        ("[battery, pose.x, pose.y, pose.x]", "robots.rover.card"),
        ("battery", "robots.rover.card"),
        ("[camera]", "robots.rover.card[0]: `camera` is a ByteString, and a card has room for one value; name another"),
        ("[joints]", "robots.rover.card[0]: `joints` is an array, and a card has room for one value; name another"),
    ],
)
def test_mistakes_in_a_card(card: str, said: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        load_content(FLEET.replace("CARD", card).encode(), "f.yaml", {})
    (problem,) = [str(one) for one in caught.value.problems]
    assert said in problem
