"""What the nine tasks are set up from fits together."""

from __future__ import annotations

from pathlib import Path

import pytest
from ua_bridges.modbus.config import ModbusBridgeConfig
from ua_bridges.plugged.config import PluggedBridgeConfig
from ua_bridges.tcp.config import TcpBridgeConfig
from ua_bridges.ur.config import UrBridgeConfig
from ua_demo.site import Site
from ua_demo.talkrobots.robots.mobile import PLACES
from ua_demo.talkrobots.setting import ACTORS, SCENARIO, Setting, make_setting

from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigError


def site(folder: Path, *, ros1: bool, secure: bool = False) -> Site:
    python = Path("/usr/bin/python3") if ros1 else None
    return Site(folder, 4840, ("opc.udp://224.0.2.14:4840",), "secret", 11311, python, "as asked", secure)


def made(folder: Path, *, ros1: bool, secure: bool = False, speed: float = 1.0) -> tuple[Setting, FleetConfig]:
    said: list[str] = []
    chosen = site(folder, ros1=ros1, secure=secure)
    setting = make_setting(chosen, domains=range(21, 24), speed=speed, mode="operator", say=said.append)
    assert said == ([] if ros1 else ["without ROS 1, as asked: Ridgeback runs in ROS 2 domain 21"])
    return setting, load(chosen.config_file)


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("secure", [True, False])
def test_the_configuration_is_valid_and_has_a_bridge_for_each_robot(tmp_path: Path, ros1: bool, secure: bool) -> None:
    setting, config = made(tmp_path, ros1=ros1, secure=secure)
    assert [robot.bridge for robot in config.robots.values()] == [actor.bridge for actor in ACTORS]
    assert len({bridge.space for bridge in config.bridges.values()}) == len(ACTORS)
    assert {actor.name: config.bridges[actor.bridge].space for actor in ACTORS} == setting.spaces
    assert config.bridges["ridgeback_bridge"].kind == ("ros1" if ros1 else "ros2")
    others = ("ur3_bridge", "drone_bridge", "conveyor_bridge", "temperature_sensor_bridge")
    assert [config.bridges[name].kind for name in others] == ["ur", "tcp", "modbus", "plugged"]
    assert config.pubsub.security.value == ("sign_and_encrypt" if secure else "none")
    assert (tmp_path / "scenarios" / f"{SCENARIO}.yaml").exists()


def test_each_robot_is_found_where_its_bridge_looks(tmp_path: Path) -> None:
    folder = tmp_path / 'the "new" hall'
    folder.mkdir()
    setting, config = made(folder, ros1=False)
    bridges = {actor.name: config.bridges[actor.bridge] for actor in ACTORS}
    plc, arm, drone, sensor = (bridges[name] for name in ("conveyor", "ur3", "drone", "temperature_sensor"))
    assert isinstance(plc, ModbusBridgeConfig)
    assert isinstance(arm, UrBridgeConfig)
    assert isinstance(drone, TcpBridgeConfig)
    assert isinstance(sensor, PluggedBridgeConfig)
    assert drone.interpreter is not None
    assert drone.interpreter.connect is not None
    looked = {
        "conveyor": str(plc.devices["plc"].port),
        "ur3": arm.address,
        "drone": drone.interpreter.connect.rpartition(":")[2],
        "temperature_sensor": sensor.devices["thermometer"].path,
    }
    assert looked == setting.places
    for actor in ACTORS:
        if not actor.kind.is_ros:
            assert setting.places[actor.name] in setting.command(actor)


def test_robots_are_ranked_by_the_places_that_they_drive_to(tmp_path: Path) -> None:
    _, config = made(tmp_path, ros1=False)
    distance = config.resilience.criteria["distance"].distance
    assert distance is not None
    assert distance.places == PLACES


@pytest.mark.parametrize(("speed", "timeout_s"), [(0.1, 1200), (1, 120), (20, 120)])
def test_skills_have_time_enough_at_any_speed(tmp_path: Path, speed: float, timeout_s: float) -> None:
    _, config = made(tmp_path, ros1=False, speed=speed)
    assert {skill.timeout_s for robot in config.robots.values() for skill in robot.skills.values()} == {timeout_s}


def test_a_run_that_an_earlier_demonstration_left_is_not_gone_on_with(tmp_path: Path) -> None:
    bridge = tmp_path / "state" / "bridges" / "ur3_bridge"
    bridge.mkdir(parents=True)
    left = [tmp_path / "state" / "server.db", bridge / "executions.db-wal"]
    kept = [bridge / "nonces.json", bridge / "bridge.der"]
    for path in (*left, *kept):
        path.touch()
    made(tmp_path, ros1=False)
    assert [path.exists() for path in left] == [False, False]
    assert [path.exists() for path in kept] == [True, True]


def test_the_folder_of_another_fleet_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "server.db").touch()
    (tmp_path / "fleet.yaml").write_text("version: 1\n")
    with pytest.raises(ConfigError, match=r"fleet\.yaml.*this is another fleet's; choose another --folder"):
        made(tmp_path, ros1=True)
    assert (tmp_path / "state" / "server.db").exists()
    assert (tmp_path / "fleet.yaml").read_text() == "version: 1\n"


def test_an_earlier_run_in_the_same_folder_is_replaced(tmp_path: Path) -> None:
    made(tmp_path, ros1=True)
    _, config = made(tmp_path, ros1=True, secure=True)
    assert config.pubsub.security.value == "sign_and_encrypt"
