"""The diagrams of the documentation, drawn from what they show: `python scripts/diagrams.py docs/assets`.

Each is one SVG for both themes: a picture follows the colour scheme of the page that it stands in. Clients are above
and robots below: data go up, commands go down. They are narrow, so that they can be read on a telephone.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.sax.saxutils import escape

__all__ = ["DIAGRAMS", "Band", "Box", "Diagram", "Link", "draw", "text_width"]

WIDTH: Final = 480
MARGIN: Final = 12
GAP: Final = 10
TITLE: Final = 14
SMALL: Final = 12
LINE: Final = 16

_STYLE: Final = """
svg { --ground: #ffffff; --box: #eef2f7; --edge: #51606f; --ink: #1c2733; --faint: #51606f;
      --data: #1565c0; --command: #b23c17; }
@media (prefers-color-scheme: dark) {
  svg { --ground: #1e2129; --box: #2b3240; --edge: #8796a8; --ink: #e6e9ef; --faint: #aab4c2;
        --data: #7fb4f5; --command: #f39b78; }
}
text { font-family: system-ui, sans-serif; fill: var(--ink); }
.title { font-size: 14px; font-weight: 600; }
.small { font-size: 12px; }
.place { font-size: 12px; fill: var(--faint); }
.ground { fill: var(--ground); }
.box { fill: var(--box); stroke: var(--edge); }
.band { fill: none; stroke: var(--edge); stroke-dasharray: 6 4; }
.data { stroke: var(--data); fill: var(--data); }
.command { stroke: var(--command); fill: var(--command); }
line { stroke-width: 2; }
text.data, text.command { stroke: none; font-size: 12px; }
"""


@dataclass(frozen=True)
class Box:
    """A thing, with what there is to say of it, a line each."""

    title: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Band:
    """A process or a machine, and what runs in it, side by side."""

    place: str
    boxes: tuple[Box, ...]
    columns: int = 0
    """In one row, unless it says how many stand in one."""


@dataclass(frozen=True)
class Link:
    """What goes between two bands: data up, commands down. Without a line there is no such arrow."""

    data: tuple[str, ...]
    commands: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagram:
    """A picture: bands from top to bottom with a link between each two."""

    title: str
    parts: tuple[Band | Link, ...]


def text_width(text: str, size: int) -> float:
    """About how wide a text is, on the safe side: the fonts of the readers differ."""
    return len(text) * size * 0.56


def _text(x: float, y: float, text: str, kind: str, anchor: str = "middle") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" class="{kind}">{escape(text)}</text>'


def _box_height(box: Box) -> int:
    return 26 + LINE * len(box.lines)


def _draw_box(box: Box, x: float, y: float, width: float, height: float) -> Iterator[str]:
    yield f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" class="box"/>'
    middle, top = x + width / 2, y + (height - _box_height(box)) / 2
    yield _text(middle, top + 18, box.title, "title")
    for number, line in enumerate(box.lines, 1):
        yield _text(middle, top + 18 + LINE * number, line, "small")


def columns_of(band: Band) -> int:
    """How many boxes stand in a row of it."""
    return band.columns or len(band.boxes)


def box_width(band: Band) -> float:
    """How wide each of its boxes is."""
    columns = columns_of(band)
    return (WIDTH - 4 * MARGIN - GAP * (columns - 1)) / columns


def _draw_band(band: Band, y: float) -> tuple[list[str], float]:
    columns, width = columns_of(band), box_width(band)
    drawn: list[str] = []
    at = y + 26
    for first in range(0, len(band.boxes), columns):
        row = band.boxes[first : first + columns]
        height = max(map(_box_height, row))
        for number, box in enumerate(row):
            drawn += _draw_box(box, 2 * MARGIN + number * (width + GAP), at, width, height)
        at += height + GAP
    height = at - GAP + MARGIN - y
    outline = f'<rect x="{MARGIN}" y="{y:g}" width="{WIDTH - 2 * MARGIN}" height="{height:g}" rx="10" class="band"/>'
    return [outline, _text(2 * MARGIN, y + 18, band.place, "place", "start"), *drawn], y + height


def _draw_link(link: Link, y: float) -> tuple[list[str], float]:
    most = max(len(link.data), len(link.commands))
    height = max(34, 16 + LINE * most)
    drawn: list[str] = []
    both = bool(link.data and link.commands)
    for kind, lines, x in (("data", link.data, 36), ("command", link.commands, WIDTH / 2 + 12 if both else 36)):
        if not lines:
            continue
        begin, end = (y + height - 2, y + 8) if kind == "data" else (y + 2, y + height - 8)
        ends = f'x1="{x:g}" y1="{begin:g}" x2="{x:g}" y2="{end:g}"'
        drawn.append(f'<line {ends} class="{kind}" marker-end="url(#{kind})"/>')
        top = y + (height - LINE * len(lines)) / 2 + 12
        drawn += [_text(x + 12, top + LINE * number, line, kind, "start") for number, line in enumerate(lines)]
    return drawn, y + height


def _marker(kind: str) -> str:
    return (
        f'<marker id="{kind}" viewBox="0 0 8 8" refX="4" refY="4" markerWidth="8" markerHeight="8" '
        f'markerUnits="userSpaceOnUse" orient="auto"><path d="M0,0 8,4 0,8z" class="{kind}" stroke="none"/></marker>'
    )


def draw(diagram: Diagram) -> str:
    """A diagram as SVG."""
    drawn: list[str] = []
    y: float = MARGIN
    for part in diagram.parts:
        more, y = _draw_band(part, y) if isinstance(part, Band) else _draw_link(part, y)
        drawn += more
    height = y + MARGIN
    size = f'width="{WIDTH}" height="{height:g}" viewBox="0 0 {WIDTH} {height:g}"'
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">',
            f"<title>{escape(diagram.title)}</title>",
            f"<style>{_STYLE}</style>",
            f"<defs>{_marker('data')}{_marker('command')}</defs>",
            f'<rect width="{WIDTH}" height="{height:g}" rx="10" class="ground"/>',
            *drawn,
            "</svg>\n",
        )
    )


_CLIENTS: Final = Band("OPC UA clients", (Box("UaExpert"), Box("PLC, MES"), Box("web console")))
_SERVICES: Final = Link(("values, events, alarms",), ("writes, Methods",))
_SERVER: Final = Band("ua-fleet serve: one process", (Box("OPC UA server", ("nodes, scenarios, who takes over",)),))
_PUBSUB: Final = Link(
    ("OPC UA PubSub, UADP over", "UDP or MQTT: DataSets,", "each second a keep-alive"),
    ("PubSub Actions; the state", "comes back as DataSet", "SkillStatus"),
)


def _bridge(kind: str, bridge: Band, link: Link, *robot: Band | Link) -> Diagram:
    title = f"What runs where with a bridge of kind {kind}: data go up from the robot, commands go down to it"
    return Diagram(title, (_CLIENTS, _SERVICES, _SERVER, _PUBSUB, bridge, link, *robot))


_CORE: Final = ("loop rule, checks, journal",)

DIAGRAMS: Final = {
    "system": Diagram(
        "The system: OPC UA clients above, one server, and below it a bridge for each space in which robots live",
        (
            Band("OPC UA clients", (Box("UaExpert"), Box("PLC, MES"), Box("console"), Box("ua-fleet")), columns=4),
            Link(("values, events, alarms",), ("writes, Methods",)),
            Band(
                "one server",
                (
                    Box("nodes", ("each robot,", "each value")),
                    Box("scenarios", ("skills of several", "robots")),
                    Box("resilience", ("who takes over", "from a failed one")),
                ),
            ),
            Link(("OPC UA PubSub: DataSets",), ("OPC UA PubSub: Actions",)),
            Band(
                "a bridge for each space, a process each",
                (
                    Box("ros1", ("rospy, roscpp", "nodes")),
                    Box("ros2", ("rclpy, rclcpp", "nodes")),
                    Box("modbus", ("PLCs and", "devices")),
                    Box("ur", ("Universal Robots", "arms")),
                    Box("tcp", ("controllers on", "a plain socket")),
                    Box("plugged", ("serial ports,", "D-Bus, sensors")),
                ),
                columns=3,
            ),
        ),
    ),
    "carried-run": Diagram(
        "A carried run: the server gives each bridge its part; then a token goes down from bridge to bridge",
        (
            Band(
                "the server: needed for the start", (Box("plan", ("segments: what one bridge does without another",)),)
            ),
            Link(
                ("what has happened, when", "it is there to ask"), ("its part to each bridge,", "a token to the first")
            ),
            Band("bridge of Ridgeback", (Box("fetch", ("journal, engine, robot: all in one process",)),)),
            Link((), ("token: said until", "it is acknowledged")),
            Band("bridge of UR3", (Box("grasp"),)),
            Link((), ("a token for each branch",)),
            Band("side by side", (Box("take_off", ("bridge of the drone",)), Box("pick", ("bridge of UR3",)))),
            Link((), ("both tokens: the join", "has one named bridge")),
            Band(
                "bridge of Ridgeback, whose drive has failed",
                (Box("bring", ("it ranks the substitutes, and asks the best", "robot by the bridge of that")),),
            ),
            Link((), ("the end, to each bridge",)),
            Band("all bridges of the run", (Box("the robots are free", ("the facts stay for the server",)),)),
        ),
    ),
    "bridge-ros1": _bridge(
        "ros1",
        Band(
            "ua-fleet bridge, in .venv-ros1: any machine with rospy", (Box("ROS 1 bridge: a node of the graph", _CORE),)
        ),
        Link(("TCPROS: topics ua_1_*,", "and mapped ones"), ("TCPROS: topics of other", "spaces, services, actionlib")),
        Band("ROS 1 graph: space 1", (Box("ROS master"), Box("rospy node"), Box("roscpp node"))),
    ),
    "bridge-ros2": _bridge(
        "ros2",
        Band(
            "ua-fleet bridge, in .venv: any machine in the domain", (Box("ROS 2 bridge: a node of the graph", _CORE),)
        ),
        Link(("DDS: topics ua_<domain>_*,", "and mapped ones"), ("DDS: topics of other", "spaces, services, actions")),
        Band(
            "ROS 2 domain 2 to 232: the space of that id", (Box("rclpy node"), Box("rclcpp node"), Box("action server"))
        ),
    ),
    "bridge-modbus": _bridge(
        "modbus",
        Band("ua-fleet bridge: any machine that reaches the devices", (Box("Modbus client", _CORE),)),
        Link(
            ("reads registers and inputs,", "each poll_s or period_s"),
            ("writes arguments, then", "a sequence word"),
        ),
        Band(
            "devices: together one vendor space",
            (Box("PLC", ("TCP 502, TLS 802",)), Box("drive, sensor", ("RTU: serial line",))),
        ),
    ),
    "bridge-ur": _bridge(
        "ur",
        Band("ua-fleet bridge: x86-64 Linux that reaches the controller", (Box("ur-rtde", _CORE),)),
        Link(
            ("RTDE, port 30004: joints,", "modes, inputs, to 500 Hz"),
            ("moves, URScript: 30001 to", "30004; dashboard: 29999"),
        ),
        Band(
            "the robot: one vendor space",
            (Box("UR controller", ("remote control switched on",)), Box("arm", ("and its inputs, outputs",))),
        ),
    ),
    "bridge-tcp": _bridge(
        "tcp",
        Band("ua-fleet bridge: any machine that reaches the controller", (Box("TCP bridge", _CORE),)),
        Link(
            ("the program tells states", "and values, field by field"),
            ("skills: fields (interpreter),", "or as lines (direct)"),
        ),
        Band(
            "the robot: one vendor space",
            (
                Box("your program", ("about 100 lines, in", "the robot's language")),
                Box("command port", ("the controller's own,", "nothing to write")),
            ),
        ),
    ),
    "bridge-plugged": _bridge(
        "plugged",
        Band(
            "ua-fleet bridge: on the robot's own computer, Linux",
            (Box("plugged bridge", ("udev tells what comes and goes", *_CORE)),),
        ),
        Link(("lines, values of files,", "signals of the D-Bus"), ("lines to the device,", "methods of the D-Bus")),
        Band(
            "plugged in: one vendor space",
            (Box("serial port"), Box("sensor of the kernel"), Box("camera: its URL"), Box("program on the D-Bus")),
            columns=2,
        ),
    ),
}


def main(arguments: Sequence[str]) -> None:
    """Write all diagrams into a folder."""
    (folder,) = arguments
    for name, diagram in DIAGRAMS.items():
        (Path(folder) / f"{name}.svg").write_text(draw(diagram), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
