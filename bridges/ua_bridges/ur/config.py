"""Configuration of a Universal Robots bridge in `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from typing import Annotated, ClassVar, Final, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from ua_bridges.ur.outputs import ALL_OUTPUTS, OUTPUT_NAMES, SPEEDS, find_output
from ua_bridges.ur.variables import VARIABLES, read_path
from ua_fleet.bridge.templates import CommandTemplate, Language, TemplateInvalid
from ua_fleet.config.base import Model, ScalarType
from ua_fleet.config.schema import DataMapping, DataSetConfig, FieldConfig, RobotConfig, SkillConfig, VendorBridgeConfig
from ua_fleet.config.shapes import exactly_one
from ua_fleet.document import KeyPath
from ua_fleet.names import closest, listed

__all__ = [
    "Dashboard",
    "DashboardSkill",
    "MoveJ",
    "MoveL",
    "RegisterResult",
    "ScriptSkill",
    "SetSkill",
    "StopSkill",
    "UrBridgeConfig",
    "UrSink",
    "UrSkillMapping",
    "UrSource",
    "field_path",
]

Problem = tuple[KeyPath, str, str]
_FLOATS: Final = (ScalarType.DOUBLE, ScalarType.FLOAT)
Given = float | Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
"""A number, or the name of the argument that it comes from."""
Six = tuple[Given, Given, Given, Given, Given, Given]


class UrSource(DataMapping, frozen=True):
    """`source` of data. Each field's `path` names a variable of RTDE, e.g. `actual_q`, `actual_q[2]`, `robot_mode_text`
    or `actual_digital_input_bits[3]`; without `path` the field's name does.
    """

    max_rate_hz: float = Field(default=10.0, gt=0, le=500)
    """At most so many samples a second, 500 at most; the controller is asked for as many as its data need."""
    only_changes: bool = False
    """Tell only samples whose values differ from the last."""


class UrSink(DataMapping, frozen=True):
    """`sink` of data with one field: clients, or other spaces, set an output."""

    output: str = Field(examples=["standard_digital_out[3]"], json_schema_extra={"enum": [*ALL_OUTPUTS, *SPEEDS]})
    """`standard_digital_out[0]` to `[7]`, `configurable_digital_out[0]` to `[7]`, `tool_digital_out[0]` and `[1]`
    (Boolean); `analog_out_voltage[0]`, `analog_out_current[0]`, `[1]` and `speed_slider` (0 to 1);
    `input_int_register[18]`, `input_double_register[18]` to `[22]`. For the data of a teleoperation `joint_speed` or
    `tool_speed`."""

    @field_validator("output")
    @classmethod
    def _known(cls, output: str) -> str:
        if output not in SPEEDS and find_output(output) is None:
            raise ValueError(f"there is no output `{output}`; there are {listed(OUTPUT_NAMES)}, and so on")
        return output


class _Move(Model, frozen=True):
    speed: Given
    acceleration: Given

    def given(self) -> Iterator[Given]:
        """What it gets, numbers and arguments."""
        yield from (self.speed, self.acceleration)


class MoveJ(_Move, frozen=True):
    """Move all joints to a position."""

    joints: Six
    """Positions in rad, base to wrist 3; each a number or the name of an argument."""
    speed: Given = 1.05
    """Of the leading joint, rad/s; a number or an argument."""
    acceleration: Given = 1.4
    """Of the leading joint, rad/s²; a number or an argument."""

    def given(self) -> Iterator[Given]:
        """See _Move."""
        yield from self.joints
        yield from super().given()


class MoveL(_Move, frozen=True):
    """Move the tool's centre in a straight line to a pose."""

    pose: Six
    """x, y, z in m, and a rotation vector in rad, in the robot's base; each a number or the name of an argument."""
    speed: Given = 0.25
    """Of the tool, m/s; a number or an argument."""
    acceleration: Given = 1.2
    """Of the tool, m/s²; a number or an argument."""

    def given(self) -> Iterator[Given]:
        """See _Move."""
        yield from self.pose
        yield from super().given()


class StopSkill(Model, frozen=True):
    """Stop what the robot does: a move slows down, a program is stopped."""

    deceleration: float = Field(default=2.0, gt=0, le=40)
    """Of the leading joint, rad/s²."""


class RegisterResult(Model, frozen=True):
    """A result that a script leaves in an output register."""

    register_type: Literal["int", "double"] = "double"
    """`int` or `double`."""
    place: int = Field(ge=12, le=19)
    """Number of the register, 12 to 19."""


class ScriptSkill(Model, frozen=True):
    """URScript that is sent to the robot (port 30002)."""

    body: Annotated[str, Field(min_length=1, max_length=65_536, examples=["movej([{base}, -1.57, 0, -1.57, 0, 0])"])]
    """The program's lines. `{angle}` stands for an argument, `{angle:.4f}` with a format; write `{{` and `}}` for
    braces. A text is put in quotes; one with a quote or a line break is refused."""
    results: dict[str, RegisterResult] = {}
    """Result to the output register that it is read from at the end."""


class Dashboard(StrEnum):
    """What the dashboard server is asked to do."""

    POWER_ON = "power_on"
    POWER_OFF = "power_off"
    BRAKE_RELEASE = "brake_release"
    LOAD = "load"
    PLAY = "play"
    PAUSE = "pause"
    STOP = "stop"
    POPUP = "popup"
    CLOSE_POPUP = "close_popup"
    CLOSE_SAFETY_POPUP = "close_safety_popup"
    UNLOCK_PROTECTIVE_STOP = "unlock_protective_stop"
    RESTART_SAFETY = "restart_safety"

    @property
    def takes_text(self) -> bool:
        """Whether it goes with a text: a program's name, a message."""
        return self in (Dashboard.LOAD, Dashboard.POPUP)


class DashboardSkill(Model, frozen=True):
    """A command to the dashboard server (port 29999)."""

    command: Dashboard
    """`power_on`, `power_off`, `brake_release`, `load`, `play`, `pause`, `stop`, `popup`, `close_popup`,
    `close_safety_popup`, `unlock_protective_stop` or `restart_safety`."""
    text: str | None = None
    """`load` and `popup`: the name of the argument with the program or the message."""
    wait_for_end: bool = False
    """`play`: done when the program has ended. Otherwise it is done when it has begun."""
    end_register: int | None = Field(default=None, ge=12, le=19)
    """With `wait_for_end`: output integer register that the program changes in its last line, e.g. counts up. Without
    it nobody can tell a program that has ended from one that somebody has stopped: Unknown."""


class SetSkill(Model, frozen=True):
    """Set an output, and see that it is set."""

    output: str = Field(examples=["speed_slider"], json_schema_extra={"enum": list(ALL_OUTPUTS)})
    """As in a sink."""
    value: bool | float | str = Field(examples=["value"])
    """A value, or the name of the argument with it."""

    @field_validator("output")
    @classmethod
    def _known(cls, output: str) -> str:
        if find_output(output) is None:
            raise ValueError(f"there is no output `{output}`; there are {listed(OUTPUT_NAMES)}, and so on")
        return output


class UrSkillMapping(
    Model,
    frozen=True,
    json_schema_extra=exactly_one("move_j", "move_l", "stop", "script", "dashboard", "set"),
):
    """`via` of a skill: exactly one of these."""

    move_j: MoveJ | None = None
    """Move all joints to a position."""
    move_l: MoveL | None = None
    """Move the tool in a straight line."""
    stop: StopSkill | None = None
    """Stop what the robot does."""
    script: ScriptSkill | None = None
    """Send URScript."""
    dashboard: DashboardSkill | None = None
    """Ask the dashboard server."""
    set: SetSkill | None = None
    """Set an output."""

    @model_validator(mode="after")
    def _exactly_one(self) -> UrSkillMapping:
        names = ("move_j", "move_l", "stop", "script", "dashboard", "set")
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {', '.join(names)}; there is {listed(given) or 'none'}")
        return self

    @property
    def way(self) -> MoveJ | MoveL | StopSkill | ScriptSkill | DashboardSkill | SetSkill:
        """The one that is given."""
        way = self.move_j or self.move_l or self.stop or self.script or self.dashboard or self.set
        assert way is not None
        return way


def field_path(name: str, field: FieldConfig) -> str:
    """The variable of a field: its path, or its name."""
    return field.path or name


class UrBridgeConfig(VendorBridgeConfig, frozen=True):
    """A bridge to the controller of a Universal Robots arm. `space` is one of the vendor spaces, 256 to 65535."""

    kind: Literal["ur"]
    """Always `ur`."""
    address: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9.-]*$", examples=["192.168.0.10"])]
    """IPv4 address or name of the controller; its ports are the usual ones, 29999 and 30001 to 30004."""
    answer_timeout_s: float = Field(default=3.0, gt=0, le=60)
    """The controller has to send something, or to answer, within this; otherwise the connection is given up."""
    retry_s: tuple[float, float] = (0.5, 10.0)
    """A controller that is away is looked for after the first, then each time after twice as long, up to the second."""
    first_register: int = Field(default=18, ge=12, le=18)
    """URScript that the bridge sends says in this output integer register, and the next, how far it is."""
    real_time_priority: int | None = Field(default=None, ge=1, le=99)
    """Priority of SCHED_FIFO for the process that reads the state, so that none of 500 samples a second is lost on a
    busy machine; needs CAP_SYS_NICE."""
    needs_remote_control: bool = True
    """Whether the bridge's status tells when the robot is in local control, where it takes no commands."""
    mirrors: dict[Annotated[str, Field(pattern=r"^[A-Za-z][\w-]*\.[A-Za-z][\w-]*$")], UrSink] = {}
    """Data of other bridges' robots, `<robot>.<data>`, that is written to outputs, or to input registers that
    its programs read."""

    skill_mapping: ClassVar[type[BaseModel] | None] = UrSkillMapping
    """Model of `via` in the skills of its robots."""
    source_mapping: ClassVar[type[DataMapping] | None] = UrSource
    sink_mapping: ClassVar[type[DataMapping] | None] = UrSink
    takes_setpoints: ClassVar[bool] = True

    @field_validator("retry_s")
    @classmethod
    def _retries(cls, retry_s: tuple[float, float]) -> tuple[float, float]:
        if not 0 < retry_s[0] <= retry_s[1]:
            raise ValueError("the first is more than 0 and at most the second")
        return retry_s

    def problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[Problem]:
        """See BridgeConfig: variables and outputs that there are not, arguments that nothing uses."""
        if len(robots) > 1:
            second = list(robots)[1]
            yield (
                ("robots", second, "bridge"),
                f"the bridge {name} has a robot already",
                "give each controller a bridge",
            )
        for robot_name, robot in robots.items():
            for data_name, data in robot.data.items():
                is_driven = robot.teleoperation is not None and robot.teleoperation.data == data_name
                yield from _data_problems(("robots", robot_name, "data", data_name), data, is_driven=is_driven)
            for skill_name, skill in robot.skills.items():
                yield from self._skill_problems(("robots", robot_name, "skills", skill_name), skill)

    def fleet_problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[Problem]:
        """See BridgeConfig: `mirrors` names data of other robots."""
        yield from super().fleet_problems(name, robots)
        known = {f"{robot}.{data}": (config, data) for robot, config in robots.items() for data in config.data}
        for mirrored, sink in self.mirrors.items():
            path: KeyPath = ("bridges", name, "mirrors", mirrored)
            if mirrored not in known:
                yield path, f"there is no data `{mirrored}`", closest(mirrored, known) or "write it as robot.data"
                continue
            robot, data = known[mirrored]
            if robot.bridge == name:
                yield path, "it is data of this bridge's own robot", "data that clients write has a `sink`"
            else:
                yield from _output_problems(path, sink, robot.data[data], "choose another output")

    def _skill_problems(self, path: KeyPath, skill: SkillConfig) -> Iterator[Problem]:
        if not skill.via:
            yield path, "it has no `via`, and a controller offers nothing by itself", "add via"
            return
        try:
            way = UrSkillMapping.model_validate(skill.via).way
        except ValueError:
            return  # told by the model itself
        results: Mapping[str, RegisterResult] = {}
        if isinstance(way, MoveJ | MoveL):
            key = "move_j" if isinstance(way, MoveJ) else "move_l"
            used = {given for given in way.given() if isinstance(given, str)}
            yield from _arguments((*path, "via", key), skill, used, _FLOATS)
        elif isinstance(way, ScriptSkill):
            results = way.results
            yield from _script_problems((*path, "via", "script"), way, skill, self.first_register)
        elif isinstance(way, DashboardSkill):
            yield from _dashboard_problems((*path, "via", "dashboard"), way, skill, self.first_register)
        elif isinstance(way, SetSkill):
            output = find_output(way.output)
            assert output is not None
            used = {way.value} if isinstance(way.value, str) else set[str]()
            yield from _arguments((*path, "via", "set"), skill, used, output.types)
            if not isinstance(way.value, str):
                try:
                    output.call(way.value)
                except ValueError as error:
                    yield (*path, "via", "set", "value"), str(error), ""
        else:
            yield from _arguments((*path, "via", "stop"), skill, set(), _FLOATS)
        for result in skill.results:
            if result not in results:
                yield (*path, "results", result), "nothing brings this result", "only a script has results"


def _data_problems(path: KeyPath, data: DataSetConfig, *, is_driven: bool) -> Iterator[Problem]:
    if data.origin == "server":
        is_speed = isinstance(data.sink, UrSink) and data.sink.output in SPEEDS
        yield from (
            _speed_problems(path, data, is_driven=is_driven) if is_speed or is_driven else _sink_problems(path, data)
        )
        return
    if data.source is None:
        yield (*path, "source"), "it has no `source`", "add `source: {}`, and the variable as `path`"
    for name, field in data.all_fields().items():
        key = (*path, "fields", name) if name else path
        reading = read_path(field_path(name, field))
        if reading is None:
            wanted = field_path(name, field) or "(none)"
            yield (*key, "path"), f"there is no variable `{wanted}`", closest(wanted, VARIABLES) or "see docs/ur.md"
            continue
        if field.array is not reading.is_array:
            said = "has several values" if reading.is_array else "has one value"
            yield (*key, "array"), f"`{reading.name}` {said}", f"array: {str(reading.is_array).lower()}"
        if field.type not in reading.types:
            yield (*key, "type"), f"`{reading.name}` is no {field.type.value}", f"type: {reading.types[0].value}"


def _speed_problems(path: KeyPath, data: DataSetConfig, *, is_driven: bool) -> Iterator[Problem]:
    if not isinstance(data.sink, UrSink):
        return  # teleoperation needs one, and says so
    output, names = data.sink.output, SPEEDS.get(data.sink.output)
    if names is None:
        yield (*path, "sink", "output"), f"nobody drives an arm by `{output}`", f"write one of {listed(list(SPEEDS))}"
        return
    if not is_driven:
        hint = "name this data in the robot's `teleoperation`, or choose another output"
        yield (*path, "sink", "output"), f"`{output}` is written by teleoperation alone", hint
    taken: set[str] = set()
    for name, field in data.all_fields().items():
        axis = field_path(name, field)
        key = (*path, "fields", name) if name else path
        if axis not in names:
            hint = closest(axis, names) or f"there are: {listed(list(names))}"
            yield (*key, "path"), f"`{output}` has no axis `{axis or '(none)'}`", hint
        elif axis in taken:
            yield (*key, "path"), f"another field is the axis `{axis}` already", "remove one of them"
        taken.add(axis)


def _sink_problems(path: KeyPath, data: DataSetConfig) -> Iterator[Problem]:
    if not isinstance(data.sink, UrSink):
        yield (*path, "sink"), "it has no `sink`", "name the output that it sets"
    elif len(data.all_fields()) != 1:
        yield (*path, "fields"), "an output takes one value", "write data for each output"
    else:
        output = find_output(data.sink.output)
        assert output is not None
        yield from _output_problems((*path, "type"), data.sink, data, f"type: {output.types[0].value}")


def _output_problems(path: KeyPath, sink: UrSink, data: DataSetConfig, remedy: str) -> Iterator[Problem]:
    output, fields = find_output(sink.output), data.all_fields()
    if output is None:
        yield path, f"`{sink.output}` is written by teleoperation alone", remedy
        return
    if len(fields) != 1:
        yield path, f"an output takes one value, and not {len(fields)}", "use data with one field"
        return
    (field,) = fields.values()
    if field.type not in output.types or field.array:
        kind = f"array of {field.type.value}" if field.array else field.type.value
        yield path, f"`{sink.output}` takes no {kind}", remedy


def _arguments(path: KeyPath, skill: SkillConfig, used: set[str], types: tuple[ScalarType, ...]) -> Iterator[Problem]:
    for name in sorted(used):
        argument = skill.arguments.get(name)
        if argument is None:
            yield path, f"the skill has no argument `{name}`", closest(name, skill.arguments)
        elif argument.type not in types:
            yield path, f"the argument `{name}` is a {argument.type.value}", f"make it a {types[0].value}"
    for name in skill.arguments:
        if name not in used:
            yield path, f"the argument `{name}` goes nowhere", "use it, or remove it"


def _script_problems(path: KeyPath, way: ScriptSkill, skill: SkillConfig, register: int) -> Iterator[Problem]:
    types = {name: argument.type for name, argument in skill.arguments.items()}
    try:
        names = CommandTemplate(way.body, types, Language.URSCRIPT).names
    except TemplateInvalid as error:
        yield (*path, "body"), str(error), ""
        return
    for name in skill.arguments:
        if name not in names:
            yield (*path, "body"), f"the argument `{name}` stands nowhere in it", f"write {{{name}}} into it"
    for name, result in way.results.items():
        wanted = skill.results.get(name)
        if wanted is None:
            yield (*path, "results", name), f"the skill has no result `{name}`", closest(name, skill.results)
            continue
        types_of = _FLOATS if result.register_type == "double" else (ScalarType.INT32, ScalarType.INT64)
        if wanted.type not in types_of:
            yield (*path, "results", name), f"a register holds no {wanted.type.value}", f"type: {types_of[0].value}"
        if result.register_type == "int" and result.place in (register, register + 1):
            yield (*path, "results", name), f"register {result.place} is the bridge's own", "choose another place"


def _dashboard_problems(path: KeyPath, way: DashboardSkill, skill: SkillConfig, register: int) -> Iterator[Problem]:
    if way.command.takes_text and way.text is None:
        yield path, f"{way.command.value} needs a text", "name the argument as `text`"
    if not way.command.takes_text and way.text is not None:
        yield (*path, "text"), f"{way.command.value} takes no text", "remove it"
    if way.wait_for_end and way.command is not Dashboard.PLAY:
        yield (*path, "wait_for_end"), f"{way.command.value} has no end", "remove it"
    if way.end_register is not None and not way.wait_for_end:
        yield (*path, "end_register"), "nobody waits for the end", "add `wait_for_end: true`, or remove it"
    if way.end_register in (register, register + 1):
        yield (*path, "end_register"), f"register {way.end_register} is the bridge's own", "choose another one"
    yield from _arguments(path, skill, {way.text} if way.text is not None else set(), (ScalarType.STRING,))
