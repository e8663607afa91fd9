"""The driver of a robot of the fleet, and work that its machine does badly."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Final

from tests.contract.harness import NUMBER
from tests.contract.skilled import FIELDS, RESULTS, TARGET, Job, Machine, SkilledDriver
from tests.contract.virtual import Bus, VirtualRobot
from ua_fleet.bridge import Execution, ExecutionEnded, ExecutionNotBegun, Skill, SkillTarget
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

__all__ = [
    "ANSWERS_FOR_ANOTHER",
    "ANSWERS_TWICE",
    "FAILS_EVERY_OTHER_TIME",
    "HEAVY",
    "POISONED",
    "RobotDriver",
    "tell_values",
]

FAILS_EVERY_OTHER_TIME: Final = "fails every other time"
"""Work whose name begins so fails when the machine is told first, third, fifth ... of it."""
ANSWERS_TWICE: Final = "answers twice"
"""It is done, and then it has failed, and then it is done with another result."""
ANSWERS_FOR_ANOTHER: Final = "answers for another"
"""Of the job before, and of one that nobody knows, it is told that they have failed; its own end never comes."""
POISONED: Final = "a part of 1e9 kg"
"""Work that no machine can do: not its fault."""
HEAVY: Final = "heavy"
"""Work that machines do unless they are weak."""

_BROKEN: Final = int(StatusCode.BAD_UNEXPECTED_ERROR)


class RobotDriver(SkilledDriver):
    """A machine with the ids of its robot. Its log has all that it was told, so it knows for sure what it was not."""

    def __init__(self, config: FleetConfig, robot: str, bus: Bus, machine: Machine) -> None:
        self._space, self._robot = config.space_of(robot), robot
        super().__init__(self._space, bus, machine)
        declared = config.robots[robot]
        self._skill, self._status = declared.skills["work"].id, declared.skill_status_id

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        assert self._skill is not None
        assert self._status is not None
        targets = (SkillTarget(TARGET, self._robot, Topic(self._space, 2, self._status)),)
        return (Skill(Topic(self._space, 2, self._skill), "work", targets, FIELDS, RESULTS),)

    def query(self, execution: Execution) -> None:
        """See Driver."""
        assert self._to is not None
        if self._machine.find(execution.execution_id) is None and not self._machine.is_forgetful:
            self._to.put(ExecutionNotBegun(execution.execution_id))
        else:
            super().query(execution)

    def _end(self, job: Job) -> None:
        assert self._to is not None
        told = self._machine.told()
        if job.work.startswith(FAILS_EVERY_OTHER_TIME):
            alike = [one for one in told if one.work == job.work]
            if alike.index(job) % 2 == 0:
                self._to.put(ExecutionEnded(job.execution_id, _BROKEN, (), "not this time"))
                return
        elif job.work == POISONED or (job.work == HEAVY and self._machine.is_weak):
            said = f"{self._robot} cannot hold {job.work}"
            self._to.put(ExecutionEnded(job.execution_id, _BROKEN, (), said))
            return
        elif job.work == ANSWERS_FOR_ANOTHER:
            for execution_id in (*[one.execution_id for one in told[: told.index(job)][-1:]], bytes(16)):
                self._to.put(ExecutionEnded(execution_id, _BROKEN, (), "told of another"))
            return
        super()._end(job)
        if job.work == ANSWERS_TWICE:
            self._to.put(ExecutionEnded(job.execution_id, _BROKEN, (), "told again"))
            self._to.put(ExecutionEnded(job.execution_id, 0, ("another result", -1.0)))


async def tell_values(config: FleetConfig, robot: str, bus: Bus, machine: Machine) -> None:
    """Tell the values of a robot while its machine is not mute: another program than the one for its skills."""
    space, data = config.space_of(robot), config.robots[robot].data
    topics = {Topic(space, 2, one.id).name: name for name, one in data.items() if one.origin == "robot" and one.id}
    program, is_there = VirtualRobot(bus), False
    while topics:
        was_there, is_there = is_there, not machine.is_mute
        values = machine.values
        for topic, name in topics.items():
            if is_there and not was_there:
                program.advertise(topic, NUMBER)
            elif was_there and not is_there:
                program.withdraw(topic)
            if is_there:
                program.publish(topic, NUMBER.values(values.get(name, 1.0)))
        await asyncio.sleep(0.1)
