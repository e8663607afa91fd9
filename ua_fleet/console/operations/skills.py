"""A robot's skills: start, halt, suspend, resume."""

from __future__ import annotations

from typing import Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters

__all__ = ["SKILL_OPERATIONS"]


class OfSkill(OperationParameters):
    """A skill of a robot."""

    robot: str = Field(min_length=1, max_length=200)
    skill: str = Field(min_length=1, max_length=200)


class Start(OfSkill):
    """What a skill is started with; what is left out has its default."""

    arguments: dict[str, bool | int | float | str] = Field(default_factory=dict[str, bool | int | float | str])


async def _start(client: FleetClient, asked: Start) -> dict[str, Any]:
    execution = await client.start_skill(asked.robot, asked.skill, **asked.arguments)
    return {"execution": execution.id, "timeout_s": execution.timeout_s}


async def _halt(client: FleetClient, asked: OfSkill) -> None:
    await client.halt_skill(asked.robot, asked.skill)


async def _suspend(client: FleetClient, asked: OfSkill) -> None:
    await client.suspend_skill(asked.robot, asked.skill)


async def _resume(client: FleetClient, asked: OfSkill) -> None:
    await client.resume_skill(asked.robot, asked.skill)


SKILL_OPERATIONS: Final = (
    OperationKind("skill.start", Start, _start, "Start of a skill", "operator"),
    OperationKind("skill.halt", OfSkill, _halt, "Halt of a skill", "operator"),
    OperationKind("skill.suspend", OfSkill, _suspend, "Suspend of a skill", "operator"),
    OperationKind("skill.resume", OfSkill, _resume, "Resume of a skill", "operator"),
)
