"""The base class of drivers: what is not overridden is refused, and what is overridden is offered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.unit.bridge.mute import Mute
from ua_fleet.bridge import Driver, Execution, Skill
from ua_fleet.errors import SkillRejected
from ua_fleet.topics import Topic


def ignore(_driver: Driver, *_told: object) -> None:
    """A method that does nothing."""


TOPIC = Topic(300, 2, 1)
EXECUTION = Execution(bytes(16), TOPIC, 1, ())


class Able(Mute):
    """It overrides what belongs to skills."""

    def skills(self) -> Sequence[Skill]:
        return (Skill(TOPIC, "pick", ()),)

    def execute(self, execution: Execution) -> None: ...

    def query(self, execution: Execution) -> None: ...


class Obedient(Able):
    """Its robots can be stopped, stand, and be driven by hand."""

    def halt(self, execution: Execution) -> None: ...

    def suspend(self, execution: Execution) -> None: ...

    def resume(self, execution: Execution) -> None: ...

    def setpoint_problem(self, topic: Topic) -> str:
        return ""

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None: ...


def test_a_driver_writes_four_methods() -> None:
    assert Driver.__abstractmethods__ == {"start", "publish", "status", "stop"}


def test_a_driver_that_overrides_nothing_offers_nothing() -> None:
    driver = Mute()
    assert not driver.has_skills
    assert not driver.can_halt
    assert not driver.can_suspend
    assert not driver.takes_packed_arrays
    assert list(driver.skills()) == []
    assert driver.setpoint_problem(TOPIC) == "its driver has no way to write setpoints"


@pytest.mark.parametrize("ask", [Driver.execute, Driver.query, Driver.halt, Driver.suspend, Driver.resume])
def test_what_it_does_not_offer_is_refused(ask: Callable[[Driver, Execution], None]) -> None:
    with pytest.raises(SkillRejected, match="the robot has no way to do that"):
        ask(Mute(), EXECUTION)


def test_what_it_is_told_it_may_ignore() -> None:
    driver = Mute()
    driver.remember_in(Path("/proc/nowhere"))
    driver.want(frozenset({TOPIC}))
    driver.stale(TOPIC, is_stale=True)
    asyncio.run(driver.stop())


def test_what_is_overridden_is_offered() -> None:
    able, obedient = Able(), Obedient()
    assert (able.has_skills, able.can_halt, able.can_suspend) == (True, False, False)
    assert (obedient.has_skills, obedient.can_halt, obedient.can_suspend) == (True, True, True)


def test_a_mixin_before_the_driver_counts() -> None:
    class Mixed(Able, Mute):
        """As the ROS drivers are made."""

    assert Mixed().has_skills


@pytest.mark.parametrize(
    ("base", "names", "refused"),
    [
        (Mute, ("skills", "execute"), "has no query; write all of skills, execute, query"),
        (Mute, ("execute",), "has no skills and no query"),
        (Able, ("suspend",), "has no resume"),
        (Mute, ("write_setpoint",), "has no setpoint_problem"),
    ],
)
def test_what_belongs_together_is_overridden_together(base: type[Driver], names: tuple[str, ...], refused: str) -> None:
    with pytest.raises(TypeError, match=refused):
        type("Half", (base,), dict.fromkeys(names, ignore))
