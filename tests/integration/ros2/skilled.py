"""A ROS 2 driver with skills in the test's process, and the robot that has them in another."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.driver import create_driver
from ua_bridges.ros2.skills.driver import SkilledRos2Driver

from tests.contract.harness import Recorder
from tests.waiting import until
from ua_fleet.bridge import Execution, ExecutionEnded, ExecutionFact, ExecutionForgotten, ExecutionProgressed
from ua_fleet.bridge.driver import Driver
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import Topic

SKILLS: dict[str, Any] = {
    "drive": {
        "id": 1010,
        "arguments": {"to": {"type": "String"}, "seconds": {"type": "Double", "default": 0.0}},
        "results": {"distance": {"type": "Double"}},
        "timeout_s": 10.0,
    },
    "move": {
        "id": 1011,
        "arguments": {"speed": {"type": "Double"}},
        "timeout_s": 2.0,
        "via": {
            "topic": {
                "topic": "/move",
                "type": "geometry_msgs/Twist",
                "fields": {"speed": "linear.x"},
                "constants": {"angular.z": 0.5},
                "halt": {},
                "status": {
                    "topic": "/move_state",
                    "type": "std_msgs/String",
                    "running": "data == 'moving'",
                    "done": "data == 'arrived'",
                    "failed": "data == 'stuck'",
                    "message": "data",
                },
            }
        },
    },
    "load": {
        "id": 1012,
        "arguments": {"map_url": {"type": "String"}},
        "results": {"width": {"type": "UInt32"}},
        "timeout_s": 1.0,
        "via": {
            "service": {
                "name": "/load_map",
                "type": "nav_msgs/LoadMap",
                "success": "result == 0",
                "results": {"width": "map.info.width"},
            }
        },
    },
}


class Skilled:
    """A started driver and what it has told."""

    def __init__(self, driver: Driver, recorder: Recorder, space: int) -> None:
        assert isinstance(driver, SkilledRos2Driver)
        self.driver = driver
        self.recorder, self.space = recorder, space

    def execution(self, skill_id: int, *values: Any, execution_id: bytes | None = None) -> Execution:
        return Execution(execution_id or secrets.token_bytes(16), Topic(self.space, 2, skill_id), 1, values)

    def begin(self, skill_id: int, *values: Any) -> bytes:
        execution = self.execution(skill_id, *values)
        self.driver.execute(execution)
        return execution.execution_id

    def halt(self, skill_id: int, execution_id: bytes) -> None:
        self.driver.halt(self.execution(skill_id, execution_id=execution_id))

    def facts(self, execution_id: bytes) -> list[ExecutionFact]:
        kinds = (ExecutionEnded, ExecutionForgotten, ExecutionProgressed)
        return [e for e in list(self.recorder.events) if isinstance(e, kinds) and e.execution_id == execution_id]

    async def until_at_it(self, execution_id: bytes) -> None:
        await until(lambda: self.facts(execution_id), "the robot's beginning")

    async def end(self, execution_id: bytes) -> ExecutionFact:
        """The fact that ends it; nothing comes after it."""

        def ended() -> bool:
            facts = self.facts(execution_id)
            return bool(facts) and not isinstance(facts[-1], ExecutionProgressed)

        await until(ended, "the end")
        await asyncio.sleep(0.1)
        facts = self.facts(execution_id)
        assert [type(fact) for fact in facts].count(type(facts[-1])) == 1
        return facts[-1]


@asynccontextmanager
async def skilled_driver(domain: int, skills: dict[str, Any] | None = None) -> AsyncGenerator[Skilled]:
    """A driver whose robot has the skills; their robot's process is started by the test."""
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"mobile": Ros2BridgeConfig(kind="ros2", space=domain)},
            "robots": {"carrier": {"bridge": "mobile", "skill_status_id": 1000, "skills": skills or SKILLS}},
        }
    )
    driver, recorder = create_driver(config, "mobile"), Recorder()
    await driver.start(recorder)
    try:
        yield Skilled(driver, recorder, domain)
    finally:
        await driver.stop()
