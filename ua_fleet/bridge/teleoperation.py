"""Robots of a bridge that are driven by hand: Actions and setpoints in, outputs to the driver, a status out.

    ActionRequest -> Responder (no journal) -> Control.acquire, renew, release -> ActionResponse
    setpoint      -> Control.take
    a timer       -> Control.step -> driver.write_setpoint,  Control.publish -> status DataSet

It has a timer of its own, since the bridge's may be put off by a second after a mistake. A mistake with one robot ends
its lease and leaves the others alone.

The clock of the event loop stands while the machine sleeps, and what waits in a socket is as fresh afterwards as it was
before. So the time of `Control` is that clock and the time for which the machine has slept.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

from ua_fleet.bridge.core import BridgeCore
from ua_fleet.bridge.driver import Driver, SourceFound
from ua_fleet.bridge.immediate import ImmediateActions
from ua_fleet.counters import Counters, Drop
from ua_fleet.one_timer import OneTimer
from ua_fleet.pubsub.events import ActionReceived, SetpointReceived
from ua_fleet.pubsub.metadata import type_codes
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.skill.executions import pack
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.teleoperation import Control, TeleoperationModel
from ua_fleet.teleoperation.messages import (
    ACQUIRE,
    ACQUIRE_REQUEST,
    ACQUIRE_RESPONSE,
    LEASE_REQUEST,
    RELEASE,
    RELEASE_REQUEST,
    RENEW,
    STATUS_FIELDS,
    read_setpoint,
)
from ua_fleet.topics import Topic
from ua_fleet.transport.addresses import answer_address
from ua_fleet.transport.party import Answers
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["BridgeTeleoperation"]

_REQUESTS_AT_ONCE: Final = 16
_PAUSE_S: Final = 0.02
"""After a mistake the timer does not ring for so long."""
_STOP_PATIENCE_S: Final = 0.5
"""For the zeros that follow a stop, and a busy machine."""
_Fields = tuple[FieldMetaData, ...]


class BridgeTeleoperation:
    """All robots of one bridge that can be driven by hand."""

    def __init__(
        self,
        space: int,
        models: Sequence[TeleoperationModel],
        publisher: Publisher,
        counters: Counters,
        *,
        driver: Driver,
        core: BridgeCore,
        next_number: Callable[[], int],
        requestors: Iterable[int],
        must_be_verified: bool,
        busy: Callable[[str, float], str],
        send: Callable[[bytes], None],
        send_to: Callable[[bytes, tuple[str, int]], None],
        wall_ticks: Callable[[], int],
        caught: Callable[[str, Exception], None],
        told: Callable[[str, str, str], None],
        loop: asyncio.AbstractEventLoop,
        answers: Answers = answer_address,
        limits: ResponderLimits | None = None,
    ) -> None:
        """Connect the parts.

        Args:
            space: the space that the bridge stands in.
            models: the robots.
            publisher: announces the Actions.
            counters: where all of the bridge count.
            driver: writes to the robots.
            core: publishes the status.
            next_number: of leases; as in `Leases`.
            requestors: spaces that may command this one; of these the server alone may ask for leases.
            must_be_verified: whether keys are configured: unsigned requests are dropped then.
            busy: why a robot cannot be driven now, by its name and the time; empty where it can.
            send: sends a plain message to all.
            send_to: sends a plain message to one address.
            wall_ticks: the time of the wall clock.
            caught: told of a mistake, with the loop that it happened in.
            told: told for the log what became of a lease, with the robot's name and the holder or the reason.
            loop: for the timer.
            answers: finds where a response goes.
            limits: of the responder; the usual ones if left out.
        """
        self._counters, self._driver, self._core, self._busy = counters, driver, core, busy
        self._wall_ticks, self._caught, self._say, self._loop = wall_ticks, caught, told, loop
        self._controls = {model.robot: Control(model, next_number) for model in models}
        self._by_writer = {model.setpoints.data_set_writer_id: self._controls[model.robot] for model in models}
        self._by_action = {topic.id: self._controls[model.robot] for model in models for topic in model.actions}
        self._actions = ImmediateActions(
            space,
            publisher,
            counters,
            self._asked,
            about="teleoperation",
            requestors=requestors,
            must_be_verified=must_be_verified,
            requests_at_once=_REQUESTS_AT_ONCE,
            send=send,
            send_to=send_to,
            wall_ticks=wall_ticks,
            caught=caught,
            answers=answers,
            limits=limits,
        )
        self._ends: dict[str, int] = {}
        """How many ends of leases were told, by robot."""
        self._timer = OneTimer(self._loop, self._on_timer)
        self._slept_s = 0.0
        self._at_rest = asyncio.Event()
        self._is_ending = False

    @property
    def topics(self) -> frozenset[Topic]:
        """The data that takes setpoints alone."""
        return frozenset(control.model.data for control in self._controls.values())

    def begin(self, now: float) -> None:
        """Announce the Actions and the status of each robot."""
        for control in self._controls.values():
            model, wall_ticks = control.model, self._wall_ticks()
            for topic, name, request, response in _actions(model):
                self._actions.offer(topic, name, model.robot, request, response, now)
            source = SourceFound(model.status, f"{model.robot} teleoperation", STATUS_FIELDS)
            self._core.from_space(source, now=now, wall_ticks=wall_ticks)
            self._core.tell(model.status, control.status().fields(), wall_ticks, now=now)
        self._arm()

    async def stop(self) -> None:
        """End all leases, bring the robots to a standstill, and write nothing any more."""
        now, self._is_ending = self._control_time(self._loop.time()), True
        for control in self._controls.values():
            control.end("the bridge ends", now)
        self._arm()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(max(each.model.stop_s for each in self._controls.values()) + _STOP_PATIENCE_S):
                await self._at_rest.wait()
        self._timer.end()

    def driven_by(self, robot: str) -> str:
        """Why a robot does no skill now, since it is driven by hand; empty where it may."""
        control = self._controls.get(robot)
        return "" if control is None else control.driven_by

    def takes(self, message: ActionMessage) -> bool:
        """Whether a request is about a lease."""
        return message.data_set_writer_id in self._by_action

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take a request about a lease."""
        self._actions.receive(event, now)
        self._arm()

    def setpoint(self, event: SetpointReceived, now: float) -> None:
        """Take a setpoint."""
        control = self._by_writer.get(event.message.data_set_writer_id)
        setpoint = read_setpoint(event.message)
        if control is None or setpoint is None:
            self._counters.drop(Drop.LAYOUT if setpoint is None else Drop.UNKNOWN_SOURCE)
            return
        drop = control.take(setpoint, self._control_time(now))
        if drop is not None:
            self._counters.drop(drop)
            self._arm()  # it may have stopped the robot

    def _asked(self, writer_id: int, values: list[Any], now: float) -> bytes:
        control = self._by_action[writer_id]
        model = control.model
        if writer_id == model.acquire.id:
            holder, session, take_over = values
            busy = "its bridge ends" if self._is_ending else self._busy(model.robot, now)
            busy = busy or self._driver.setpoint_problem(model.data)
            granted = control.acquire(
                holder or "", session or "", self._control_time(now), take_over=take_over, busy=busy
            )
            self._say("a lease to drive it by hand begins", model.robot, f"lease {granted.lease}: {holder}")
            return pack(type_codes(ACQUIRE_RESPONSE), granted.fields())
        if writer_id == model.renew.id:
            control.renew(values[0], self._control_time(now))
        else:
            control.release(values[0], values[1] or "", self._control_time(now))
        return b""

    def _control_time(self, now: float) -> float:
        """The time for `Control`, by that of the event loop."""
        self._slept_s = max(self._slept_s, slept_s())
        return now + self._slept_s

    def _arm(self) -> None:
        """Set the timer to the next deadline, unless it will ring before that."""
        if all(control.is_at_rest for control in self._controls.values()):
            self._at_rest.set()
        else:
            self._at_rest.clear()
        due = [self._actions.next_deadline()]
        for control in self._controls.values():
            due += [at - self._slept_s for at in (control.next_step, control.next_publish) if at is not None]
        self._timer.set(min((each for each in due if each is not None), default=math.inf))

    def _on_timer(self) -> None:
        now = self._loop.time()
        for robot, control in self._controls.items():
            try:
                self._serve(robot, control, now)
            except Exception as error:  # noqa: BLE001 - a mistake with one robot must not keep the others from stopping
                control.end("the bridge failed while it drove the robot", self._control_time(now))
                self._timer.pause(now + _PAUSE_S)
                self._caught("teleoperation", error)
        try:
            self._actions.poll(now)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with an answer, the robots go on
            self._timer.pause(now + _PAUSE_S)
            self._caught("teleoperation", error)
        self._arm()

    def _serve(self, robot: str, control: Control, now: float) -> None:
        """Write to a robot and tell of it, as far as that is due."""
        data, at = control.model.data, self._control_time(now)
        if (values := control.step(at)) is not None:
            self._driver.write_setpoint(data, values)
        if control.next_publish is None or at < control.next_publish:
            return
        if control.lease is not None and (problem := self._driver.setpoint_problem(data)):
            control.end(problem, at)
        if (status := control.publish(at)) is not None:
            self._core.tell(control.model.status, status.fields(), self._wall_ticks(), now=now)
        if control.ends != self._ends.get(robot, 0):
            self._ends[robot] = control.ends
            self._say("a lease to drive it by hand has ended", robot, control.last_end)


def slept_s() -> float:
    """How long this machine has slept since it was started, or less where this process was put off meanwhile."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic() if sys.platform == "linux" else 0.0


def _actions(model: TeleoperationModel) -> Iterable[tuple[Topic, str, _Fields, _Fields]]:
    """Topic, name, request and response of each Action."""
    yield model.acquire, ACQUIRE, ACQUIRE_REQUEST, ACQUIRE_RESPONSE
    yield model.renew, RENEW, LEASE_REQUEST, ()
    yield model.release, RELEASE, RELEASE_REQUEST, ()
