"""The exchange with a small program on a robot: messages field by field, and what became of each number. Pure.

A command is sent once. A program that does not answer it in time, or whose connection was lost meanwhile, is asked by
its number; only one that says `never` is told again, and only over another connection than the one before. So nothing
is done twice, whatever breaks in between.

`never` is believed of a number of which the program has said nothing before, and which it was not sent over this very
connection. Otherwise it contradicts itself, and nobody knows what it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ua_bridges.tcp.config import FAULT, InterpreterLink, TcpSkillMapping
from ua_bridges.tcp.data import Put, RobotData, Sources, subtype_of, unfit
from ua_bridges.tcp.framing import FieldReader, FramingBroken
from ua_bridges.tcp.link import APPEARS_S
from ua_bridges.tcp.messages import (
    ACK,
    Message,
    MessageReader,
    MessageRefused,
    RobotState,
    Type,
    fields_of,
    number_of,
    value_of,
)
from ua_bridges.tcp.outbox import Encoded, Outbox
from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.bridge.driver import Execution
from ua_fleet.bridge.executing import Ended, Executing, Open, ended_text, halted
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline, SkillRejected
from ua_fleet.values import StatusCode

__all__ = ["InterpreterSession", "TcpSkill"]

TcpSkill = ConfiguredSkill[TcpSkillMapping]
ASK_AGAIN_S: Final = 5.0
"""A program that was silent about a number for so long is asked: a message may have been lost with a connection."""
_NO_PROGRAM: Final = "the program on the robot is not connected; start it"


@dataclass(slots=True)
class _Told:
    """A number that the robot was told, or is asked about."""

    skill: TcpSkill
    execution_id: bytes
    command: Encoded | None
    """None where a bridge before us has sent it."""
    is_sent: bool
    """Whether the robot may have heard of it."""
    connection: int = 0
    """Over which one it was told; 0 where it was told over none, or a bridge before us did."""
    asked: int = 0
    """Questions over this connection that are not answered yet, as far as we know."""
    stale: int = 0
    """Those of them that were asked before it was told over this connection."""


class InterpreterSession:
    """One robot's program.

    `write` sends bytes, False: it did not; `reset` ends the connection for a reason; `misbehaves` does so for a while.
    """

    def __init__(
        self,
        link: InterpreterLink,
        sources: Sequence[RobotData],
        put: Put,
        write: Callable[[bytes], bool],
        reset: Callable[[str], None],
        misbehaves: Callable[[str], None],
        now: float,
    ) -> None:
        self._link, self._reset, self._misbehaves = link, reset, misbehaves
        self._outbox = Outbox(link, write)
        self._data = {subtype_of(data): data for data in sources}
        self._sources = Sources(put)
        self._executing = Executing(put)
        self._told: dict[int, _Told] = {}
        self._ask_at: dict[int, float] = {}
        self._asked_for: Mapping[str, tuple[Any, ...] | None] = {}
        self._is_connected = False
        self._connection = 0
        """The number of this connection, or of the last."""
        self._offline_since = now
        self._fields, self._messages = FieldReader(link), MessageReader(link.most_fields)
        self._begun_at: float | None = None
        """When all that had arrived was done with, and a message was not whole; None while there is no such message."""

    @property
    def is_connected(self) -> bool:
        """Whether the robot's program is there."""
        return self._is_connected

    def answer_from(self, values: Mapping[str, tuple[Any, ...] | None]) -> None:
        """Data of other robots by `robot.data`, which this one may ask for; None for what is not known now."""
        self._asked_for = values

    # The connection

    def connected(self, now: float) -> None:
        """The robot's program is there. It is told what waited, and asked about all else that is open."""
        self._is_connected = True
        self._connection += 1
        self._outbox.clear()
        self._fields, self._messages = FieldReader(self._link), MessageReader(self._link.most_fields)
        self._begun_at = None
        for data in self._data.values():
            self._sources.found(data)
        for number, told in self._told.items():
            told.asked = told.stale = 0
            if told.command is not None and not told.is_sent:
                self._tell(number, told.command, now)
            else:
                self._ask_at[number] = now
        self.turn(now)

    def lost(self, now: float) -> None:
        """The connection is gone. What is open stays so, and is asked about when the program is back."""
        self._is_connected, self._offline_since = False, now
        self._outbox.clear()
        self._sources.all_lost()

    def received(self, data: bytes, now: float, time_ns: int) -> None:
        """Bytes from the robot. To be followed by `turn`, with the time at which they are done with."""
        try:
            for field in self._fields.feed(data):
                if not self._messages.is_within and field == ACK:
                    self._begun_at = None
                    if not self._outbox.acknowledged(now):
                        self._sources.dropped(Drop.UNASKED, "the program acknowledged what was not sent")
                    continue
                if (message := self._messages.feed(field)) is not None:
                    self._begun_at = None
                    self._message(message, now, time_ns)
                    if not self._is_connected:
                        return  # an answer was too much for it, and the connection is over
        except (FramingBroken, MessageRefused) as error:
            self._sources.dropped(Drop.MALFORMED, f"the program on the robot sent {error}")
            self._misbehaves(f"it sent {error}")
            return
        if not self._is_within:
            self._begun_at = None

    @property
    def _is_within(self) -> bool:
        return self._fields.is_within or self._messages.is_within

    # What the robot says

    def _message(self, message: Message, now: float, time_ns: int) -> None:
        if message.type is Type.STATUS:
            self._status(message, now)
        elif message.type is Type.INFORMATION:
            self._information(message, now, time_ns)
        else:
            self._request(message, now)

    def _information(self, message: Message, now: float, time_ns: int) -> None:
        data = self._data.get(message.subtype)
        if data is None:
            known = f"fleet.yaml has {', '.join(self._data) or 'none'}"
            self._sources.dropped(Drop.UNKNOWN_SOURCE, f"the program sends `{message.subtype[:40]}`; {known}")
            return
        if message.subtype == FAULT and not message.data:
            message = message._replace(data=("",))
        values: dict[str, Any] = {}
        for (name, wanted), field in zip(data.types.items(), message.data, strict=False):
            try:
                values[name] = value_of(field, wanted)
            except ValueError as error:
                values[name] = error
        self._sources.read(data, values, now, time_ns)

    def _request(self, message: Message, now: float) -> None:
        if message.subtype not in self._asked_for:
            reason = f"the program asks for `{message.subtype[:40]}`, which `answers` of the bridge does not name"
            self._sources.dropped(Drop.UNKNOWN_SOURCE, reason)
        values = self._asked_for.get(message.subtype) or ()
        answer = Message(Type.INFORMATION, message.subtype, message.number, fields_of(values))
        try:
            self._post(self._outbox.encode(answer), now)
        except SkillRejected as error:
            self._sources.dropped(Drop.CONVERSION, f"{message.subtype}: {error}")
            self._send(answer._replace(data=()), now)

    def _status(self, message: Message, now: float) -> None:
        told = self._told.get(message.number)
        try:
            state = RobotState(message.subtype)
        except ValueError:
            self._sources.dropped(Drop.MALFORMED, f"the program says {message.subtype[:40]!r} of a number")
            return
        said = ended_text(message.data[0]) if message.data else ""
        if told is None or self._executing.get(told.execution_id) is None:
            if state not in (RobotState.UNKNOWN, RobotState.NEVER):
                self._executing.unasked(told.execution_id if told else b"", f"number {message.number}")
            return
        execution_id = told.execution_id
        if state is RobotState.NEVER:
            self._never(message.number, told, now)
            return
        told.asked = max(told.asked - 1, 0)
        if state is RobotState.RUNNING:
            self._ask_at[message.number] = now + ASK_AGAIN_S
            self._executing.progress(execution_id, _fraction(said), "" if _is_number(said) else said)
        elif state is RobotState.DONE:
            self._close(message.number, _results(told.skill, message.data))
        elif state is RobotState.FAILED:
            self._close(message.number, Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said or "the robot says so"))
        elif state is RobotState.REFUSED:
            self._close(message.number, Ended(StatusCode.BAD_REQUEST_NOT_ALLOWED, (), said or "the robot refuses it"))
        elif state is RobotState.BUSY:
            self._close(
                message.number, Ended(StatusCode.BAD_TOO_MANY_OPERATIONS, (), said or "the robot is at another")
            )
        elif state is RobotState.HALTED:
            self._close(message.number, halted(said))
        else:
            self._forget(message.number, told, said or "the program on the robot remembers nothing of it")

    def _never(self, number: int, told: _Told, now: float) -> None:
        """It says that it never heard of a number: it is told, unless that cannot be true."""
        opened = self._executing.get(told.execution_id)
        assert opened is not None, "looked at before"
        if opened.told is not None:
            said = "the program on the robot was at it, and now says that it never heard of it"
            self._contradicted(number, told, said)
        elif told.connection == self._connection:
            if told.stale:  # it answers what it was asked before it was told
                told.stale -= 1
                self._sources.dropped(Drop.UNASKED, "the program answers `never` once more, to an earlier question")
            else:
                said = "the program on the robot was sent it over this connection, and says that it never heard of it"
                self._contradicted(number, told, said)
        elif told.command is not None:
            told.stale = max(told.asked - 1, 0)
            self._tell(number, told.command, now)
        else:
            del self._told[number]
            self._executing.never(told.execution_id)

    def _contradicted(self, number: int, told: _Told, why: str) -> None:
        self._sources.dropped(Drop.MALFORMED, f"number {number}: {why}")
        self._forget(number, told, f"{why}; see what the robot does")

    def _forget(self, number: int, told: _Told, why: str) -> None:
        del self._told[number]
        self._executing.forget(told.execution_id, why)

    def _close(self, number: int, ended: Ended) -> None:
        self._executing.end(self._told[number].execution_id, ended)

    # What the robot is asked to do

    def execute(self, skill: TcpSkill, execution: Execution, now: float) -> None:
        """Tell the robot.

        Raises:
            SkillRejected: an argument is no field.
            RobotBusy: the number is in use.
            RobotOffline: its program is not connected.
        """
        if not self._is_connected and now >= self._offline_since + APPEARS_S:
            raise RobotOffline(_NO_PROGRAM)
        number = self._number(execution.execution_id)
        kind = Type.REQUEST if skill.config.immediate else Type.COMMAND
        command = self._outbox.encode(Message(kind, _subtype(skill), number, fields_of(execution.values)))
        self._executing.begin(skill, execution, now)
        self._told[number] = _Told(skill, execution.execution_id, command, False)
        if self._is_connected:
            self._tell(number, command, now)

    def _tell(self, number: int, command: Encoded, now: float) -> None:
        told = self._told[number]
        told.is_sent, told.connection = True, self._connection
        self._ask_at[number] = now + self._link.answer_timeout_s
        self._post(command, now)

    def query(self, skill: TcpSkill, execution: Execution, now: float) -> None:
        """Ask what became of a number that a bridge before us may have sent."""
        self._executing.begin(skill, execution, now)
        number = number_of(execution.execution_id)
        self._told[number] = _Told(skill, execution.execution_id, None, True)
        self._ask_at[number] = now
        self.turn(now)

    def halt(self, execution: Execution, now: float) -> None:
        """Have the robot stop; raises RobotOffline."""
        number = number_of(execution.execution_id)
        told = self._told.get(number)
        if told is None or self._executing.get(execution.execution_id) is None:
            return
        if not told.is_sent:
            self._executing.end(execution.execution_id, halted("it was halted before the robot was told"))
        elif not self._is_connected:
            raise RobotOffline(_NO_PROGRAM)
        else:
            self._send(Message(Type.HALT, _subtype(told.skill), number), now)

    def inform(self, data: RobotData, values: Sequence[Any], now: float) -> bool:
        """Hand the robot a value; False, after a drop was counted, where that is not possible."""
        if (problem := unfit(data, values)) is not None:
            self._sources.dropped(Drop.CONVERSION, f"{data.label}: {problem}")
            return False
        message = Message(Type.INFORMATION, subtype_of(data), 0, fields_of(values))
        try:
            encoded = self._outbox.encode(message)
        except SkillRejected as error:
            self._sources.dropped(Drop.CONVERSION, f"{data.label}: {error}")
            return False
        if not self._is_connected or not self._post(encoded, now):
            self._sources.dropped(Drop.NOT_CONNECTED, f"{data.label}: {_NO_PROGRAM}")
            return False
        return True

    def _number(self, execution_id: bytes) -> int:
        number = number_of(execution_id)
        told = self._told.get(number)
        if told is not None and self._executing.get(told.execution_id) is not None:
            raise RobotBusy(f"the number {number} is under way; ask again, which gives another one")
        return number

    def _send(self, message: Message, now: float) -> None:
        self._post(self._outbox.encode(message), now)

    def _post(self, encoded: Encoded, now: float) -> bool:
        is_sent = self._outbox.send(encoded, now)
        if self._outbox.is_full:
            self._reset("it does not take what it is sent")
        return is_sent

    # Time

    def turn(self, now: float) -> float | None:
        """Do what is due; when to be called again, None where nothing is open."""
        for opened in self._executing.overdue(now):
            self._give_up(opened, now)
        if not self._is_connected and now >= self._offline_since + APPEARS_S:
            for told in [told for told in self._told.values() if not told.is_sent]:
                if self._executing.get(told.execution_id) is not None:
                    self._executing.end(told.execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), _NO_PROGRAM))
        self._told = {
            number: told for number, told in self._told.items() if self._executing.get(told.execution_id) is not None
        }
        self._ask_at = {number: at for number, at in self._ask_at.items() if number in self._told}
        timeout_s = self._link.answer_timeout_s
        if self._is_connected:
            if self._begun_at is None and self._is_within:
                self._begun_at = now  # not when it was received: to take many messages may have taken long
            if self._outbox.waits_since is not None and now >= self._outbox.waits_since + timeout_s:
                self._reset(f"it acknowledged no field within {timeout_s:g} s")
            elif self._begun_at is not None and now >= self._begun_at + timeout_s:
                self._sources.dropped(Drop.MALFORMED, "the program on the robot stopped in the middle of a message")
                self._misbehaves(f"it stopped in the middle of a message for {timeout_s:g} s")
        if self._is_connected:
            for number, ask_at in self._ask_at.items():
                if now >= ask_at:
                    self._ask_at[number] = now + timeout_s
                    self._told[number].asked += 1
                    self._send(Message(Type.QUERY, _subtype(self._told[number].skill), number), now)
        waiting = self._sources.turn(now)
        return min((at for at in (waiting, self._due()) if at is not None), default=None)

    def _due(self) -> float | None:
        overdue = self._executing.due()
        times = [overdue] if overdue is not None else []
        if self._is_connected:
            times += self._ask_at.values()
            begun = (self._outbox.waits_since, self._begun_at)
            times += [at + self._link.answer_timeout_s for at in begun if at is not None]
        elif any(not told.is_sent for told in self._told.values()):
            times.append(self._offline_since + APPEARS_S)
        return min(times, default=None)

    def _give_up(self, opened: Open, now: float) -> None:
        """The program is told to stop; of one that never answered nobody knows what it did."""
        number = number_of(opened.execution_id)
        told = self._told.get(number)
        can_halt = self._is_connected and told is not None and told.is_sent
        if can_halt and told is not None:
            self._send(Message(Type.HALT, _subtype(told.skill), number), now)
        if told is not None and not told.is_sent:
            self._executing.end(opened.execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), _NO_PROGRAM))
        elif opened.told is None:
            self._executing.forget(opened.execution_id, "the program on the robot never answered; see what it does")
        else:
            self._executing.end(opened.execution_id, opened.too_long(is_halted=can_halt))


def _subtype(skill: TcpSkill) -> str:
    return (skill.via.subtype if skill.via is not None else None) or skill.name


def _is_number(text: str) -> bool:
    try:
        return float(text) == float(text)
    except ValueError:
        return False


def _fraction(text: str) -> float:
    return min(max(float(text), 0.0), 1.0) if _is_number(text) else 0.0


def _results(skill: TcpSkill, data: Sequence[str]) -> Ended:
    values: list[Any] = []
    wanted = skill.config.results
    for index, (name, result) in enumerate(wanted.items()):
        try:
            values.append(value_of(data[index], result.type))
        except (IndexError, ValueError) as error:
            why = "it is missing" if isinstance(error, IndexError) else str(error)
            return Ended(StatusCode.UNCERTAIN, (), f"it is done; its result {name} is not known: {why}")
    return Ended(StatusCode.GOOD, tuple(values), ended_text(data[len(wanted)]) if len(data) > len(wanted) else "")
