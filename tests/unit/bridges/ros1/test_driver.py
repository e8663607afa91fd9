"""The driver in a Python without rospy."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """\
import sys
sys.modules["rospy"] = None
from ua_bridges.ros1.driver import create_driver
from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.errors import BridgeUnavailable

pubsub = PubSubConfig(security=PubSubSecurity.NONE)
config = FleetConfig(version=1, pubsub=pubsub, bridges={"cell": BridgeConfig(kind="ros1", space=1)})
try:
    create_driver(config, "cell")
except BridgeUnavailable as refused:
    print(refused)
"""


def test_a_python_without_rospy_is_told_which_has_it() -> None:
    """In a process of its own: modules that other tests have by name would be there twice."""
    run = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("rospy cannot be imported (")
    assert run.stdout.endswith("(docs/install.md), in a clone: .venv-ros1/bin/ua-fleet bridge cell\n")
