"""A robot's own program: functions offered as skills."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import pytest
from ua_bridges.robot import Announcer, Busy, Execution, Program, Refused

ID, OTHER = "00" * 16, "11" * 16


class Heard:
    """What a program has said; `wait` for a state of an execution."""

    def __init__(self) -> None:
        self.all: list[dict[str, Any]] = []
        self._changed = threading.Condition()

    def say(self, text: str) -> None:
        with self._changed:
            self.all.append(json.loads(text))
            self._changed.notify_all()

    def wait(self, state: str, execution_id: str = ID) -> dict[str, Any]:
        def found() -> dict[str, Any] | None:
            wanted = [said for said in self.all if (said["execution_id"], said["state"]) == (execution_id, state)]
            return wanted[-1] if wanted else None

        with self._changed:
            assert self._changed.wait_for(found, 10), f"{state} was never said: {self.all}"
            said = found()
        assert said is not None
        return said

    def states(self, execution_id: str = ID) -> list[str]:
        return [said["state"] for said in self.all if said["execution_id"] == execution_id]


def request(execution_id: str = ID, **members: Any) -> str:
    return json.dumps({"request": "execute", "execution_id": execution_id, "skill": "go", **members})


def offer(function: Callable[..., Mapping[str, Any] | None], **options: Any) -> tuple[Program, Heard]:
    heard = Heard()
    return Program("go", function, heard.say, **options), heard


def test_it_is_done_with_its_arguments_and_says_its_results() -> None:
    def go(execution: Execution, to: str, speed: float = 0.2) -> dict[str, Any]:
        execution.progress(0.5, "half way")
        execution.progress(7.0)
        return {"to": to, "speed": speed, "timeout_s": execution.timeout_s, "id": execution.id}

    program, heard = offer(go)
    program.receive(request(arguments={"to": "dock"}, timeout_s=9))
    done = heard.wait("done")
    assert done["results"] == {"to": "dock", "speed": 0.2, "timeout_s": 9.0, "id": ID}
    assert heard.states() == ["accepted", "running", "running", "done"]
    assert [said.get("progress") for said in heard.all[1:]] == [0.5, 1.0, 1.0]


def test_what_is_repeated_is_not_done_again() -> None:
    done: list[str] = []
    release = threading.Event()

    def go(execution: Execution) -> None:
        done.append(execution.id)
        release.wait(10)

    program, heard = offer(go)
    for _ in range(3):
        program.receive(request())
    assert heard.states() == ["accepted"] * 3
    release.set()
    heard.wait("done")
    program.receive(request())
    program.receive(json.dumps({"request": "query", "execution_id": ID}))
    assert heard.states()[3:] == ["done"] * 3
    assert done == [ID]


def test_who_hears_the_end_may_ask_for_the_next_at_once() -> None:
    heard, following = Heard(), "11" * 16

    def say(text: str) -> None:
        heard.say(text)
        if json.loads(text)["state"] == "done" and not heard.states(following):
            program.receive(request(following))

    program = Program("go", nothing, say)
    program.receive(request())
    heard.wait("done", following)
    assert heard.states(following) == ["accepted", "done"]


def raises(error: BaseException) -> Callable[[Execution], None]:
    def go(execution: Execution) -> None:
        raise error

    return go


def gives(speed: object) -> Callable[[Execution], dict[str, Any]]:
    return lambda _execution: {"speed": speed}


def returns(what: object) -> Callable[[Execution], Any]:
    return lambda _execution: what


def nothing(execution: Execution) -> None:
    """Is done at once."""


def there(execution: Execution, to: str) -> dict[str, Any]:
    return {"to": to}


@pytest.mark.parametrize(
    ("function", "state", "message"),
    [
        (raises(Refused("no way")), "refused", "no way"),
        (raises(Busy("not now")), "refused", "not now"),
        (raises(ValueError("bumped")), "failed", "ValueError: bumped"),
        (gives(float("nan")), "failed", "ValueError: Out of range float values"),
        (gives(object()), "failed", "TypeError"),
        (returns("ok"), "failed", "TypeError: a skill returns its results by their names, or nothing, and not str"),
        (returns([1, 2]), "failed", "TypeError: a skill returns"),
        (returns(False), "failed", "TypeError: a skill returns"),
        (raises(SystemExit(1)), "failed", "SystemExit: 1"),
    ],
)
def test_what_goes_wrong_is_said(function: Any, state: str, message: str) -> None:
    program, heard = offer(function)
    program.receive(request())
    said = heard.wait(state)
    assert said["message"].startswith(message)
    assert said["busy"] is (message == "not now")
    assert heard.states() == ["accepted", state]


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"arguments": {"speed": 1}}, "go: missing a required argument: 'to'"),
        ({"arguments": {"to": 1, "from": 2}}, "go: got an unexpected keyword argument 'from'"),
        ({"arguments": [1]}, "`arguments` is no object"),
        ({"arguments": {"to": 1}, "skill": "stay"}, "this is go, and not stay"),
    ],
)
def test_what_does_not_fit_is_refused(members: dict[str, Any], message: str) -> None:
    program, heard = offer(there)
    program.receive(request(**members))
    assert [(said["state"], said["message"]) for said in heard.all] == [("refused", message)]


def test_results_can_be_any_mapping() -> None:
    program, heard = offer(returns(MappingProxyType({"to": "dock"})))
    program.receive(request())
    assert heard.wait("done")["results"] == {"to": "dock"}


def test_one_at_a_time_unless_it_says_otherwise() -> None:
    release = threading.Event()

    def go(execution: Execution) -> None:
        release.wait(10)

    program, heard = offer(go)
    program.receive(request())
    program.receive(request(OTHER))
    refused = heard.wait("refused", OTHER)
    assert (refused["message"], refused["busy"]) == ("go is being done already", True)
    release.set()
    heard.wait("done")
    both, heard = offer(go, at_once=2)
    both.receive(request())
    both.receive(request(OTHER))
    heard.wait("done", OTHER)


def test_it_stops_when_it_is_told_to() -> None:
    def go(execution: Execution) -> None:
        while True:
            execution.progress(0.5)
            execution.canceled.wait(10)

    program, heard = offer(go)
    program.receive(request())
    heard.wait("running")
    program.receive(json.dumps({"request": "cancel", "execution_id": ID}))
    assert heard.wait("halted")["message"] == "it was halted"


def test_what_it_does_not_know_is_unknown() -> None:
    program, heard = offer(nothing)
    for what in ("query", "cancel"):
        program.receive(json.dumps({"request": what, "execution_id": OTHER}))
    assert heard.states(OTHER) == ["unknown", "unknown"]


@pytest.mark.parametrize("text", ["", "[]", "{}", "5", '{"execution_id": "0f"}', '{"execution_id": 7}', "[" * 100_000])
def test_what_is_no_request_is_left_alone(text: str) -> None:
    program, heard = offer(nothing)
    program.receive(text)
    assert heard.all == []


def test_memory_is_bounded_and_forgets_what_has_ended() -> None:
    program, heard = offer(nothing, at_once=10_000)
    for number in range(1002):
        program.receive(request(f"{number:032x}"))
        heard.wait("done", f"{number:032x}")
    program.receive(json.dumps({"request": "query", "execution_id": f"{0:032x}"}))
    assert heard.states(f"{0:032x}")[-1] == "unknown"


def test_a_fault_is_said_once_and_its_end_too() -> None:
    said: list[str] = []
    robot = Announcer(said.append)
    robot.fault(" motor\n overheated ")
    robot.fault("motor overheated")
    robot.fault("motor burnt")
    robot.repaired()
    robot.repaired()
    assert said == ["motor overheated", "motor burnt", ""]


def test_a_robot_that_was_restarted_says_that_it_is_well() -> None:
    said: list[str] = []
    Announcer(said.append).repaired()
    assert said == [""]


def test_a_fault_needs_a_reason_and_an_id() -> None:
    with pytest.raises(ValueError, match="say in a line what is wrong"):
        Announcer(print).fault(" \n")
    with pytest.raises(ValueError, match="give Robot the fault_id"):
        Announcer(None).fault("motor overheated")


def stand(what: str, execution_id: str = ID) -> str:
    return json.dumps({"request": what, "execution_id": execution_id})


def test_a_function_stands_where_it_says_so_and_goes_on() -> None:
    stood: list[bool] = []
    at_rest = threading.Event()

    def go(execution: Execution) -> None:
        execution.progress(0.4, "half")
        assert execution.suspended.wait(10)
        at_rest.wait(10)
        stood.append(execution.wait_if_suspended())
        stood.append(execution.wait_if_suspended())

    program, heard = offer(go)
    program.receive(request())
    heard.wait("running")
    program.receive(stand("suspend"))
    assert heard.states() == ["accepted", "running"], "it does not stand before it says so"
    at_rest.set()
    suspended = heard.wait("suspended")
    assert (suspended["progress"], suspended["message"]) == (0.4, "half")
    program.receive(stand("query"))
    program.receive(stand("resume"))
    heard.wait("done")
    assert heard.states() == ["accepted", "running", "suspended", "suspended", "running", "done"]
    assert stood == [True, False]


def test_what_stands_can_be_halted_and_says_that_it_stands_whatever_its_threads_say() -> None:
    told: list[Execution] = []

    def go(execution: Execution) -> None:
        told.append(execution)
        execution.suspended.wait(10)
        execution.wait_if_suspended()

    program, heard = offer(go)
    program.receive(request())
    program.receive(stand("suspend"))
    heard.wait("suspended")
    told[0].progress(0.7)
    assert heard.states() == ["accepted", "suspended", "suspended"]
    program.receive(stand("cancel"))
    assert heard.wait("halted")["message"] == "it was halted"
    assert heard.states() == ["accepted", "suspended", "suspended", "halted"]


def test_what_is_not_under_way_is_asked_for_by_a_request_to_stand() -> None:
    program, heard = offer(nothing)
    program.receive(stand("suspend"))
    assert heard.states() == ["unknown"]
