"""The driver with ur-rtde against the simulated controller: state, skills, outputs, faults, and a link that breaks."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import socket
import threading
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs
from ua_bridges.ur.config import UrBridgeConfig, UrSink, UrSource
from ua_bridges.ur.driver import UrDriver, create_driver
from ua_bridges.ur.library.child import ChildFailed, LibraryChild

from tests.contract.harness import Recorder, message_of
from tests.system import Processes
from tests.ur_controller import UrController
from tests.waiting import until
from ua_fleet.bridge import (
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionProgressed,
)
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline, SkillRejected
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

pytestmark = pytest.mark.needs("ur")

SPACE = 300
FAULT = Topic(SPACE, 2, 1300)
JOINTS, MODE, SLIDER, REGISTER = (Topic(SPACE, 2, 11), Topic(SPACE, 2, 12), Topic(0, 2, 13), Topic(0, 2, 14))
TEMPERATURE = Topic(301, 2, 91)
NUMBER = {"type": "Double"}
ROBOT: dict[str, Any] = {
    "bridge": "arm",
    "skill_status_id": 1902,
    "fault_id": FAULT.id,
    "data": {
        "joints": {"id": 11, "type": "Double", "array": True, "path": "actual_q", "source": UrSource(max_rate_hz=50)},
        "mode": {"id": 12, "type": "String", "path": "robot_mode_text", "source": UrSource(only_changes=True)},
        "slider": {"id": 13, "type": "Double", "origin": "server", "sink": UrSink(output="speed_slider")},
        "register": {"id": 14, "type": "Int32", "origin": "server", "sink": UrSink(output="input_int_register[19]")},
    },
    "skills": {
        "turn": {
            "id": 1,
            "arguments": {"base": NUMBER, "speed": NUMBER},
            "via": {
                "move_j": {"joints": ["base", -1.5708, 1.2, -1.5708, -1.5708, 0], "speed": "speed", "acceleration": 6}
            },
        },
        "lower": {
            "id": 2,
            "arguments": {"z": NUMBER},
            "via": {"move_l": {"pose": [-0.5, -0.13, "z", 2.22, 2.22, 0.0], "speed": 1.0, "acceleration": 4.0}},
        },
        "measure": {
            "id": 3,
            "arguments": {"text": {"type": "String"}, "seconds": NUMBER},
            "results": {"twice": NUMBER},
            "via": {
                "script": {
                    "body": "textmsg({text})\nwrite_output_float_register(12, {seconds} * 2)\nsleep({seconds})",
                    "results": {"twice": {"place": 12}},
                }
            },
        },
        "sweep": {"id": 16, "via": {"script": {"body": "movej([2.5, -1.5708, 1.2, -1.5708, -1.5708, 0], a=2, v=0.4)"}}},
        "fails": {"id": 4, "via": {"script": {"body": "sleep(0.05)\nno_such_function()"}}},
        "grip": {
            "id": 5,
            "arguments": {"close": {"type": "Boolean"}},
            "via": {"set": {"output": "tool_digital_out[0]", "value": "close"}},
        },
        "load": {
            "id": 6,
            "arguments": {"program": {"type": "String"}},
            "via": {"dashboard": {"command": "load", "text": "program"}},
        },
        "play": {"id": 7, "via": {"dashboard": {"command": "play", "wait_for_end": True, "end_register": 13}}},
        "power_on": {"id": 8, "via": {"dashboard": {"command": "power_on"}}},
        "release": {"id": 9, "via": {"dashboard": {"command": "brake_release"}}},
        "unlock": {"id": 10, "via": {"dashboard": {"command": "unlock_protective_stop"}}},
        "pause": {"id": 17, "via": {"dashboard": {"command": "pause"}}},
        "stop": {"id": 15, "via": {"stop": {"deceleration": 8}}},
    },
}


class Started:
    """A started driver, and what it has told."""

    def __init__(self, driver: UrDriver) -> None:
        self.driver, self.recorder = driver, Recorder()

    def execution(self, name: str, *values: Any) -> Execution:
        skill = next(skill for skill in self.driver.skills() if skill.name == name)
        return Execution(secrets.token_bytes(16), skill.topic, skill.targets[0].id, values, 30.0)

    def begin(self, name: str, *values: Any) -> Execution:
        execution = self.execution(name, *values)
        self.driver.execute(execution)
        return execution

    def facts(self, execution: Execution) -> list[Any]:
        return [e for e in list(self.recorder.events) if getattr(e, "execution_id", None) == execution.execution_id]

    async def end(self, execution: Execution) -> ExecutionEnded | ExecutionForgotten:
        def ends() -> list[Any]:
            return [fact for fact in self.facts(execution) if not isinstance(fact, ExecutionProgressed)]

        await until(ends, "the end", 30)
        ended: ExecutionEnded | ExecutionForgotten
        (ended,) = ends()
        return ended

    async def do(self, name: str, *values: Any) -> ExecutionEnded | ExecutionForgotten:
        return await self.end(self.begin(name, *values))

    async def moves(self, execution: Execution) -> None:
        def begun() -> list[Any]:
            over = [fact for fact in self.facts(execution) if not isinstance(fact, ExecutionProgressed)]
            assert not over, over
            return [fact for fact in self.facts(execution) if fact.progress > 0.02]

        await until(begun, "the move")

    def fault(self) -> str:
        samples = self.recorder.samples(FAULT)
        return samples[-1].values[0] if samples else "(none)"


def fleet(host: str, answer_timeout_s: float = 1.5) -> FleetConfig:
    mirrors = {"rover.temperature": UrSink(output="input_double_register[20]")}
    timing: dict[str, Any] = {"answer_timeout_s": answer_timeout_s, "retry_s": (0.1, 0.3)}
    bridge = UrBridgeConfig(kind="ur", space=SPACE, address=host, mirrors=mirrors, **timing)
    other = UrBridgeConfig(kind="ur", space=TEMPERATURE.space, address="192.0.2.1")
    rover = {"bridge": "other", "data": {"temperature": {"id": TEMPERATURE.id, "type": "Double"}}}
    return FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"arm": bridge, "other": other},
            "robots": {"ur5": ROBOT, "rover": rover},
        }
    )


@asynccontextmanager
async def started(host: str, *, connects: bool = True, answer_timeout_s: float = 1.5) -> AsyncGenerator[Started]:
    driver = create_driver(fleet(host, answer_timeout_s), "arm")
    assert isinstance(driver, UrDriver)
    one = Started(driver)
    await driver.start(one.recorder)
    try:
        if connects:
            await until(lambda: driver.status().connected, "the connection")
        yield one
    finally:
        await driver.stop()


def good(ended: object) -> tuple[Any, ...]:
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == 0, ended.message
    return ended.values


def bad(ended: object, status: StatusCode) -> str:
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == status, ended
    assert ended.values == ()
    assert "\n" not in ended.message
    return ended.message


async def test_state_comes_with_the_controllers_time_at_the_rate_that_was_asked(controller: UrController) -> None:
    async with started(controller.host) as one:

        def rates() -> list[float]:
            """Of sixty samples each."""
            times = [sample.source_time_ns for sample in one.recorder.samples(JOINTS)]
            return [59e9 / (last - first) for first, last in zip(times, times[59:], strict=False)]

        # A busy machine takes fewer, and never more.
        await until(lambda: any(rate > 45 for rate in rates()), "samples")
        samples = one.recorder.samples(JOINTS)
        times = [sample.source_time_ns for sample in samples]
        assert times == sorted(set(times))
        assert max(rates()) < 55
        assert samples[-1].values[0] == pytest.approx(controller.state()["q"])
        assert [sample.values for sample in one.recorder.samples(MODE)] == [("RUNNING",)]
        assert one.fault() == ""


async def test_moves_end_where_they_lead(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = one.begin("turn", 0.8, 2.0)
        assert good(await one.end(execution)) == ()
        assert controller.state()["q"][0] == pytest.approx(0.8, abs=1e-6)
        fractions = [fact.progress for fact in one.facts(execution) if isinstance(fact, ExecutionProgressed)]
        assert fractions == sorted(fractions)
        assert len(fractions) > 5
        good(await one.do("turn", 0.0, 2.0))
        good(await one.do("lower", 0.45))
        assert controller.state()["pose"][2] == pytest.approx(0.45, abs=1e-3)


async def test_one_move_at_a_time_and_a_halt_ends_it(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = one.begin("turn", 3.0, 0.5)
        await one.moves(execution)
        with pytest.raises(RobotBusy, match="at another move"):
            one.begin("lower", 0.4)
        one.driver.halt(execution)
        assert bad(await one.end(execution), StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT) == "halted"
        assert 0.0 < controller.state()["q"][0] < 2.5
        good(await one.do("turn", 0.0, 2.0))


async def test_stop_skill_stops_a_move(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = one.begin("turn", 3.0, 0.5)
        await one.moves(execution)
        good(await one.do("stop"))
        assert "stopped before its end" in bad(await one.end(execution), StatusCode.BAD_UNEXPECTED_ERROR)


@pytest.mark.parametrize("before", [None, ("turn", 0.1, 2.0)])
async def test_stop_skill_stops_a_script(controller: UrController, before: tuple[str, *tuple[Any, ...]] | None) -> None:
    async with started(controller.host) as one:
        if before is not None:
            good(await one.do(*before))
        execution = one.begin("sweep")
        place = controller.state()["q"][0]
        await until(lambda: controller.state()["q"][0] > place + 0.05, "the sweep")
        good(await one.do("stop"))
        place = controller.state()["q"][0]
        assert place < 1.0
        assert "ended before its last line" in bad(await one.end(execution), StatusCode.BAD_UNEXPECTED_ERROR)
        assert controller.state()["q"][0] == pytest.approx(place, abs=0.01)
        good(await one.do("turn", place, 2.0))


async def test_script_runs_with_its_arguments_and_brings_results(controller: UrController) -> None:
    async with started(controller.host) as one:
        assert good(await one.do("measure", "for {you} \\ 'x' Grüße", 0.2)) == (0.4,)
        assert "for {you} \\ 'x' Grüße" in controller.log()
        message = bad(await one.do("fails"), StatusCode.BAD_UNEXPECTED_ERROR)
        assert "ended before its last line" in message
        good(await one.do("turn", 0.1, 2.0))  # the control program is sent again
        for place in (0.2, 0.1, 0.2):  # at once: a script is told done when the robot is free
            assert good(await one.do("measure", "again", 0.1)) == (0.2,)
            good(await one.do("turn", place, 2.0))


@pytest.mark.parametrize("text", ['a"b', "a\nb", "a\r", "a\x00b", '")\nset_digital_out(0, True)\ntextmsg("'])
async def test_argument_that_could_become_a_command_is_refused(controller: UrController, text: str) -> None:
    async with started(controller.host) as one:
        with pytest.raises(SkillRejected):
            one.begin("measure", text, 0.1)
        with pytest.raises(SkillRejected):
            one.begin("measure", "fine", float("nan"))
        if text != 'a"b':
            with pytest.raises(SkillRejected):
                one.begin("load", text)
        await asyncio.sleep(0.1)
        assert controller.state()["digital_outputs"] == 0
        assert not [line for line in controller.log() if "program" in line]


async def test_script_is_halted(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = one.begin("measure", "long", 20.0)
        await until(lambda: one.facts(execution), "the beginning")
        one.driver.halt(execution)
        assert bad(await one.end(execution), StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT) == "halted"


async def test_outputs_are_set_and_seen(controller: UrController) -> None:
    async with started(controller.host) as one:
        good(await one.do("grip", True))
        assert controller.state()["digital_outputs"] == 1 << 16
        good(await one.do("grip", False))
        assert controller.state()["digital_outputs"] == 0
        fields = (make_field("slider", BuiltinType.DOUBLE),)
        metadata = DataSetMetaData("slider", fields, ConfigurationVersion(1, 1))
        assert one.driver.publish(SLIDER, metadata, message_of(SLIDER, 0.25))
        await until(lambda: controller.state()["speed_slider"] == 0.25, "the slider")
        assert not one.driver.publish(SLIDER, metadata, message_of(SLIDER, 1.5))
        assert one.recorder.dropped(Drop.CONVERSION) == 1
        assert not one.driver.publish(JOINTS, metadata, message_of(JOINTS, 1.5))
        assert one.recorder.dropped(Drop.UNMAPPED) == 1


async def test_anothers_data_is_written_to_a_register(controller: UrController) -> None:
    controller.do("record", input="input_double_register_20")
    async with started(controller.host) as one:
        metadata = DataSetMetaData(
            "temperature", (make_field("temperature", BuiltinType.DOUBLE),), ConfigurationVersion(1, 1)
        )
        for celsius in (20.5, 21.0):
            assert one.driver.publish(TEMPERATURE, metadata, message_of(TEMPERATURE, celsius))
        await until(
            lambda: controller.do("recorded", input="input_double_register_20")["recorded"] == [20.5, 21.0],
            "the values",
        )


async def test_dashboard_takes_the_robot_from_off_to_a_programs_end(controller: UrController) -> None:
    async with started(controller.host) as one:
        controller.do("power_off")
        await until(lambda: one.recorder.samples(MODE)[-1].values == ("POWER_OFF",), "the mode")
        with pytest.raises(SkillRejected, match="POWER_OFF: switch the power on"):
            one.begin("turn", 0.1, 1.0)
        good(await one.do("power_on"))
        good(await one.do("release"))
        assert "File not found" in bad(await one.do("load", "nothing.urp"), StatusCode.BAD_UNEXPECTED_ERROR)
        good(await one.do("load", "pick.urp"))
        good(await one.do("play"))
        assert controller.state()["q"][0] == pytest.approx(0.4)
        good(await one.do("turn", 0.1, 2.0))


async def test_protective_stop_is_a_fault_and_ends_the_move(controller: UrController) -> None:
    async with started(controller.host) as one:
        execution = one.begin("turn", 3.0, 0.5)
        await one.moves(execution)
        controller.do("protective_stop")
        assert "protective stop" in bad(await one.end(execution), StatusCode.BAD_OUT_OF_SERVICE)
        assert one.fault().startswith("protective stop")
        with pytest.raises(SkillRejected, match="protective stop"):
            one.begin("turn", 0.0, 2.0)
        while isinstance(unlocked := await one.do("unlock"), ExecutionEnded) and unlocked.status:
            # By the controller's own time.
            assert "Cannot unlock protective stop until 0.3s" in bad(unlocked, StatusCode.BAD_UNEXPECTED_ERROR)
            await asyncio.sleep(0.1)
        good(unlocked)
        await until(lambda: one.fault() == "", "the end of the fault")
        assert controller.state()["runtime"] == "STOPPED", "nobody may let the failed move go on"
        good(await one.do("turn", 0.0, 2.0))


async def test_emergency_stop_is_a_fault_and_local_control_only_refuses(controller: UrController) -> None:
    async with started(controller.host) as one:
        controller.do("emergency_stop")
        await until(lambda: one.fault().startswith("emergency stop at the robot"), "the fault")
        controller.do("reset_safety")
        controller.do("start_up")
        await until(lambda: one.fault() == "", "the end of the fault")
        controller.do("remote_control", on=False)
        await until(lambda: "remote control is off" in one.driver.status().detail, "the status")
        assert one.fault() == "", "the robot may be at work"
        with pytest.raises(SkillRejected, match="local control"):
            one.begin("turn", 0.0, 2.0)


@pytest.mark.parametrize(
    ("deed", "status"),
    [
        ("protective_stop", StatusCode.BAD_OUT_OF_SERVICE),
        ("emergency_stop", StatusCode.BAD_OUT_OF_SERVICE),
        ("dashboard", StatusCode.BAD_UNEXPECTED_ERROR),
    ],
)
async def test_program_that_is_stopped_in_its_middle_is_not_done(
    controller: UrController, deed: str, status: StatusCode
) -> None:
    async with started(controller.host) as one:
        good(await one.do("load", "slow.urp"))
        execution = one.begin("play")
        await until(lambda: controller.state()["q"][0] > 0.05, "the program")
        with pytest.raises(RobotBusy):
            one.begin("turn", 0.0, 2.0)
        if deed == "dashboard":
            with socket.create_connection((controller.host, 29999), 5) as person:
                person.sendall(b"stop\n")
                assert b"Dashboard" in person.recv(200)
        else:
            controller.do(deed)
        bad(await one.end(execution), status)
        assert controller.state()["q"][0] < 0.39
        assert controller.state()["runtime"] == "STOPPED", "nobody may let it go on"


async def test_move_whose_child_ends_before_it_answers_is_followed(
    controller: UrController, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a broken connection ends it: the controller has the move."""
    told: list[LibraryChild] = []
    say, line = LibraryChild.say, LibraryChild.line

    def said_to(child: LibraryChild, thing: dict[str, Any]) -> None:
        if thing["call"] == "moveJ":
            told.append(child)
        say(child, thing)

    def heard_of(child: LibraryChild, timeout_s: float) -> object:
        if child in told:
            told.clear()
            deadline = time.monotonic() + 10.0
            while controller.state()["q"][0] < 0.12 and time.monotonic() < deadline:
                time.sleep(0.01)
            child.end()
            raise ChildFailed("ur-rtde's process has ended")
        return line(child, timeout_s)

    async with started(controller.host) as one:
        good(await one.do("turn", 0.1, 2.0))
        with monkeypatch.context() as broken:
            broken.setattr(LibraryChild, "say", said_to)
            broken.setattr(LibraryChild, "line", heard_of)
            execution = one.begin("turn", 0.6, 0.5)
            await until(lambda: controller.state()["q"][0] > 0.2, "the move")
            assert not [fact for fact in one.facts(execution) if isinstance(fact, ExecutionEnded)]
        good(await one.end(execution))
        assert controller.state()["q"][0] == pytest.approx(0.6, abs=0.005)


@pytest.mark.parametrize("before", [None, ("turn", 0.1, 2.0)])
async def test_program_of_somebody_else_is_left_alone(
    controller: UrController, before: tuple[str, *tuple[Any, ...]] | None
) -> None:
    async with started(controller.host) as one:
        if before is not None:
            good(await one.do(*before))
        with socket.create_connection((controller.host, 30002), 5) as connection:
            connection.sendall(b"def theirs():\n  sleep(60)\nend\n")
            await until(lambda: controller.state()["program"] == "theirs", "the program")
        count = len(one.recorder.samples(JOINTS))
        await until(lambda: len(one.recorder.samples(JOINTS)) > count + 1, "a state with it")
        for ask in (("turn", 0.3, 2.0), ("measure", "mine", 0.1)):
            message = bad(await one.do(*ask), StatusCode.BAD_UNEXPECTED_ERROR)
            assert "another program runs on the controller" in message
            assert controller.state()["program"] == "theirs"
        good(await one.do("pause"))
        with pytest.raises(SkillRejected, match="a program is paused"):
            one.begin("turn", 0.3, 2.0)


async def test_dropped_link_is_told_and_comes_back(controller: UrController) -> None:
    async with started(controller.host) as one:
        good(await one.do("turn", 0.2, 2.0))
        controller.do("drop")
        await until(lambda: one.recorder.lost(JOINTS) == 1, "the loss")
        await until(lambda: one.driver.status().connected and one.fault() == "", "the connection")
        good(await one.do("turn", 0.0, 2.0))
        assert {sample.values[0] for sample in one.recorder.samples(FAULT)} == {""}, "silence is no fault"
        assert one.recorder.lost(FAULT) == 1


async def test_move_goes_on_over_a_lost_link_and_its_end_is_seen(controller: UrController) -> None:
    async with started(controller.host) as one:
        good(await one.do("turn", 0.0, 2.0))
        execution = one.begin("turn", 2.0, 1.0)
        await one.moves(execution)
        controller.do("drop")
        good(await one.end(execution))
        assert one.recorder.lost(JOINTS) == 1
        assert controller.state()["q"][0] == pytest.approx(2.0, abs=0.005)


async def test_controller_that_hangs_stops_nobody(controller: UrController) -> None:
    """It accepts connections and says nothing: ur-rtde itself would wait for ever, with the interpreter's lock."""
    async with started(controller.host) as one:
        sweep = one.begin("sweep")
        await until(lambda: controller.state()["q"][0] > 0.05, "the sweep")
        controller.do("silence", on=True)
        ticks, loop = 0, asyncio.get_running_loop()
        began = loop.time()
        while loop.time() - began < 4.0:
            await asyncio.sleep(0.01)
            ticks += 1
        assert ticks > 250
        status = one.driver.status()
        assert not status.connected
        assert "sends nothing" in status.detail
        assert (one.fault(), one.recorder.lost(FAULT)) == ("", 1), "the arm goes on, whoever hears it"
        with pytest.raises(RobotOffline, match="sends nothing"):
            one.begin("turn", 0.0, 2.0)
        controller.do("silence", on=False)
        await until(lambda: one.driver.status().connected, "the connection")
        good(await one.end(sweep))
        good(await one.do("turn", 0.1, 2.0))


async def test_controller_may_come_later_and_be_switched_off(processes: Processes) -> None:
    controller = UrController(processes)
    async with started(controller.host, connects=False) as one:
        await until(lambda: "nothing answers at port 30004" in one.driver.status().detail, "the reason")
        assert one.fault() == "(none)"
        with pytest.raises(RobotOffline):
            one.begin("turn", 0.0, 2.0)
        controller.start()
        await until(lambda: one.driver.status().connected, "the connection")
        controller.end()
        await until(lambda: not one.driver.status().connected, "the loss")
        controller.start()
        await until(lambda: one.driver.status().connected, "the connection")


async def test_driver_that_comes_later_finds_out_what_became_of_it(controller: UrController) -> None:
    async with started(controller.host) as one:
        done = one.begin("measure", "done", 0.1)
        good(await one.end(done))
        moved = one.begin("turn", 1.5, 1.0)
        await one.moves(moved)
    async with started(controller.host) as other:
        never, set_before = other.execution("measure", "never", 1.0), other.execution("grip", True)
        for execution in (done, moved, never, set_before):
            other.driver.query(execution)
        assert good(await other.end(done)) == (0.2,)
        good(await other.end(moved))
        assert controller.state()["q"][0] == pytest.approx(1.5, abs=0.005)
        for execution in (never, set_before):
            assert isinstance(await other.end(execution), ExecutionForgotten)
        good(await other.do("turn", 0.0, 2.0))  # over the control program that the driver before left


async def test_stopped_driver_leaves_nothing_behind(controller: UrController) -> None:
    threads = set(threading.enumerate())
    async with started(controller.host) as one:
        good(await one.do("turn", 0.1, 2.0))
    await until(lambda: not children(), f"the end of {children()}")
    await until(
        lambda: not [t for t in set(threading.enumerate()) - threads if not t.name.startswith("asyncio_")], "threads"
    )
    await one.driver.stop()


def children() -> list[int]:
    """Our own children with ur-rtde."""
    found: list[int] = []
    for process in Path("/proc").iterdir():
        try:
            status = (process / "stat").read_text().rpartition(")")[2].split()
            if int(status[1]) == os.getpid() and "ur.library" in (process / "cmdline").read_text():
                found.append(int(process.name))
        except (OSError, IndexError, ValueError):
            continue
    return found


async def test_each_loss_is_logged_once(processes: Processes) -> None:
    controller = UrController(processes)
    with capture_logs() as log:
        async with started(controller.host, connects=False) as one:
            await asyncio.sleep(1.0)  # several attempts
            controller.start()
            await until(lambda: one.driver.status().connected, "the connection")
            controller.end()
            await until(lambda: not one.driver.status().connected, "the loss")
            await asyncio.sleep(0.5)
    assert [entry["event"] for entry in log if entry["log_level"] != "debug"] == [], "the bridge says what it comes to"
    said = [entry.get("reason", entry["event"]) for entry in log if "to the controller" in entry["event"]]
    absent = f"{controller.host}: nothing answers at port 30004; check the address, and that the controller is on"
    assert said[:2] == [absent, "connected to the controller"]
    assert said[2:] in ([f"{controller.host}: the controller closed the connection", absent], [absent])


async def test_child_that_is_killed_is_replaced(controller: UrController) -> None:
    async with started(controller.host) as one:
        good(await one.do("grip", True))
        for pid in children():
            os.kill(pid, signal.SIGKILL)
        await until(lambda: one.recorder.lost(JOINTS) == 1, "the loss")
        await until(lambda: one.driver.status().connected, "the connection")
        good(await one.do("grip", False))
