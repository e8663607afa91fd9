"""What is said on a serial port: lines that are heard, questions, and commands. Pure.

The port is listened to only while something on it is needed: a sensor, or the answer to a command. What the device said
before is thrown away then, with the line in whose middle it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from ua_bridges.plugged.config import MESSAGE, PluggedSink, PluggedSkill, SerialSettings
from ua_bridges.plugged.data import Put, as_type
from ua_bridges.plugged.sensor import Sensor
from ua_fleet.bridge.configured import ConfiguredData, ConfiguredSkill
from ua_fleet.bridge.driver import Dropped, Execution
from ua_fleet.bridge.executing import Ended, Executing, Open, ended_text, halted
from ua_fleet.bridge.templates import AnswerPattern, CommandTemplate, Language
from ua_fleet.config.base import ScalarType
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline, SkillRejected
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

__all__ = ["LONGEST_LINE", "MOST_LINES", "Lines", "NewestKey", "PluggedSkillSpec"]

LONGEST_LINE: Final = 4096
MOST_LINES: Final = 64
"""Lines that are looked at of one reading, which has 4 KiB: of a flood the latest, the others are counted."""
MOST_LONG: Final = 10
"""So many lines in a row that are too long, and the device is put aside."""
ANSWER_S: Final = 1.0
"""One question is asked at a time; without an answer the next one comes after so long."""
_MOST_TOLD: Final = 20

PluggedSkillSpec = ConfiguredSkill[PluggedSkill]
NewestKey = Topic | bytes
"""Of a line that a newer one may replace before it is sent: whose value it is, or the question itself."""


class _Command(NamedTuple):
    """A skill, ready to be written."""

    skill: PluggedSkillSpec
    command: CommandTemplate
    done: AnswerPattern | None
    failed: AnswerPattern | None
    halt: CommandTemplate | None
    halted: AnswerPattern | None


def _compile(skill: PluggedSkillSpec) -> _Command:
    via = skill.via
    assert via is not None
    assert via.command is not None
    arguments = {name: given.type for name, given in skill.config.arguments.items()}
    results = {name: given.type for name, given in skill.config.results.items()}
    plain = Language.PLAIN
    return _Command(
        skill,
        CommandTemplate(via.command, arguments, plain),
        AnswerPattern(via.done, results, plain) if via.done is not None else None,
        AnswerPattern(via.failed, {MESSAGE: ScalarType.STRING}, plain) if via.failed is not None else None,
        CommandTemplate(via.halt, arguments, plain) if via.halt is not None else None,
        AnswerPattern(via.halted, {}, plain) if via.halted is not None else None,
    )


class _Source:
    """A sensor on the port."""

    def __init__(self, sensor: Sensor, encoding: str) -> None:
        source = sensor.source
        assert source.line is not None
        self.sensor = sensor
        self.pattern = AnswerPattern(source.line, sensor.data.types, Language.PLAIN)
        self.ask = source.ask.encode(encoding) if source.ask is not None else None
        self.ask_at: float | None = None
        """When it is to be asked next; None: it has not been needed."""


class Lines:
    """One serial port.

    `write` sends a command, False: it did not; `write_newest` a value or a question, behind all commands; `reset`
    closes and opens the port for a reason; `listen` sees `listens`; `put_aside` closes it for a while, since the device
    misbehaves.
    """

    def __init__(
        self,
        device: str,
        settings: SerialSettings,
        sensors: Sequence[Sensor],
        skills: Sequence[PluggedSkillSpec],
        sinks: Sequence[ConfiguredData[PluggedSink]],
        put: Put,
        executing: Executing,
        write: Callable[[bytes], bool],
        write_newest: Callable[[NewestKey, bytes], bool],
        reset: Callable[[str], None],
        listen: Callable[[], None],
        put_aside: Callable[[str], None],
    ) -> None:
        self._device, self._settings = device, settings
        self._put, self._executing = put, executing
        self._write, self._write_newest = write, write_newest
        self._reset, self._listen, self._put_aside = reset, listen, put_aside
        self._terminator = settings.terminator.encode("ascii")
        self._sources = [_Source(sensor, settings.encoding) for sensor in sensors]
        self._commands = {skill.topic: _compile(skill) for skill in skills}
        self._sinks = {
            data.topic: (data, CommandTemplate(data.side.command, data.types, Language.PLAIN))
            for data in sinks
            if data.side.command is not None
        }
        self._gone = f"{device} was pulled out, or failed, before it was written to; plug it in, and ask again"
        self._asked: tuple[_Source, float] | None = None
        """Who was asked last, and until when an answer is waited for."""
        self._awaiting: tuple[_Command, Execution] | None = None
        self._left = b""
        self._skips_line = False
        self._long = 0
        """Bytes without the end of a line, in longest lines."""
        self._is_open = False
        self._told: set[str] = set()

    @property
    def is_open(self) -> bool:
        """Whether the port is."""
        return self._is_open

    @property
    def listens(self) -> bool:
        """Whether anything that the device says is needed."""
        return self._awaiting is not None or any(source.sensor.is_needed for source in self._sources)

    # The port

    def opened(self, now: float, time_ns: int) -> None:
        """The port is open."""
        self._is_open, self._left, self._asked, self._long = True, b"", None, 0
        self._told.clear()
        for source in self._sources:
            source.ask_at = None
            source.sensor.plugged(now, time_ns)

    def closed(self, why: str, now: float) -> None:
        """The port is gone. What was not answered yet, nobody knows."""
        self._is_open, self._left = False, b""
        for source in self._sources:
            source.sensor.unplugged(why, now)
        if self._awaiting is not None:
            execution_id = self._awaiting[1].execution_id
            self._awaiting = None
            if self._executing.get(execution_id) is not None:
                self._executing.forget(execution_id, f"{why} before it answered; see what it did")

    def begin_listening(self) -> None:
        """What was said before has been thrown away, as a rule in the middle of a line."""
        self._left = b""
        self._skips_line = any(source.ask is None and source.sensor.is_needed for source in self._sources)

    def received(self, data: bytes, now: float, time_ns: int) -> None:
        """Bytes from the device."""
        *lines, self._left = (self._left + data).split(self._terminator)
        if lines:
            self._long = 0
        if self._skips_line and lines:
            self._skips_line = False
            self._answers(self._text(lines.pop(0)))  # half a line of a sensor; but an answer is whole
        if len(self._left) > LONGEST_LINE:
            self._dropped(Drop.MALFORMED, f"it says a line of more than {LONGEST_LINE} bytes; see port.terminator")
            self._left, self._skips_line = self._left[-len(self._terminator) :], True
            self._long += 1
            if self._long >= MOST_LONG:
                self._put_aside(f"more than {MOST_LONG * LONGEST_LINE} bytes without the end of a line")
                return
        if len(lines) > MOST_LINES:
            flood, lines = lines[:-MOST_LINES], lines[-MOST_LINES:]
            # The answer to a command comes once.
            answered = sum(self._awaiting is not None and self._answers(self._text(raw)) for raw in flood)
            self._dropped(Drop.RATE_LIMITED, "it says more lines than can be looked at", len(flood) - answered)
        for raw in lines:
            self._line(self._text(raw), now, time_ns)

    def _text(self, raw: bytes) -> str:
        return raw.decode(self._settings.encoding, "replace").strip("\r")

    def _line(self, line: str, now: float, time_ns: int) -> None:
        if not line or self._answers(line):
            return
        for source in self._sources:
            if not source.sensor.is_needed:
                continue
            values = source.pattern.match(line)
            if values is not None:
                if self._asked is not None and self._asked[0] is source:
                    self._asked = None
                source.sensor.take(values, now, time_ns)
                return
        if not any(source.pattern.match(line) is not None for source in self._sources):
            self._dropped(Drop.UNASKED, "it says what no pattern in fleet.yaml expects")

    def _answers(self, line: str) -> bool:
        if self._awaiting is None:
            return False
        command, execution = self._awaiting
        opened = self._executing.get(execution.execution_id)
        is_told_to_stop = opened is not None and opened.is_told_to_stop
        if is_told_to_stop and command.halted is not None and command.halted.match(line) is not None:
            ended = halted()
        elif command.failed is not None and (values := command.failed.match(line)) is not None:
            said = ended_text(str(values.get(MESSAGE, "")))
            failed = Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said or "the device says that it failed")
            ended = halted(said) if is_told_to_stop else failed
        elif command.done is not None and (values := command.done.match(line)) is not None:
            ended = _done(command.skill, values)
        else:
            return False
        self._awaiting = None
        self._executing.end(execution.execution_id, ended)
        return True

    def _dropped(self, cause: Drop, detail: str, count: int = 1) -> None:
        is_new = detail not in self._told and len(self._told) < _MOST_TOLD
        if is_new:
            self._told.add(detail)
        self._put(Dropped(cause, count, f"{self._device}: {detail}" if is_new else ""))

    # What is asked and written

    def read(self, sensor: Sensor, now: float) -> None:
        """A reading waits: ask at once where it has to be asked."""
        for source in self._sources:
            if source.sensor is sensor:
                source.ask_at = now

    def execute(self, skill: PluggedSkillSpec, execution: Execution, now: float) -> None:
        """Write the command.

        Raises:
            SkillRejected: an argument cannot be written.
            RobotBusy: the device is at another command.
            RobotOffline: the port is not open.
        """
        command = self._commands[skill.topic]
        if not self._is_open:
            raise RobotOffline(f"{self._device} is not plugged in; plug it in, and see the bridge's status")
        if command.done is not None and self._awaiting is not None:
            said = f"{self._device} has not answered {self._awaiting[0].skill.label} yet; ask again when it has"
            raise RobotBusy(said)
        data = self._encoded(command.command.render(_arguments(skill, execution)))
        self._executing.begin(skill, execution, now)
        if command.done is not None:
            self._awaiting = (command, execution)
            self._executing.progress(execution.execution_id, 0.0)
            self._listen()
        if not self._write(data):
            if command.done is not None:
                self._awaiting = None
            self._executing.end(execution.execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), self._gone))
        elif command.done is None:
            self._executing.end(execution.execution_id, Ended(StatusCode.GOOD, (), "it was sent to the device"))

    def halt(self, execution: Execution, now: float) -> None:
        """Write the command that stops it. Its end is what the device says then.

        Raises:
            SkillRejected: there is none.
            RobotOffline: the port is not open.
        """
        command = self._commands[execution.topic]
        if command.halt is None:
            raise SkillRejected(f"{command.skill.label} cannot be stopped: it has no `halt`")
        if not self._is_open:
            raise RobotOffline(f"{self._device} is not plugged in")
        if not self._write(self._encoded(command.halt.render(_arguments(command.skill, execution)))):
            raise RobotOffline(self._gone)
        self._executing.told_to_stop(execution.execution_id, now)

    def _end(self, execution_id: bytes, ended: Ended | None) -> bool:
        """A command is over without an answer (None: nobody knows how), which must not be taken for the next one's.

        False where none was.
        """
        if self._awaiting is None or self._awaiting[1].execution_id != execution_id:
            return False
        command, self._awaiting = self._awaiting[0], None
        if ended is None:
            self._executing.forget(execution_id)
        else:
            self._executing.end(execution_id, ended)
        self._reset(f"{command.skill.label} is over without an answer, which may still come")
        return True

    def overdue(self, opened: Open) -> bool:
        """A command has taken too long: it is stopped where that is possible. False where it is none of these."""
        if self._awaiting is None or self._awaiting[1].execution_id != opened.execution_id:
            return False
        if opened.is_told_to_stop:
            return self._end(opened.execution_id, None)
        command, execution = self._awaiting
        can_halt = command.halt is not None and self._is_open
        if can_halt and command.halt is not None:
            self._write(self._encoded(command.halt.render(_arguments(command.skill, execution))))
        return self._end(opened.execution_id, opened.too_long(is_halted=can_halt, otherwise="see what the device does"))

    def inform(self, topic: Topic, values: Sequence[Any]) -> bool:
        """Hand the device a value; False, after a drop was counted, where that is not possible."""
        data, template = self._sinks[topic]
        fitting = {
            name: as_type(name, kind, value) for (name, kind), value in zip(data.types.items(), values, strict=True)
        }
        try:
            for value in fitting.values():
                if isinstance(value, ValueError):
                    raise SkillRejected(str(value))
            written = self._encoded(template.render(fitting))
        except SkillRejected as error:
            self._dropped(Drop.CONVERSION, f"{data.label}: {error}")
            return False
        if not self._is_open:
            self._dropped(Drop.NOT_CONNECTED, f"{data.label}: the device is not plugged in")
            return False
        if not self._write_newest(topic, written):
            self._dropped(Drop.NOT_CONNECTED, f"{data.label}: {self._gone}")
            return False
        return True

    def overtaken(self, key: NewestKey) -> None:
        """A newer line is sent in the place of one that waited."""
        if isinstance(key, Topic):  # a question is the same one
            label = self._sinks[key][0].label
            self._dropped(
                Drop.RATE_LIMITED, f"{label}: values come faster than the line takes them; the newest is sent"
            )

    def never_sent(self, key: NewestKey) -> None:
        """The port is over, and a line still waited."""
        if isinstance(key, Topic):
            self._dropped(Drop.NOT_CONNECTED, f"{self._sinks[key][0].label}: {self._gone}")

    def writes(self, topic: Topic) -> bool:
        """Whether data goes to this port."""
        return topic in self._sinks

    def does(self, topic: Topic) -> bool:
        """Whether a skill is a command for this port."""
        return topic in self._commands

    def _encoded(self, text: str) -> bytes:
        try:
            return text.encode(self._settings.encoding)
        except UnicodeEncodeError:
            raise SkillRejected(f"{text[:60]!r} cannot be written in {self._settings.encoding}") from None

    # Time

    def turn(self, now: float) -> float | None:
        """Do what is due; when to be called again, None where nothing is open."""
        times = [source.sensor.turn(now) for source in self._sources]
        if not self._is_open:
            return min((at for at in times if at is not None), default=None)
        if self._asked is not None and now >= self._asked[1]:
            self._asked = None
        for source in self._sources:
            if source.ask is None:
                continue
            if not source.sensor.is_needed:
                source.ask_at = None
                continue
            if source.ask_at is None:
                source.ask_at = now
            if now >= source.ask_at and self._asked is None:
                period_s = source.sensor.source.period_s
                source.ask_at = now + period_s
                self._asked = (source, now + min(ANSWER_S, period_s))
                self._write_newest(source.ask, source.ask)
            times.append(source.ask_at if self._asked is None else max(source.ask_at, self._asked[1]))
        return min((at for at in times if at is not None), default=None)


def _arguments(skill: PluggedSkillSpec, execution: Execution) -> Mapping[str, Any]:
    return dict(zip(skill.arguments, execution.values, strict=True))


def _done(skill: PluggedSkillSpec, values: Mapping[str, Any]) -> Ended:
    results: list[Any] = []
    for name, result in skill.config.results.items():
        value = as_type(name, result.type, values[name])
        if isinstance(value, ValueError):
            return Ended(StatusCode.UNCERTAIN, (), f"it is done; its result {name} is not known: {value}")
        results.append(value)
    return Ended(StatusCode.GOOD, tuple(results), "")
