"""A bridge is disabled and enabled by an Action of the server, and halting stays possible."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.bridge.test_actions import ACTION, ID, SENDER, SPACE, WALL, Bench
from ua_fleet.bridge import ExecutionEnded, SampleRead, SourceFound
from ua_fleet.bridge.immediate import TARGET_ID
from ua_fleet.bridge.switching import BridgeSwitches
from ua_fleet.counters import Drop
from ua_fleet.pubsub import Publisher, PubSubTiming, Subscriber
from ua_fleet.pubsub.components import CONNECTION, Component, writer, writer_group
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.pubsub.metadata import fields_version, make_field
from ua_fleet.pubsub.switch_action import (
    SWITCH,
    SWITCH_ID,
    SWITCH_REQUEST,
    component_of,
    switch_arguments,
    switch_topic,
)
from ua_fleet.skill import ExecutionState
from ua_fleet.skill.answers import read_answer
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.messages import NetworkMessage

LEVEL = Topic(SPACE, 2, 1001)
FIELDS = (make_field("level", BuiltinType.DOUBLE),)


class Switched(Bench):
    """A bridge with a source and a skill, and its switches."""

    def __init__(self) -> None:
        super().__init__()
        self.now: float = 0.0
        self.publisher: Publisher = self.core._publisher
        subscriber: Subscriber = self.core._subscriber
        self.told: list[tuple[str, bool]] = []
        self.mistakes: list[tuple[str, Exception]] = []
        self.switches = self.core.switches = BridgeSwitches(
            "cell",
            SPACE,
            2,
            self.publisher,
            subscriber,
            self.counters,
            requestors=(0, 9),
            must_be_verified=False,
            send=self.sent.append,
            send_to=self._answer,
            wall_ticks=lambda: WALL + round(self.now * 1e7),
            hear=self.core.hear,
            told=lambda what, is_enabled: self.told.append((what, is_enabled)),
            failed=lambda text, _: self.failures.append(text),
            caught=lambda about, error: self.mistakes.append((about, error)),
        )
        self.actions.rival = lambda _now: self.switches.problem
        self.core.from_space(SourceFound(LEVEL, "level", FIELDS), now=0.0, wall_ticks=WALL)
        self.switches.begin(0.0)
        self.number = 100

    def switch(self, component: Component, *, is_enabled: bool, **rest: Any) -> int:
        """Ask as the server does; the StatusCode of the answer."""
        self.number += 1
        message = ActionMessage(
            SPACE,
            2,
            SWITCH_ID,
            TARGET_ID,
            1,
            ActionState.EXECUTING,
            is_request=True,
            requestor_id="0.pubsub",
            correlation_data=self.number.to_bytes(16, "big"),
            timeout_hint_ms=2000.0,
            types=tuple(field.builtin_type for field in SWITCH_REQUEST),
            values=tuple(switch_arguments(component, is_enabled=is_enabled).values()),
            timestamp=WALL + self.number,
        )
        count = len(self.answers)
        self.core._action(ActionReceived(message._replace(**rest), SENDER, False), self.now)
        assert len(self.answers) in (count, count + 1)
        return -1 if len(self.answers) == count else read_answer(self.answers[-1][0]).status

    def data_after(self, level: float) -> list[float]:
        """What is sent of the source when its robot says something."""
        self.sent.clear()
        self.now += 0.1
        self.core.from_space(
            SampleRead(LEVEL, (level,), 1_700_000_000_000_000_000 + round(self.now * 1e9)),
            now=self.now,
            wall_ticks=WALL,
        )
        self.core.poll(self.now, WALL)
        messages = [message for message in map(Codec().decode, self.sent) if isinstance(message, NetworkMessage)]
        parts = [part for message in messages for part in message.messages if part.data_set_writer_id == LEVEL.id]
        return [part.values[0] for part in parts if part.values]


def test_the_action_is_announced_with_the_bridge_as_its_target() -> None:
    bench = Switched()
    announced = [one for one in bench.announced() if one.data_set_writer_id == SWITCH_ID]
    assert [(one.request.name, [target.name for target in one.targets]) for one in announced] == [(SWITCH, ["cell"])]
    version = fields_version(SWITCH_REQUEST, ())
    assert announced[0].request.configuration_version.major == version
    assert switch_topic(SPACE, 2) == Topic(SPACE, 2, 0xFFFF)


@pytest.mark.parametrize("component", [CONNECTION, writer_group(2), writer(2, 1001)])
def test_the_names_of_components_go_over_the_wire(component: Component) -> None:
    ns, writer_id, is_enabled = switch_arguments(component, is_enabled=True).values()
    assert component_of(int(ns), int(writer_id)) == component
    assert is_enabled is True


@pytest.mark.parametrize("component", [CONNECTION, writer_group(2), writer(2, 1001)])
def test_what_is_disabled_says_nothing_until_it_is_enabled(component: Component) -> None:
    bench = Switched()
    assert bench.data_after(1.0) == [1.0]
    assert bench.switch(component, is_enabled=False) == 0
    assert bench.data_after(2.0) == []
    assert bench.counters.drops[Drop.DISABLED] == 1
    assert bench.switch(component, is_enabled=False) == StatusCode.BAD_INVALID_STATE
    assert bench.switch(component, is_enabled=True) == 0
    assert 3.0 in bench.data_after(3.0)
    assert bench.switch(component, is_enabled=True) == StatusCode.BAD_INVALID_STATE
    assert [is_enabled for _, is_enabled in bench.told] == [False, True]


def test_nothing_is_begun_while_the_connection_is_disabled_and_what_runs_goes_on() -> None:
    bench = Switched()
    bench.ask(1)
    assert bench.switch(CONNECTION, is_enabled=False) == 0
    bench.tell(ExecutionEnded(ID, 0, (12.5,)))
    assert bench.states() == [ExecutionState.DONE]
    bench.ask(2)
    assert [execution.execution_id[-1] for execution in bench.robot.begun] == [1]
    assert bench.reports()[-1].status == StatusCode.BAD_NO_COMMUNICATION
    assert "Disabled" in bench.reports()[-1].message
    assert bench.switch(CONNECTION, is_enabled=True) == 0
    bench.ask(3)
    assert [execution.execution_id[-1] for execution in bench.robot.begun] == [1, 3]


def test_only_the_server_may_ask_and_only_for_what_there_is() -> None:
    bench = Switched()
    assert bench.switch(CONNECTION, is_enabled=False, requestor_id="9.pubsub") == StatusCode.BAD_USER_ACCESS_DENIED
    assert bench.switch(writer(2, 4242), is_enabled=False) == StatusCode.BAD_NOT_FOUND
    assert bench.switch(writer_group(7), is_enabled=False) == StatusCode.BAD_NOT_FOUND
    assert bench.switch(CONNECTION, is_enabled=False, values=(0, 1001, False)) == StatusCode.BAD_NOT_FOUND
    assert bench.told == []
    assert bench.data_after(1.0) == [1.0]


def test_a_request_that_comes_twice_switches_once() -> None:
    bench = Switched()
    assert bench.switch(CONNECTION, is_enabled=False) == 0
    bench.number -= 1
    assert bench.switch(CONNECTION, is_enabled=False) == 0  # the same answer
    assert bench.told == [("the PubSubConnection", False)]


def test_a_bridge_whose_data_has_that_id_says_that_it_cannot_be_switched() -> None:
    bench = Switched()
    publisher = Publisher(SPACE, PubSubTiming(), bench.counters, Codec())
    publisher.announce(Topic(SPACE, 2, SWITCH_ID), "taken", FIELDS, now=0.0, wall_ticks=WALL)
    bench.switches._actions._publisher = publisher
    bench.sent.clear()
    bench.switches.begin(0.0)
    assert "cannot be disabled from the server" in bench.failures[-1]
    assert not [one for one in map(Codec().decode, bench.sent) if isinstance(one, ActionMetaDataAnnouncement)]
    assert ACTION.id != SWITCH_ID


def test_a_mistake_costs_the_request_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Switched()

    def broken(*_: Any, **__: Any) -> None:
        raise RuntimeError("broken")

    with monkeypatch.context() as patched:
        patched.setattr(bench.publisher.switches, "disable", broken)
        assert bench.switch(CONNECTION, is_enabled=False) == StatusCode.BAD_INTERNAL_ERROR
    [(about, error)] = bench.mistakes
    assert (about, str(error)) == ("switches", "broken")
    assert bench.switch(CONNECTION, is_enabled=False) == 0
