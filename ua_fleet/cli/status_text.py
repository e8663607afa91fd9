"""How a fleet stands, on one screen; and what of it is wrong. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta, tzinfo
from typing import TYPE_CHECKING, Any, Final, cast

from ua_fleet.cli.table import Cell, Colour, painted, table_lines, within
from ua_fleet.cli.value_text import ValueStyle, age_text, clock_text, value_text
from ua_fleet.drop_meanings import drop_meanings, is_loss

if TYPE_CHECKING:
    from ua_fleet.client.status import FaultStatus, FleetStatus, NamespaceStatus, RobotStatus

__all__ = ["StatusProblem", "problems_of", "status_json", "status_lines"]

MOST_ROBOTS: Final = 40
"""Robots that are listed when all is well with them; of a larger fleet only the others are."""
EXPIRES_SOON: Final = timedelta(days=30)
_SILENT: Final = "silent"
_WELL: Final = ("idle", "busy")
_INDENT: Final = "  "


@dataclass(frozen=True, slots=True)
class StatusProblem:
    """Something that is wrong."""

    text: str
    remedy: str
    """The command to try next; empty where none helps."""


def problems_of(status: FleetStatus, now: datetime) -> list[StatusProblem]:
    """All that is wrong now: what `status` ends with 1 for."""
    found: list[StatusProblem] = []
    server = status.server
    if server.state != "Running":
        found.append(StatusProblem(f"the server is {server.state}", ""))
    if server.certificate_until is not None and server.certificate_until - now < EXPIRES_SOON:
        has = "has expired" if server.certificate_until <= now else "expires"
        found.append(
            StatusProblem(
                f"the server's certificate {has} on {server.certificate_until:%Y-%m-%d}", "ua-fleet cert create --help"
            )
        )
    for bridge in status.bridges:
        if not bridge.online:
            found.append(StatusProblem(f"bridge {bridge.name} is not heard", f"ua-fleet bridge {bridge.name}"))
        elif bridge.connected is False:
            found.append(StatusProblem(f"bridge {bridge.name} is not connected: {bridge.detail}", ""))
    if status.namespace is not None and not status.namespace.connected:
        found.append(StatusProblem(f"the Unified Namespace is not published: {status.namespace.detail}", ""))
    active = [fault for fault in status.faults if fault.active]
    found += [StatusProblem(f"{fault.fault_id}: {fault.reason}", _remedy(fault)) for fault in active]
    told = {fault.robot for fault in active}
    found += [
        StatusProblem(f"{robot.name} is {robot.state}", f"ua-fleet read {robot.name}")
        for robot in status.robots
        if robot.state not in _WELL and robot.name not in told
    ]
    found += [
        StatusProblem(
            f"{one.task} waits for a robot: {one.reason}", f"ua-fleet decision confirm {one.decision_id} ROBOT"
        )
        for one in status.decisions
    ]
    return found


def _remedy(fault: FaultStatus) -> str:
    """The command that ends a fault, where a person can."""
    if not fault.active:
        return f"ua-fleet fault ack {fault.fault_id}"
    if fault.source in ("skill", "robot", "not_halted"):
        return f"ua-fleet fault clear {fault.fault_id}"
    return ""


def status_json(status: FleetStatus, problems: Sequence[StatusProblem]) -> dict[str, Any]:
    """The same as JSON can hold it: times in UTC, and what is no finite number as text, as `read` has it."""

    def plain(value: Any) -> Any:
        if isinstance(value, datetime):
            return value.astimezone(UTC).isoformat()
        if isinstance(value, float) and not math.isfinite(value):
            return str(value)
        if isinstance(value, Mapping):
            members = cast("Mapping[str, Any]", value)
            return {name: plain(each) for name, each in members.items()}
        if isinstance(value, list | tuple):
            return [plain(each) for each in cast("Sequence[Any]", value)]
        return value

    shown: dict[str, Any] = plain(asdict(status))
    return shown | {"problems": [asdict(one) for one in problems]}


def status_lines(
    status: FleetStatus,
    now: datetime,
    *,
    width: int | None = None,
    colours: bool = False,
    zone: tzinfo | None = None,
    all_robots: bool = False,
) -> list[str]:
    """The screen.

    Args:
        status: what was read.
        now: the time of day.
        width: cells that a line may take; None is any number.
        colours: whether there are colours.
        zone: for times; None is the local one.
        all_robots: whether all robots of a large fleet are listed.
    """
    problems = problems_of(status, now)

    def head(name: str, text: str) -> str:
        cut = text if width is None else within(text, max(1, width - len(name) - 2))
        return painted(name, Colour.HEAD, colours=colours) + "  " + painted(cut, None, colours=colours)

    def table(rows: Sequence[Sequence[Cell | str]]) -> list[str]:
        if len(rows) < 2:
            return []
        heading = [Cell(str(one), Colour.FAINT) for one in rows[0]]
        return table_lines([heading, *rows[1:]], width=width, colours=colours, indent=_INDENT)

    def time(moment: datetime | None) -> str:
        return clock_text(moment, now, zone).partition(".")[0]

    heard = sum(bridge.online for bridge in status.bridges)
    lines = [head(name, one) for name, one in zip(("server", " " * 6), _server(status, now, width), strict=False)]
    lines += [*_verdict(problems, width=width, colours=colours), ""]
    lines += [head("bridges", f"{heard} of {len(status.bridges)} heard")]
    lines += table(
        [
            ("bridge", "kind", "space", "", "since", "detail"),
            *(
                (
                    bridge.name,
                    bridge.kind,
                    "" if bridge.space is None else str(bridge.space),
                    *(_bridge(bridge.online, bridge.connected)),
                    time(bridge.since),
                    bridge.detail if bridge.online else "",
                )
                for bridge in status.bridges
            ),
        ]
    )
    if status.namespace is not None:
        lines += ["", head("Unified Namespace", _namespace(status.namespace))]
    lines += ["", head("robots", _robots(status.robots))]
    listed = list(status.robots)
    if len(listed) > MOST_ROBOTS and not all_robots:
        listed = [robot for robot in listed if robot.state != "idle" or robot.held_by][:MOST_ROBOTS]
    lines += table(
        [
            ("robot", "state", "since", "values", "battery", "does"),
            *(_robot(robot, time(robot.since)) for robot in listed),
        ]
    )
    if len(listed) < len(status.robots):
        others = len(status.robots) - len(listed)
        lines.append(painted(f"{_INDENT}{others:,} more robots; --all lists them", Colour.FAINT, colours=colours))
    lines += ["", head("faults", _faults(status.faults))]
    lines += table(
        [
            ("fault", "", "since", "reason", "next command"),
            *(
                (
                    fault.fault_id,
                    Cell("active", Colour.BAD) if fault.active else Cell("over", Colour.WARNING),
                    time(fault.since),
                    fault.reason,
                    _remedy(fault),
                )
                for fault in status.faults
            ),
        ]
    )
    lines += ["", head("runs", f"{len(status.runs)} under way")]
    for run in status.runs:
        reason = f"  {run.reason}" if run.reason else ""
        text = f"{_INDENT}{run.run_id}  {run.scenario}  {run.state} since {time(run.started)}{reason}"
        lines.append(painted(text if width is None else within(text, width), None, colours=colours))
        lines += table_lines(
            [(task, robot, state) for task, robot, state in run.tasks if state not in ("done", "failed")],
            width=width,
            colours=colours,
            indent=2 * _INDENT,
        )
    lines += ["", head("drops", "messages dropped since each process started")]
    places = [("server", status.drops), *((bridge.name, bridge.drops) for bridge in status.bridges)]
    if status.namespace is not None:
        places.append(("Unified Namespace", status.namespace.drops))
    total = Counter[str]()
    for _, drops in places:
        total.update(drops)
    lost = [cause for cause, _ in total.most_common() if is_loss(cause)]
    where = {cause: ", ".join(f"{at} {drops[cause]:,}" for at, drops in places if cause in drops) for cause in lost}
    lines += table(
        [
            ("cause", "messages", "meaning", "where"),
            *(
                (Cell(cause, Colour.WARNING), f"{total[cause]:,}", drop_meanings().get(cause, ""), where[cause])
                for cause in lost
            ),
        ]
    )
    normal = ", ".join(f"{cause} {count:,}" for cause, count in total.most_common() if not is_loss(cause))
    if normal:
        lines.append(painted(f"{_INDENT}as it should be: {normal}", Colour.FAINT, colours=colours))
    return lines


def _server(status: FleetStatus, now: datetime, width: int | None) -> list[str]:
    """What is said of the server: one text, or a second one for what the first has no room for."""
    server = status.server
    parts = [server.name, server.endpoint, f"ua_fleet {server.version}", server.state]
    if server.started is not None:
        parts[-1] += f" for {age_text(server.started, server.now or now)}"
    if server.certificate_until is not None:
        parts.append(f"certificate until {server.certificate_until:%Y-%m-%d}")
    line = "  ".join(parts)
    if width is None or len(line) + len("server  ") <= width:
        return [line]
    return ["  ".join(parts[:2]), "  ".join(parts[2:])]


def _bridge(online: bool, connected: bool | None) -> tuple[Cell]:
    if not online:
        return (Cell("not heard", Colour.BAD),)
    if connected is False:
        return (Cell("not connected", Colour.BAD),)
    return (Cell("connected" if connected else "heard", Colour.GOOD),)


def _namespace(namespace: NamespaceStatus) -> str:
    text = f"{namespace.topics:,} topics, {namespace.published:,} messages published"
    return f"{namespace.detail}  {text}" if namespace.connected else f"not connected  {text}"


def _robots(robots: Sequence[RobotStatus]) -> str:
    counts = Counter(robot.state for robot in robots)
    told = ", ".join(f"{count:,} {state}" for state, count in counts.most_common())
    return f"{len(robots):,}: {told}" if robots else "none"


def _robot(robot: RobotStatus, since: str) -> tuple[Cell | str, ...]:
    colour = {"idle": None, "busy": Colour.GOOD}.get(robot.state, Colour.BAD)
    battery = "" if robot.battery is None else value_text(robot.battery, "Float", ValueStyle(robot.battery_unit))
    does = [*robot.tasks, *([f"held by {robot.held_by}"] if robot.held_by else [])]
    return (robot.name, Cell(robot.state, colour), since, _quality(robot), battery, ", ".join(does))


def _quality(robot: RobotStatus) -> Cell:
    if robot.values is None:
        return _worst(robot.quality)
    total = sum(robot.values.values())
    others = Counter({name: count for name, count in robot.values.items() if not name.startswith("Good")})
    if not total:
        return Cell("none came", Colour.FAINT)
    if not others:
        return Cell(f"{total} Good")
    ((name, _),) = others.most_common(1)
    is_bad = any(one.startswith("Bad") for one in others)
    return Cell(f"{others.total()} of {total} {name}", Colour.BAD if is_bad else Colour.WARNING)


def _worst(quality: str) -> Cell:
    """What is known of the quality of a robot whose values were not read."""
    if not quality:
        return Cell("not read", Colour.FAINT)
    if quality == "BadWaitingForInitialData":
        return Cell("none came", Colour.FAINT)
    if quality.startswith("Good"):
        return Cell(quality)
    return Cell(quality, Colour.BAD if quality.startswith("Bad") else Colour.WARNING)


def _faults(faults: Sequence[FaultStatus]) -> str:
    active = sum(fault.active for fault in faults)
    over = len(faults) - active
    return f"{active} active" + (f", {over} over and not acknowledged" if over else "")


def _verdict(problems: Sequence[StatusProblem], *, width: int | None, colours: bool) -> list[str]:
    if not problems:
        return [painted("nothing is wrong", Colour.GOOD, colours=colours)]
    lines = [painted(f"{len(problems)} wrong", Colour.BAD, colours=colours)]
    shown = problems[:MOST_ROBOTS]
    lines += table_lines([(one.text, one.remedy) for one in shown], width=width, colours=colours, indent=_INDENT)
    if len(shown) < len(problems):
        lines.append(f"{_INDENT}{len(problems) - len(shown):,} more; --json has all")
    return lines
