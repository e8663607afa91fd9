"""The setting of one run of the nine tasks: which robots there are, how each is simulated, and `fleet.yaml`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from itertools import count
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Final, Literal

from ua_demo.layout import Layout
from ua_demo.processes import free_loopback_address, free_tcp_port

if TYPE_CHECKING:
    from ua_demo.site import Site

__all__ = [
    "ACTORS",
    "BELT_MM_S",
    "DOMAINS",
    "SCENARIO",
    "TIMEOUT_S",
    "Actor",
    "Kind",
    "Mode",
    "Setting",
    "fleet_text",
    "make_setting",
    "scenario_text",
]

Mode = Literal["automatic", "operator"]

SCENARIO: Final = "nine_tasks"
ROBOTS: Final = Path(__file__).resolve().parent / "robots"
TIMEOUT_S: Final = 120.0
"""Of each skill, in the demonstration's seconds; the longest takes about 30."""
BELT_MM_S: Final = 40
_ARM_MOVE_S: Final = 5.0
"""Of UR3, from one place to the next."""
_GRIPPER_S: Final = 1.0
_FIRST_VENDOR_SPACE: Final = 300
_LOOPBACK: Final = "127.0.0.1"
_UR_PORTS: Final = (29999, *range(30001, 30006))
"""ur-rtde knows no others, so a controller has an address of its own."""
_MOVE_BASE: Final = """\
        via:
          action:
            name: /move_base
            type: move_base_msgs/MoveBase
            fields: {to: target_pose.header.frame_id}
            constants: {target_pose.pose.orientation.w: 1.0}"""
_OWN_PROGRAM: Final = "        # Without ROS 1 the robot's own program offers it."


class Kind(StrEnum):
    """What a robot or machine speaks, and so what simulates it."""

    ROS1 = "ros1"
    """A node in ROS 1, or in a ROS 2 domain where there is no ROS 1."""
    ROS2 = "ros2"
    """A node in a ROS 2 domain of its own."""
    PLC = "plc"
    """A PLC with Modbus."""
    TCP = "tcp"
    """A robot whose program reads fields from a socket (interpreter mode)."""
    UR = "ur"
    """An arm of Universal Robots, with its controller."""
    PLUGGED = "plugged"
    """A device on a serial port."""

    @property
    def is_ros(self) -> bool:
        """Whether it lives in a ROS graph."""
        return self in (Kind.ROS1, Kind.ROS2)


@dataclass(frozen=True, slots=True)
class Actor:
    """One robot or machine. Its bridge is `<name>_bridge` of `fleet.yaml`."""

    name: str
    kind: Kind
    program: str
    """File in the folder `robots`; for a PLC the program of its simulator, for an arm of Universal Robots its model."""
    options: tuple[str, ...] = ()
    takes_space: bool = False
    """Whether the program needs the id of its space: it offers skills by itself."""

    @property
    def bridge(self) -> str:
        """The name of its bridge."""
        return f"{self.name}_bridge"

    def arguments(self, *, space: int, host: str, place: str, speed: float) -> list[str]:
        """What simulates it, for a Python interpreter.

        Args:
            space: its own.
            host: address to listen on, for those that a bridge connects to.
            place: TCP port to listen on, or the file of the serial port.
            speed: how many times faster than in the paper.
        """
        pace = ("--speed", str(speed))
        where: tuple[str, ...]
        match self.kind:
            case Kind.PLC:
                where = ("--host", host, "--port", place, "--stay")
                return ["-m", "ua_demo.simulators.modbus", *where, "--program", self.program, *self.options]
            case Kind.UR:
                return ["-m", "ua_demo.simulators.ur", "--host", host, "--model", self.program, *self.options]
            case Kind.TCP:
                where = ("--host", host, "--port", place)
            case Kind.PLUGGED:
                where = ("--device", place)
            case Kind.ROS1 | Kind.ROS2:
                where = ("--space", str(space)) if self.takes_space else ()
        return [str(ROBOTS / self.program), *where, *pace, *self.options]


def _pioneer(number: int, go_id: int, x_m: float, y_m: float, battery: float) -> Actor:
    name = f"pioneer_{number}"
    place = ("--at", str(x_m), str(y_m), "--battery", str(battery))
    return Actor(name, Kind.ROS2, "pioneer.py", ("--name", name, "--go-id", str(go_id), *place), takes_space=True)


ACTORS: Final = (
    Actor("ridgeback", Kind.ROS1, "ridgeback.py", takes_space=True),
    Actor("ur3", Kind.UR, "ur3e"),
    _pioneer(1, 1210, 7.0, 3.0, 71.0),
    _pioneer(2, 1310, 2.0, 4.0, 88.0),
    Actor("drone", Kind.TCP, "drone.py"),
    Actor("conveyor", Kind.PLC, "conveyor"),
    Actor("temperature_sensor", Kind.PLUGGED, "sensor.py"),
)
DOMAINS: Final = sum(actor.kind.is_ros for actor in ACTORS)
"""ROS 2 domains that are needed where there is no ROS 1."""


@dataclass(frozen=True, slots=True)
class Setting:
    """See the module."""

    site: Site
    speed: float
    mode: Mode
    spaces: dict[str, int]
    """Of each actor."""
    places: dict[str, str]
    """Where each actor is found that does not speak ROS: a TCP port, an address, or the file of a serial port."""
    is_carried: bool = False
    """Whether bridges carry the run."""

    @property
    def has_ros1(self) -> bool:
        """Whether a robot runs in ROS 1."""
        return 1 in self.spaces.values()

    def bridge_ros(self, actor: Actor) -> int:
        """In the interpreter for which ROS an actor's bridge runs: 1 or 2; for one that needs none it is 2."""
        return 1 if self.spaces[actor.name] == 1 else 2

    def command(self, actor: Actor) -> list[str | Path]:
        """What simulates an actor."""
        place = self.places.get(actor.name, "")
        host = place if actor.kind is Kind.UR else _LOOPBACK
        python = self.site.python(self.bridge_ros(actor))
        return [python, *actor.arguments(space=self.spaces[actor.name], host=host, place=place, speed=self.speed)]

    def environment(self, actor: Actor) -> dict[str, str]:
        """The environment of what simulates an actor."""
        space = self.spaces[actor.name]
        return self.site.environment(space if space != 1 and actor.kind.is_ros else None)


PATIENCE_S: Final = 600.0
"""How long an operator may think who is there to look at everything."""


def make_setting(
    site: Site,
    *,
    domains: Sequence[int],
    speed: float,
    mode: Mode,
    limit_s: float = PATIENCE_S,
    is_carried: bool = False,
    say: Callable[[str], None],
) -> Setting:
    """Write `fleet.yaml` and the scenario, and say what differs from what a reader expects.

    The server would go on with a run that was ended in the middle: what an earlier demonstration has left of runs and
    commands in this folder is removed. Certificates and used nonces stay.

    Args:
        site: where the run takes place.
        domains: DOMAINS ROS 2 domains.
        speed: how many times faster than in the paper.
        mode: who chooses a replacement.
        limit_s: how long an operator may take for it; then the best candidate takes over.
        is_carried: whether bridges carry the run.
        say: prints a line for people.
    """
    free, vendor = iter(domains), count(_FIRST_VENDOR_SPACE)
    spaces = {actor.name: next(free if actor.kind.is_ros else vendor) for actor in ACTORS}
    places = {actor.name: _place(actor, site, domains[0]) for actor in ACTORS if not actor.kind.is_ros}
    if site.ros1_python is not None:
        spaces |= {actor.name: 1 for actor in ACTORS if actor.kind is Kind.ROS1}
    else:
        say(f"without ROS 1, {site.why_without_ros1}: Ridgeback runs in ROS 2 domain {spaces['ridgeback']}")
    setting = Setting(site, speed, mode, spaces, places, is_carried)
    hosts = {actor.name: places[actor.name] if actor.kind is Kind.UR else _LOOPBACK for actor in ACTORS}
    layout = site.layout("talkrobots")
    site.write_config(
        fleet_text(layout, spaces, hosts, places, speed=speed, mode=mode, limit_s=limit_s, is_carried=is_carried)
    )
    _forget_runs(site.folder / "state")
    scenarios = site.folder / "scenarios"
    scenarios.mkdir(exist_ok=True)
    (scenarios / f"{SCENARIO}.yaml").write_text(scenario_text(), encoding="utf-8")
    return setting


def fleet_text(
    layout: Layout,
    spaces: Mapping[str, int],
    hosts: Mapping[str, str],
    places: Mapping[str, str],
    *,
    speed: float,
    mode: Mode,
    limit_s: float,
    is_carried: bool = False,
) -> str:
    """The `fleet.yaml`.

    Args:
        layout: where its processes run.
        spaces: of each actor.
        hosts: where each actor is reached whose bridge connects to it.
        places: of each actor that does not speak ROS, its TCP port or the file of its serial port.
        speed: how many times faster than in the paper.
        mode: who chooses a replacement.
        limit_s: how long an operator may take for it.
        is_carried: whether bridges carry the run.
    """
    is_ros1 = spaces["ridgeback"] == 1
    master = f'kind: ros1, space: 1, master_uri: "{layout.master_uri}", host_ip: {layout.ros1_host_ip}'
    domain = f"kind: ros2, space: {spaces['ridgeback']}, discovery: {layout.ros2_discovery}"
    template = Template(_package_text("fleet.template.yaml"))
    return template.substitute(
        layout.words(),
        **{f"{name}_space": space for name, space in spaces.items()},
        **{f"{name}_host": host for name, host in hosts.items()},
        # A path may have any characters; a quoted word of JSON is one of YAML too.
        **{f"{name}_place": json.dumps(place) if "/" in place else place for name, place in places.items()},
        ridgeback_bridge=master if is_ros1 else domain,
        ridgeback_go=_MOVE_BASE if is_ros1 else _OWN_PROGRAM,
        belt_mm_s=round(BELT_MM_S * speed),
        arm_move_s=round(_ARM_MOVE_S / speed, 3),
        gripper_s=round(_GRIPPER_S / speed, 3),
        timeout_s=TIMEOUT_S / min(speed, 1.0),
        mode=mode,
        limit_s=limit_s,
        # Carried: each bridge may hand each other one a token, or ask for its robot in place of one that has failed.
        requestors=[0, *sorted(set(spaces.values()))] if is_carried else [0],
    )


def scenario_text() -> str:
    """The scenario's file."""
    return _package_text(f"{SCENARIO}.yaml")


def _package_text(name: str) -> str:
    return files("ua_demo.talkrobots").joinpath(name).read_text(encoding="utf-8")


def _place(actor: Actor, site: Site, domain: int) -> str:
    if actor.kind is Kind.UR:
        # Nothing listens there yet: a demonstration that starts now must not choose the same. No other has this domain.
        return free_loopback_address(_UR_PORTS, domain)
    if actor.kind is Kind.PLUGGED:
        return str(site.folder.absolute() / actor.name)
    return str(free_tcp_port(0))


def _forget_runs(state: Path) -> None:
    for journal in state.rglob("*.db*"):
        if journal.is_file():
            journal.unlink()
