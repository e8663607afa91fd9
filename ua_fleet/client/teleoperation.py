# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Robots that are driven by hand (docs/teleoperation.md).

    async with driving(client, "carrier") as lease:
        while not lease.over:
            await lease.drive({"linear": 0.2, "angular": 0.0})
            await asyncio.sleep(0.05)

Each setpoint echoes the newest counter that the subscription has brought to this process. So call `drive` with what its
operator wishes now, and as often as the wish stands: what is wished once is followed for `deadman_s`.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, Final

from asyncua import ua

from ua_fleet.client.translated import NodeNotFound
from ua_fleet.errors import AccessRefused, LeaseRefused, UaFleetError
from ua_fleet.values import Quality, StatusCode, quality_of

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = [
    "AxisInfo",
    "DrivingLease",
    "TeleoperationInfo",
    "TeleoperationStatus",
    "driving",
    "teleoperation_info",
    "watch_teleoperation",
]

PUBLISHING_MS: Final = 50.0
"""The shortest that the server has, and as often as the bridge counts."""
_METHODS: Final = {
    "Acquire": "ns=3;i=72071",
    "Renew": "ns=3;i=72072",
    "Release": "ns=3;i=72073",
    "Drive": "ns=3;i=72074",
}
"""Of TeleoperationType; see nodesets/UaFleet.NodeIds.csv."""
_PROPERTIES: Final = (
    *("Axes", "Units", "Speed", "Acceleration", "Deceleration", "Jerk"),
    *("DeadmanMs", "LeaseMs", "RobotTimeoutMs", "PeriodMs", "StopMs"),
)
_DROPS: Final = ("lease", "number", "echo", "setpoint")
_STATES: Final = ("Idle", "Held", "Stopping")


@dataclass(frozen=True, slots=True)
class AxisInfo:
    """What an axis does at most, in both directions, in its unit and seconds."""

    name: str
    unit: str
    """Empty: it has none."""
    speed: float
    acceleration: float
    deceleration: float
    jerk: float


@dataclass(frozen=True, slots=True)
class TeleoperationInfo:
    """How a robot is driven by hand."""

    robot: str
    node_id: str
    """Of its Object; the Variables are below."""
    axes: tuple[AxisInfo, ...]
    deadman_s: float
    """It is stopped when its newest setpoint echoes a counter that was published longer ago."""
    lease_s: float
    """So long a lease lasts without Renew or a setpoint."""
    robot_timeout_s: float
    period_s: float
    stop_s: float
    """So long a stop takes at most."""

    def variable(self, name: str) -> str:
        """The NodeId of one of its Variables, e.g. `Counter` or `Drops.echo`."""
        namespace, _, number = self.node_id.partition(";i=")
        return f"{namespace};s={number}.{name}"


@dataclass(frozen=True, slots=True)
class TeleoperationStatus:
    """What the bridge says of a robot."""

    status: int
    """StatusCode: what is not Good is not of now."""
    state: str = ""
    """`Idle`, `Held` or `Stopping`; empty before the first value."""
    holder: str = ""
    held_since: datetime | None = None
    lease: int = 0
    counter: int = 0
    last_number: int = 0
    last_end: str = ""
    output: tuple[float, ...] = ()
    """What is written to the robot now, by axis."""
    drops: Mapping[str, int] = field(default_factory=dict[str, int])
    """Setpoints that the bridge has dropped, by cause."""

    @property
    def is_good(self) -> bool:
        """Whether it is of now."""
        return bool(self.state) and quality_of(self.status) is Quality.GOOD


async def teleoperation_info(client: FleetClient, robot: str) -> TeleoperationInfo:
    """How a robot is driven by hand.

    Raises:
        NodeNotFound: there is no such robot, or nobody drives it by hand.
        NotConnected: the connection was lost.
    """
    below = await client.browse(f"ns=2;s=Robots.{robot}")
    found = [node.node_id for node in below if node.browse_name == "Teleoperation" and node.node_class == "Object"]
    if not found:
        raise NodeNotFound(f"{robot} is not driven by hand: fleet.yaml has no `teleoperation` for it")
    info = TeleoperationInfo(robot, found[0], (), 0, 0, 0, 0, 0)
    readings = await client.read([info.variable(name) for name in _PROPERTIES])
    values = {name: reading.value for name, reading in zip(_PROPERTIES, readings, strict=True)}
    columns = [values[name] for name in _PROPERTIES[:6]]
    times_s = [values[name] / 1000 for name in _PROPERTIES[6:]]
    return replace(
        info,
        axes=tuple([AxisInfo(*row) for row in zip(*columns, strict=True)]),
        deadman_s=times_s[0],
        lease_s=times_s[1],
        robot_timeout_s=times_s[2],
        period_s=times_s[3],
        stop_s=times_s[4],
    )


async def watch_teleoperation(
    client: FleetClient, info: TeleoperationInfo, *, period_ms: float = PUBLISHING_MS
) -> AsyncGenerator[TeleoperationStatus]:
    """How it stands with a robot, now and with each change, until the iteration is closed.

    Raises:
        NotConnected: the connection was lost.
    """
    names = {
        "State": "state",
        "Holder": "holder",
        "HeldSince": "held_since",
        "Lease": "lease",
        "LastNumber": "last_number",
        "LastEnd": "last_end",
        "Output": "output",
        "Counter": "counter",
    }
    fields = {info.variable(name): field_name for name, field_name in names.items()}
    causes = {info.variable(f"Drops.{cause}"): cause for cause in _DROPS}
    status = TeleoperationStatus(int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA))
    # The counter last: with a new one all that the bridge has said with it is there.
    async for change in client.watch([*causes, *fields], period_ms=period_ms):
        value: Any = change.exact
        if (cause := causes.get(change.node_id)) is not None:
            status = replace(status, drops={**status.drops, cause: int(value or 0)})
        else:
            name = fields[change.node_id]
            if name == "state":
                value = _STATES[value] if value in range(len(_STATES)) else ""
                status = replace(status, status=change.status)
            elif name == "output":
                value = tuple(value or ())
            elif value is None and name != "held_since":
                continue  # nothing has come yet
            status = replace(status, **{name: value})
        yield status


class DrivingLease:
    """The lease of a robot; made by `driving`."""

    def __init__(
        self, client: FleetClient, info: TeleoperationInfo, granted: Sequence[Any], clock: Callable[[], float]
    ) -> None:
        self._client, self._clock = client, clock
        self.info = info
        self.number: int = int(granted[0])
        """Of the lease."""
        self.taken_from = str(granted[2] or "")
        """Whose lease has ended for it; empty: nobody's."""
        self.status = TeleoperationStatus(int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA))
        """The latest that the bridge has said."""
        self.over = ""
        """Why it is over, for people; empty while it is held."""
        self.setpoints = 0
        """Sent under it."""
        self.round_trip_s = 0.0
        """From the last `drive` to the server's answer."""
        self.changed = asyncio.Event()
        """Set with each status; whoever waits for it clears it."""
        self._counter: int = int(granted[1])
        self._counted_at = self._used_at = clock()

    @property
    def counter(self) -> int:
        """What the next setpoint echoes."""
        return self._counter

    @property
    def age_s(self) -> float:
        """How long ago the counter came that the next setpoint echoes."""
        return self._clock() - self._counted_at

    @property
    def unused_s(self) -> float:
        """How long ago the lease was last used."""
        return self._clock() - self._used_at

    async def drive(self, values: Mapping[str, float] | Sequence[float], *, echo: int | None = None) -> int:
        """Send what each axis shall do: by the names of the axes, those left out being zero, or in their order.

        Good says that the server has sent it; whether the bridge took it says `status.last_number`.

        Args:
            values: speeds.
            echo: the newest counter that the operator's own device had seen, where that is another one than this
                process; without it the newest that this process has seen.

        Returns:
            The number of the setpoint.

        Raises:
            LeaseRefused: the lease is over (`ua_status` Bad_ResourceUnavailable: taken over), or that was no setpoint.
            AccessRefused: the user may not drive any more.
            NotConnected: the connection was lost; the robot is stopped.
        """
        if isinstance(values, Mapping):
            names = [axis.name for axis in self.info.axes]
            if unknown := [name for name in values if name not in names]:
                raise LeaseRefused(
                    StatusCode.BAD_INVALID_ARGUMENT,
                    f"{self.info.robot} has no axis {unknown[0]!r}; there are: {', '.join(names)}",
                )
            values = [values.get(name, 0.0) for name in names]
        self.setpoints += 1
        number = self.setpoints
        echo = self._counter if echo is None else echo
        began = self._used_at = self._clock()
        doubles = ua.Variant([float(value) for value in values], ua.VariantType.Double, is_array=True)
        await self._call("Drive", _number(self.number), _number(number), _number(echo), doubles)
        self.round_trip_s = self._clock() - began
        return number

    async def renew(self) -> None:
        """Keep the lease; `driving` does that by itself. Raises as `drive`."""
        self._used_at = self._clock()
        await self._call("Renew", _number(self.number))

    async def release(self) -> None:
        """Stop the robot and give it back; `driving` does that in the end. Raises as `drive`."""
        self.over = self.over or "released"
        await self._call("Release", _number(self.number))

    def heard(self, status: TeleoperationStatus) -> None:
        """Take what the bridge says."""
        if status.is_good:
            newer = 0 < (status.counter - self._counter) & 0xFFFF_FFFF < 0x8000_0000
            if newer:
                self._counter, self._counted_at = status.counter, self._clock()
            if status.lease != self.number and newer and not self.over:
                self.over = status.last_end or "the bridge was started anew"
        self.status = status
        self.changed.set()

    async def _call(self, name: str, *arguments: ua.Variant) -> None:
        try:
            await self._client.call(self.info.node_id, _METHODS[name], *arguments)
        except AccessRefused as error:
            if error.ua_status == StatusCode.BAD_USER_ACCESS_DENIED:
                self.over = self.over or str(error)
                raise
            if error.ua_status in (StatusCode.BAD_INVALID_STATE, StatusCode.BAD_RESOURCE_UNAVAILABLE):
                self.over = self.over or str(error)
            raise LeaseRefused(error.ua_status, str(error)) from error


@asynccontextmanager
async def driving(
    client: FleetClient, robot: str | TeleoperationInfo, *, take_over: bool = False, renew: bool = True
) -> AsyncGenerator[DrivingLease]:
    """Hold a robot while the context lasts: its lease is renewed, and released in the end.

    Args:
        client: whose session has the lease; it ends with its connection.
        robot: its name, or what `teleoperation_info` has said of it.
        take_over: end the lease of another one for it; for engineers.
        renew: keep the lease while nothing is driven. Who passes on the setpoints of others leaves it to them.

    Raises:
        LeaseRefused: it is not given out; the text says why, e.g. who drives it.
        AccessRefused: the user may not drive, or not take over.
        NodeNotFound: there is no such robot, or nobody drives it by hand.
        NotConnected: the connection was lost.
    """
    info = robot if isinstance(robot, TeleoperationInfo) else await teleoperation_info(client, robot)
    try:
        granted = await client.call(info.node_id, _METHODS["Acquire"], ua.Variant(take_over, ua.VariantType.Boolean))
    except AccessRefused as error:
        if error.ua_status == StatusCode.BAD_USER_ACCESS_DENIED:
            raise
        raise LeaseRefused(error.ua_status, str(error)) from error
    lease = DrivingLease(client, info, granted, time.monotonic)
    tasks = [asyncio.ensure_future(_follow(client, lease))]
    if renew:
        tasks.append(asyncio.ensure_future(_keep(lease)))
    try:
        yield lease
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        if not lease.over:
            with contextlib.suppress(UaFleetError):
                await lease.release()


async def _follow(client: FleetClient, lease: DrivingLease) -> None:
    try:
        async with contextlib.aclosing(watch_teleoperation(client, lease.info)) as statuses:
            async for status in statuses:
                lease.heard(status)
    except UaFleetError as error:
        is_held, lease.over = not lease.over, lease.over or str(error)
        lease.changed.set()
        if is_held:  # without the counter no setpoint is fresh
            with contextlib.suppress(UaFleetError):
                await lease.release()


async def _keep(lease: DrivingLease) -> None:
    """Renew the lease while nothing is driven."""
    often_s = lease.info.lease_s / 4
    while not lease.over:
        await asyncio.sleep(max(often_s - lease.unused_s, 0.05))
        if lease.unused_s < often_s or lease.over:
            continue
        with contextlib.suppress(UaFleetError):
            await lease.renew()


def _number(value: int) -> ua.Variant:
    return ua.Variant(value, ua.VariantType.UInt32)
