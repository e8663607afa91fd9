"""Configuration of a TCP bridge in `fleet.yaml`.

Two ways lead to a robot, and a robot may have both (TalkRoBots 3.2.4):

    direct         a socket on which the robot takes commands in its own language
    interpreter    a socket to a small program on the robot, which gets one field after the other
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Annotated, ClassVar, Final, Literal

from pydantic import AfterValidator, BaseModel, Field, model_validator

from ua_fleet.bridge.templates import AnswerPattern, CommandTemplate, Language, TemplateInvalid
from ua_fleet.config.base import Model, ScalarType
from ua_fleet.config.schema import DataMapping, DataSetConfig, RobotConfig, SkillConfig, VendorBridgeConfig
from ua_fleet.config.shapes import all_of, at_least_one, exactly_one, given, implies, none_of
from ua_fleet.document import KeyPath
from ua_fleet.names import closest

__all__ = [
    "FAULT",
    "MESSAGE",
    "NUMBER",
    "DirectLink",
    "DirectSink",
    "DirectSkill",
    "DirectSource",
    "Framing",
    "InterpreterLink",
    "TcpBridgeConfig",
    "TcpSink",
    "TcpSkillMapping",
    "TcpSource",
    "address_of",
    "host_and_port",
]


def _checked_port(address: str) -> str:
    if not 1 <= host_and_port(address)[1] <= 65535:
        raise ValueError("a port is 1 to 65535")
    return address


def _checked_peer(text: str) -> str:
    try:
        address_of(text)
    except ValueError:
        raise ValueError(f"{text[:60]} is no IP address; write that of the robot, e.g. 10.0.0.7") from None
    return text


Address = Annotated[
    str,
    Field(pattern=r"^(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):\d{1,5}$", examples=["10.0.0.7:30002"]),
    AfterValidator(_checked_port),
]
Peer = Annotated[str, AfterValidator(_checked_peer)]
Terminator = Annotated[str, Field(min_length=1, max_length=4, pattern=r"^[\x00-\x7f]+$")]
Word = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]{0,63}$")]
Line = Annotated[str, Field(min_length=1, max_length=4096)]
_NO_FIELDS: Final = (ScalarType.DATETIME, ScalarType.BYTE_STRING)
NUMBER: Final = "number"
"""A command may hold `{number}`, and an answer repeat it: the execution's own number, 1 to 2147483647."""
FAULT: Final = "fault"
"""Subtype of the information with which a robot says what is wrong with it; the empty text when all is well."""
MESSAGE: Final = "message"
"""A pattern of failure may hold `{message}`: what the robot says of it."""


def host_and_port(address: str) -> tuple[str, int]:
    """`10.0.0.7:30002` or `[::1]:30002` in its two parts."""
    host, _, port = address.rpartition(":")
    return host.strip("[]"), int(port)


def address_of(text: str) -> IPv4Address | IPv6Address:
    """The address that a text means, however it is written: `0:0::1` is `::1`, `::ffff:10.0.0.7` is 10.0.0.7.

    Raises:
        ValueError: it is none, e.g. a name.
    """
    address = ip_address(text)
    return (isinstance(address, IPv6Address) and address.ipv4_mapped) or address


class Framing(StrEnum):
    """How a program on a robot knows where a field ends."""

    TERMINATOR = "terminator"
    """After each field stands `terminator`."""
    LENGTH = "length"
    """Each field has `length` characters, filled up with spaces."""
    ACKNOWLEDGED = "acknowledged"
    """A field is sent when the one before it was acknowledged. For programs that take whatever one read gives."""


class DirectLink(Model, frozen=True):
    """The socket on which the robot takes commands in its own language."""

    connect: Address
    """Address of the robot."""
    language: Language = Language.PLAIN
    """How values are written: `plain`, `urscript`, `rapid`, `krl` or `c`."""
    terminator: Terminator = "\n"
    """Ends each line that the robot says."""
    encoding: Literal["ascii", "latin-1", "utf-8"] = "utf-8"
    """Of commands and answers."""


class InterpreterLink(
    Model,
    frozen=True,
    json_schema_extra=all_of(
        exactly_one("connect", "listen"),
        implies(given("listen"), given("peer")),
        implies(given("connect"), none_of("peer")),
    ),
):
    """The socket to the small program on the robot."""

    connect: Address | None = None
    """Address of the robot, where its program listens."""
    listen: Address | None = None
    """Address to listen on, where the robot's program connects."""
    peer: Peer | None = None
    """With `listen`: the robot's IP address, and no name. Nobody else is let in."""
    framing: Framing = Framing.TERMINATOR
    """How the program knows where a field ends."""
    terminator: Terminator = "\n"
    """Ends each field; with `acknowledged` only those that the robot sends."""
    length: int = Field(default=80, ge=8, le=1024)
    """With `length`: characters of each field."""
    longest_field: int = Field(default=255, ge=16, le=4096)
    """A longer field is not sent, and one that the robot sends ends the connection. In bytes."""
    most_fields: int = Field(default=32, ge=1, le=256)
    """Data fields of one message."""
    encoding: Literal["ascii", "latin-1", "utf-8"] = "ascii"
    """Of all fields."""
    answer_timeout_s: float = Field(default=2.0, gt=0)
    """A field has to be acknowledged, a message that was begun to be ended, and a question answered within this."""

    @model_validator(mode="after")
    def _check(self) -> InterpreterLink:
        if (self.connect is None) == (self.listen is None):
            raise ValueError("give either `connect`, where the robot listens, or `listen`, where it connects")
        if self.listen is not None and self.peer is None:
            raise ValueError("peer: give the robot's address; only that address may connect")
        if self.connect is not None and self.peer is not None:
            raise ValueError("peer: belongs to `listen`; remove it")
        if self.listen is not None and self.peer is not None:
            is_v6 = ":" in host_and_port(self.listen)[0]
            if is_v6 is not (address_of(self.peer).version == 6):
                raise ValueError(f"peer: {self.peer} cannot reach {self.listen}; write both as IPv4, or both as IPv6")
        return self


class DirectSkill(Model, frozen=True):
    """A command in the robot's own language, and how it answers."""

    command: Line
    """The command, e.g. `movej([{j1:.4f}, {j2:.4f}])\\n`. Nothing is added to it: write the end of line too."""
    done: Line | None = None
    """What the robot says when it is done, e.g. `OK {distance}`. Left out: it is done when it is sent."""
    failed: Line | None = None
    """What the robot says when it has failed, e.g. `ERROR {message}`."""
    halt: Line | None = None
    """Command that stops the robot. Left out: it cannot be stopped."""
    halted: Line | None = None
    """What the robot says when it stands after `halt`, e.g. `STOPPED`. `done` and `failed` tell it too; where it says
    none of these within 5 s, nobody knows whether it stands: Unknown."""


class TcpSkillMapping(Model, frozen=True, json_schema_extra=implies(given("direct"), none_of("subtype"))):
    """`via` of a skill. Without it, or without `direct`, the program on the robot does it."""

    direct: DirectSkill | None = None
    """A command in the robot's own language."""
    subtype: Word | None = None
    """What the program on the robot knows the skill by; its name if left out."""

    @model_validator(mode="after")
    def _one(self) -> TcpSkillMapping:
        if self.direct is not None and self.subtype is not None:
            raise ValueError("subtype: belongs to the program on the robot; a direct command has none")
        return self


class DirectSource(Model, frozen=True):
    """A line that the robot says."""

    line: Line
    """The line, e.g. `POS {x} {y}`; the names are those of the fields."""
    ask: Line | None = None
    """Command that has the robot say it. Left out: the robot says it by itself."""
    period_s: float = Field(default=1.0, ge=0.01, le=3600)
    """With `ask`: asked so often."""


class TcpSource(DataMapping, frozen=True):
    """`source` of data. Without it, or without `direct`, the program on the robot sends it as information."""

    direct: DirectSource | None = None
    """A line that the robot says in direct mode."""
    subtype: Word | None = None
    """What the program on the robot calls it; the name of the data if left out."""
    max_rate_hz: float | None = Field(default=None, gt=0, le=10_000)
    """At most so many values a second are handed on; the latest wins, and the last one always arrives."""


class DirectSink(Model, frozen=True):
    """A command that hands a value to the robot."""

    command: Line
    """The command, e.g. `SPEED {value}\\n`; the names are those of the fields, `value` for a single one."""


class TcpSink(DataMapping, frozen=True):
    """`sink` of data. Without it, or without `direct`, the program on the robot gets it as information."""

    direct: DirectSink | None = None
    """A command in the robot's own language."""
    subtype: Word | None = None
    """What the program on the robot knows it by; the name of the data if left out."""


class TcpBridgeConfig(VendorBridgeConfig, frozen=True, json_schema_extra=at_least_one("direct", "interpreter")):
    """A bridge to a robot that speaks over TCP. `space` is one of the vendor spaces, 256 to 65535."""

    kind: Literal["tcp"]
    """Always `tcp`."""
    direct: DirectLink | None = None
    """The socket on which the robot takes commands in its own language."""
    interpreter: InterpreterLink | None = None
    """The socket to the small program on the robot."""
    answers: tuple[Annotated[str, Field(pattern=r"^[A-Za-z][\w-]*\.[A-Za-z][\w-]*$")], ...] = ()
    """Data of other robots, as `robot.data`, that the program on this one may ask for."""

    skill_mapping: ClassVar[type[BaseModel] | None] = TcpSkillMapping
    """Model of `via` in the skills of its robots."""
    source_mapping: ClassVar[type[DataMapping] | None] = TcpSource
    sink_mapping: ClassVar[type[DataMapping] | None] = TcpSink

    @model_validator(mode="after")
    def _links(self) -> TcpBridgeConfig:
        if self.direct is None and self.interpreter is None:
            raise ValueError("give `direct`, `interpreter` or both: without either nothing reaches the robot")
        return self

    def problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig: templates against arguments, ways without a link, names that are used twice."""
        used: dict[tuple[str, str], KeyPath] = {}
        for robot_name, robot in robots.items():
            if robot.fault_id is not None:
                yield from self._named_once(used, "source", FAULT, ("robots", robot_name, "fault_id"))
            for skill_name, skill in robot.skills.items():
                path: KeyPath = ("robots", robot_name, "skills", skill_name)
                via = _mapping_of(skill)
                if via is None:
                    continue
                if via.direct is not None:
                    yield from self._skill_problems((*path, "via", "direct"), via.direct, skill)
                else:
                    yield from self._named_once(used, "skill", via.subtype or skill_name, path)
                    yield from self._limits(path, skill)
            for data_name, data in robot.data.items():
                yield from self._data_problems(used, ("robots", robot_name, "data", data_name), data_name, data)

    def fleet_problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig: `answers` names data of other robots."""
        yield from super().fleet_problems(name, robots)
        known = {f"{robot}.{data}": (config, data) for robot, config in robots.items() for data in config.data}
        for position, asked in enumerate(self.answers):
            path: KeyPath = ("bridges", name, "answers", position)
            if asked not in known:
                yield path, f"there is no data `{asked}`", closest(asked, known) or "write it as robot.data"
                continue
            robot, data_name = known[asked]
            data = robot.data[data_name]
            if robot.bridge == name and data.origin == "robot":
                yield path, "it is data of this bridge's own robot", "only data of others can be asked for"
            if any(field.array or field.type in _NO_FIELDS for field in data.all_fields().values()):
                yield path, "it has arrays, DateTime or ByteString, which are no fields", "leave it out"
        if self.answers and self.interpreter is None:
            yield ("bridges", name, "answers"), "only a program on the robot can ask", "add `interpreter`, or remove it"

    def _limits(self, path: KeyPath, skill: SkillConfig) -> Iterator[tuple[KeyPath, str, str]]:
        link = self.interpreter
        if link is None:
            yield path, "the bridge has no `interpreter`, and the skill no `via.direct`", "give one of them"
        elif max(len(skill.arguments), len(skill.results)) > link.most_fields:
            yield path, f"it has more than most_fields ({link.most_fields}) arguments or results", "raise most_fields"

    def _skill_problems(
        self, path: KeyPath, via: DirectSkill, skill: SkillConfig
    ) -> Iterator[tuple[KeyPath, str, str]]:
        if self.direct is None:
            yield path, "the bridge has no `direct`, the socket that takes commands", "add it to the bridge"
            return
        language = self.direct.language
        arguments = {NUMBER: ScalarType.INT32, **{name: given.type for name, given in skill.arguments.items()}}
        results = {NUMBER: ScalarType.INT32, **{name: given.type for name, given in skill.results.items()}}
        names = frozenset[str]()
        for key, text in (("command", via.command), ("halt", via.halt)):
            try:
                if text is not None:
                    names |= CommandTemplate(text, arguments, language).names
            except TemplateInvalid as error:
                yield (*path, key), str(error), ""
        for missing in [name for name in skill.arguments if name not in names]:
            yield (*path, "command"), f"the argument `{missing}` stands nowhere in it", f"write {{{missing}}} into it"
        try:
            told = AnswerPattern(via.done, results, language).names if via.done is not None else frozenset[str]()
        except TemplateInvalid as error:
            yield (*path, "done"), str(error), ""
        else:
            for missing in [name for name in skill.results if name not in told]:
                yield (*path, "done"), f"the result `{missing}` stands nowhere in it", f"write {{{missing}}} into it"
        try:
            if via.failed is not None:
                AnswerPattern(via.failed, {MESSAGE: ScalarType.STRING, NUMBER: ScalarType.INT32}, language)
                if via.done is None:
                    yield (*path, "failed"), "without `done` the robot is not listened to", "add `done`, or remove it"
        except TemplateInvalid as error:
            yield (*path, "failed"), str(error), ""
        try:
            if via.halted is not None:
                AnswerPattern(via.halted, {NUMBER: ScalarType.INT32}, language)
                if via.done is None or via.halt is None:
                    yield (*path, "halted"), "it answers `halt`, of what has `done`", "add both, or remove it"
        except TemplateInvalid as error:
            yield (*path, "halted"), str(error), ""

    def _data_problems(
        self, used: dict[tuple[str, str], KeyPath], path: KeyPath, name: str, data: DataSetConfig
    ) -> Iterator[tuple[KeyPath, str, str]]:
        side = "source" if data.origin == "robot" else "sink"
        mapping = data.source if data.origin == "robot" else data.sink
        for field_name, field in data.all_fields().items():
            if field.array:
                key = (*path, "fields", field_name, "array") if field_name else (*path, "array")
                yield key, "a TCP robot has no arrays", "write a field for each element"
            if field.type in _NO_FIELDS:
                key = (*path, "fields", field_name, "type") if field_name else (*path, "type")
                yield key, f"a TCP robot has no {field.type.value}", "a String or a number serves"
        direct = mapping.direct if isinstance(mapping, TcpSource | TcpSink) else None
        if direct is None:
            subtype = mapping.subtype if isinstance(mapping, TcpSource | TcpSink) else None
            yield from self._named_once(used, side, subtype or name, path)
            if self.interpreter is None:
                yield path, f"the bridge has no `interpreter`, and the data no `{side}.direct`", "give one of them"
            return
        key_path = (*path, side, "direct")
        if self.direct is None:
            yield key_path, "the bridge has no `direct`, the socket that takes commands", "add it to the bridge"
            return
        types = data.field_types()
        try:
            if isinstance(direct, DirectSource):
                names = AnswerPattern(direct.line, types, self.direct.language).names
                for missing in [field_name for field_name in types if field_name not in names]:
                    yield (*key_path, "line"), f"the field `{missing}` stands nowhere in it", f"write {{{missing}}}"
            else:
                CommandTemplate(direct.command, types, self.direct.language)
        except TemplateInvalid as error:
            yield (*key_path, "line" if isinstance(direct, DirectSource) else "command"), str(error), ""

    @staticmethod
    def _named_once(
        used: dict[tuple[str, str], KeyPath], what: str, name: str, path: KeyPath
    ) -> Iterator[tuple[KeyPath, str, str]]:
        first = used.setdefault((what, name), path)
        if first != path:
            where = ".".join(str(step) for step in first)
            yield path, f"the program on the robot knows {where} as `{name}` too", "give one of them another `subtype`"


def _mapping_of(skill: SkillConfig) -> TcpSkillMapping | None:
    """How a skill is done; None where `via` has mistakes, which are told already."""
    try:
        return TcpSkillMapping.model_validate(skill.via)
    except ValueError:
        return None
