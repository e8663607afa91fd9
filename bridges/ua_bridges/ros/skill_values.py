"""Between a skill's values and the messages of a robot: arguments in, conditions and results out. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, NamedTuple

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.mapping import FieldUnfit, cast_scalar, compile_path
from ua_bridges.ros.schema import MessageSchema
from ua_bridges.ros.sink import compile_sink
from ua_bridges.ros.skills import ARGUMENTS, ActionSkill, Constant, ServiceSkill, SkillSpec, StatusTopic, TopicSkill
from ua_fleet.bridge.executing import Ended, ended_text
from ua_fleet.config.schema import SkillConfig
from ua_fleet.errors import ScenarioError, SkillRejected
from ua_fleet.scenario.expression import Expression, Lookup, Value, ValueUnknown, parse_expression
from ua_fleet.values import StatusCode

__all__ = [
    "Condition",
    "Outcome",
    "RequestFiller",
    "ResponseReader",
    "StatusReader",
    "fill_constants",
]

Arguments = Mapping[str, Any]


class RequestFiller:
    """Puts the values of an execution, and the constants, into a message."""

    def __init__(self, spec: SkillSpec, way: TopicSkill | ServiceSkill | ActionSkill, schema: MessageSchema) -> None:
        """Raises ConversionError for an argument or a constant that the message has no place for."""
        fields = [(name, way.fields.get(name, name)) for name in spec.arguments]
        places = [*fields, *((path, path) for path in way.constants)]
        self._constants = tuple(way.constants.values())
        self._write = compile_sink(schema, places)
        self._singles = [(compile_sink(schema, [(path, path)]), value) for path, value in way.constants.items()]

    def check(self, message: Any) -> None:
        """Raise ConversionError for a constant that does not fit its place."""
        for write, value in self._singles:
            write(message, (value,))

    def fill(self, message: Any, values: Sequence[Any]) -> Any:
        """The message with the values in it.

        Raises:
            SkillRejected: a value does not fit its place.
        """
        try:
            self._write(message, (*values, *self._constants))
        except ConversionError as error:
            raise SkillRejected(f"the robot's message cannot hold that: {error}") from error
        return message


def fill_constants(schema: MessageSchema, constants: Mapping[str, Constant], message: Any) -> Any:
    """A message with constants in it; raises ConversionError."""
    compile_sink(schema, [(path, path) for path in constants])(message, tuple(constants.values()))
    return message


def _plain(value: Any, name: str) -> Value:
    if isinstance(value, bool | str):
        return value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    if isinstance(value, bytes | bytearray) and len(value) == 1:
        return value[0]  # rclpy's form of a `byte`
    raise ValueUnknown(f"{name} is a {type(value).__name__}, neither a number nor a text")


class Condition:
    """An expression over the members of a message and `arguments.<name>`."""

    def __init__(self, text: str, arguments: Sequence[str], sample: Any) -> None:
        """`sample` is an empty message; raises ConversionError where a name is neither a member nor an argument."""
        self._expression: Expression = parse_expression(text)
        self._follow: dict[str, Callable[[Any], Any]] = {}
        for name in sorted(self._expression.names):
            if name.startswith(ARGUMENTS):
                if name.removeprefix(ARGUMENTS) not in arguments:
                    raise ConversionError(name, f"{text!r}: the skill has no such argument")
                continue
            self._follow[name] = follow = compile_path(name)
            try:
                _plain(follow(sample), name)
            except FieldUnfit as unfit:
                raise ConversionError(name, f"{text!r}: {unfit.reason}") from None
            except ValueUnknown as error:
                raise ConversionError(name, f"{text!r}: {error}") from None

    def _lookup(self, message: Any, arguments: Arguments) -> Lookup:
        def lookup(name: str) -> Value:
            if name.startswith(ARGUMENTS):
                return _plain(arguments[name.removeprefix(ARGUMENTS)], name)
            try:
                return _plain(self._follow[name](message), name)
            except FieldUnfit as unfit:
                raise ValueUnknown(unfit.reason) from None

        return lookup

    def holds(self, message: Any, arguments: Arguments) -> bool:
        """Whether it is true; raises ValueUnknown where that cannot be said."""
        return self._expression.holds(self._lookup(message, arguments))

    def fraction(self, message: Any, arguments: Arguments) -> float | None:
        """Its value as a number from 0 to 1, None where it is none."""
        try:
            value = self._expression.value(self._lookup(message, arguments))
        except ScenarioError:
            return None
        if isinstance(value, str) or math.isnan(value):
            return None
        return min(max(float(value), 0.0), 1.0)


class ResponseReader:
    """Reads how an execution ended, and its results, out of a message."""

    def __init__(
        self,
        spec: SkillSpec,
        way: ServiceSkill | ActionSkill | StatusTopic,
        success: str | None,
        sample: Any,
    ) -> None:
        """`sample` is an empty message; raises ConversionError where it lacks what is read."""
        self._config: SkillConfig = spec.config
        self._success = Condition(success, spec.arguments, sample) if success is not None else None
        self._results = [
            (name, compile_path(way.results.get(name, name)), result.type)
            for name, result in spec.config.results.items()
        ]
        self._message = compile_path(way.message) if way.message is not None else None
        for name, follow, _type in self._results:
            _check_place(name, follow, sample)
        if way.message is not None and self._message is not None:
            _check_place(way.message, self._message, sample)

    def text(self, message: Any) -> str:
        """The robot's own words."""
        try:
            return ended_text(str(self._message(message))) if self._message is not None else ""
        except FieldUnfit:
            return ""

    def read(self, message: Any, arguments: Arguments) -> Ended:
        """The end that the message tells."""
        said = self.text(message)
        if self._success is not None:
            try:
                if not self._success.holds(message, arguments):
                    return Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said or "the robot says that it failed")
            except ValueUnknown as error:
                return Ended(StatusCode.BAD_TYPE_MISMATCH, (), f"whether it succeeded cannot be said: {error}")
        return self.done(message, said)

    def done(self, message: Any, said: str) -> Ended:
        """The end of what has succeeded, with its results."""
        values: list[Any] = []
        for name, follow, wanted in self._results:
            try:
                values.append(cast_scalar(follow(message), wanted))
            except FieldUnfit as unfit:
                return Ended(StatusCode.UNCERTAIN, (), f"it is done; its result {name} is not known: {unfit.reason}")
        return Ended(StatusCode.GOOD, tuple(values), said)


def _check_place(name: str, follow: Callable[[Any], Any], sample: Any) -> None:
    try:
        follow(sample)
    except FieldUnfit as unfit:
        if unfit.status != StatusCode.BAD_OUT_OF_RANGE:  # an array that is empty now may hold it later
            raise ConversionError(name, unfit.reason) from None


class Outcome(NamedTuple):
    """What one message on a status topic says of an execution."""

    ended: Ended | None = None
    progress: float | None = None


class StatusReader:
    """Judges the messages of a status topic."""

    def __init__(self, spec: SkillSpec, status: StatusTopic, sample: Any) -> None:
        """`sample` is an empty message; raises ConversionError where it lacks what is read."""

        def condition(text: str | None) -> Condition | None:
            return Condition(text, spec.arguments, sample) if text is not None else None

        self._reader = ResponseReader(spec, status, None, sample)
        self._done, self._failed = condition(status.done), condition(status.failed)
        self._running, self._progress = condition(status.running), condition(status.progress)
        self._halted = condition(status.halted)

    def runs(self, message: Any, arguments: Arguments) -> bool:
        """Whether the robot is at it; raises ValueUnknown."""
        return self._running is None or self._running.holds(message, arguments)

    def stands(self, message: Any, arguments: Arguments) -> bool:
        """Whether the robot, which was at it and was told to stop, is not at it any more; raises ValueUnknown."""
        if self._halted is not None and self._halted.holds(message, arguments):
            return True
        return self._running is not None and not self._running.holds(message, arguments)

    def judge(self, message: Any, arguments: Arguments) -> Outcome:
        """What the message says; raises ValueUnknown where that cannot be said."""
        if self._failed is not None and self._failed.holds(message, arguments):
            said = self._reader.text(message) or "the robot says that it failed"
            return Outcome(Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), said))
        assert self._done is not None
        if self._done.holds(message, arguments):
            return Outcome(self._reader.done(message, self._reader.text(message)))
        return Outcome(None, self._progress.fraction(message, arguments) if self._progress is not None else 0.0)
