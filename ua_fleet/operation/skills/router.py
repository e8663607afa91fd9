"""Requests for skills, to whoever does them: robots behind bridges, or OPC UA clients."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ua_fleet.operation.robots.offers import ClientOffers
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.topics import SERVER_SPACE, Topic

__all__ = ["SkillRouter"]


class SkillRouter:
    """Asks by the space of the Action; space 0 is the server's own, and has the skills of clients."""

    def __init__(self, commands: SkillCommands, offers: ClientOffers) -> None:
        self._commands, self._offers = commands, offers

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        """Have a skill done, once; see both."""
        self._of(topic).request(topic, robot, skill, arguments, timeout_s, execution_id)

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have an execution stopped; see both."""
        self._of(topic).halt(topic, robot, execution_id)

    def suspend_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stand in the middle of an execution; see both."""
        self._of(topic).suspend_execution(topic, robot, execution_id)

    def resume_execution(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot go on with an execution; see both."""
        self._of(topic).resume_execution(topic, robot, execution_id)

    def inquire(self, execution_id: bytes) -> None:
        """Ask a bridge once more what became of a request; a client's answer is told as soon as there is one."""
        try:
            self._offers.known_outcome(execution_id)
        except KeyError:
            self._commands.inquire(execution_id)

    def known_outcome(self, execution_id: bytes) -> RequestOutcome | None:
        """What is known of a request; None while it is asked for, KeyError where it was never made."""
        try:
            return self._offers.known_outcome(execution_id)
        except KeyError:
            return self._commands.known_outcome(execution_id)

    def _of(self, topic: Topic) -> SkillCommands | ClientOffers:
        return self._offers if topic.space == SERVER_SPACE else self._commands
