"""What a task says of its end, held against what the words mean: every task through every stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest
from ua_bridges.ur.config import Dashboard, DashboardSkill, MoveJ, ScriptSkill, UrSkillMapping
from ua_bridges.ur.dashboard_tasks import DashboardTask, PlayTask
from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.modes import RuntimeState, SafetyMode
from ua_bridges.ur.state import State
from ua_bridges.ur.task import Forgotten, Progress, RobotTask, Told
from ua_bridges.ur.tasks import MoveTask, ScriptTask, refusal_of

from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.bridge.executing import Ended
from ua_fleet.config.schema import SkillConfig
from ua_fleet.errors import SkillTimeout
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

END = 13
MARK = 7
STOPS = [mode for mode in SafetyMode if not mode.may_move and mode is not SafetyMode.UNDEFINED]
MOVING = [0.0, 0.4, 0.0, 0.0, 0.0, 0.0]
VALUES: dict[str, Any] = {
    "robot_mode": 7,
    "safety_mode": 1,
    "runtime_state": int(RuntimeState.STOPPED),
    "actual_q": [0.0] * 6,
    "actual_qd": [0.0] * 6,
    "actual_TCP_pose": [0.0] * 6,
    **{f"output_int_register_{place}": 0 for place in range(12, 20)},
}


def state(**values: Any) -> State:
    return State(1.0, 1, 1.0, {**VALUES, **values})


UNDER_WAY: dict[str, Any] = {
    "runtime_state": int(RuntimeState.PLAYING),
    "actual_qd": MOVING,
    "output_int_register_18": MARK,
}


class Link:
    """A link whose controller takes everything."""

    has_control = False
    error: Exception | None = None

    def __init__(self) -> None:
        self.stopped = 0

    def call(self, *_: Any, **__: Any) -> Any:
        if self.error is not None:
            raise self.error

    def take_control(self, *, is_playing: bool) -> None:
        self.has_control = True

    def operation(self) -> tuple[bool, int]:
        return True, 1

    def has_begun_one(self) -> bool:
        return False

    def send_script(self, program: str) -> None:
        self.call(program)

    def stop_move(self, _deceleration: float) -> bool:
        return False

    def stop_program(self) -> None:
        self.stopped += 1


def move() -> RobotTask:
    return MoveTask(MoveJ(joints=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)), {})


def script() -> RobotTask:
    way = ScriptSkill(body="movej([1, 0, 0, 0, 0, 0])")
    via = UrSkillMapping(script=way)
    topic = Topic(300, 2, 1)
    skill = ConfiguredSkill("arm", "sweep", topic, topic, SkillConfig(), via)
    return ScriptTask(skill, way, {}, 18, MARK)


def play(register: int | None = END, *, waits: bool = True) -> RobotTask:
    return PlayTask(DashboardSkill(command=Dashboard.PLAY, wait_for_end=waits, end_register=register))


def blind_play() -> RobotTask:
    return play(None)


class Bench:
    """A task that was begun, and its controller."""

    def __init__(self, task: RobotTask, *, error: Exception | None = None) -> None:
        self.task, self.link, self.now = task, Link(), 10.0
        self._link = cast("CommandLink", self.link)
        self.link.error = error
        if error is None:
            task.begin(self._link, state(), self.now)
        else:
            with pytest.raises(type(error)):
                task.begin(self._link, state(), self.now)
            task.is_unsure = task.is_told
            self.link.error = None

    def look(self, after_s: float = 0.02, **values: Any) -> Told:
        self.now += after_s
        return self.task.look(self._link, state(**values), self.now)

    def halt(self) -> None:
        self.task.halt(self._link, state(**UNDER_WAY))

    def settles(self, **values: Any) -> Told:
        """What it says in the end of a controller that shows the same for long."""
        told: Told = None
        for _ in range(20):
            told = self.look(0.3, **values)
            if isinstance(told, Ended | Forgotten):
                break
        return told


@pytest.mark.parametrize("mode", STOPS)
@pytest.mark.parametrize("make", [move, script, play, blind_play])
def test_a_safety_stop_is_the_robots_state_once_it_stands(make: Callable[[], RobotTask], mode: SafetyMode) -> None:
    bench = Bench(make())
    assert isinstance(bench.look(**UNDER_WAY), Progress)
    slowing: dict[str, Any] = {**UNDER_WAY, "safety_mode": int(mode)}
    assert not isinstance(bench.look(**slowing), Ended | Forgotten), "it still moves"
    for runtime in (RuntimeState.PAUSED, RuntimeState.STOPPED):
        standing: dict[str, Any] = {**slowing, "runtime_state": int(runtime), "actual_qd": [0.0] * 6}
        told = bench.look(**standing)
        assert isinstance(told, Ended)
        assert told.status == StatusCode.BAD_OUT_OF_SERVICE


@pytest.mark.parametrize(
    ("make", "status"),
    [(script, StatusCode.BAD_UNEXPECTED_ERROR), (play, StatusCode.BAD_UNEXPECTED_ERROR), (blind_play, None)],
)
def test_a_program_that_somebody_has_stopped_is_not_done(make: Callable[[], RobotTask], status: int | None) -> None:
    bench = Bench(make())
    bench.look(**UNDER_WAY)
    stopped: dict[str, Any] = {"output_int_register_18": MARK}
    assert not isinstance(bench.look(**stopped, actual_qd=MOVING), Ended | Forgotten), "it still moves"
    told = bench.settles(**stopped)
    if status is None:
        assert isinstance(told, Forgotten)
        assert "end_register" in told.message
    else:
        assert isinstance(told, Ended)
        assert told.status == status
        assert "before its last line" in told.message


@pytest.mark.parametrize("make", [script, play, blind_play])
def test_it_was_halted_once_it_stands(make: Callable[[], RobotTask]) -> None:
    bench = Bench(make())
    bench.look(**UNDER_WAY)
    bench.halt()
    assert bench.link.stopped == 1
    assert isinstance(bench.look(5.0, **UNDER_WAY), Progress), "a robot that ignores it is not halted"
    slowing = {**UNDER_WAY, "runtime_state": int(RuntimeState.STOPPED)}
    assert not isinstance(bench.look(5.0, **slowing), Ended | Forgotten)
    told = bench.settles(output_int_register_18=MARK)
    assert isinstance(told, Ended)
    assert told.status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT


def test_a_program_that_has_changed_its_register_was_done() -> None:
    bench = Bench(play())
    bench.look(**UNDER_WAY)
    assert isinstance(bench.look(**UNDER_WAY, output_int_register_13=1), Progress)
    assert bench.settles(output_int_register_13=1) == Ended(0)


def test_a_program_that_is_over_before_a_state_shows_it_is_told_by_its_register() -> None:
    assert Bench(play()).settles(output_int_register_13=1) == Ended(0)
    assert isinstance(Bench(play()).settles(), Ended)
    assert Bench(play(None, waits=False)).settles() == Ended(0)


@pytest.mark.parametrize("make", [move, script, play, blind_play])
def test_what_was_said_and_not_answered_is_followed_by_what_the_controller_shows(
    make: Callable[[], RobotTask],
) -> None:
    bench = Bench(make(), error=SkillTimeout("the child has ended"))
    assert bench.task.is_told
    bench.link.has_control = False
    assert isinstance(bench.look(**UNDER_WAY), Progress)
    assert not isinstance(bench.look(9.0, **UNDER_WAY), Ended | Forgotten)


def test_a_program_that_nobody_has_seen_and_whose_play_was_not_answered_is_unknown() -> None:
    for task in (play(), play(None), play(None, waits=False)):
        assert isinstance(Bench(task, error=SkillTimeout("no answer")).settles(), Forgotten)


@pytest.mark.parametrize("command", [Dashboard.PAUSE, Dashboard.POWER_ON, Dashboard.BRAKE_RELEASE])
def test_other_commands_do_not_take_a_stop_for_what_they_are_for(command: Dashboard) -> None:
    bench = Bench(DashboardTask(DashboardSkill(command=command), {}))
    shown: dict[str, Any] = {
        "runtime_state": int(RuntimeState.PAUSED),
        "robot_mode": 3,
        "safety_mode": int(SafetyMode.FAULT),
    }
    told = bench.settles(**shown)
    assert isinstance(told, Ended)
    assert told.status == StatusCode.BAD_OUT_OF_SERVICE


def test_what_says_nothing_of_standing_keeps_from_new_work_all_the_same() -> None:
    for make in (move, script, play):
        assert "local control" in refusal_of(make(), state(), remote_control=False)
        assert "says nothing" in refusal_of(make(), state(safety_mode=99), remote_control=None)
        assert refusal_of(make(), state(), remote_control=True) == ""
    paused = state(runtime_state=int(RuntimeState.PAUSED))
    assert "is paused" in refusal_of(move(), paused, remote_control=True)
    assert refusal_of(play(), paused, remote_control=True) == "", "it has it go on"
