"""Requests that wait for nothing: also those to halt, suspend and resume."""

from __future__ import annotations

import pytest

from tests.unit.server.test_commands_out import ANNOUNCED, Bench, announced
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.skill.executions import (
    HALT_TARGETS,
    RESUME_TARGETS,
    SUSPEND_TARGETS,
    ExecutionState,
    OutcomeKind,
    Report,
    halt_id,
)
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.discovered import ActionTarget

ACTION = Topic(300, 2, 1501)
ID = bytes(15) + b"\7"


async def test_a_request_is_sent_at_once_and_its_outcome_told() -> None:
    bench = announced(Bench())
    bench.commands.request(ACTION, "any name", ("bin",), 5.0, ID)
    (request,) = bench.requests()
    assert (request.correlation_data, request.action_target_id, request.values) == (ID, 1, ("bin",))
    bench.respond(request)
    assert bench.told == [OutcomeKind.ACCEPTED]


async def test_of_several_robots_the_named_one_is_asked() -> None:
    bench = Bench()
    targets = (ActionTarget(3, "left"), ActionTarget(4, "right"), ActionTarget(4 | HALT_TARGETS, "right, halt"))
    bench.commands.announced(ANNOUNCED._replace(targets=targets))
    bench.commands.request(ACTION, "right", ("bin",), 5.0, ID)
    assert bench.requests()[-1].action_target_id == 4
    with pytest.raises(SkillRejected, match="pick has no target 'middle'"):
        bench.commands.request(ACTION, "middle", ("bin",), 5.0, ID)


async def test_what_nobody_has_announced_is_asked_for_and_refused() -> None:
    bench = Bench()
    with pytest.raises(RobotOffline, match="nobody announces"):
        bench.commands.request(ACTION, "arm", ("bin",), 5.0, ID)
    assert (bench.wanted, bench.sent) == ([(300, 1501)], [])
    with pytest.raises(RobotOffline, match="nobody announces"):
        bench.commands.halt(ACTION, "arm", ID)


async def test_a_halt_names_its_execution_is_asked_for_once_and_a_refusal_is_logged(
    capsys: pytest.CaptureFixture[str],
) -> None:
    bench = Bench()
    targets = (ActionTarget(1, "arm"), ActionTarget(1 | HALT_TARGETS, "arm, halt"))
    bench.commands.announced(ANNOUNCED._replace(targets=targets))
    for _ in range(2):
        bench.commands.halt(ACTION, "arm", ID)
    (request,) = bench.requests()
    assert (request.action_target_id, request.correlation_data, request.values) == (1 | HALT_TARGETS, halt_id(ID), ())
    bench.respond(request, Report(ExecutionState.REFUSED, message="it holds a load"))
    said = capsys.readouterr().out
    assert "a robot did not do it" in said
    assert "stop" in said
    assert "it holds a load" in said


async def test_a_robot_without_a_way_to_stop_is_told() -> None:
    bench = announced(Bench())
    with pytest.raises(SkillRejected, match="no way to stop pick") as caught:
        bench.commands.halt(ACTION, "arm", ID)
    assert caught.value.ua_status == StatusCode.BAD_NOT_SUPPORTED
    assert bench.sent == []


async def test_a_robot_is_asked_to_stand_and_go_on_as_often_as_somebody_wants() -> None:
    bench = Bench()
    targets = [ActionTarget(1, "arm")]
    targets += [ActionTarget(1 | bits, "arm, more") for bits in (HALT_TARGETS, SUSPEND_TARGETS, RESUME_TARGETS)]
    bench.commands.announced(ANNOUNCED._replace(targets=tuple(targets)))
    for _ in range(2):
        bench.commands.suspend_execution(ACTION, "any name", ID)
        bench.commands.resume_execution(ACTION, "any name", ID)
    requests = bench.requests()
    assert [request.action_target_id for request in requests] == [1 | SUSPEND_TARGETS, 1 | RESUME_TARGETS] * 2
    assert {request.values for request in requests} == {(ID,)}
    assert len({request.correlation_data for request in requests}) == 4


async def test_a_robot_without_a_way_to_stand_is_told() -> None:
    bench = announced(Bench())
    for ask, said in ((bench.commands.suspend_execution, "suspend"), (bench.commands.resume_execution, "resume")):
        with pytest.raises(SkillRejected, match=f"no way to {said} pick") as caught:
            ask(ACTION, "arm", ID)
        assert caught.value.ua_status == StatusCode.BAD_NOT_SUPPORTED
    assert bench.sent == []
