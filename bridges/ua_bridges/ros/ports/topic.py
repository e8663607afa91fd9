"""A skill that is begun by a message on a topic, and whose end is a condition on another topic.

A topic tells nothing of one execution, so there is one at a time, and after a restart nobody can be asked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ua_bridges.ros.ports.port import Listened, SkillGraph, SkillPort
from ua_bridges.ros.skill_values import RequestFiller, StatusReader, fill_constants
from ua_bridges.ros.skills import SkillSpec, TopicSkill
from ua_bridges.ros.topic_mapping import absolute
from ua_fleet.bridge.driver import DriverEvent, Dropped, Execution
from ua_fleet.bridge.executing import Ended, Executing, Open, halted
from ua_fleet.counters import Drop
from ua_fleet.scenario.expression import ValueUnknown
from ua_fleet.values import Quality, StatusCode, quality_of

__all__ = ["TopicPort"]


class TopicPort(SkillPort[SkillGraph]):
    """See the module."""

    repeats_halt = False  # it names no execution, and may mean more to the robot than to stop this one

    def __init__(
        self, spec: SkillSpec, way: TopicSkill, executing: Executing, put: Callable[[DriverEvent], None]
    ) -> None:
        super().__init__(spec, executing, put)
        self._way = way
        self._name = absolute(way.topic)
        self._source = (
            "" if way.status is None else f"{absolute(way.status.topic)} has no publisher; start the robot's node"
        )
        if way.halt is None:
            self.cannot_stop = f"fleet.yaml does not say how {spec.robot}.{spec.name} is stopped; give `via.topic.halt`"
        self._reader: StatusReader | None = None
        self._current: bytes | None = None
        self._has_run = False

    def _open(self, graph: SkillGraph) -> None:
        way = self._way
        self._kind = kind = graph.load(way.type)
        self._filler = RequestFiller(self.spec, way, kind.schema)
        self._filler.check(kind.cls())
        if way.halt is not None:
            fill_constants(kind.schema, way.halt, kind.cls())
        if way.status is not None:
            self._reader = StatusReader(self.spec, way.status, graph.load(way.status.type).cls())
        self._spoken = graph.speak(self._name, way.type, way.qos)

    def _request_of(self, execution: Execution) -> Any:
        return self._filler.fill(self._kind.cls(), execution.values)

    def listened(self) -> tuple[Listened, ...]:
        """See SkillPort."""
        status = self._way.status
        if status is None:
            return ()
        return (Listened(absolute(status.topic), status.type, status.qos, self._heard, self._source_changed),)

    def _source_changed(self, problem: str) -> None:
        self._source = problem

    def _look(self, now: float) -> str:
        return self._spoken.look(now) or self._source

    def _tell(self, execution_id: bytes, request: Any, now: float) -> None:
        self._current, self._has_run = execution_id, False
        self._spoken.publish(request)
        if self._reader is None:
            self._executing.end(execution_id, Ended(StatusCode.GOOD))
        else:
            self._executing.progress(execution_id, 0.0)

    def _heard(self, message: Any) -> None:
        opened = self._executing.get(self._current) if self._current is not None else None
        if self._reader is None or opened is None:
            return
        try:
            self._judge(self._reader, opened, message)
        except ValueUnknown as error:
            self._put(Dropped(Drop.CONVERSION, detail=f"{self.spec.robot}.{self.spec.name}: {error}"))

    def _judge(self, reader: StatusReader, opened: Open, message: Any) -> None:
        if not self._has_run:
            self._has_run = reader.runs(message, opened.arguments)
            if not self._has_run:
                return
        outcome = reader.judge(message, opened.arguments)
        if opened.is_told_to_stop:
            self._judge_halt(reader, opened, message, outcome.ended)
        elif outcome.ended is not None:
            self._executing.end(opened.execution_id, outcome.ended)
        elif outcome.progress is not None:
            self._executing.progress(opened.execution_id, outcome.progress)

    def _judge_halt(self, reader: StatusReader, opened: Open, message: Any, ended: Ended | None) -> None:
        if ended is not None and quality_of(ended.status) is not Quality.BAD:
            self._executing.end(opened.execution_id, ended)
        elif ended is not None or reader.stands(message, opened.arguments):
            self._executing.end(opened.execution_id, halted(ended.message if ended is not None else ""))

    def _ask(self, execution_id: bytes, now: float) -> None:
        self._executing.forget(execution_id, f"{self._name} tells nothing of a time before; see what the robot does")

    def _cannot_be_told(self, now: float) -> str:
        """The status topic is not needed for that."""
        return self._spoken.look(now)

    def _stop(self, execution_id: bytes, now: float) -> None:
        if self._way.halt is not None:
            self._spoken.publish(fill_constants(self._kind.schema, self._way.halt, self._kind.cls()))
            self._executing.told_to_stop(execution_id, now)

    def _give_up(self, opened: Open, now: float) -> None:
        if opened.is_told_to_stop:
            self._executing.forget(opened.execution_id)
        elif self._way.halt is None:
            self._executing.end(opened.execution_id, opened.too_long(is_halted=False))
        else:
            untold = self._have_stopped(opened.execution_id, now)
            ended = opened.too_long(is_halted=not untold, otherwise=self._untold(untold))
            self._executing.end(opened.execution_id, ended)
