"""Requests for skills, to whoever does them: robots behind bridges, or OPC UA clients."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ua_fleet.operation.robots.offers import ClientOffers
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest
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

    def prepare(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> RecordedRequest | RecordedExecution | None:
        """The record of a request, to be written down with what it follows from; see both."""
        return self._of(topic).prepare(topic, robot, skill, arguments, timeout_s, execution_id)

    def recorded(self, records: Iterable[RecordedRequest | RecordedExecution], left_out: Iterable[bytes]) -> None:
        """These records are on the disk now, and these that were left are not any more."""
        records, left_out = list(records), list(left_out)
        self._commands.recorded(records, left_out)
        self._offers.recorded(records, left_out)

    def leave(self, execution_id: bytes) -> None:
        """A request that was prepared is not made after all."""
        self._commands.leave(execution_id)
        self._offers.leave(execution_id)

    @property
    def left(self) -> tuple[bytes, ...]:
        """Requests that were recorded and left; who records the others deletes them."""
        return self._commands.left + self._offers.left

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
