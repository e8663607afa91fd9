"""What ROS 2 and Fast DDS read from the environment, set only while a node is made."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator, Mapping
from importlib import resources
from pathlib import Path
from typing import Final, Literal

__all__ = ["PROFILES_VARIABLE", "dds_environment", "profile_path", "settings"]

PROFILES_VARIABLE: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Read once for each process, when its first participant is made. (FASTDDS_DEFAULT_PROFILES_FILE has no effect.)"""

_RANGES: Final = {"localhost": "LOCALHOST", "subnet": "SUBNET"}


def profile_path(who: Literal["bridge", "robot"]) -> Path:
    """The Fast DDS profile for the bridge, or that for robots that want to be found and missed quickly."""
    return Path(str(resources.files("ua_bridges.ros2") / "profiles" / f"{who}.xml"))


def settings(environment: Mapping[str, str], discovery: Literal["localhost", "subnet"]) -> dict[str, str | None]:
    """The variables to set (None: to remove) for a node with that discovery; a profile of the user's own stays."""
    changes: dict[str, str | None] = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": _RANGES[discovery],
        "ROS_LOCALHOST_ONLY": None,  # the older variable, which would overrule the range
    }
    if not environment.get(PROFILES_VARIABLE):
        changes[PROFILES_VARIABLE] = str(profile_path("bridge"))
    return changes


@contextlib.contextmanager
def dds_environment(discovery: Literal["localhost", "subnet"]) -> Generator[None]:
    """Make a node with this discovery in here; children that the process starts later do not inherit the settings."""
    changes = settings(os.environ, discovery)
    before = {name: os.environ.get(name) for name in changes}
    _apply(changes)
    try:
        yield
    finally:
        _apply(before)


def _apply(changes: Mapping[str, str | None]) -> None:
    for name, value in changes.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
