"""The setting of one run of the nine tasks: which robots there are, how each is simulated, and `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template
from typing import Final, Literal

from ua_fleet.demo.site import Site

__all__ = ["ACTORS", "SCENARIO", "SENSOR", "Actor", "Mode", "Setting", "make_setting"]

Mode = Literal["automatic", "operator"]

SCENARIO: Final = "nine_tasks"
SENSOR: Final = "temperature_sensor"
_TIMEOUT_S: Final = 120.0
"""Of each skill, in the demonstration's seconds; the longest takes about 30."""
_MOVE_BASE: Final = """\
        via:
          action:
            name: /move_base
            type: move_base_msgs/MoveBase
            fields: {to: target_pose.header.frame_id}
            constants: {target_pose.pose.orientation.w: 1.0}"""
_OWN_PROGRAM: Final = "        # Without ROS 1 the robot's own program offers it."


@dataclass(frozen=True, slots=True)
class Actor:
    """One robot or machine, and the program that simulates it. Its bridge is `<name>_bridge` of `fleet.yaml`."""

    name: str
    program: str
    """File in the folder `robots`."""
    options: tuple[str, ...] = ()
    ros: int = 2
    """1: in ROS 1 where there is one; 2: in a ROS 2 domain of its own."""
    takes_space: bool = False
    """Whether the program needs the id of its space: it offers skills by itself."""
    stdin: bool = False
    """Whether it is told something by lines on stdin."""

    @property
    def bridge(self) -> str:
        """The name of its bridge."""
        return f"{self.name}_bridge"


def _pioneer(number: int, go_id: int, x_m: float, y_m: float, battery: float) -> Actor:
    name = f"pioneer_{number}"
    place = ("--at", str(x_m), str(y_m), "--battery", str(battery))
    return Actor(name, "pioneer.py", ("--name", name, "--go-id", str(go_id), *place), takes_space=True)


ACTORS: Final = (
    Actor("ridgeback", "ridgeback.py", ros=1, takes_space=True, stdin=True),
    Actor("ur3", "ur3.py"),
    _pioneer(1, 1210, 7.0, 3.0, 71.0),
    _pioneer(2, 1310, 2.0, 4.0, 88.0),
    Actor("drone", "drone.py"),
    Actor("conveyor", "conveyor.py"),
    Actor(SENSOR, "sensor.py"),
)


@dataclass(frozen=True, slots=True)
class Setting:
    """See the module."""

    site: Site
    speed: float
    mode: Mode
    spaces: dict[str, int]
    """Of each actor."""

    def ros_of(self, actor: Actor) -> int:
        """Which ROS an actor runs: 1 or 2."""
        return 1 if self.spaces[actor.name] == 1 else 2


def make_setting(
    site: Site, *, domains: Sequence[int], speed: float, mode: Mode, say: Callable[[str], None]
) -> Setting:
    """Write `fleet.yaml` and the scenario, and say what differs from what a reader expects.

    Args:
        site: where the run takes place.
        domains: ROS 2 domains, one for each actor.
        speed: how many times faster than in the paper.
        mode: who chooses a replacement.
        say: prints a line for people.
    """
    spaces = dict(zip((actor.name for actor in ACTORS), domains, strict=True))
    if site.ros1_python is not None:
        spaces |= {actor.name: 1 for actor in ACTORS if actor.ros == 1}
    else:
        say(f"without ROS 1, {site.why_without_ros1}: Ridgeback runs in ROS 2 domain {spaces['ridgeback']}")
    is_ros1 = spaces["ridgeback"] == 1
    master = f'kind: ros1, space: 1, master_uri: "http://127.0.0.1:{site.master_port}"'
    package = files("ua_fleet.demo.talkrobots")
    template = Template(package.joinpath("fleet.template.yaml").read_text(encoding="utf-8"))
    site.config_file.write_text(
        template.substitute(
            {f"{name}_space": space for name, space in spaces.items()},
            server_port=site.server_port,
            pubsub_url=site.pubsub_url,
            pubsub_security=site.pubsub_security,
            ridgeback_bridge=master if is_ros1 else f"kind: ros2, space: {spaces['ridgeback']}",
            ridgeback_go=_MOVE_BASE if is_ros1 else _OWN_PROGRAM,
            timeout_s=_TIMEOUT_S / min(speed, 1.0),
            mode=mode,
        ),
        encoding="utf-8",
    )
    scenarios = site.folder / "scenarios"
    scenarios.mkdir(exist_ok=True)
    text = package.joinpath(f"{SCENARIO}.yaml").read_text(encoding="utf-8")
    (scenarios / f"{SCENARIO}.yaml").write_text(text, encoding="utf-8")
    return Setting(site, speed, mode, spaces)
