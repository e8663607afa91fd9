"""The setting of the fleet in two halls: its `fleet.yaml`, its scenario, and what simulates its robots."""

from __future__ import annotations

from importlib.resources import files
from string import Template
from typing import Final

from ua_demo.layout import Layout
from ua_demo.talkrobots.setting import BELT_MM_S, TIMEOUT_S, Actor, Kind

__all__ = [
    "ACTORS",
    "BELT_PORT",
    "PROCESS_VARIABLE",
    "QUADCOPTER_PORT",
    "SCENARIO",
    "TASKS",
    "fleet_text",
    "scenario_text",
]

SCENARIO: Final = "two_halls"
TASKS: Final = 4
PROCESS_VARIABLE: Final = "UA_FLEET_PROCESS"
"""Variable of the environment that `fleet.yaml` asks for: the folder of a process, which is its user at the broker."""
BELT_PORT, QUADCOPTER_PORT = 1502, 4841
ACTORS: Final = {
    "belt": Actor("belt", Kind.PLC, "conveyor"),
    "quadcopter": Actor("quadcopter", Kind.TCP, "drone.py", ("--name", "quadcopter")),
}
_FLIGHT_TIMEOUT_S: Final = 8.0
"""A flight takes 6 s."""
_HALL_SPACE, _YARD_SPACE = 301, 302


def fleet_text(layout: Layout, broker_url: str, *, speed: float) -> str:
    """The `fleet.yaml`.

    Args:
        layout: where its processes run; its `pubsub_url` is that of the hall.
        broker_url: of the broker, whose certificate is checked.
        speed: how many times faster than usual everything goes.
    """
    template = Template(_package_text("fleet.template.yaml"))
    return template.substitute(
        layout.words(),
        process=PROCESS_VARIABLE,
        broker_url=broker_url,
        hall_space=_HALL_SPACE,
        yard_space=_YARD_SPACE,
        belt_host="belt",
        belt_port=BELT_PORT,
        quadcopter_host="quadcopter",
        quadcopter_port=QUADCOPTER_PORT,
        belt_mm_s=round(BELT_MM_S * speed),
        timeout_s=TIMEOUT_S / min(speed, 1.0),
        flight_timeout_s=_FLIGHT_TIMEOUT_S / min(speed, 1.0),
    )


def scenario_text() -> str:
    """The scenario's file."""
    return _package_text(f"{SCENARIO}.yaml")


def _package_text(name: str) -> str:
    return files("ua_demo.brokered").joinpath(name).read_text(encoding="utf-8")
