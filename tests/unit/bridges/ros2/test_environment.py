from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from typing import Literal

import pytest
from ua_bridges.ros2.environment import PROFILES_VARIABLE, dds_environment, profile_path, settings

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def test_settings_for_both_discoveries() -> None:
    assert settings({}, "localhost") == {
        RANGE: "LOCALHOST",
        "ROS_LOCALHOST_ONLY": None,
        PROFILES_VARIABLE: str(profile_path("bridge")),
    }
    assert settings({}, "subnet")[RANGE] == "SUBNET"


def test_profile_of_the_user_stays() -> None:
    assert PROFILES_VARIABLE not in settings({PROFILES_VARIABLE: "/my.xml"}, "localhost")


def test_environment_is_as_before_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(PROFILES_VARIABLE, raising=False)
    monkeypatch.setenv(RANGE, "OFF")
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    before = dict(os.environ)
    with dds_environment("localhost"):
        assert os.environ[RANGE] == "LOCALHOST"
        assert os.environ[PROFILES_VARIABLE].endswith("bridge.xml")
        assert "ROS_LOCALHOST_ONLY" not in os.environ
    assert dict(os.environ) == before


@pytest.mark.parametrize("who", ["bridge", "robot"])
def test_profiles_are_default_profiles_and_only_the_bridge_is_deaf_to_itself(who: Literal["bridge", "robot"]) -> None:
    root = ET.parse(profile_path(who)).getroot()
    space = {"dds": "http://www.eprosima.com"}
    (participant,) = root.iterfind(".//dds:participant", space)
    assert participant.get("is_default_profile") == "true"
    names = [name.text for name in root.iterfind(".//dds:property/dds:name", space)]
    assert names == (["fastdds.ignore_local_endpoints"] if who == "bridge" else [])
    assert root.findtext(".//dds:leaseDuration/dds:sec", namespaces=space) == "3"
