"""The driver in a Python without rospy."""

from __future__ import annotations

import sys

import pytest
from ua_bridges.ros1.driver import create_driver

from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.errors import BridgeUnavailable


def test_a_python_without_rospy_is_told_which_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("ua_bridges.ros1.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rospy", None)
    config = FleetConfig(
        version=1,
        pubsub=PubSubConfig(security=PubSubSecurity.NONE),
        bridges={"cell": BridgeConfig(kind="ros1", space=1)},
    )
    with pytest.raises(BridgeUnavailable) as refused:
        create_driver(config, "cell")
    assert str(refused.value).startswith("rospy cannot be imported (")
    assert str(refused.value).endswith("(docs/install.md), in a clone: .venv-ros1/bin/ua-fleet bridge cell")
