from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ua_fleet.config.schema import FleetConfig, PubSubConfig
from ua_fleet.config.security import all_groups, envelope_of, groups_of, keys_needed, weaknesses
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigError
from ua_fleet.keys.files import FileKeySource
from ua_fleet.wire.security import SecurityMode, SecurityPolicy

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


URL = "opc.udp://224.0.2.14:4840"
NONE = f"PubSub messages are neither signed nor encrypted: anyone who reaches {URL} on lo can read and forge them"


def with_pubsub(**pubsub: Any) -> FleetConfig:
    return CONFIG.model_copy(update={"pubsub": PubSubConfig.model_validate(pubsub)})


@pytest.mark.parametrize(
    ("pubsub", "said"),
    [
        ({"security": "sign_and_encrypt"}, []),
        (
            {"security": "none", "relaxed_replay": [7]},
            [NONE],
        ),
        (
            {"security": "sign", "relaxed_replay": [7, 900], "interface": "eth1"},
            [
                f"PubSub messages are signed and not encrypted: anyone who reaches {URL} on eth1 can read them",
                "PubSub messages of these spaces are taken without a check for replays: 7, 900",
            ],
        ),
    ],
)
def test_what_weakens_security_is_said(pubsub: dict[str, Any], said: list[str]) -> None:
    assert weaknesses(with_pubsub(**pubsub)) == said


def test_secured_messages_need_a_source_of_keys(tmp_path: Path) -> None:
    source = FileKeySource(tmp_path, SecurityPolicy.AES256_CTR)
    assert keys_needed(CONFIG, 0, source) is source
    assert keys_needed(with_pubsub(security="none"), 0, source) is None
    assert keys_needed(with_pubsub(security="none"), 0, None) is None
    with pytest.raises(ConfigError) as caught:
        keys_needed(with_pubsub(security="sign"), 0, None)
    assert str(caught.value) == (
        "pubsub.keys: messages are to be secured (sign), and no key source is configured; name one, or accept "
        "unsecured messages with `security: none`"
    )


def test_an_envelope_wants_the_keys_of_its_space(tmp_path: Path) -> None:
    envelope = envelope_of(CONFIG, 7, Counters(), tmp_path / "state")
    assert envelope.mode is SecurityMode.SIGN_AND_ENCRYPT
    assert tuple(envelope.groups_wanted()) == groups_of(CONFIG, 7)
    assert (tmp_path / "state").stat().st_mode & 0o777 == 0o700
    envelope = envelope_of(with_pubsub(security="none"), 7, Counters(), tmp_path / "other")
    assert (envelope.mode, envelope.groups_wanted()) == (SecurityMode.NONE, [])
    assert not (tmp_path / "other").exists()
