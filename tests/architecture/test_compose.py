"""The testbed's compose.yaml and Dockerfile keep the rules of docs/testbed.md."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import pytest
import yaml
from ua_demo.testbed.plan import TESTBEDS

ROOT: Final = Path(__file__).parents[2]
COMPOSE: Final[Any] = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))
SERVICES: Final[Mapping[str, Any]] = COMPOSE["services"]
DOCKERFILE: Final = (ROOT / "Dockerfile").read_text(encoding="utf-8")
JOBS: Final = {"setup": "talkrobots", "setup-pal": "pal", "setup-brokered": "brokered"}
SERVERS: Final = {testbed.server for testbed in TESTBEDS.values()}
CONDUCTORS: Final = {testbed.conductor for testbed in TESTBEDS.values()}
CONSOLES: Final = {testbed.console for testbed in TESTBEDS.values()}
BESIDE_THE_SERVER: Final = {*SERVERS, *CONDUCTORS, *CONSOLES, "plc-gateway", "broker"}
"""Who is on the server's network beside the bridges."""
STATE: Final = "/var/lib/ua-fleet"

each_service = pytest.mark.parametrize("name", SERVICES)


def networks(name: str) -> Mapping[str, Any]:
    return SERVICES[name].get("networks") or {}


def is_bridge(name: str) -> bool:
    return name.endswith(("-bridge", "-side"))


def plain_name(volume: str) -> str:
    """Of a volume, without what tells those of one testbed from those of others."""
    return volume.removeprefix("pal-").removeprefix("brokered-")


def mounts(name: str) -> Iterator[tuple[str, str, bool]]:
    """Volume, folder, and whether it is read-only."""
    for mount in SERVICES[name].get("volumes", ()):
        volume, folder, *options = mount.split(":")
        yield volume, folder, options == ["ro"]


@each_service
def test_a_container_has_no_right_that_it_does_not_need(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["init"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["tmpfs"] == ["/tmp"]
    assert service["sysctls"] == {"net.ipv4.ip_forward": "0"}
    assert not {"privileged", "cap_add", "devices", "pid", "ipc", "user", "userns_mode"} & service.keys()
    assert service.get("network_mode", "none") == "none"
    assert not [volume for volume, _, _ in mounts(name) if volume not in COMPOSE["volumes"]], "a folder of the machine"


@each_service
def test_a_container_s_log_is_bounded(name: str) -> None:
    logging = SERVICES[name]["logging"]
    assert logging["driver"] == "json-file"
    assert logging["options"].keys() == {"max-size", "max-file"}


@each_service
def test_a_container_s_memory_is_bounded(name: str) -> None:
    service = SERVICES[name]
    assert service["mem_limit"] == service["memswap_limit"] in ("512m", "1g")
    assert service["pids_limit"]


@each_service
def test_a_container_comes_back_and_says_how_it_is(name: str) -> None:
    service = SERVICES[name]
    if name in JOBS:
        assert service["restart"] == "no"
        return
    assert service["restart"] == "unless-stopped"
    assert service["healthcheck"]["test"][:3] == ["CMD", "ua-fleet", "healthcheck"]


@each_service
def test_only_bridges_the_gateway_and_the_broker_stand_in_two_networks(name: str) -> None:
    joined = networks(name).keys()
    assert bool(joined) == (name not in JOBS)
    if len(joined) > 1:
        assert is_bridge(name) or name in ("plc-gateway", "broker")
        assert len(joined) == 2
        assert "ua" in joined or name == "yard-side"
    assert ("ua" in joined) == ((is_bridge(name) and name != "yard-side") or name in BESIDE_THE_SERVER)


def test_only_the_broker_joins_the_yard_and_only_its_bridge_the_machines_there() -> None:
    on = {
        network: {name for name in SERVICES if network in networks(name)} for network in ("ua", "yard", "yard-machines")
    }
    assert on["yard"] == {"broker", "yard-side"}
    assert on["yard-machines"] == {"yard-side", "quadcopter"}
    assert on["ua"] & on["yard"] == {"broker"}
    assert COMPOSE["networks"]["yard"]["internal"] is True


def subnet_of(network: str) -> ipaddress.IPv4Network:
    text: str = COMPOSE["networks"][network]["ipam"]["config"][0]["subnet"]
    return ipaddress.IPv4Network(text.replace("${UA_FLEET_NET:-10.214.84}", "10.214.84"))


def test_networks_share_no_address() -> None:
    subnets = [subnet_of(network) for network in COMPOSE["networks"]]
    assert not [(one, other) for one, other in combinations(subnets, 2) if one.overlaps(other)]


def test_addresses_are_in_their_network_and_each_is_given_once_in_a_profile() -> None:
    for profile in TESTBEDS:
        given: list[int] = []
        for name, service in SERVICES.items():
            if profile not in service["profiles"]:
                continue
            for network, options in networks(name).items():
                net, _, last_byte = options["ipv4_address"].rpartition(".")
                assert net == "${UA_FLEET_NET:-10.214.84}"
                last = int(last_byte)
                subnet = subnet_of(network)
                first, *_, highest = (int(str(host).rpartition(".")[2]) for host in subnet.hosts())
                assert first < last <= highest, f"{name}: the first address is the gateway's"
                given.append(last)
        assert len(given) == len(set(given))


def test_no_network_has_an_answer_from_outside() -> None:
    for network in COMPOSE["networks"].values():
        masquerade = network.get("driver_opts", {}).get("com.docker.network.bridge.enable_ip_masquerade")
        assert network.get("internal") is True or masquerade == "false"


@each_service
def test_ports_are_published_on_the_address_that_was_asked_for(name: str) -> None:
    ports = SERVICES[name].get("ports", [])
    assert bool(ports) == (name in {*SERVERS, *CONSOLES, "plc-gateway"})
    for port in ports:
        if name in CONSOLES:
            assert port == "127.0.0.1:${UA_FLEET_CONSOLE_PORT:-8080}:8080", "without TLS on loopback alone"
            continue
        assert port.startswith("${UA_FLEET_PUBLISH:-127.0.0.1}:${UA_FLEET_")


@each_service
def test_only_the_job_may_change_the_fleet_s_files(name: str) -> None:
    for volume, folder, is_read_only in mounts(name):
        assert folder == f"{STATE}/{plain_name(volume).replace('-', '_')}"
        if folder == f"{STATE}/fleet":
            assert is_read_only == (name not in JOBS)


@each_service
def test_keys_and_passwords_are_read_by_their_owner_alone(name: str) -> None:
    own = {
        "operator": {*CONDUCTORS, "plc-gateway"},
        "server": SERVERS,
        "console": CONSOLES,
        "modbus": {"plc-gateway"},
    }
    for volume, _, _ in mounts(name):
        plain = plain_name(volume)
        if name not in JOBS and plain not in {"fleet", "events", "traffic"}:
            assert name in own.get(plain, {plain}), f"{name} reads {volume}"


@each_service
def test_what_a_robot_writes_is_opened_by_no_server_or_bridge(name: str) -> None:
    opens_traffic = name.startswith("server") or name.endswith(("-bridge", "-side"))
    for volume, _, is_read_only in mounts(name):
        if name in JOBS or name == "temperature-sensor-bridge":
            continue  # the thermometer, a robot, shares the container of its bridge
        if name in CONDUCTORS:
            assert is_read_only or not volume.endswith(("events", "traffic"))
        else:
            assert not volume.endswith("events" if opens_traffic else "traffic"), f"{name} has {volume}"


@each_service
def test_nothing_secret_stands_in_the_environment(name: str) -> None:
    environment: dict[str, str] = SERVICES[name].get("environment") or {}
    for key, value in environment.items():
        assert not re.search("PASSW|SECRET|TOKEN|KEY", key), f"{key}={value}"


@each_service
def test_an_image_is_built_here(name: str) -> None:
    assert SERVICES[name]["pull_policy"] == "never"
    target = SERVICES[name]["build"]["target"]
    assert SERVICES[name]["image"] == f"ua-fleet/{target}:${{UA_FLEET_TAG:-local}}"
    assert f" AS {target}\n" in DOCKERFILE


def test_every_process_of_a_testbed_has_a_service() -> None:
    for profile, testbed in TESTBEDS.items():
        there = {name for name, service in SERVICES.items() if profile in service["profiles"]}
        job = next(job for job, of in JOBS.items() if of == profile)
        with_thermometer = {"temperature_sensor"}  # beside its bridge, at the other end of its line
        robots = {robot for robot in testbed.robots if robot not in with_thermometer}
        wanted = {name.replace("_", "-") for name in (*testbed.bridges, *robots)}
        wanted |= {job, testbed.server, testbed.console, testbed.conductor}
        wanted |= {"rosmaster"} if testbed.ros1_address else set()
        wanted |= {"plc-gateway"} if testbed.has_modbus else set()
        wanted |= {"broker"} if testbed.has_broker else set()
        assert there == wanted
        folders = {folder.removeprefix(f"{STATE}/") for _, folder, _ in mounts(job)}
        assert folders == set(testbed.volumes)
        done = {job: {"condition": "service_completed_successfully"}}
        for name in there - {job, "rosmaster", testbed.conductor}:
            assert SERVICES[name]["depends_on"] == done
        begun = {name: {"condition": "service_started"} for name in there - {job, testbed.conductor}}
        assert SERVICES[testbed.conductor]["depends_on"] == {**done, **begun}, "it comes last, and can be shown alone"


def test_the_ros_1_bridge_has_the_address_that_the_fleet_names() -> None:
    assert networks("ridgeback-bridge")["ros1"]["ipv4_address"].endswith(f".{TESTBEDS['talkrobots'].ros1_address}")
    assert networks("arm-side")["ros1"]["ipv4_address"].endswith(f".{TESTBEDS['pal'].ros1_address}")


@pytest.mark.parametrize("target", ["core", "ros1", "ros2", "ur", "broker"])
def test_an_image_runs_as_a_user_without_rights_and_has_no_argument_of_the_build(target: str) -> None:
    stages = {
        name: (stands_on, text)
        for stands_on, name, text in re.findall(r"^FROM (\S+) AS (\S+)\n(.*?)(?=^FROM |\Z)", DOCKERFILE, re.M | re.S)
    }
    user, stage = None, target
    while stage in stages:
        stage, text = stages[stage]
        users = re.findall(r"^USER (\S+)$", text, re.M)
        user = user or (users[-1] if users else None)
        assert not re.findall(r"^ARG ", text, re.M)
    assert user == "ua-fleet"


def test_each_process_has_its_own_name_for_the_file_that_asks_for_it() -> None:
    for testbed in TESTBEDS.values():
        for service in (testbed.server, *(bridge.replace("_", "-") for bridge in testbed.bridges)):
            (own,) = {
                folder.removeprefix(f"{STATE}/")
                for volume, folder, _ in mounts(service)
                if plain_name(volume) not in {"fleet", "traffic", "events"}
            }
            environment: dict[str, str] = SERVICES[service]["environment"]
            assert testbed.environment(own).items() <= environment.items()


def test_the_images_have_the_folder_of_each_volume() -> None:
    made = re.findall(r"install -d -o ua-fleet -g ua-fleet -m 700 ([\w \\\n]+?)\n[^ ]", DOCKERFILE)[0]
    names = set(made.replace("\\", " ").split())
    assert names == {volume for testbed in TESTBEDS.values() for volume in testbed.volumes}


def test_the_build_sees_only_what_it_needs() -> None:
    lines = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert next(line for line in lines if not line.startswith("#")) == "*"
    wanted = {
        f"!{source}"
        for source in re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.M)
        for source in source.split()
    }
    assert {line.rstrip("/") for line in lines if line.startswith("!")} >= {line for line in wanted if "/" not in line}


def test_each_option_is_on_the_page() -> None:
    page = (ROOT / "docs" / "testbed.md").read_text(encoding="utf-8")
    options = set(re.findall(r"\$\{(\w+):-", (ROOT / "compose.yaml").read_text(encoding="utf-8")))
    assert {option for option in options if f"`{option}`" not in page} == set()
