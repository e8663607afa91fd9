"""A ROS 2 bridge with message security."""

from __future__ import annotations

import signal
import time
from typing import Any, Final

import pytest

from tests.integration.peer import Peer
from tests.integration.ros2.conftest import Ros2Space, heard
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.keys.files import FileKeySource
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.security import SecurityMode, SecurityPolicy, read_security

pytestmark = pytest.mark.needs("ros2")

POLICY: Final = SecurityPolicy.AES256_CTR
SECURED: Final[dict[str, Any]] = {"security": "sign_and_encrypt", "keys": {"source": "files"}}
NUMBER: Final = (make_field("data", BuiltinType.INT32, properties={"RosType": "std_msgs/Int32"}),)
GOAL: Final = Topic(0, 2, 9)


async def test_both_ways_and_after_a_kill(ros2: Ros2Space) -> None:
    config = FleetConfig.model_validate(ros2.fleet(**SECURED))
    keys = KeyFolder(ros2.folder / "keys")
    for group_id in all_groups(config):
        keys.write(KeyFile.new(group_id, POLICY, 3600.0, time.time()))
    topic = Topic(ros2.domain, 2, 1)
    ros2.talker(topic.name, "std_msgs/Int32", {"data": "COUNT"})
    listener = ros2.listener(GOAL.name, "std_msgs/Int32")
    bridge = ros2.bridge(**SECURED)
    async with Peer.secured(config, 0, ros2.folder, FileKeySource(keys.path, POLICY)) as peer:
        peer.announce(GOAL, NUMBER)
        peer.publish(GOAL, 1)
        await peer.until(lambda: peer.good(topic) and len(heard(listener)) == 1)
        bridge.end(signal.SIGKILL)
        before = peer.good(topic)[-1][0]
        ros2.bridge(**SECURED)
        await peer.until(lambda: peer.good(topic)[-1][0] > before)
        peer.publish(GOAL, 2)
        await peer.until(lambda: len(heard(listener)) == 2)
        modes = {found.mode for found in map(read_security, peer.datagrams) if not found.is_discovery}
        assert modes == {SecurityMode.SIGN_AND_ENCRYPT}
