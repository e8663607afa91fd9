"""The executions that go through one handshake of a device, one at a time."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Protocol

import structlog

from ua_bridges.modbus.handshake import Phase, SkillRegisters, StatusWords, next_number, phase_of
from ua_bridges.modbus.link import NoAnswer, RequestFailed
from ua_bridges.modbus.memory import Given, HandshakeMemory
from ua_bridges.modbus.sinks import BitWrite, Writing
from ua_bridges.modbus.sources import ReadPlan
from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
)
from ua_fleet.bridge.executing import Ended, Executing, ended_text
from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError, SkillRejected, StorageUnavailable
from ua_fleet.registers import AddressSpan, Cell, RegisterUnfit
from ua_fleet.skill.executions import pack, unpack
from ua_fleet.values import StatusCode

__all__ = ["DeviceRequests", "Handshake", "check_can_halt"]

_LEAST_WATCH_S: Final = 0.2
_LATE_LOOK_S: Final = 1.0
"""How often a device is asked whether it has begun what was taken back from it."""
_HALTED_S: Final = 5.0
"""So long a program that was told to stop has to end what it does."""


_log = structlog.get_logger("ua_bridges.modbus")


class DeviceRequests(Protocol):
    """What a handshake needs of its device; each raises RequestFailed."""

    async def read_plan(self, plan: ReadPlan) -> Mapping[AddressSpan, Sequence[Cell]]:
        """All cells of a plan."""
        ...

    async def write(self, write: Writing | BitWrite) -> None:
        """Write; after NoAnswer the device may have it or not."""
        ...


class _Job:
    def __init__(self, registers: SkillRegisters, execution: Execution, writes: Sequence[Writing | BitWrite]) -> None:
        self.registers, self.execution, self.writes = registers, execution, writes
        self.number = self.before = 0
        self.is_begun = False
        """Whether the request may be in the device."""
        self.was_seen = False
        """Whether the device has shown its number."""
        self.accept_by: float | None = None
        self.is_withdrawn = False
        """Whether it was taken back from the device, or is about to be."""
        self.watch_until: float | None = None
        """So long the device is asked whether it has begun what was taken back."""
        self.is_halting = False
        self.is_overdue = False
        """Whether it is halted since it took too long."""
        self.halt_written = False
        self.is_done = False
        """Whether the device has said so; its results may be to come."""
        self.trouble = ""
        """Why the device could not be asked, last."""

    @property
    def id(self) -> bytes:
        """The execution's."""
        return self.execution.execution_id


class Handshake:
    """One request register, and the skills that use it. In the thread of the driver."""

    def __init__(
        self,
        name: str,
        memory: HandshakeMemory,
        executing: Executing,
        put: Callable[[DriverEvent], None],
        free: Callable[[bytes], None],
    ) -> None:
        """Make one that is idle.

        Args:
            name: the device and its request register; what is remembered is kept under it.
            memory: of executions that were given to devices.
            executing: those under way.
            put: takes the facts about them.
            free: told when an execution needs the handshake no longer.
        """
        self._name, self._memory, self._executing, self._put, self._free = name, memory, executing, put, free
        self._job: _Job | None = None
        self._asked: deque[_Job] = deque()
        self._withdrawn: dict[int, bytes] = {}
        """Executions by their numbers that were taken back, and that the device may begin yet."""
        self._late = 0
        """The number of one that it has begun after all."""
        self._registers: SkillRegisters | None = None
        """Where to look for it."""
        with contextlib.suppress(StorageUnavailable):  # said again, and louder, with the first execution
            self._withdrawn = memory.withdrawn(name)
        self.due = 0.0

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing to do."""
        return self._job is None and not (self._withdrawn and self._registers is not None)

    def begin(self, registers: SkillRegisters, execution: Execution, writes: Sequence[Writing | BitWrite]) -> None:
        """Give an execution to the device at the next turn."""
        self._executing.begin(registers.skill, execution, time.monotonic())
        self._start(_Job(registers, execution, writes))

    def ask(self, registers: SkillRegisters, execution: Execution) -> None:
        """Find out what became of an execution of a run before."""
        execution_id = execution.execution_id
        try:
            given, last = self._memory.find(execution_id), self._memory.last(self._name)
        except StorageUnavailable as error:
            self._answer(ExecutionForgotten(execution_id, f"the bridge's record of it cannot be read: {error}"))
            return
        if given is None:
            if self._memory.is_new:
                self._answer(ExecutionForgotten(execution_id, "the bridge's record of it is gone"))
            else:
                self._answer(ExecutionNotBegun(execution_id))
            return
        if given.status is not None:
            values = tuple([variant.value for variant in unpack(given.result)])
            self._answer(ExecutionEnded(execution_id, given.status, values, given.message))
            return
        if last is None or last.execution_id != execution_id:
            self._answer(ExecutionForgotten(execution_id, "the device was given another one after it"))
            return
        self._executing.begin(registers.skill, execution, time.monotonic())
        job = _Job(registers, execution, ())
        job.number, job.before, job.is_begun = given.number, given.before, True
        job.is_withdrawn = given.number in self._withdrawn
        self._start(job)

    def halt(self, execution_id: bytes) -> None:
        """Stop an execution at the next turn."""
        if self._job is not None and self._job.id == execution_id:
            self._job.is_halting = True
            self.due = 0.0

    async def turn(self, device: DeviceRequests, now: float) -> None:
        """Do the next step; where the device does not answer it, the next turn tries again."""
        job = self._job
        if job is None:
            await self._look_for_late(device, now)
            return
        self.due = now + job.registers.via.poll_s
        try:
            words = await self._words(device, job.registers)
            await self._check_late(device, job.registers, words)
            job.trouble = ""
            if not job.is_begun:
                await self._give(device, job, words, now)
            else:
                await self._follow(device, job, words, now)
        except RequestFailed as failed:
            self._refused(job, failed, now)

    def check_time(self, now: float) -> None:
        """End what takes too long while the device cannot be asked."""
        if self._job is not None:
            self._check_time(self._job, now)

    def _answer(self, fact: ExecutionEnded | ExecutionForgotten | ExecutionNotBegun) -> None:
        """What is known of an execution without its device."""
        self._put(fact)
        self._free(fact.execution_id)

    async def _words(self, device: DeviceRequests, registers: SkillRegisters) -> StatusWords:
        cells = dict(await device.read_plan(registers.first))
        if registers.then is not None:
            cells.update(await device.read_plan(registers.then))
        return registers.status(cells)

    async def _give(self, device: DeviceRequests, job: _Job, words: StatusWords, now: float) -> None:
        if words.busy:
            what = f"number {self._late}, which was taken back from it" if self._late else "something else"
            self._end(job, Ended(StatusCode.BAD_TOO_MANY_OPERATIONS, (), f"the device is busy with {what}"))
            return
        if job.is_halting:
            self._end(job, Ended(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), "stopped before it began"))
            return
        for write in job.writes:
            await device.write(write)
        if self._check_time(job, time.monotonic()):
            return  # whoever asked for it is told so: it must not be done after that
        try:
            last = self._memory.last(self._name)
            number = next_number(words, last and last.number, self._withdrawn)
            job.before = words.request
            self._memory.give(Given(job.id, self._name, number, job.before))
        except StorageUnavailable as error:
            self._end(job, Ended(error.ua_status, (), str(error)))
            return
        job.number = number
        job.is_begun, job.accept_by = True, now + job.registers.via.accept_s
        await device.write(Writing(job.registers.request.span, (job.number,)))
        self.due = now  # a quick program has begun already

    async def _follow(self, device: DeviceRequests, job: _Job, words: StatusWords, now: float) -> None:
        phase = phase_of(words, job.number, job.before)
        job.was_seen |= phase not in (Phase.NEVER_WRITTEN, Phase.LOST)
        if words.accepted == job.number:
            self._settle()  # a program that has begun this one begins none from before any more
        if phase is Phase.RUNNING:
            if job.is_halting and not job.halt_written:
                await self._write_halt(device, job)
            progress = job.registers.progress(await device.read_plan(job.registers.while_running))
            self._executing.progress(job.id, progress)
            self._check_time(job, now)
        elif phase is Phase.DONE:
            await self._done(device, job)
        elif phase is Phase.FAILED:
            text = job.registers.error(await device.read_plan(job.registers.after_error))
            opened = self._executing.get(job.id)
            if job.is_overdue and opened is not None:
                self._end(job, opened.too_long(is_halted=True))
                return
            status = StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT if job.halt_written else StatusCode.BAD_UNEXPECTED_ERROR
            self._end(job, Ended(status, (), ended_text(text)))
        elif phase is Phase.WAITING:
            await self._wait(device, job, now)
        elif job.is_withdrawn:
            await self._watch(device, job, now)
        elif phase is Phase.NEVER_WRITTEN and not job.was_seen:
            self._never_written(job)
        else:
            self._forget(job, "the device's words are about something else; see what it did")

    async def _wait(self, device: DeviceRequests, job: _Job, now: float) -> None:
        """The request is there and the program has not taken it."""
        if job.accept_by is None:
            job.accept_by = now + job.registers.via.accept_s
        if now < job.accept_by and not job.is_halting:
            return
        try:
            self._memory.withdraw(job.id, self._name, job.number)
        except StorageUnavailable as error:
            job.trouble = str(error)
            self._check_time(job, now)
            return  # the request stays there, and is followed
        self._withdrawn[job.number] = job.id
        job.is_withdrawn = True
        # Not the number before: a program that begins this one all the same would do that one again after it.
        await device.write(Writing(job.registers.request.span, (0,)))
        if job.is_halting:
            await self._write_halt(device, job)

    async def _watch(self, device: DeviceRequests, job: _Job, now: float) -> None:
        """It was taken back. A program that had read it before begins it all the same."""
        via = job.registers.via
        if job.watch_until is None:
            watch_s = via.cycle_s if job.is_halting or via.cycle_s is not None else via.accept_s
            job.watch_until = now + max(watch_s or 0.0, 2 * via.poll_s, _LEAST_WATCH_S)
        if now >= job.watch_until:
            await self._not_taken(device, job)

    def _never_written(self, job: _Job) -> None:
        if job.accept_by is None:  # asked about: a bridge before us recorded it, and got no farther
            self._executing.never(job.id)
            self._finish(job)
        else:
            self._end(job, Ended(StatusCode.BAD_NO_COMMUNICATION, (), "the request did not arrive in the device"))

    async def _not_taken(self, device: DeviceRequests, job: _Job) -> None:
        via = job.registers.via
        if job.registers.halt is not None and not job.halt_written:
            await self._write_halt(device, job)  # should it begin it yet, it stops at once
        self._registers = job.registers
        text = f"the device did not begin within {via.accept_s:g} s; is its program running?"
        if job.is_halting:
            self._end(job, Ended(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), "stopped before it began"))
        elif via.cycle_s is not None:
            self._end(job, Ended(StatusCode.BAD_NO_COMMUNICATION, (), text))
        else:
            self._forget(job, f"{text} It was taken back, and the program may have read it before; see what it does")

    # What was taken back and is begun after all

    async def _look_for_late(self, device: DeviceRequests, now: float) -> None:
        """Nothing is under way, as far as we know."""
        registers = self._registers
        if registers is None:
            return
        self.due = now + _LATE_LOOK_S
        try:
            await self._check_late(device, registers, await self._words(device, registers))
        except NoAnswer:
            pass  # which was counted
        except RequestFailed as failed:
            self._put(Dropped(failed.cause, 1, f"{registers.skill.label}: {failed.reason}"))

    async def _check_late(self, device: DeviceRequests, registers: SkillRegisters, words: StatusWords) -> None:
        """Whether the device is at what was taken back from it; it is stopped, where it can be."""
        execution_id = self._withdrawn.get(words.accepted)
        if execution_id is None or (self._job is not None and self._job.id == execution_id):
            self._late = 0
            return
        if self._late != words.accepted:
            self._late = words.accepted
            said = f"{registers.skill.label}: the device has begun number {words.accepted}, which was taken back"
            _log.error(
                f"{said}; see what it does, and raise accept_s", handshake=self._name, execution=execution_id.hex()
            )
            self._put(Dropped(Drop.UNASKED, 1, said))
            if words.busy and registers.halt is not None:
                await device.write(Writing(registers.halt.span, (words.accepted,)))
        if not words.busy:
            self._late = 0
            self._settle()

    def _settle(self) -> None:
        """The device begins none of them any more."""
        if self._withdrawn:
            with contextlib.suppress(StorageUnavailable):  # their numbers are not given until it can be written
                self._memory.settle(self._name)
                self._withdrawn.clear()

    async def _done(self, device: DeviceRequests, job: _Job) -> None:
        job.is_done = True
        try:
            values = job.registers.results(await device.read_plan(job.registers.after_done))
        except RegisterUnfit as unfit:
            self._end(job, Ended(StatusCode.UNCERTAIN, (), f"it is done; {unfit.reason}"))
            return
        self._end(job, Ended(StatusCode.GOOD, values))

    async def _write_halt(self, device: DeviceRequests, job: _Job) -> None:
        halt = job.registers.halt
        assert halt is not None, "checked before"
        await device.write(Writing(halt.span, (job.number,)))
        job.halt_written = True

    def _check_time(self, job: _Job, now: float) -> bool:
        """Whether it has taken too long, and was ended for that."""
        opened = self._executing.get(job.id)
        if opened is None or now < opened.deadline:
            return False
        if job.is_begun and job.registers.halt is not None and not job.is_halting:
            job.is_halting = job.is_overdue = True
            opened.deadline = now + _HALTED_S
            return False
        timeout_s = job.registers.skill.config.timeout_s
        status = StatusCode.BAD_TIMEOUT
        if not job.is_begun:
            status = StatusCode.BAD_NO_COMMUNICATION
            text = f"the device could not be given it within {timeout_s:g} s"
        elif job.is_done:
            status, text = StatusCode.UNCERTAIN, f"it is done; {job.trouble or 'its results cannot be read'}"
        else:
            what_then = job.trouble or "see what the device does"
            if job.halt_written:
                what_then = f"it was told to stop, and does not; {what_then}"
            text = f"it takes longer than {timeout_s:g} s; {what_then}"
        self._end(job, Ended(status, (), text))
        return True

    def _refused(self, job: _Job, failed: RequestFailed, now: float) -> None:
        """A request that has to do with the execution brought nothing. Once begun, the device goes on meanwhile."""
        job.trouble = failed.reason
        if isinstance(failed, NoAnswer):  # which was counted
            self._check_time(job, now)
        elif job.is_begun:
            self._put(Dropped(failed.cause, 1, f"{job.registers.skill.label}: {failed.reason}"))
            self._check_time(job, now)
        else:
            self._end(job, Ended(failed.status, (), failed.reason))

    def _end(self, job: _Job, ended: Ended) -> None:
        if job.number:
            types = tuple([result.type.builtin for result in job.registers.skill.config.results.values()])
            try:
                result = pack(types, ended.values) if ended.values else b""
            except (LocalWireError, ValueError):
                ended, result = Ended(StatusCode.UNCERTAIN, (), "it is done; the results do not fit"), b""
            with contextlib.suppress(StorageUnavailable):  # the device still shows it, and the bridge records it too
                self._memory.end(job.id, ended.status, ended.message, result)
        self._executing.end(job.id, ended)
        self._finish(job)

    def _forget(self, job: _Job, why: str) -> None:
        self._executing.forget(job.id, why)
        self._finish(job)

    def _start(self, job: _Job) -> None:
        if self._job is None:
            self._job, self.due = job, 0.0
        else:
            self._asked.append(job)

    def _finish(self, job: _Job) -> None:
        self._free(job.id)
        self._job = self._asked.popleft() if self._asked else None
        self.due = 0.0


def check_can_halt(registers: SkillRegisters) -> None:
    """Raises SkillRejected for a skill that cannot be stopped."""
    if registers.halt is None:
        raise SkillRejected(f"{registers.skill.label} cannot be stopped: fleet.yaml names no `halt` for it")
