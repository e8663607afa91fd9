"""The setting of one run of the assembly line: its site, its ROS 2 domains and its `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from string import Template

from ua_fleet.demo.processes import DemoFailed
from ua_fleet.demo.site import Site
from ua_fleet.topics import check_ros2_space

__all__ = ["Setting", "make_setting"]


@dataclass(frozen=True, slots=True)
class Setting:
    """The arm lives in a ROS 2 domain where the site has no ROS 1."""

    site: Site
    arm_space: int
    mobile_space: int
    speed: float
    loop_rule: bool

    @property
    def arm_ros(self) -> int:
        """Which ROS the arm runs: 1 or 2."""
        return 1 if self.site.ros1_python is not None else 2


def make_setting(
    site: Site, *, domain: int, arm_domain: int, speed: float, loop_rule: bool, say: Callable[[str], None]
) -> Setting:
    """Write `fleet.yaml`, and say what differs from what a reader expects.

    Args:
        site: where the run takes place.
        domain: ROS 2 domain of the TurtleBot3.
        arm_domain: ROS 2 domain of the arm where it does not run in ROS 1.
        speed: how many times faster than in the paper.
        loop_rule: False lets the bridges forward everything, for a test.
        say: prints a line for people.
    """
    check_ros2_space(domain)
    arm_space = 1
    arm_bridge = f"    kind: ros1\n    space: 1\n    master_uri: http://127.0.0.1:{site.master_port}"
    if site.ros1_python is None:
        arm_space = check_ros2_space(arm_domain)
        if arm_space == domain:
            raise DemoFailed(f"arm and TurtleBot3 cannot both have domain {domain}; choose another --arm-domain")
        say(f"without ROS 1, {site.why_without_ros1}: the arm runs in ROS 2 domain {arm_space}")
        arm_bridge = f"    kind: ros2\n    space: {arm_space}"
    template = Template(files("ua_fleet.demo.pal").joinpath("fleet.template.yaml").read_text(encoding="utf-8"))
    site.write_config(
        template.substitute(
            server_port=site.server_port,
            pubsub_url=site.pubsub_url,
            pubsub_security=site.pubsub_security,
            arm_bridge=arm_bridge,
            mobile_space=domain,
        )
    )
    return Setting(site, arm_space, domain, speed, loop_rule)
