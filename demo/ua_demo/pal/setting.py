"""The setting of one run of the assembly line: its site, its ROS 2 domains and its `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Final

from ua_demo.layout import Layout
from ua_demo.processes import DemoFailed
from ua_fleet.topics import check_ros2_space

if TYPE_CHECKING:
    from ua_demo.site import Site

__all__ = ["IN_ARM_SPACE", "ROBOTS", "Setting", "fleet_text", "make_setting", "robot_arguments"]

ROBOTS: Final = ("operator_panel", "human", "turtlebot3", "ned")
"""The robots' programs, and people's; the arm comes last, since it begins by itself."""
IN_ARM_SPACE: Final = frozenset({"operator_panel", "ned"})
"""Those of them that live in the arm's graph."""
_PROGRAMS: Final = Path(__file__).resolve().parent / "robots"


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
    if site.ros1_python is None:
        arm_space = check_ros2_space(arm_domain)
        if arm_space == domain:
            raise DemoFailed(f"arm and TurtleBot3 cannot both have domain {domain}; choose another --arm-domain")
        say(f"without ROS 1, {site.why_without_ros1}: the arm runs in ROS 2 domain {arm_space}")
    site.write_config(fleet_text(site.layout("pal"), arm_space=arm_space, mobile_space=domain))
    return Setting(site, arm_space, domain, speed, loop_rule)


def fleet_text(layout: Layout, *, arm_space: int, mobile_space: int) -> str:
    """The `fleet.yaml`.

    Args:
        layout: where its processes run.
        arm_space: 1 for ROS 1, or a ROS 2 domain.
        mobile_space: ROS 2 domain of the TurtleBot3.
    """
    keys = ["kind: ros2", f"space: {arm_space}", f"discovery: {layout.ros2_discovery}"]
    if arm_space == 1:
        keys = ["kind: ros1", "space: 1", f"master_uri: {layout.master_uri}", f"host_ip: {layout.ros1_host_ip}"]
    arm_bridge = "\n".join(f"    {key}" for key in keys)
    template = Template(files("ua_demo.pal").joinpath("fleet.template.yaml").read_text(encoding="utf-8"))
    return template.substitute(layout.words(), arm_bridge=arm_bridge, mobile_space=mobile_space)


def robot_arguments(name: str, *, arm_space: int, mobile_space: int, speed: float) -> list[str]:
    """The program of one of ROBOTS with its arguments, for the interpreter of its ROS."""
    arm_ros = ("--ros", "1" if arm_space == 1 else "2")
    pace = ("--speed", str(speed))
    on_floor = ("--space", str(mobile_space), "--arm-space", str(arm_space), *pace)
    arguments: dict[str, tuple[str, ...]] = {
        "ned": (*arm_ros, "--space", str(arm_space), "--turtlebot-space", str(mobile_space), *pace),
        "operator_panel": (*arm_ros, *pace),
        "human": on_floor,
        "turtlebot3": on_floor,
    }
    return [str(_PROGRAMS / f"{name}.py"), *arguments[name]]
