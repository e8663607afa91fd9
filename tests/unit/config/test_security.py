from __future__ import annotations

from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups, groups_of

CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "sign_and_encrypt"},
        "bridges": {
            "arm": {"kind": "ros1", "space": 1, "requestors": [0, 7]},
            "floor": {"kind": "ros2", "space": 7},
            "press": {"kind": "plc", "space": 300, "requestors": []},
        },
    }
)


def test_every_publisher_has_a_group_for_data_and_every_bridge_one_for_commands() -> None:
    assert all_groups(CONFIG) == ("t-0", "t-1", "c-1", "t-7", "c-7", "t-300", "c-300")


def test_a_process_needs_all_data_its_own_commands_and_those_that_it_gives() -> None:
    assert groups_of(CONFIG, 0) == ("t-0", "t-1", "t-7", "t-300", "c-1", "c-7")
    assert groups_of(CONFIG, 1) == ("t-1", "t-0", "t-7", "t-300", "c-1")
    assert groups_of(CONFIG, 7) == ("t-7", "t-0", "t-1", "t-300", "c-1", "c-7")
    assert groups_of(CONFIG, 300) == ("t-300", "t-0", "t-1", "t-7", "c-300")
