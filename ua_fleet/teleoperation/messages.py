"""What travels between server and bridge of teleoperation: three Actions, the setpoints, and the bridge's status.

    Acquire, Renew, Release   Actions of the bridge's space, with one target that has the robot's name. Not journaled: a
                              bridge that is started anew has no leases, and gives greater numbers.
    setpoints                 key frames of (PublisherId 0, the bridge's status_id, the id of the teleoperation), under
                              the keys of `c-<space>`. Nothing is announced, repeated or retained.
    status                    the DataSet ua_<space>_<ns>_<id> of the bridge, under `t-<space>`: each 50 ms while a
                              lease is held, else as every DataSet.

The values of a setpoint are in the order of Axes in the answer to Acquire: whoever asked has a lease of a bridge that
has this very order, whatever stands in its own `fleet.yaml`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Final, NamedTuple, cast

from ua_fleet.pubsub.metadata import make_field
from ua_fleet.teleoperation.model import LEASE_S, SetpointAddress, TeleoperationModel
from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.header import HAS_SECURITY_HEADER
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData, FrameKind, NetworkMessage

__all__ = [
    "ACQUIRE",
    "ACQUIRE_REQUEST",
    "ACQUIRE_RESPONSE",
    "LEASE_REQUEST",
    "MOST_NAME_CHARACTERS",
    "RELEASE",
    "RELEASE_REQUEST",
    "RENEW",
    "SETPOINT_DROPS",
    "STATUS_FIELDS",
    "Granted",
    "Setpoint",
    "State",
    "Status",
    "datagram_heads",
    "encode_setpoint",
    "read_granted",
    "read_setpoint",
    "read_status",
]

_UINT32: Final = BuiltinType.UINT32
_STRING: Final = BuiltinType.STRING
_DOUBLE: Final = BuiltinType.DOUBLE

ACQUIRE: Final = "Acquire"
RENEW: Final = "Renew"
RELEASE: Final = "Release"
"""Names of the Actions."""
MOST_NAME_CHARACTERS: Final = 256
"""Of Holder, Session and Reason; longer ones are refused."""

ACQUIRE_REQUEST: Final[tuple[FieldMetaData, ...]] = (
    make_field("Holder", _STRING),
    make_field("Session", _STRING),
    make_field("TakeOver", BuiltinType.BOOLEAN),
)
"""Holder is the name that others see. Session is what the lease ends with, unique in its server. With TakeOver, which
the server sets for engineers, the lease of another holder ends for it."""
ACQUIRE_RESPONSE: Final[tuple[FieldMetaData, ...]] = (
    make_field("Lease", _UINT32),
    make_field("Counter", _UINT32),
    make_field("TakenFrom", _STRING),
    make_field("DeadmanMs", _UINT32),
    make_field("LeaseMs", _UINT32),
    make_field("RobotTimeoutMs", _UINT32),
    make_field("PeriodMs", _UINT32),
    make_field("StopMs", _UINT32),
    make_field("Axes", _STRING, array=True),
    make_field("Speed", _DOUBLE, array=True),
    make_field("Acceleration", _DOUBLE, array=True),
    make_field("Deceleration", _DOUBLE, array=True),
    make_field("Jerk", _DOUBLE, array=True),
)
"""Counter is the one to echo until the first status is there; TakenFrom whose lease ended for it, or empty; LeaseMs
how long it lasts without Renew or a setpoint; StopMs how long a stop takes at most. Arrays have an element for each
axis."""
LEASE_REQUEST: Final[tuple[FieldMetaData, ...]] = (make_field("Lease", _UINT32),)
"""Of Renew; its response has no fields."""
RELEASE_REQUEST: Final[tuple[FieldMetaData, ...]] = (make_field("Lease", _UINT32), make_field("Reason", _STRING))
"""Of Release; its response has no fields. Reason is why, for people: `released`, or that the session has ended."""

SETPOINT_DROPS: Final = ("lease", "number", "echo", "setpoint")
"""Causes for which the bridge drops setpoints, as they are called in `counters.Drop`."""


class State(IntEnum):
    """What the bridge does. The numbers travel."""

    IDLE = 0
    """Nobody holds the robot, it stands, and nothing is written to it."""
    HELD = 1
    """It follows the holder's setpoints, or stands at zero before the first of them."""
    STOPPING = 2
    """It is brought to a standstill, since a lease has ended. There may be a new holder, who drives from then on."""


STATUS_FIELDS: Final[tuple[FieldMetaData, ...]] = (
    make_field("Counter", _UINT32, properties={"NodeOnly": True}),
    make_field("State", BuiltinType.BYTE),
    make_field("Lease", _UINT32),
    make_field("Holder", _STRING),
    make_field("Number", _UINT32),
    make_field("LastEnd", _STRING),
    make_field("Values", _DOUBLE, array=True),
    *[make_field(f"Drops.{cause}", _UINT32) for cause in SETPOINT_DROPS],
)
"""Fields of the status. It is for the server alone, and has no form in a robot's space."""


class Status(NamedTuple):
    """What the bridge publishes of one robot."""

    counter: int
    """To be echoed; it rises with each status."""
    state: State
    lease: int
    """Number of the lease that is held; 0 is none."""
    holder: str
    number: int
    """Of the last setpoint that was taken under this lease; 0 before the first."""
    last_end: str
    """Why the last lease ended, a line for people that begins with its holder; empty where none has ended."""
    values: tuple[float, ...]
    """What is written to the robot now, by axis."""
    drops: tuple[int, ...]
    """Setpoints of this robot that were dropped since the bridge's start, in the order of SETPOINT_DROPS."""

    def fields(self) -> tuple[Any, ...]:
        """The values in the order of STATUS_FIELDS."""
        plain = (self.counter, int(self.state), self.lease, self.holder, self.number, self.last_end, self.values)
        return (*plain, *self.drops)


class Setpoint(NamedTuple):
    """One wish of an operator."""

    lease: int
    number: int
    """Rises with each setpoint of a lease; the first is at least 1."""
    echo: int
    """The newest counter that the operator's device had seen."""
    values: tuple[float, ...]
    """One for each axis."""


class Granted(NamedTuple):
    """The answer to Acquire."""

    lease: int
    counter: int
    taken_from: str
    model: TeleoperationModel

    def fields(self) -> tuple[Any, ...]:
        """The values in the order of ACQUIRE_RESPONSE."""
        model = self.model
        limits = [each for _, each in model.axes]
        times_s = (model.deadman_s, LEASE_S, model.robot_timeout_s, model.period_s, model.stop_s)
        return (
            self.lease,
            self.counter,
            self.taken_from,
            *[round(time_s * 1000) for time_s in times_s],
            tuple([name for name, _ in model.axes]),
            tuple([each.speed for each in limits]),
            tuple([each.acceleration for each in limits]),
            tuple([each.deceleration for each in limits]),
            tuple([each.jerk for each in limits]),
        )


_SETPOINT_TYPES: Final = (int(_UINT32), int(_UINT32), int(_UINT32), int(_DOUBLE) | ARRAY)
_HEAD_BYTES: Final = 7
"""Flags, PublisherId, GroupFlags and WriterGroupId."""
_MOST: Final = 0xFFFF_FFFF


def encode_setpoint(codec: Codec, address: SetpointAddress, setpoint: Setpoint) -> bytes:
    """The plain NetworkMessage; raises LocalWireError for what does not fit its types."""
    part = DataSetMessage(
        address.data_set_writer_id,
        FrameKind.KEY.value,
        _SETPOINT_TYPES,
        (setpoint.lease, setpoint.number, setpoint.echo, setpoint.values),
        setpoint.number & 0xFFFF,
    )
    return codec.encode(NetworkMessage(address.publisher_id, writer_group_id=address.writer_group_id, messages=(part,)))


def datagram_heads(writer_group_id: int) -> tuple[bytes, bytes]:
    """How datagrams of a WriterGroup of setpoints begin, without security and with it."""
    plain = encode_setpoint(Codec(), SetpointAddress(writer_group_id, 1), Setpoint(1, 1, 1, ()))[:_HEAD_BYTES]
    return plain, bytes((plain[0], plain[1] | HAS_SECURITY_HEADER)) + plain[2:]


def read_setpoint(message: DataSetMessage) -> Setpoint | None:
    """The setpoint in a DataSetMessage; None where it is none. Values may be anything that a Double can be."""
    if message.kind != FrameKind.KEY or message.types != _SETPOINT_TYPES or not message.valid:
        return None
    lease, number, echo, values = message.values
    return Setpoint(lease, number, echo, tuple(values or ()))


def read_status(values: dict[str, Any]) -> Status | None:
    """The status in a DataSet, by the names of its fields; None where it is none."""
    try:
        numbers = [values[name] for name in ("Counter", "State", "Lease", "Number")]
        texts = [values[name] or "" for name in ("Holder", "LastEnd")]
        speeds = tuple([float(value) for value in values.get("Values") or ()])
        drops = tuple([int(values.get(f"Drops.{cause}", 0)) for cause in SETPOINT_DROPS])
        if not all(isinstance(one, int) and 0 <= one <= _MOST for one in numbers):
            return None
        if not all(isinstance(text, str) for text in texts):
            return None
        counter, state, lease, number = cast("list[int]", numbers)
        return Status(counter, State(state), lease, texts[0], number, texts[1], speeds, drops)
    except (KeyError, TypeError, ValueError):
        return None


def read_granted(results: dict[str, Any]) -> tuple[int, int, tuple[str, ...]] | None:
    """Lease, counter and the order of the axes in the results of Acquire by their names; None where they are none."""
    lease, counter, axes = results.get("Lease"), results.get("Counter"), results.get("Axes")
    if not isinstance(lease, int) or not isinstance(counter, int) or not isinstance(axes, tuple | list):
        return None
    names = [each for each in cast("Sequence[object]", axes) if isinstance(each, str)]
    return (lease, counter, tuple(names)) if len(names) == len(cast("Sequence[object]", axes)) else None
