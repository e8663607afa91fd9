"""What the testbeds consist of fits to what their fleets are."""

from __future__ import annotations

from pathlib import Path

import pytest
from ua_demo.commands.testbed import Name
from ua_demo.hand import ROBOT_TIMEOUT_S
from ua_demo.testbed.plan import CONSOLE_PORT, CONSOLE_SETTINGS, OPERATOR, TESTBEDS, Options

from ua_fleet.config.load import load_content
from ua_fleet.config.teleoperation import teleoperations
from ua_fleet.console.load import load_settings
from ua_fleet.errors import ConfigError


def test_the_command_line_knows_all() -> None:
    assert [name.value for name in Name] == list(TESTBEDS)


@pytest.mark.parametrize("name", TESTBEDS)
def test_each_bridge_has_a_volume(name: str) -> None:
    testbed = TESTBEDS[name]
    config = load_content(testbed.files(Options())["fleet.yaml"].encode(), "fleet.yaml", testbed.environment(OPERATOR))
    assert tuple(config.bridges) == testbed.bridges
    assert set(testbed.bridges) < set(testbed.volumes)
    assert {config.server.state_dir, *map(config.state_dir_of, config.bridges)} < {f"../{v}" for v in testbed.volumes}


@pytest.mark.parametrize(("name", "robot"), [(t, robot) for t, testbed in TESTBEDS.items() for robot in testbed.robots])
def test_each_robot_is_a_program_that_is_there(name: str, robot: str) -> None:
    arguments, added = TESTBEDS[name].robot(robot, Options(speed=2))
    assert arguments[0] == "-m" or Path(arguments[0]).is_file()
    if robot not in ("ur3", "conveyor", "belt"):
        assert arguments[arguments.index("--speed") + 1] == "2"
    in_ros2 = {"human", "turtlebot3", "pioneer_1", "pioneer_2"}
    assert ("ROS_DOMAIN_ID" in added) is (robot in in_ros2)


@pytest.mark.parametrize("name", TESTBEDS)
def test_the_console_has_settings_of_its_own_fleet(name: str, tmp_path: Path) -> None:
    testbed = TESTBEDS[name]
    files = testbed.files(Options())
    config = load_content(files["fleet.yaml"].encode(), "fleet.yaml", testbed.environment(OPERATOR))
    (tmp_path / "fleet").mkdir()
    path = tmp_path / "fleet" / CONSOLE_SETTINGS
    path.write_text(files[CONSOLE_SETTINGS])
    settings = load_settings(path, {})
    endpoint = "opc.tcp://server:4840/ua_fleet"
    assert {name: one.endpoint for name, one in settings.fleets.items()} == {config.fleet.name: endpoint}
    assert config.pubsub.keys.endpoint == (endpoint if config.pubsub.keys.source == "service" else None)
    assert settings.state_dir is not None
    assert settings.state_dir.resolve() == tmp_path / "console"
    assert settings.listen == f"0.0.0.0:{CONSOLE_PORT}"


@pytest.mark.parametrize(("name", "driven"), [("pal", ["turtlebot3"]), ("talkrobots", ["pioneer_1", "pioneer_2"])])
def test_some_robots_can_be_driven_by_hand(name: str, driven: list[str]) -> None:
    config = load_content(TESTBEDS[name].files(Options())["fleet.yaml"].encode(), "fleet.yaml", {})
    found = [model for bridge in config.bridges for model in teleoperations(config, bridge)]
    assert [model.robot for model in found] == driven
    assert {model.robot_timeout_s for model in found} == {ROBOT_TIMEOUT_S}


def test_bridges_look_where_robots_are() -> None:
    testbed = TESTBEDS["talkrobots"]
    config = load_content(testbed.files(Options())["fleet.yaml"].encode(), "fleet.yaml", testbed.environment(OPERATOR))
    for number in (1, 2):
        _, added = testbed.robot(f"pioneer_{number}", Options())
        assert added["ROS_DOMAIN_ID"] == str(config.bridges[f"pioneer_{number}_bridge"].space)
    drone, _ = testbed.robot("drone", Options())
    text = testbed.files(Options())["fleet.yaml"]
    assert f'connect: "drone:{drone[drone.index("--port") + 1]}"' in text
    conveyor, _ = testbed.robot("conveyor", Options())
    assert f"plc: {{host: conveyor, port: {conveyor[conveyor.index('--port') + 1]}}}" in text
    sensor, _ = testbed.robot("temperature_sensor", Options())
    assert f'path: "{sensor[sensor.index("--device") + 1]}"' in text


def test_options_come_from_the_environment() -> None:
    assert Options.of({"UA_FLEET_SPEED": "", "HOME": "/"}) == Options()
    given = {"SPEED": "2.5", "RESILIENCE": "automatic", "PUBLISH": "192.0.2.7", "PORT": "4841", "NET": "10.1.2"}
    given["CONSOLE_PORT"] = "8081"
    expected = Options(2.5, "automatic", "192.0.2.7", 4841, "10.1.2", 8081)
    assert Options.of({f"UA_FLEET_{name}": value for name, value in given.items()}) == expected
    carried = {"UA_FLEET_MODE": "carried", "UA_FLEET_RESILIENCE": "automatic"}
    assert Options.of(carried) == Options(mode="automatic", is_carried=True)
    with pytest.raises(ConfigError, match="give automatic where UA_FLEET_MODE is carried"):
        Options.of({"UA_FLEET_MODE": "carried"})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("SPEED", value) for value in ("fast", "nan", "0", "21", "1e1")),
        ("RESILIENCE", "abort"),
        ("MODE", "flown"),
        *(("PORT", value) for value in ("http", "0", "70000")),
        *(("NET", value) for value in ("10.1", "10.1.2.0/24")),
    ],
)
def test_what_an_option_cannot_be_is_said(name: str, value: str) -> None:
    with pytest.raises(ConfigError, match=rf"^environment:UA_FLEET_{name}: '{value}' cannot be; give "):
        Options.of({f"UA_FLEET_{name}": value})
