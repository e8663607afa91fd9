"""The setting of one run of the assembly line: its folder, its ports and its `fleet.yaml`."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template

from ua_fleet.bridge.launch import child_environment, find_ros1_python
from ua_fleet.demo.processes import DemoFailed, free_tcp_port, udp_port_in_use
from ua_fleet.topics import check_ros2_space

__all__ = ["KEY_LIFETIME_S", "Setting", "make_setting"]

OPC_UA_PORT = 4840
ROS_MASTER_PORT = 11311
DEFAULT_GROUP = "224.0.2.14"
ARM_DOMAIN_WITHOUT_ROS1 = 3
UNSECURED = "# Unsigned messages, on loopback only.\n  security: none"
KEY_LIFETIME_S = 5
SECURED = f"""\
# The server makes the keys; the bridges fetch them with their certificates, and they change while the line runs.
  security: sign_and_encrypt
  keys: {{lifetime_s: {KEY_LIFETIME_S}}}"""


@dataclass(frozen=True, slots=True)
class Setting:
    """Where everything is. `ros1_python` is None when the arm has to live in a ROS 2 domain."""

    folder: Path
    endpoint: str
    pubsub_url: str
    password: str
    master_port: int
    arm_space: int
    mobile_space: int
    ros1_python: Path | None
    speed: float
    loop_rule: bool
    secure: bool
    """Whether PubSub is signed and encrypted, with keys from the server's key service."""

    @property
    def config_file(self) -> Path:
        """The `fleet.yaml` of the run."""
        return self.folder / "fleet.yaml"

    @property
    def arm_ros(self) -> int:
        """Which ROS the arm runs: 1 or 2."""
        return 1 if self.ros1_python is not None else 2

    def robot_environment(self, domain: int | None) -> dict[str, str]:
        """The environment of a robot's program: in the ROS 2 domain `domain`, or with the ROS 1 master for None."""
        environment = child_environment(os.environ)
        log_folder = self.folder / "log" / "ros"
        log_folder.mkdir(parents=True, exist_ok=True)
        environment["ROS_LOG_DIR"] = str(log_folder)
        if domain is None:
            environment["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.master_port}"
            environment["ROS_IP"] = environment["ROS_HOSTNAME"] = "127.0.0.1"
        else:
            environment["ROS_DOMAIN_ID"] = str(domain)
            environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
            profile = files("ua_bridges.ros2").joinpath("profiles", "robot.xml")
            environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
        return environment


def make_setting(
    folder: Path,
    *,
    domain: int,
    speed: float,
    loop_rule: bool,
    without_ros1: bool,
    secure: bool = False,
    arm_domain: int = ARM_DOMAIN_WITHOUT_ROS1,
    port: int = OPC_UA_PORT,
    master_port: int = ROS_MASTER_PORT,
    pubsub_url: str | None = None,
    say: Callable[[str], None],
) -> Setting:
    """Choose ports, write `fleet.yaml` into `folder`, and say what differs from what a reader expects.

    Args:
        folder: an empty folder for this run.
        domain: ROS 2 domain of the TurtleBot3.
        speed: how many times faster than in the paper.
        loop_rule: False lets the bridges forward everything, for a test.
        without_ros1: run the arm in ROS 2 even if ROS 1 is there.
        secure: sign and encrypt PubSub, with keys from the server's key service.
        arm_domain: ROS 2 domain of the arm where it does not run in ROS 1.
        port: wanted TCP port of the OPC UA server; another is taken if it is in use.
        master_port: wanted TCP port of the ROS master, likewise.
        pubsub_url: PubSub address; by default the registered one, or another group if its port is in use.
        say: prints a line for people.
    """
    check_ros2_space(domain)
    server_port = _free_port("the OPC UA server", port, say)
    if pubsub_url is None:
        pubsub_url = f"opc.udp://{DEFAULT_GROUP}:{OPC_UA_PORT}"
        if udp_port_in_use(OPC_UA_PORT):
            group = f"239.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}"
            pubsub_url = f"opc.udp://{group}:{OPC_UA_PORT}"
            say(f"UDP port {OPC_UA_PORT} is in use; PubSub takes the group {group}")
    ros1_python = None if without_ros1 else find_ros1_python(os.environ)
    if ros1_python is not None:
        master_port = _free_port("the ROS master", master_port, say)
    arm_space = 1
    if ros1_python is None:
        arm_space = check_ros2_space(arm_domain)
        if arm_space == domain:
            raise DemoFailed(f"arm and TurtleBot3 cannot both have domain {domain}; choose another --arm-domain")
        why = "as asked" if without_ros1 else "since there is no .venv-ros1 (make setup says why)"
        say(f"without ROS 1, {why}: the arm runs in ROS 2 domain {arm_space}")
    arm_bridge = (
        f"    kind: ros1\n    space: 1\n    master_uri: http://127.0.0.1:{master_port}"
        if ros1_python is not None
        else f"    kind: ros2\n    space: {arm_space}"
    )
    template = Template(files("ua_fleet.demo.pal").joinpath("fleet.template.yaml").read_text(encoding="utf-8"))
    setting = Setting(
        folder=folder,
        endpoint=f"opc.tcp://127.0.0.1:{server_port}/ua_fleet",
        pubsub_url=pubsub_url,
        password=secrets.token_urlsafe(9),
        master_port=master_port,
        arm_space=arm_space,
        mobile_space=domain,
        ros1_python=ros1_python,
        speed=speed,
        loop_rule=loop_rule,
        secure=secure,
    )
    setting.config_file.write_text(
        template.substitute(
            server_port=server_port,
            pubsub_url=pubsub_url,
            pubsub_security=SECURED if secure else UNSECURED,
            arm_bridge=arm_bridge,
            mobile_space=domain,
        ),
        encoding="utf-8",
    )
    return setting


def _free_port(who: str, wanted: int, say: Callable[[str], None]) -> int:
    port = free_tcp_port(wanted)
    if port != wanted:
        say(f"port {wanted} is in use; {who} takes {port}")
    return port
