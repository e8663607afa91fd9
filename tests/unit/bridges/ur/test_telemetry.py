from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_bridges.ur.modes import RobotMode, RuntimeState, SafetyMode
from ua_bridges.ur.outputs import find_output
from ua_bridges.ur.state import ControllerClock, State, WallClock, remark_of, stop_of
from ua_bridges.ur.telemetry import Source, Telemetry
from ua_bridges.ur.variables import VARIABLES, Kind, read_path
from ua_bridges.ur.watching import Faults

from tests.contract.harness import Recorder
from ua_fleet.bridge import Dropped, SourceRead
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

SECOND = 1_000_000_000
MOST_LATE_S = 3.0
VALUES: dict[str, Any] = {
    "robot_mode": 7,
    "safety_mode": 1,
    "runtime_state": 2,
    "actual_q": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
    "actual_qd": [0.0] * 6,
    "actual_digital_input_bits": 0b1010,
    "speed_scaling": 0.5,
    "target_speed_fraction": 0.25,
    "actual_digital_output_bits": 1 << 9,
    "standard_analog_output0": 5.0,
}


def state(time: float, **values: Any) -> State:
    return State(time, round(time * SECOND), time, {**VALUES, **values})


def source(path: str, rate: float, *, only_changes: bool = False, is_aging: bool = False, number: int = 11) -> Source:
    reading = read_path(path)
    assert reading is not None
    fields = (make_field(path, BuiltinType.DOUBLE, array=reading.is_array),)
    return Source(Topic(300, 2, number), f"arm.{path}", fields, (reading,), rate, only_changes, is_aging)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("actual_q", (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)),
        ("actual_q[2]", 2.0),
        ("actual_digital_input_bits", 0b1010),
        ("actual_digital_input_bits[0]", False),
        ("actual_digital_input_bits[3]", True),
        ("robot_mode", 7),
        ("robot_mode_text", "RUNNING"),
        ("safety_mode_text", "NORMAL"),
        ("runtime_state_text", "PLAYING"),
        ("speed_scaling", 0.5),
    ],
)
def test_path_names_a_value_or_a_part_of_it(path: str, value: object) -> None:
    reading = read_path(path)
    assert reading is not None
    assert reading.of(VALUES) == value


@pytest.mark.parametrize(
    "path", ["", "q", "actual_q[6]", "robot_mode[0]", "actual_q[x]", "actual_q.0", "robot_mode_text[1]"]
)
def test_path_that_there_is_not_is_none(path: str) -> None:
    assert read_path(path) is None


def test_unknown_mode_has_a_word() -> None:
    reading = read_path("safety_mode_text")
    assert reading is not None
    assert reading.of({"safety_mode": 77}) == "UNKNOWN_77"


def test_library_has_every_method_that_is_named() -> None:
    rtde_receive = pytest.importorskip("rtde_receive")
    for variable in VARIABLES.values():
        assert hasattr(rtde_receive.RTDEReceiveInterface, variable.getter), variable
    rtde_io = pytest.importorskip("rtde_io")
    for name in ("standard_digital_out[0]", "speed_slider", "analog_out_current[1]", "input_double_register[22]"):
        output = find_output(name)
        assert output is not None
        assert hasattr(rtde_io.RTDEIOInterface, output.setter.method)


@pytest.mark.parametrize(("rate", "count"), [(500.0, 500), (125.0, 125), (50.0, 50), (30.0, 30), (1.0, 1), (0.5, 1)])
def test_each_source_has_its_rate(rate: float, count: int) -> None:
    recorder = Recorder()
    telemetry = Telemetry((source("actual_q", rate), source("speed_scaling", 10.0, number=12)), 500.0, recorder.put)
    for cycle in range(500):
        telemetry.sampled(state(100 + cycle * 0.002), 0)
    assert len(recorder.samples(Topic(300, 2, 11))) == pytest.approx(count, abs=1)
    assert len(recorder.samples(Topic(300, 2, 12))) == 10
    assert len(recorder.found(Topic(300, 2, 11))) == 1


def test_only_changes_are_told_and_each_at_once() -> None:
    recorder = Recorder()
    topic = Topic(300, 2, 11)
    telemetry = Telemetry((source("robot_mode_text", 10.0, only_changes=True),), 500.0, recorder.put)
    modes = [7] * 100 + [3] * 100 + [5] * 200
    for cycle, mode in enumerate(modes):
        telemetry.sampled(state(cycle * 0.002, robot_mode=mode), 0)
    assert [sample.values for sample in recorder.samples(topic)] == [("RUNNING",), ("POWER_OFF",), ("IDLE",)]
    assert recorder.samples(topic)[1].source_time_ns == pytest.approx(0.2 * SECOND)


def test_each_reading_of_a_source_with_a_maximum_age_counts() -> None:
    recorder, topic = Recorder(), Topic(300, 2, 11)
    sources = (source("robot_mode_text", 10.0, only_changes=True, is_aging=True),)
    telemetry = Telemetry(sources, 500.0, recorder.put)
    for cycle in range(500):
        telemetry.sampled(state(cycle * 0.002), 0)
    assert [sample.values for sample in recorder.samples(topic)] == [("RUNNING",)]
    assert sum(isinstance(event, SourceRead) for event in recorder.events) == 9, "ten times a second, as it is sent"


def test_lost_sources_are_found_again_also_when_the_controllers_clock_began_anew() -> None:
    recorder, topic = Recorder(), Topic(300, 2, 11)
    telemetry = Telemetry((source("actual_q", 10.0),), 500.0, recorder.put)
    telemetry.sampled(state(1000.0), 0)
    telemetry.sampled(state(1.0), 0)
    assert len(recorder.samples(topic)) == 2
    telemetry.lost()
    telemetry.lost()
    telemetry.sampled(state(2.0), 0)
    assert (recorder.lost(topic), len(recorder.found(topic)), len(recorder.samples(topic))) == (1, 2, 3)


def test_lost_samples_are_counted_and_told_once() -> None:
    recorder = Recorder()
    telemetry = Telemetry((), 500.0, recorder.put)
    for lost in (0, 3, 2):
        telemetry.sampled(state(1.0), lost)
    assert recorder.dropped(Drop.INLET_FULL) == 5
    assert [bool(event.detail) for event in recorder.events if isinstance(event, Dropped)] == [True, False]


@given(st.lists(st.floats(0.0, 0.05), min_size=2, max_size=50))
def test_clock_follows_the_controllers(delays: list[float]) -> None:
    """Whatever the way takes, times differ as the controller's do, but for what the clock learns."""
    clock, began = ControllerClock(MOST_LATE_S), 7_000.0
    times = [clock.taken_s(5.0 + n * 0.002, began + n * 0.002 + late) for n, late in enumerate(delays)]
    for number, time in enumerate(times):
        true = began + number * 0.002
        assert true - 1e-3 <= time <= true + 0.05 + 1e-3
    best = min(delays)
    assert times[-1] == pytest.approx(began + (len(delays) - 1) * 0.002 + best, abs=2e-3)


def test_clock_begins_anew_with_the_controller() -> None:
    clock = ControllerClock(MOST_LATE_S)
    assert clock.taken_s(1000.0, 5000.0) == 5000.0
    assert clock.taken_s(1.0, 6000.0) == 6000.0


def test_clock_that_stood_or_is_slow_makes_no_sample_older_than_one_can_be() -> None:
    """A simulator's, on a machine that is busy or was suspended: `stop` waits for a sample that is not of before."""
    clock = ControllerClock(MOST_LATE_S)
    clock.taken_s(10.0, 5000.0)
    assert clock.taken_s(10.02, 8600.0) == pytest.approx(8600.0 - MOST_LATE_S)
    late = [8600.0 + n * 0.02 - clock.taken_s(10.02 + n * 0.019, 8600.0 + n * 0.02) for n in range(1, 10_000)]
    assert max(late) <= MOST_LATE_S + 1e-6


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_times_follow_a_wall_clock_that_is_set(step_s: int) -> None:
    clock = WallClock()
    clock.looked_at(10 * SECOND, 1_700_000_000 * SECOND, 10 * SECOND + 100)
    assert clock.unix_ns(9.5) == 1_700_000_000 * SECOND - SECOND // 2
    clock.looked_at(11 * SECOND, (1_700_000_001 + step_s) * SECOND, 11 * SECOND + 100)
    assert clock.unix_ns(11.0) == (1_700_000_001 + step_s) * SECOND


def test_a_look_at_the_clocks_that_took_long_teaches_nothing() -> None:
    """Else a busy machine would make times later, and a sample older than the one before it."""
    clock = WallClock()
    clock.looked_at(10 * SECOND, 100 * SECOND, 10 * SECOND + 100)
    clock.looked_at(11 * SECOND, 101 * SECOND + SECOND // 100, 11 * SECOND + SECOND // 100)
    assert clock.unix_ns(11.0) == 101 * SECOND


def test_stops_have_their_reason_and_what_says_nothing_of_standing_is_none() -> None:
    for mode in SafetyMode:
        is_stop = not (mode.may_move or mode is SafetyMode.UNDEFINED)
        assert bool(stop_of(state(1.0, safety_mode=int(mode)))) is is_stop
    odd = state(1.0, safety_mode=99)
    assert (stop_of(odd), remark_of(odd, None)) == ("", "the safety system says nothing; see the teach pendant")
    assert remark_of(state(1.0), True) == remark_of(state(1.0), None) == ""
    assert remark_of(state(1.0), False).startswith("remote control is off")


def test_only_a_stop_is_announced_once_the_arm_stands_and_a_lost_link_is_silence() -> None:
    topic, recorder = Topic(300, 2, 20), Recorder()
    faults = Faults((topic,), "arm.fault", recorder.put)
    moving = [0.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    stop = int(SafetyMode.ROBOT_EMERGENCY_STOP)

    def said() -> list[str]:
        return [sample.values[0] for sample in recorder.samples(topic)]

    faults.seen(state(1.0, actual_qd=moving))
    faults.seen(state(1.1, safety_mode=int(SafetyMode.UNDEFINED)))
    faults.seen(state(1.2, safety_mode=stop, actual_qd=moving))
    assert said() == [""]
    faults.seen(state(1.3, safety_mode=stop))
    faults.seen(state(1.4, safety_mode=stop, actual_qd=moving))
    assert [text[:14] for text in said()] == ["", "emergency stop"]
    faults.lost()
    faults.lost()
    assert (len(said()), recorder.lost(topic)) == (2, 1)
    faults.seen(state(1.5))
    assert (said()[2:], len(recorder.found(topic))) == ([""], 2)


def test_modes_that_a_newer_controller_may_have_are_no_crash() -> None:
    odd = state(1.0, robot_mode=99, runtime_state=99)
    assert (odd.robot_mode, odd.runtime) == (RobotMode.NO_CONTROLLER, RuntimeState.STOPPED)


@pytest.mark.parametrize(
    ("name", "value", "call"),
    [
        ("standard_digital_out[7]", True, ("setStandardDigitalOut", [7, True])),
        ("speed_slider", 1, ("setSpeedSlider", [1.0])),
        ("analog_out_voltage[1]", 0.5, ("setAnalogOutputVoltage", [1, 0.5])),
        ("input_int_register[18]", 7.0, ("setInputIntRegister", [18, 7])),
    ],
)
def test_output_is_a_call_of_the_library(name: str, value: Any, call: object) -> None:
    output = find_output(name)
    assert output is not None
    assert output.call(value) == call


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("standard_digital_out[0]", 1),
        ("speed_slider", 1.01),
        ("speed_slider", math.nan),
        ("speed_slider", True),
        ("speed_slider", "0.5"),
        ("speed_slider", None),
        ("input_int_register[18]", 2**31),
        ("input_double_register[18]", math.inf),
    ],
)
def test_value_that_an_output_does_not_take_is_refused(name: str, value: Any) -> None:
    output = find_output(name)
    assert output is not None
    with pytest.raises(ValueError, match=r"\S"):
        output.call(value)


@pytest.mark.parametrize(
    "name", ["", "fly", "standard_digital_out", "speed_slider[0]", "tool_digital_out[2]", "input_int_register[17]"]
)
def test_output_that_there_is_not_is_none(name: str) -> None:
    assert find_output(name) is None


@pytest.mark.parametrize(
    ("name", "value", "seen"),
    [
        ("configurable_digital_out[1]", True, True),
        ("configurable_digital_out[1]", False, False),
        ("standard_digital_out[1]", True, False),
        ("speed_slider", 0.25, True),
        ("speed_slider", 0.5, False),
        ("analog_out_voltage[0]", 0.5, True),
        ("analog_out_voltage[0]", 0.4, False),
        ("input_int_register[18]", 4, True),
    ],
)
def test_output_is_seen_in_the_state(name: str, value: Any, seen: bool) -> None:
    output = find_output(name)
    assert output is not None
    assert output.is_seen(value, VALUES) is seen


def test_every_variable_has_a_size() -> None:
    assert all(variable.size > 1 for variable in VARIABLES.values() if variable.kind in (Kind.FLOATS, Kind.BITS))
