"""The service with the real requestor, both recording in the server's file; robots answer when a test says so."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import cast

import structlog

from tests.unit.operation.runs.world import CONFIG, STATUS, FailingJournal, World
from ua_fleet.config.schema import FleetConfig
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.orchestrator import Output
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.skill.exchanges import answer
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, RequestOutcome
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, PublisherIdType

_REQUEST = DataSetMetaData("grab", (make_field("angle", BuiltinType.DOUBLE),), ConfigurationVersion(1, 1))
_RESPONSE = DataSetMetaData("grab", (make_field("weight", BuiltinType.DOUBLE),), ConfigurationVersion(1, 1))
RUNNING = ExecutionReport(ExecutionState.RUNNING)
TOO_LATE = ExecutionReport(ExecutionState.TIMED_OUT, int(StatusCode.BAD_TIMEOUT))


ROBOTS = {1100: "left", 1101: "right"}
"""By the ids of their skill."""


class Machines:
    """What the robots were told, with all that they have from before; their bridges remember it."""

    def __init__(self, told: Mapping[bytes, str] = MappingProxyType({})) -> None:
        self.told = dict(told)
        """The robot of each execution that was begun. A bridge begins none twice."""

    def hear(self, message: ActionMessage) -> None:
        if message.action_state == ActionState.EXECUTING and message.timeout_hint_ms:
            assert message.correlation_data is not None
            self.told.setdefault(message.correlation_data, ROBOTS[message.data_set_writer_id])


class RecordedWorld(World):
    def __init__(
        self,
        folder: Path,
        machines: Machines | None = None,
        *,
        is_announced: bool = True,
        config: FleetConfig = CONFIG,
    ) -> None:
        self.file = ServerRecords(folder)
        self.machines = machines or Machines()
        self.output_s = 0.0
        """How long it takes to carry an output out."""
        self.sent: list[ActionMessage] = []
        self.before_send: Callable[[], None] = lambda: None
        self.now = 100.0
        self.commands = SkillCommands(
            self.file.requests,
            send=self._send,
            want=lambda space, writer_id, now: True,
            sooner=lambda: None,
            wall_ticks=lambda: ticks_from_unix_ns(round(self.now * 1e9)),
            must_be_verified=False,
            told=self._concluded,
            clock=lambda: self.now,
            log=structlog.get_logger(),
        )
        journal = cast("FailingJournal", self.file.runs)
        heard = [robot for robot in ("left", "right") if robot in config.robots]
        super().__init__(folder, requests=self.commands, journal=journal, config=config, heard=heard)
        if is_announced:
            self.announce()

    def show(self, output: Output) -> None:
        super().show(output)
        self.now += self.output_s

    def announce(self) -> None:
        """The bridge says what skills there are."""
        for number, robot in enumerate(("left", "right")):
            targets = (ActionTarget(1, robot),)
            self.commands.announced(
                ActionMetaDataAnnouncement(2, PublisherIdType.UINT16, 0, 1100 + number, targets, _REQUEST, _RESPONSE)
            )

    def go_on(self) -> None:
        """As the server does after a start."""
        self.commands.resume(self.now, self.service.must_not_begin())
        self.service.go_on()

    def asked(self) -> list[ActionMessage]:
        """The first request for each execution."""
        asked = [one for one in self.sent if one.action_state == ActionState.EXECUTING]
        return list({one.correlation_data: one for one in reversed(asked)}.values())[::-1]

    def respond(self, request: ActionMessage) -> None:
        """The bridge says that the robot has begun, or that it never will since it was asked too late."""
        report = RUNNING if request.correlation_data in self.machines.told else TOO_LATE
        self.receive(answer(request, ActionState.DONE, report, None).message)

    def receive(self, response: ActionMessage) -> None:
        self.commands.receive(ActionReceived(response, ("192.0.2.1", 1), False), self.now)

    def end(self) -> None:
        """The robots say that they have done all that they were told."""
        for robot, status in STATUS.items():
            done = [execution_id for execution_id, told in self.machines.told.items() if told == robot]
            self.hear(status.id, *[ExecutionStatus(one, "grab", ExecutionState.DONE) for one in done])

    def do_all(self) -> None:
        """The robots do whatever they are asked for, and what follows from that."""
        responded = -1
        while (count := len(asked := self.asked())) > responded:
            for request in asked[max(0, responded) :]:
                self.respond(request)
            responded = count
            self.end()

    def close(self) -> None:
        self.file.close()

    def _send(self, datagram: bytes) -> None:
        message = Codec().decode(datagram)
        assert isinstance(message, ActionMessage)
        self.before_send()
        self.sent.append(message)
        self.machines.hear(message)

    def _concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        self.service.concluded(execution_id, outcome)
