# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""How a fleet stands: its server, bridges, robots, faults, runs and drops, read in few requests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, ClassVar, Final

from asyncua import ua
from cryptography import x509

from ua_fleet.client.browsing import variables_below
from ua_fleet.client.convert import plain_value
from ua_fleet.client.skill_nodes import read_skills, skill_nodes
from ua_fleet.client.summaries import RobotSummary
from ua_fleet.client.translated import NodeNotFound, translated

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = [
    "CHARGES",
    "BridgeNodes",
    "BridgeStatus",
    "FaultStatus",
    "FleetStatus",
    "NamespaceStatus",
    "OpenDecision",
    "RobotStatus",
    "RunStatus",
    "ServerStatus",
    "bridge_nodes",
    "fleet_status",
    "server_status",
]

MOST_LOOKED_AT: Final = 500
"""Robots of a fleet of which all nodes are read. 5,000 with 30 values each would take some ten seconds."""
MOST_NOT_WELL: Final = 40
"""Robots of a larger fleet, which its summaries are read of, whose values are read too."""
_STATES: Final = ("offline", "idle", "busy", "faulted")
"""RobotStateEnumeration of the UaFleet nodeset."""
_OVER: Final = ("done", "failed", "aborted")
_TASK_OVER: Final = ("done", "failed")
CHARGES: Final = ("battery", "percentage", "charge", "level", "soc", "state_of_charge")
"""Fields of a data source `battery` that say how full it is."""
_OBJECTS: Final = int(ua.NodeClass.Object)
_WAITING: Final = ua.StatusCodes.BadWaitingForInitialData


@dataclass(frozen=True, slots=True)
class ServerStatus:
    """The server."""

    endpoint: str
    name: str
    """Of the fleet."""
    version: str
    state: str
    """ServerState of OPC 10000-5, e.g. `Running`."""
    started: datetime | None
    now: datetime | None
    """The time by its clock."""
    certificate_until: datetime | None
    """When the certificate that it shows expires; None where the connection has none."""


@dataclass(frozen=True, slots=True)
class BridgeStatus:
    """A bridge."""

    name: str
    kind: str
    space: int | None
    online: bool
    """Whether the server hears it."""
    since: datetime | None
    """Since when that is so."""
    connected: bool | None
    """Whether it is connected to its space, as it said last."""
    detail: str
    drops: Mapping[str, int]
    """By cause, those that are not 0."""


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """A robot."""

    name: str
    state: str
    """`offline`, `idle`, `busy` or `faulted`."""
    since: datetime | None
    values: Mapping[str, int] | None
    """How many values have which StatusCode, without those that have never come; None where nobody has looked."""
    battery: float | None = None
    battery_unit: str = ""
    tasks: tuple[str, ...] = ()
    """What it does: `task of RUN`, or the name of a skill."""
    held_by: str = ""
    """Who holds it back from tasks; empty: nobody."""
    quality: str = ""
    """Of a robot whose values nobody has looked at: the worst StatusCode of them, by its name."""


@dataclass(frozen=True, slots=True)
class FaultStatus:
    """A fault that is active, or that nobody has acknowledged."""

    fault_id: str
    robot: str
    source: str
    reason: str
    active: bool
    acknowledged: bool
    since: datetime | None


@dataclass(frozen=True, slots=True)
class RunStatus:
    """A run that is under way."""

    run_id: str
    scenario: str
    state: str
    started: datetime | None
    reason: str
    tasks: tuple[tuple[str, str, str], ...]
    """Task, robot and state of each task whose turn has come."""


@dataclass(frozen=True, slots=True)
class NamespaceStatus:
    """The Unified Namespace."""

    connected: bool
    """Whether its broker is."""
    detail: str
    """The broker, or why it is not connected."""
    topics: int
    published: int
    """Messages that the broker has acknowledged."""
    drops: Mapping[str, int]
    """By cause, those that are not 0."""


@dataclass(frozen=True, slots=True)
class OpenDecision:
    """A decision that waits for a person."""

    decision_id: str
    task: str
    failed: str
    reason: str


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """All of it."""

    server: ServerStatus
    bridges: tuple[BridgeStatus, ...]
    robots: tuple[RobotStatus, ...]
    faults: tuple[FaultStatus, ...]
    runs: tuple[RunStatus, ...]
    decisions: tuple[OpenDecision, ...]
    drops: Mapping[str, int] = field(default_factory=dict[str, int])
    """Of the server, by cause, those that are not 0."""
    namespace: NamespaceStatus | None = None
    """None where there is none."""


class _Values:
    """Values that were read together, by NodeId."""

    def __init__(self, told: Mapping[str, ua.DataValue]) -> None:
        self._told = told

    def value(self, node_id: str) -> Any:
        """The value, None where there is none."""
        data = self._told.get(node_id)
        return None if data is None or data.Value is None else plain_value(data.Value.Value)

    def is_good(self, node_id: str) -> bool:
        """Whether it is one of now."""
        data = self._told.get(node_id)
        return data is not None and (data.StatusCode is None or data.StatusCode.is_good())

    def source_time(self, node_id: str) -> datetime | None:
        """When it was so."""
        data = self._told.get(node_id)
        return None if data is None else _moment(data.SourceTimestamp)


async def fleet_status(client: FleetClient, *, all_values: bool = False) -> FleetStatus:
    """How the fleet stands now.

    Args:
        client: a connected client.
        all_values: whether the values of all robots are looked at, however many there are; else, of a fleet of more
            than 500 robots, those of 40 robots that are busy, held or not well. How the others stand was so a second
            ago at most.

    Raises:
        NotConnected: the connection was lost.
        SendTimeout: the server did not answer in time.
    """
    with translated(client.endpoint):
        runs = await _runs(client)
        return FleetStatus(
            await _server(client),
            await _bridges(client),
            await _robots(client, runs, all_values=all_values),
            await _faults(client),
            runs,
            await _decisions(client),
            await _drops(client, "ns=2;s=Fleet.Traffic.Drops"),
            await _namespace(client),
        )


async def server_status(client: FleetClient) -> ServerStatus:
    """The server alone; raises as `fleet_status`."""
    with translated(client.endpoint):
        return await _server(client)


@dataclass(frozen=True, slots=True)
class BridgeNodes:
    """NodeIds of the Variables of a bridge, by their names; or, as `SERVER`, those of the server's own traffic."""

    SERVER: ClassVar[str] = ""

    name: str
    members: Mapping[str, str]
    drops: Mapping[str, str]


async def bridge_nodes(client: FleetClient) -> list[BridgeNodes]:
    """Where all bridges say how they are, and the server what its traffic is; raises as `fleet_status`."""
    with translated(client.endpoint):
        (bridges,) = await client.batches.browse([ua.NodeId.from_string("ns=2;s=Fleet.Bridges")], classes=_OBJECTS)
        owners = [(str(one.BrowseName.Name), one.NodeId) for one in bridges]
        owners.append((BridgeNodes.SERVER, ua.NodeId.from_string("ns=2;s=Fleet.Traffic")))
        children = await client.batches.browse([node for _, node in owners])
        folders = [next((one.NodeId for one in below if one.BrowseName.Name == "Drops"), None) for below in children]
        causes = iter(await client.batches.browse([node for node in folders if node is not None]))
        return [
            BridgeNodes(
                name,
                _variables(below),
                _variables(next(causes)) if folder is not None else {},
            )
            for (name, _), below, folder in zip(owners, children, folders, strict=True)
        ]


def _variables(children: Sequence[ua.ReferenceDescription]) -> dict[str, str]:
    return {
        str(child.BrowseName.Name): child.NodeId.to_string()
        for child in children
        if child.NodeClass is ua.NodeClass.Variable
    }


async def _read(client: FleetClient, node_ids: Sequence[str]) -> _Values:
    told = await client.batches.read([ua.NodeId.from_string(one) for one in node_ids])
    return _Values(dict(zip(node_ids, told, strict=True)))


async def _names(client: FleetClient, folder: str) -> list[str]:
    """The Objects in a folder; none where there is no such folder."""
    (children,) = await client.batches.browse([ua.NodeId.from_string(folder)], classes=_OBJECTS)
    return [str(child.BrowseName.Name) for child in children]


async def _server(client: FleetClient) -> ServerStatus:
    status = (await _read(client, ["i=2256"])).value("i=2256") or {}
    (name,) = await client.batches.read([ua.NodeId.from_string("ns=2;s=Fleet")], ua.AttributeIds.DisplayName)
    certificate = client.server_certificate
    return ServerStatus(
        client.endpoint,
        str(plain_value(name.Value.Value) or "") if name.Value is not None else "",
        str(status.get("BuildInfo", {}).get("SoftwareVersion") or ""),
        ua.ServerState(status.get("State", ua.ServerState.Unknown)).name,
        _parsed(status.get("StartTime")),
        _parsed(status.get("CurrentTime")),
        x509.load_der_x509_certificate(certificate).not_valid_after_utc if certificate else None,
    )


async def _bridges(client: FleetClient) -> tuple[BridgeStatus, ...]:
    (bridges,) = await client.batches.browse([ua.NodeId.from_string("ns=2;s=Fleet.Bridges")], classes=_OBJECTS)
    members = [
        {str(child.BrowseName.Name): child.NodeId.to_string() for child in children}
        for children in await client.batches.browse([bridge.NodeId for bridge in bridges])
    ]
    wanted = ("Kind", "Space", "Online", "Connected", "Detail")
    values = await _read(client, [parts[name] for parts in members for name in wanted if name in parts])
    found: list[BridgeStatus] = []
    for bridge, parts in zip(bridges, members, strict=True):
        kind, space, online, connected, detail = (parts.get(name, "") for name in wanted)
        found.append(
            BridgeStatus(
                str(bridge.BrowseName.Name),
                str(values.value(kind) or ""),
                values.value(space),
                values.value(online) is True,
                values.source_time(online),
                values.value(connected),
                str(values.value(detail) or ""),
                await _drops(client, parts["Drops"]) if "Drops" in parts else {},
            )
        )
    return tuple(found)


async def _drops(client: FleetClient, folder: str) -> dict[str, int]:
    (causes,) = await client.batches.browse([ua.NodeId.from_string(folder)])
    values = await _read(client, [cause.NodeId.to_string() for cause in causes])
    counts = {str(cause.BrowseName.Name): values.value(cause.NodeId.to_string()) for cause in causes}
    return {name: count for name, count in counts.items() if count}


async def _namespace(client: FleetClient) -> NamespaceStatus | None:
    node = "ns=2;s=Fleet.UnifiedNamespace"
    (members,) = await client.batches.browse([ua.NodeId.from_string(node)])
    if not members:
        return None
    names = ("Connected", "Detail", "Topics", "Published")
    values = await _read(client, [f"{node}.{name}" for name in names])
    connected, detail, topics, published = (values.value(f"{node}.{name}") for name in names)
    return NamespaceStatus(
        connected is True,
        str(detail or ""),
        int(topics or 0),
        int(published or 0),
        await _drops(client, f"{node}.Drops"),
    )


async def _robots(client: FleetClient, runs: Sequence[RunStatus], *, all_values: bool) -> tuple[RobotStatus, ...]:
    summaries = [] if all_values else await _summaries(client)
    if len(summaries) > MOST_LOOKED_AT:
        return await _many_robots(client, summaries, runs)
    nodes = {name: node.to_string() for name, node in (await client.robots()).items()}
    states = await _read(client, [f"{node}.{part}" for node in nodes.values() for part in ("State", "HeldBy")])
    shown = {name: _state(states.value(f"{node}.State")) for name, node in nodes.items()}
    told = await _data(client, nodes)
    tasks = _tasks(nodes, runs)
    at_skills = [name for name in nodes if shown[name] == "busy" and not tasks[name]]
    for robot, skill in await _skills(client, at_skills):
        tasks[robot].append(skill)
    found: list[RobotStatus] = []
    for name in sorted(nodes):
        values, battery, unit = told.get(name, (None, None, ""))
        since = states.source_time(f"{nodes[name]}.State")
        held_by = str(states.value(f"{nodes[name]}.HeldBy") or "")
        found.append(RobotStatus(name, shown[name], since, values, battery, unit, tuple(tasks[name]), held_by))
    return tuple(found)


async def _summaries(client: FleetClient) -> list[RobotSummary]:
    try:
        return await client.summaries()
    except NodeNotFound:  # a server of an earlier version
        return []


async def _many_robots(
    client: FleetClient, summaries: Sequence[RobotSummary], runs: Sequence[RunStatus]
) -> tuple[RobotStatus, ...]:
    """The robots of a large fleet, by their summaries."""
    summaries = sorted(summaries, key=lambda one: one.name)
    looked_at = [one.name for one in summaries if one.state != "idle" or one.held_by][:MOST_NOT_WELL]
    told = await _data(client, {name: f"ns=2;s=Robots.{name}" for name in looked_at})
    tasks = _tasks([one.name for one in summaries], runs)
    found: list[RobotStatus] = []
    for one in summaries:
        values, battery, unit = told.get(one.name, (None, None, ""))
        does = tuple(tasks[one.name]) or ((one.task,) if one.task else ())
        quality = "" if values is not None else one.status_text
        found.append(
            RobotStatus(one.name, one.state, one.state_since, values, battery, unit, does, one.held_by, quality)
        )
    return tuple(found)


def _tasks(robots: Iterable[str], runs: Sequence[RunStatus]) -> dict[str, list[str]]:
    """What runs have robots do."""
    tasks: dict[str, list[str]] = {name: [] for name in robots}
    for run in runs:
        for task, robot, state in run.tasks:
            if robot in tasks and state not in _TASK_OVER:
                tasks[robot].append(f"{task} of {run.run_id}")
    return tasks


def _state(value: Any) -> str:
    return _STATES[value] if isinstance(value, int) and value in range(len(_STATES)) else str(value)


async def _skills(client: FleetClient, robots: Sequence[str]) -> list[tuple[str, str]]:
    """The skills that robots are at."""
    folders = [(robot, ua.NodeId.from_string(f"ns=2;s=Robots.{robot}.Skills")) for robot in robots]
    known = await read_skills(client.batches, await skill_nodes(client.batches, folders))
    return [(one.info.robot, one.info.name) for one in known if one.info.state in ("Running", "Suspended")]


async def _data(client: FleetClient, robots: Mapping[str, str]) -> dict[str, tuple[dict[str, int], float | None, str]]:
    """Of robots, given with their nodes: their values by StatusCode, and how full the battery is, with its unit."""
    data_of = {name: ua.NodeId.from_string(f"{node}.Data") for name, node in robots.items()}
    variables = await variables_below(client.batches, data_of)
    told: dict[str, tuple[Counter[str], list[tuple[int, ua.NodeId, float]]]] = {
        name: (Counter(), []) for name in robots
    }
    values = await client.batches.read([one.node for one in variables])
    for (robot, path, node), data in zip(variables, values, strict=True):
        code = data.StatusCode
        if code is not None and code.value == _WAITING:
            continue
        told[robot][0][code.name if code is not None else "Good"] += 1
        value = data.Value.Value if data.Value is not None else None
        if path[-1] in CHARGES and isinstance(value, int | float) and not isinstance(value, bool):
            told[robot][1].append((CHARGES.index(path[-1]), node, float(value)))
    charges = {name: min(batteries, key=lambda one: one[0]) for name, (_, batteries) in told.items() if batteries}
    details = await client.details([node.to_string() for _, node, _ in charges.values()])
    units = dict(zip(charges, details, strict=True))
    return {
        name: (
            dict(counts),
            charges[name][2] if name in charges else None,
            units[name].unit if name in units else "",
        )
        for name, (counts, _) in told.items()
    }


async def _faults(client: FleetClient) -> tuple[FaultStatus, ...]:
    names = await _names(client, "ns=2;s=Fleet.Faults")
    parts = ("Robot", "FaultSource", "Reason", "ActiveState.Id", "AckedState.Id", "Retain", "Time")
    since = "ActiveState.TransitionTime"
    ids = {name: f"ns=2;s=Fleet.Faults.{name}" for name in names}
    values = await _read(client, [f"{one}.{part}" for one in ids.values() for part in (*parts, since)])
    found: list[FaultStatus] = []
    for name, one in ids.items():
        robot, source, reason, active, seen, retain, time = (values.value(f"{one}.{part}") for part in parts)
        if retain:
            moment = _parsed(values.value(f"{one}.{since}")) or _parsed(time)
            found.append(
                FaultStatus(name, str(robot), str(source), str(reason or ""), active is True, seen is True, moment)
            )
    return tuple(found)


async def _runs(client: FleetClient) -> tuple[RunStatus, ...]:
    ids = {name: f"ns=2;s=Fleet.Scenarios.Runs.{name}" for name in await _names(client, "ns=2;s=Fleet.Scenarios.Runs")}
    parts = ("State", "Scenario", "StartTime", "Reason", "Tasks", "Robots", "States")
    values = await _read(client, [f"{one}.{part}" for one in ids.values() for part in parts])
    found: list[RunStatus] = []
    for name, one in ids.items():
        state, scenario, started, reason, tasks, robots, states = (values.value(f"{one}.{part}") for part in parts)
        if isinstance(state, str) and state not in _OVER:
            rows = tuple(zip(tasks or (), robots or (), states or (), strict=False))
            found.append(RunStatus(name, str(scenario or ""), state, _parsed(started), str(reason or ""), rows))
    return tuple(found)


async def _decisions(client: FleetClient) -> tuple[OpenDecision, ...]:
    folder = "ns=2;s=Fleet.Resilience.Decisions"
    ids = {name: f"{folder}.{name}" for name in await _names(client, folder)}
    parts = ("State", "Task", "Failed", "Reason")
    values = await _read(client, [f"{one}.{part}" for one in ids.values() for part in parts])
    found: list[OpenDecision] = []
    for name, one in ids.items():
        state, task, failed, reason = (str(values.value(f"{one}.{part}") or "") for part in parts)
        if state == "open":
            found.append(OpenDecision(name, task, failed, reason))
    return tuple(found)


def _parsed(text: Any) -> datetime | None:
    try:
        return _moment(datetime.fromisoformat(text)) if isinstance(text, str) else None
    except ValueError:
        return None


def _moment(moment: datetime | None) -> datetime | None:
    return moment if moment is None or moment.tzinfo is not None else moment.replace(tzinfo=UTC)
