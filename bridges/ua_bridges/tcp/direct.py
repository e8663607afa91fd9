"""Commands in the robot's own language, and the lines that it answers. Pure.

A line rarely says which command it answers, so one command that is answered is under way at a time. After a timeout,
and after a halt that another line than `halted` has answered, the connection is made anew, unless all lines have
`{number}`: an answer that still comes cannot be taken for the next one's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from ua_bridges.tcp.config import (
    MESSAGE,
    NUMBER,
    DirectLink,
    DirectSink,
    DirectSkill,
    DirectSource,
    TcpSink,
    TcpSkillMapping,
    TcpSource,
)
from ua_bridges.tcp.data import Put, RobotData, Sources, unfit
from ua_bridges.tcp.link import APPEARS_S
from ua_bridges.tcp.messages import number_of
from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.bridge.driver import Execution
from ua_fleet.bridge.executing import Ended, Executing, ended_text, halted
from ua_fleet.bridge.templates import AnswerPattern, CommandTemplate
from ua_fleet.config.base import ScalarType
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline, SkillRejected
from ua_fleet.fleet.skills import ArgumentModel, argument_problem
from ua_fleet.values import StatusCode

__all__ = ["DirectSession"]

LONGEST_LINE: Final = 4096
MOST_LINES: Final = 256
"""Lines that are looked at of one reading, which has 64 KiB: of a flood the latest, the others are counted."""
MISSED_ANSWERS: Final = 3
"""A source that is asked and silent for so many periods is lost."""
LEAST_SILENCE_S: Final = 2.0
_OFFLINE: Final = "the robot takes no connection for commands; see that it is on and in remote control"
_BROKEN: Final = "the connection broke before the command was sent; ask again when the robot is connected"
TcpSkill = ConfiguredSkill[TcpSkillMapping]


class _Command(NamedTuple):
    """A skill, ready to be sent."""

    skill: TcpSkill
    command: CommandTemplate
    done: AnswerPattern | None
    failed: AnswerPattern | None
    halt: CommandTemplate | None
    halted: AnswerPattern | None

    @property
    def is_numbered(self) -> bool:
        """Whether each line that may answer it says which execution it means."""
        lines = [line for line in (self.done, self.failed, self.halted) if line is not None]
        return all(NUMBER in line.names for line in lines)


def _compile(skill: TcpSkill, via: DirectSkill, link: DirectLink) -> _Command:
    number = {NUMBER: ScalarType.INT32}
    arguments = {**number, **{name: given.type for name, given in skill.config.arguments.items()}}
    results = {**number, **{name: given.type for name, given in skill.config.results.items()}}
    failed = {**number, MESSAGE: ScalarType.STRING}
    return _Command(
        skill,
        CommandTemplate(via.command, arguments, link.language),
        AnswerPattern(via.done, results, link.language) if via.done is not None else None,
        AnswerPattern(via.failed, failed, link.language) if via.failed is not None else None,
        CommandTemplate(via.halt, arguments, link.language) if via.halt is not None else None,
        AnswerPattern(via.halted, number, link.language) if via.halted is not None else None,
    )


class _Source:
    """A line that the robot says."""

    def __init__(self, data: RobotData, source: DirectSource, link: DirectLink) -> None:
        self.data = data
        self.pattern = AnswerPattern(source.line, data.types, link.language)
        self.ask = source.ask.encode(link.encoding) if source.ask is not None else None
        self.period_s = source.period_s
        self.ask_at = 0.0
        self.heard_at = 0.0


class DirectSession:
    """One robot's command socket.

    `write` sends bytes, False: it did not; `reset` ends the connection for a reason; `misbehaves` does so for a while.
    """

    def __init__(
        self,
        link: DirectLink,
        skills: Sequence[TcpSkill],
        data: Sequence[RobotData],
        put: Put,
        write: Callable[[bytes], bool],
        reset: Callable[[str], None],
        misbehaves: Callable[[str], None],
        now: float,
    ) -> None:
        self._link, self._write, self._reset, self._misbehaves = link, write, reset, misbehaves
        self._terminator = link.terminator.encode("ascii")
        self._commands = {
            skill.topic: _compile(skill, skill.via.direct, link)
            for skill in skills
            if skill.via is not None and skill.via.direct is not None
        }
        self._is_numbered = all(command.is_numbered for command in self._commands.values())
        """Whether no late answer can be taken for that of another command, of the same skill or another one."""
        self._own = [
            _Source(each, each.side.direct, link)
            for each in data
            if isinstance(each.side, TcpSource) and each.side.direct is not None
        ]
        self._sinks: dict[Any, tuple[RobotData, CommandTemplate]] = {
            each.topic: (each, CommandTemplate(direct.command, each.types, link.language))
            for each in data
            if isinstance(each.side, TcpSink) and isinstance(direct := each.side.direct, DirectSink)
        }
        self._sources = Sources(put)
        self._executing = Executing(put)
        self._awaiting: tuple[_Command, Execution] | None = None
        self._halts_sent = 0
        """How often what is awaited was told to stop."""
        self._waiting: tuple[_Command, Execution, bytes] | None = None
        """What was begun while the robot was not connected."""
        self._left = b""
        self._is_connected = False
        self._offline_since = now

    @property
    def is_connected(self) -> bool:
        """Whether the robot takes commands."""
        return self._is_connected

    # The connection

    def connected(self, now: float) -> None:
        """The robot takes commands."""
        self._is_connected, self._left = True, b""
        for source in self._own:
            source.ask_at = source.heard_at = now
            self._sources.found(source.data)
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            if self._executing.get(waiting[1].execution_id) is not None:
                self._tell(*waiting)
        self.turn(now)

    def lost(self, now: float) -> None:
        """The connection is gone. What was not answered yet, nobody knows."""
        self._is_connected, self._offline_since = False, now
        if self._left.strip():
            self._sources.dropped(Drop.MALFORMED, "the connection ended in the middle of a line")
        self._left = b""
        self._sources.all_lost()
        if self._awaiting is not None:
            execution_id = self._awaiting[1].execution_id
            self._awaiting = None
            if self._executing.get(execution_id) is not None:
                self._executing.forget(
                    execution_id, "the connection was lost before the robot answered; see what it does"
                )

    def received(self, data: bytes, now: float, time_ns: int) -> None:
        """Bytes from the robot."""
        *lines, self._left = (self._left + data).split(self._terminator)
        if len(lines) > MOST_LINES:
            flood, lines = lines[:-MOST_LINES], lines[-MOST_LINES:]
            answered = sum(self._awaiting is not None and self._answers(self._text(raw)) for raw in flood)
            said = "the robot says more lines than can be looked at"
            self._sources.dropped(Drop.RATE_LIMITED, said, len(flood) - answered)
        for position, raw in enumerate(lines):
            if not self._is_connected:  # the line before has ended it; what came with that is nobody's answer
                if after := sum(bool(late.strip()) for late in lines[position:]):
                    self._sources.dropped(Drop.UNASKED, "the robot said more after a halt that crossed an end", after)
                break
            self._line(self._text(raw), now, time_ns)
        if len(self._left) > LONGEST_LINE:
            self._sources.dropped(Drop.MALFORMED, f"the robot sends a line of more than {LONGEST_LINE} bytes")
            self._left = b""
            self._misbehaves("it sends a line without end; see direct.terminator")

    def _text(self, raw: bytes) -> str:
        return raw.decode(self._link.encoding, "replace").strip("\r")

    def _line(self, line: str, now: float, time_ns: int) -> None:
        if self._answers(line):
            return
        for source in self._own:
            if (values := source.pattern.match(line)) is not None:
                source.heard_at = now
                self._sources.found(source.data)
                self._sources.read(source.data, _checked(source.data, values), now, time_ns)
                return
        if line:
            self._sources.dropped(Drop.UNASKED, "the robot says what no pattern in fleet.yaml expects")

    def _answers(self, line: str) -> bool:
        if self._awaiting is None:
            return False
        command, execution = self._awaiting
        number, opened = number_of(execution.execution_id), self._executing.get(execution.execution_id)
        is_told_to_stop = opened is not None and opened.is_told_to_stop
        for pattern in (command.halted if is_told_to_stop else None, command.failed, command.done):
            values = pattern.match(line) if pattern is not None else None
            if values is None:
                continue
            if values.get(NUMBER, number) != number:
                self._executing.unasked(b"", command.skill.label)
                return True
            said = ended_text(str(values.get(MESSAGE, "")))
            if pattern is command.done:
                ended = _done(command.skill, values)
            elif is_told_to_stop:
                ended = halted(said)
            else:
                ended = Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said or "the robot says that it failed")
            self._awaiting = None
            self._executing.end(execution.execution_id, ended)
            if is_told_to_stop and not self._is_numbered and not self._answers_halt(command, line):
                self._halt_crossed(command)
            return True
        return False

    def _answers_halt(self, command: _Command, line: str) -> bool:
        """Whether a line is the answer to the halt for sure, so that no other one is to come."""
        lines = (command.halted, command.failed, command.done)
        is_halted, *is_other = (pattern is not None and pattern.match(line) is not None for pattern in lines)
        return self._halts_sent == 1 and is_halted and not any(is_other)

    def _halt_crossed(self, command: _Command) -> None:
        """It ended by itself as it was told to stop. The robot's answer to that would be taken for the next one's."""
        why = f"{command.skill.label} ended as it was told to stop, and the robot's answer to that may still come"
        self._sources.dropped(Drop.UNASKED, f"{why}; the bridge connects anew")
        self._reset(why)

    # What the robot is asked to do

    def execute(self, skill: TcpSkill, execution: Execution, now: float) -> None:
        """Send the command.

        Raises:
            SkillRejected: an argument cannot be written.
            RobotBusy: it is at another command.
            RobotOffline: it takes no connection.
        """
        if not self._is_connected and now >= self._offline_since + APPEARS_S:
            raise RobotOffline(_OFFLINE)
        command = self._commands[skill.topic]
        busy = self._waiting or (self._awaiting if command.done is not None else None)
        if busy is not None:
            raise RobotBusy(f"the robot has not answered {busy[0].skill.label} yet; ask again when it has")
        data = self._encoded(command.command.render(_arguments(skill, execution)))
        self._executing.begin(skill, execution, now)
        if self._is_connected:
            self._tell(command, execution, data)
        else:
            self._waiting = (command, execution, data)

    def _tell(self, command: _Command, execution: Execution, data: bytes) -> None:
        if not self._write(data):
            self._executing.end(execution.execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), _BROKEN))
        elif command.done is not None:
            self._awaiting, self._halts_sent = (command, execution), 0
            self._executing.progress(execution.execution_id, 0.0)
        else:
            self._executing.end(execution.execution_id, Ended(StatusCode.GOOD, (), "it was sent to the robot"))

    def query(self, skill: TcpSkill, execution: Execution, now: float) -> None:
        """A robot in direct mode remembers nothing that could be asked for."""
        self._executing.begin(skill, execution, now)
        said = "a robot in direct mode cannot be asked; see what it does"
        self._executing.forget(execution.execution_id, said)

    def halt(self, execution: Execution, now: float) -> None:
        """Send the command that stops it. Its end is what the robot says then.

        Raises:
            SkillRejected: there is none; or it has ended, and the next one would be stopped.
            RobotOffline: the robot takes no connection.
        """
        if self._waiting is not None and self._waiting[1].execution_id == execution.execution_id:
            self._waiting = None
            self._ended(execution.execution_id, halted())
            return
        if not self._is_connected:
            raise RobotOffline(_OFFLINE)
        if self._executing.get(execution.execution_id) is None:
            raise SkillRejected("that execution is not under way")
        command = self._commands[execution.topic]
        if command.halt is None:
            raise SkillRejected(f"{command.skill.label} cannot be stopped: it has no `halt`")
        if not self._write(self._encoded(command.halt.render(_arguments(command.skill, execution)))):
            raise RobotOffline(_BROKEN)
        self._halts_sent += 1
        self._executing.told_to_stop(execution.execution_id, now)

    def _ended(self, execution_id: bytes, ended: Ended | None) -> None:
        """It is over without an answer, None: nobody knows. What comes later must not be taken for another's."""
        if self._executing.get(execution_id) is None:
            return
        if ended is None:
            self._executing.forget(execution_id)
        else:
            self._executing.end(execution_id, ended)
        if self._awaiting is not None and self._awaiting[1].execution_id == execution_id:
            command, self._awaiting = self._awaiting[0], None
            if not self._is_numbered:
                self._reset(f"{command.skill.label} is over without an answer, which may still come")

    def inform(self, topic: Any, values: Sequence[Any]) -> bool:
        """Hand the robot a value; False, after a drop was counted, where that is not possible."""
        data, template = self._sinks[topic]
        if (problem := unfit(data, values)) is not None:
            self._sources.dropped(Drop.CONVERSION, f"{data.label}: {problem}")
            return False
        try:
            written = self._encoded(template.render(dict(zip(data.types, values, strict=True))))
        except SkillRejected as error:
            self._sources.dropped(Drop.CONVERSION, f"{data.label}: {error}")
            return False
        if not self._is_connected or not self._write(written):
            self._sources.dropped(Drop.NOT_CONNECTED, f"{data.label}: {_OFFLINE}")
            return False
        return True

    def writes(self, topic: Any) -> bool:
        """Whether data goes to the robot as a command."""
        return topic in self._sinks

    def _encoded(self, text: str) -> bytes:
        try:
            return text.encode(self._link.encoding)
        except UnicodeEncodeError:
            raise SkillRejected(f"{text[:60]!r} cannot be written in {self._link.encoding}") from None

    # Time

    def turn(self, now: float) -> float | None:
        """Do what is due; when to be called again, None where nothing is open."""
        if self._waiting is not None and not self._is_connected and now >= self._offline_since + APPEARS_S:
            waiting, self._waiting = self._waiting, None
            self._ended(waiting[1].execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), _OFFLINE))
        for opened in self._executing.overdue(now):
            if opened.is_told_to_stop:
                self._ended(opened.execution_id, None)
                continue
            awaiting = self._awaiting
            can_halt = awaiting is not None and awaiting[0].halt is not None and self._is_connected
            if can_halt and awaiting is not None and awaiting[0].halt is not None:
                self._write(self._encoded(awaiting[0].halt.render(_arguments(awaiting[0].skill, awaiting[1]))))
            self._ended(opened.execution_id, opened.too_long(is_halted=can_halt))
        times = [at for at in (self._executing.due(), self._sources.turn(now)) if at is not None]
        if self._waiting is not None:
            times.append(self._offline_since + APPEARS_S)
        if self._is_connected:
            for source in self._own:
                if source.ask is None:
                    continue
                if now >= source.ask_at:
                    source.ask_at = max(source.ask_at + source.period_s, now)
                    self._write(source.ask)
                if now >= source.heard_at + max(MISSED_ANSWERS * source.period_s, LEAST_SILENCE_S):
                    self._sources.lost(source.data)
                times.append(source.ask_at)
        return min(times, default=None)


def _arguments(skill: TcpSkill, execution: Execution) -> Mapping[str, Any]:
    given = dict(zip(skill.arguments, execution.values, strict=True))
    return {NUMBER: number_of(execution.execution_id), **given}


def _checked(data: RobotData, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values, with a ValueError in place of what the type of its field cannot hold."""
    checked: dict[str, Any] = {}
    for name, value in values.items():
        problem = argument_problem(ArgumentModel(name, int(data.types[name].builtin)), value)
        checked[name] = ValueError(problem) if problem is not None else value
    return checked


def _done(skill: TcpSkill, values: Mapping[str, Any]) -> Ended:
    results: list[Any] = []
    for name, result in skill.config.results.items():
        if (problem := argument_problem(ArgumentModel(name, int(result.type.builtin)), values[name])) is not None:
            return Ended(StatusCode.UNCERTAIN, (), f"it is done; its result {name} is not known: {problem}")
        results.append(values[name])
    return Ended(StatusCode.GOOD, tuple(results), "")
