"""Requests that wait for nothing: also those to halt, suspend and resume."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.unit.operation.skills.test_commands import ANNOUNCED, Bench, announced
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.skill.executions import (
    HALT_TARGETS,
    RESUME_TARGETS,
    SUSPEND_TARGETS,
    ExecutionReport,
    ExecutionState,
    OutcomeKind,
    halt_id,
    is_halted_by,
    named_results,
    pack,
)
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, QualifiedName, StatusCode
from ua_fleet.wire.discovered import ActionTarget

ACTION = Topic(300, 2, 1501)
ID = bytes(15) + b"\7"


async def test_a_request_is_sent_at_once_and_its_outcome_told() -> None:
    bench = announced(Bench())
    bench.commands.request(ACTION, "arm", "pick", {"place": "bin"}, 5.0, ID)
    (request,) = bench.requests()
    assert (request.correlation_data, request.action_target_id, request.values) == (ID, 1, ("bin",))
    bench.respond(request)
    assert bench.told == [OutcomeKind.ACCEPTED]


async def test_of_several_robots_the_named_one_is_asked() -> None:
    bench = Bench()
    targets = (ActionTarget(3, "left"), ActionTarget(4, "right"), ActionTarget(4 | HALT_TARGETS, "right, halt"))
    bench.commands.announced(ANNOUNCED._replace(targets=targets))
    bench.commands.request(ACTION, "right", "pick", {"place": "bin"}, 5.0, ID)
    assert bench.requests()[-1].action_target_id == 4
    with pytest.raises(SkillRejected, match=r"pick of left, right at ua_300_2_1501, and .* pick of middle"):
        bench.commands.request(ACTION, "middle", "pick", {"place": "bin"}, 5.0, ID)


async def test_another_skill_at_the_same_id_is_not_asked_for() -> None:
    """Two files that give the ids the other way round had the robot close where it was told to open."""
    bench = announced(Bench())
    with pytest.raises(SkillRejected, match="give both the same ids") as refused:
        bench.commands.request(ACTION, "arm", "place", {"place": "bin"}, 5.0, ID)
    assert refused.value.ua_status == StatusCode.BAD_CONFIGURATION_ERROR
    assert bench.sent == []


async def test_arguments_go_with_the_version_of_what_was_announced() -> None:
    bench = announced(Bench())
    bench.commands.request(ACTION, "arm", "pick", {"place": "bin"}, 5.0, ID)
    (request,) = bench.requests()
    assert request.major_version == ANNOUNCED.request.configuration_version.major
    again = Bench(bench.journal)
    again.commands.resume(0.0)
    assert again.requests()[0].major_version == request.major_version, "also after a restart"
    refused = ExecutionReport(ExecutionState.REFUSED, StatusCode.BAD_CONFIGURATION_ERROR, "other arguments")
    bench.respond(request, refused)
    bench.commands.poll(10.0)  # nobody else has accepted it meanwhile
    assert (bench.told, bench.wanted) == ([OutcomeKind.REFUSED], [(300, 1501)]), "it is asked what is announced now"


async def test_what_nobody_has_announced_is_asked_for_and_refused() -> None:
    bench = Bench()
    with pytest.raises(RobotOffline, match="no bridge announces"):
        bench.commands.request(ACTION, "arm", "pick", {"place": "bin"}, 5.0, ID)
    assert (bench.wanted, bench.sent) == ([(300, 1501)], [])
    with pytest.raises(RobotOffline, match="no bridge announces"):
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
    bench.respond(request, ExecutionReport(ExecutionState.REFUSED, message="it holds a load"))
    bench.commands.poll(10.0)  # nobody else has accepted it meanwhile
    said = capsys.readouterr().out
    assert "a robot did not do it" in said
    assert "stop" in said
    assert "it holds a load" in said


async def test_a_robot_that_has_not_stopped_is_told_again_by_another_request() -> None:
    """The first one is over: its bridge would only say again what it has recorded of it."""
    bench = Bench()
    targets = (ActionTarget(1, "arm"), ActionTarget(1 | HALT_TARGETS, "arm, halt"))
    bench.commands.announced(ANNOUNCED._replace(targets=targets))
    bench.commands.halt(ACTION, "arm", ID)
    bench.respond(bench.requests()[-1], ExecutionReport(ExecutionState.DONE))
    bench.commands.halt(ACTION, "arm", ID)
    first, *_, last = bench.requests()
    assert (first.correlation_data, last.correlation_data) == (halt_id(ID), halt_id(ID, 1))
    assert is_halted_by(ID, halt_id(ID, 1))
    assert not is_halted_by(bytes(12) + b"\1" + ID[13:], halt_id(ID, 1))


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


def of_two(*names: str) -> Bench:
    """A bench with an Action that takes these Doubles and answers with them."""
    bench = Bench()
    fields = tuple([make_field(name, BuiltinType.DOUBLE) for name in names])
    named = ANNOUNCED.request._replace(fields=fields)
    bench.commands.announced(ANNOUNCED._replace(request=named, response=named))
    return bench


async def test_arguments_go_by_their_names_whatever_order_the_bridge_announces() -> None:
    bench = of_two("y", "x")
    bench.commands.request(ACTION, "arm", "pick", {"x": 1.0, "y": 2.0}, 5.0, ID)
    (request,) = bench.requests()
    assert request.values == (2.0, 1.0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"x": 1.0}, "pick takes 'y', which is not given: the bridge's fleet.yaml and the server's differ"),
        ({"x": 1.0, "y": 2.0, "z": 3.0}, "pick does not take 'z'"),
        ({"x": 1.0, "why": 2.0}, "pick takes 'y', which is not given, and does not take 'why'"),
    ],
)
async def test_a_name_that_the_other_side_lacks_refuses_the_request(given: dict[str, float], said: str) -> None:
    bench = of_two("y", "x")
    with pytest.raises(SkillRejected, match=said):
        bench.commands.request(ACTION, "arm", "pick", given, 5.0, ID)
    assert bench.sent == []


async def test_an_argument_with_a_default_may_be_left_out_by_a_server_that_does_not_know_it() -> None:
    bench = Bench()
    default = QualifiedName(0, "Default"), int(BuiltinType.DOUBLE), 0.5
    field = make_field("speed", BuiltinType.DOUBLE)
    fields = (field._replace(properties=(default,)), make_field("x", BuiltinType.DOUBLE))
    bench.commands.announced(ANNOUNCED._replace(request=ANNOUNCED.request._replace(fields=fields)))
    bench.commands.request(ACTION, "arm", "pick", {"x": 1.0}, 5.0, ID)
    (request,) = bench.requests()
    assert request.values == (0.5, 1.0)


async def test_results_have_the_names_that_the_bridge_announces() -> None:
    bench = of_two("y", "x")
    bench.commands.request(ACTION, "arm", "pick", {"x": 1.0, "y": 2.0}, 5.0, ID)
    (request,) = bench.requests()
    packed = pack((int(BuiltinType.DOUBLE),) * 2, (2.0, 1.0))
    bench.respond(request, ExecutionReport(ExecutionState.DONE, result=packed))
    outcome = bench.commands.known_outcome(ID)
    assert outcome is not None
    assert named_results(outcome, ("x", "y")) == {"x": 1.0, "y": 2.0}
    unknown = replace(outcome, names=None)
    assert named_results(unknown, ("x", "y")) == {}
    assert named_results(unknown, ("x",)) == {"x": 2.0}


async def test_a_prepared_request_is_sent_as_it_was_recorded() -> None:
    bench = announced(Bench())
    asked = (ACTION, "arm", "pick", {"place": "bin"}, 5.0, ID)
    record = bench.commands.prepare(*asked)
    assert record is not None
    assert bench.sent == []
    assert list(bench.journal.requests()) == []
    bench.journal.requested(record)
    bench.commands.recorded([record], [])
    assert bench.commands.prepare(*asked) is None
    bench.commands.request(*asked)
    (request,) = bench.requests()
    assert (request.correlation_data, request.values, request.timestamp) == (ID, ("bin",), record.issued)
    assert request.major_version == ANNOUNCED.request.configuration_version.major
    assert list(bench.journal.requests()) == [record]
    bench.respond(request)
    assert bench.told == [OutcomeKind.ACCEPTED]


async def test_what_cannot_be_asked_for_now_is_not_prepared() -> None:
    assert Bench().commands.prepare(ACTION, "arm", "pick", {"place": "bin"}, 5.0, ID) is None
    bench = announced(Bench())
    with pytest.raises(SkillRejected, match="give both the same ids"):
        bench.commands.prepare(ACTION, "arm", "place", {"place": "bin"}, 5.0, ID)
    with pytest.raises(SkillRejected, match="pick"):
        bench.commands.prepare(ACTION, "arm", "pick", {"place": 5}, 5.0, ID)
