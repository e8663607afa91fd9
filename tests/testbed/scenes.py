"""The testbeds that are disturbed: which containers there are, what is asked of robots, and who says what was begun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from ua_demo.testbed.plan import TESTBEDS

from tests.testbed.commands import Asked
from tests.testbed.disturb import ALWAYS, Deed, Kind
from tests.testbed.runs import CASES, RunCase

__all__ = ["BROKERED", "GATEWAY", "SCENES", "TALKROBOTS", "Scene"]


@dataclass(frozen=True, slots=True)
class Scene:
    """A testbed of `compose.yaml`, up and at work."""

    profile: str
    kinds: Sequence[Kind]
    asked: Asked
    controllers: Sequence[str]
    """Robots whose simulated controllers write what they were told into their logs, not into the volume of events."""
    telling: Mapping[str, Sequence[str]] = field(default_factory=dict[str, Sequence[str]])
    """Nodes of values that robots tell all the time: there has to be one that was told after a disturbance."""
    cases: Sequence[RunCase] = ()
    """Kills within runs."""

    @property
    def server(self) -> str:
        """The server's service."""
        return TESTBEDS[self.profile].server

    @property
    def conductor(self) -> str:
        """The conductor's service."""
        return TESTBEDS[self.profile].conductor


GATEWAY: Final = "plc-gateway"
"""Modbus clients on this machine have to reach it again."""
_CONDUCTOR: Final = "tasks"
"""It has to be connected to the server again."""
_ALL_ROBOTS: Final = ("ridgeback", "ur3", "pioneer_1", "pioneer_2", "drone", "conveyor", "temperature_sensor")

_KINDS: Final = (
    Kind("OPC UA server", "server", _ALL_ROBOTS, (GATEWAY, _CONDUCTOR)),
    Kind("ROS master", "rosmaster", ("ridgeback",), ("ridgeback-bridge",)),
    Kind("ROS 1 bridge", "ridgeback-bridge", ("ridgeback",)),
    Kind("ROS 2 bridge", "pioneer-1-bridge", ("pioneer_1",)),
    Kind("UR bridge", "ur3-bridge", ("ur3",)),
    Kind("Modbus bridge", "conveyor-bridge", ("conveyor",)),
    Kind("TCP bridge", "drone-bridge", ("drone",)),
    Kind("bridge of a plugged-in device", "temperature-sensor-bridge", ("temperature_sensor",)),
    Kind("Modbus server", GATEWAY),
    Kind("web console", "console"),
    Kind("conductor", _CONDUCTOR),
    Kind("ROS 1 robot", "ridgeback", ("ridgeback",), ("ridgeback-bridge",)),
    Kind("ROS 2 robot", "pioneer-1", ("pioneer_1",), ("pioneer-1-bridge",)),
    Kind("UR controller", "ur3", ("ur3",), ("ur3-bridge",)),
    Kind("PLC", "conveyor", ("conveyor",), ("conveyor-bridge",)),
    Kind("TCP robot", "drone", ("drone",), ("drone-bridge",)),
)
_ASKED: Final[Asked] = {
    # Where it stands already, a drive takes no time.
    "ridgeback": [
        ("fetch", lambda _: {"table": "table", "to": "table"}),
        ("go", lambda _: {"to": "table"}),
        ("load", lambda _: {}),
    ],
    "ur3": [("pick", lambda count: {"angle": count % 120 - 60.0})],
    "pioneer_1": [("go", lambda _: {"to": "table"})],
    "pioneer_2": [("go", lambda _: {"to": "table"})],
    "drone": [("take_off", lambda _: {}), ("land", lambda _: {})],
    # A distance for each, by which the PLC's word is told from others.
    "conveyor": [("transport", lambda count: {"distance": 10 + count % 300})],
}
"""What is asked of each robot in turn; each takes about a second, ten times faster than in the paper."""
_TELLING: Final = {
    "ridgeback": ("ns=2;i=1020",),
    "pioneer_1": ("ns=2;i=1220",),
    "pioneer_2": ("ns=2;i=1320",),
    "temperature_sensor": ("ns=2;i=1620",),
}
TALKROBOTS: Final = Scene("talkrobots", _KINDS, _ASKED, ("ur3", "conveyor"), _TELLING, CASES)

_YARD: Final = ("quadcopter",)
_HALL: Final = ("belt",)
BROKERED: Final = Scene(
    "brokered",
    (
        Kind(
            "MQTT broker",
            "broker",
            _YARD,
            ("server-brokered", "yard-side"),
            deeds=(*ALWAYS, Deed.STOP, Deed.FORGET),
            silenced=_YARD,
            spared=_HALL,
            state="/var/lib/ua-fleet/broker/state",
        ),
        Kind("bridge behind the broker", "yard-side", _YARD, silenced=_YARD, spared=_HALL),
        Kind("OPC UA server", "server-brokered", (*_YARD, *_HALL), ("flights",)),
    ),
    {
        "quadcopter": [("take_off", lambda _: {}), ("land", lambda _: {})],
        "belt": [("transport", lambda count: {"distance": 10 + count % 300})],
    },
    ("belt",),
)
SCENES: Final = (TALKROBOTS, BROKERED)
