"""What a server shows of robots that are driven, as their bridges are heard, silent, and heard again."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.unit.teleoperation.rigs import model
from ua_fleet.counters import Drop
from ua_fleet.errors import LeaseRefused, RobotOffline
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.pubsub.events import (
    DataReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SubscriberEvent,
)
from ua_fleet.server.teleoperation.service import DrivingSession, TeleoperationService
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, pack
from ua_fleet.teleoperation import State, Status
from ua_fleet.teleoperation.messages import STATUS_FIELDS
from ua_fleet.values import ARRAY, BuiltinType, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

MODEL = model()
METADATA = DataSetMetaData("Teleoperation", STATUS_FIELDS, ConfigurationVersion(1, 1))
HELD = Status(5, State.HELD, 3, "anna", 9, "otto: released", (0.25, 0.0), (1, 2, 3, 4))
IDLE = Status(6, State.IDLE, 0, "", 0, "anna: released", (0.0, 0.0), (1, 2, 3, 4))


class Server:
    def __init__(self) -> None:
        self.nodes: dict[str, tuple[Any, int]] = {}
        self.order: list[str] = []
        self.driven: list[str] = []
        self.service = TeleoperationService(
            [MODEL],
            send=lambda _datagram: None,
            want=lambda _space, _id, _now: True,
            sooner=lambda: None,
            put=self.put,
            busy=lambda _robot: "",
            driven=lambda _robot, told: self.driven.append(told),
            ended=lambda _ended, _lasted_s: None,
            must_be_verified=False,
            clock=lambda: 0.0,
            wall_ticks=lambda: 77,
        )

    def put(self, change: ValueChanged) -> None:
        name = str(change.key.identifier).partition(".")[2]
        self.nodes[name] = change.value, change.status
        self.order.append(name)

    def hear(self, status: Status, *, code: int = 0) -> None:
        types = tuple([0] * len(STATUS_FIELDS))
        message = DataSetMessage(MODEL.status.id, 0, types, status.fields(), timestamp=70, status=code)
        self.follow(DataReceived(MODEL.status, message, METADATA))

    def follow(self, event: SubscriberEvent) -> None:
        self.order.clear()
        self.service.follow(event)


def test_what_a_bridge_says_is_shown_and_the_counter_last() -> None:
    server = Server()
    server.hear(HELD)
    assert {name: value for name, (value, _) in server.nodes.items()} == {
        "State": 1,
        "Holder": "anna",
        "HeldSince": 70,
        "Lease": 3,
        "LastNumber": 9,
        "LastEnd": "otto: released",
        "Output": (0.25, 0.0),
        "Drops.lease": 1,
        "Drops.number": 2,
        "Drops.echo": 3,
        "Drops.setpoint": 4,
        "Counter": 5,
    }
    assert server.order[-1] == "Counter"
    server.hear(IDLE)
    assert "Drops.lease" not in server.order
    assert server.order[-1] == "Counter"
    assert server.nodes["HeldSince"] == (None, 0)


def test_others_are_told_who_drives_until_it_stands() -> None:
    server = Server()
    server.hear(HELD)
    server.hear(HELD._replace(counter=6))
    server.hear(IDLE._replace(state=State.STOPPING))
    server.hear(IDLE)
    assert server.driven == ["driven by hand by anna", "being stopped, since it was driven by hand", ""]
    assert server.service.driven_by("carrier") == ""
    assert server.service.driven_by("another") == ""


@pytest.mark.parametrize(
    ("event", "code"),
    [
        (SourceSilent(MODEL.status), StatusCode.BAD_NO_COMMUNICATION),
        (SourceRefused(MODEL.status, Drop.BAD_SIGNATURE), StatusCode.BAD_SECURITY_CHECKS_FAILED),
        (None, StatusCode.BAD_NO_COMMUNICATION),
    ],
)
async def test_a_bridge_that_is_gone_is_asked_for_nothing(event: SubscriberEvent | None, code: int) -> None:
    server = Server()
    server.hear(HELD)
    if event is None:
        server.hear(HELD, code=code)  # it has said itself that it goes
    else:
        server.follow(event)
    assert server.nodes["Holder"] == ("anna", code)
    assert server.nodes["Counter"] == (5, code)
    driver = DrivingSession("s1", "otto", None, lambda: "")
    with pytest.raises(RobotOffline, match="the bridge of carrier is silent"):
        await server.service.acquire("carrier", driver, take_over=False)
    for back, shown in ((SourceStale, 0x408F_0000), (SourceReturned, 0)):
        server.follow(SourceSilent(MODEL.status))
        server.follow(back(MODEL.status))
        assert server.nodes["Holder"] == ("anna", shown)
        with pytest.raises(RobotOffline, match="no bridge announces"):
            async with asyncio.timeout(1):
                await server.service.acquire("carrier", driver, take_over=False)


async def test_a_bridge_that_was_never_heard_is_asked_for_nothing() -> None:
    server = Server()
    driver = DrivingSession("s1", "otto", None, lambda: "")
    with pytest.raises(RobotOffline, match="the bridge of carrier is silent"):
        await server.service.acquire("carrier", driver, take_over=False)


async def test_a_robot_whose_bridge_falls_silent_while_it_is_asked_is_not_given_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = Server()
    server.hear(IDLE)
    types = (int(BuiltinType.UINT32), int(BuiltinType.UINT32), BuiltinType.STRING | ARRAY)
    results = pack(types, (4, 1, tuple([name for name, _ in MODEL.axes])))

    async def ask(*_asked: Any, **_more: Any) -> RequestOutcome:
        server.follow(SourceSilent(MODEL.status))
        report = ExecutionReport(ExecutionState.DONE, result=results)
        return RequestOutcome(OutcomeKind.ACCEPTED, report, ("Lease", "Counter", "Axes"))

    requested: list[Any] = []
    monkeypatch.setattr(server.service, "_ask", ask)

    def request(*asked: Any) -> None:
        requested.append(asked[2:4])

    monkeypatch.setattr(server.service.commands, "request", request)
    driver = DrivingSession("s1", "otto", None, lambda: "")
    with pytest.raises(LeaseRefused, match="not given out: nothing is heard of its bridge"):
        await server.service.acquire("carrier", driver, take_over=False)
    assert requested == [("Release", {"Lease": 4, "Reason": "nothing is heard of its bridge"})]
