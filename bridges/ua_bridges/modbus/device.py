"""One device and what is done with it, one request after the other: writes, handshakes, readings, and its silence.

    away      the line cannot be connected, or the device does not answer: asked again after `retry_s`, longer and
              longer, by one request after the other; its sources are lost, and what is to be written is dropped and
              counted
    there     it answers: commands go first, but not without end, then handshakes, then what is to be read, the group
              that is due longest

A request that is not answered makes its own values Bad_Timeout. Then the one that was answered last is asked again:
where that is silent too, the device is away. One that says what no device should is put aside, for longer and longer.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeVar

import structlog

from ua_bridges.modbus.config import DeviceConfig
from ua_bridges.modbus.job import Handshake
from ua_bridges.modbus.link import ILLEGAL_ADDRESS, Line, NoAnswer, RequestFailed
from ua_bridges.modbus.sinks import BitWrite, SinkSpec, Writing, writes_of
from ua_bridges.modbus.sources import Answer, Failed, PolledSource, ReadPlan, SourceSpec
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop
from ua_fleet.registers import AddressSpan, Cell, RegisterUnfit, Table

__all__ = ["Device", "SinkWrite", "check_fits"]

MOST_WAITING: Final = 100
"""Messages of one sink that may wait to be written; then the oldest is dropped."""
MOST_BAD: Final = 10
"""So many answers in a row that are none, and the device is put aside."""
_WRITING_S: Final = 0.2
"""So long writes go before everything else."""
_T = TypeVar("_T")

_log = structlog.get_logger("ua_bridges.modbus")


class _Away(Exception):
    """The device is not reached, or answers nothing: why."""


class _Misbehaves(Exception):
    """The device does what no device should: what."""


class SinkWrite(NamedTuple):
    """A message on its way into registers."""

    sink: SinkSpec
    values: tuple[Any, ...]


class _Group:
    """Values that are read together."""

    def __init__(self, period_s: float, specs: Sequence[SourceSpec], config: DeviceConfig) -> None:
        self.period_s, self._limits = period_s, config.limits
        self.sources = [PolledSource(spec) for spec in specs]
        self.due = 0.0
        self.is_late = False
        self.plan_anew()

    def plan_anew(self) -> None:
        """In as few requests as can be, whatever was refused before."""
        spans = (field.register.span for source in self.sources for field in source.spec.fields)
        self.plan = ReadPlan(spans, self._limits)
        self.place()

    def place(self) -> None:
        for source in self.sources:
            source.place(self.plan)


class Device:
    """All of it runs in the thread of the driver but `is_there` and `detail`, which any thread may read."""

    def __init__(
        self,
        name: str,
        config: DeviceConfig,
        line: Line,
        sources: Sequence[SourceSpec],
        handshakes: Sequence[Handshake],
        put: Callable[[DriverEvent], None],
        offenders: Offenders,
    ) -> None:
        """Make a device that is away."""
        self.name, self._config, self._line, self._put, self._offenders = name, config, line, put, offenders
        line.devices += 1
        periods = sorted({spec.period_s for spec in sources})
        self._groups = [_Group(p, [spec for spec in sources if spec.period_s == p], config) for p in periods]
        self._handshakes = tuple(handshakes)
        self._waiting: dict[SinkSpec, deque[SinkWrite]] = {}
        self._order: deque[SinkSpec] = deque()
        self._last: dict[SinkSpec, tuple[Any, ...]] = {}
        self._written: dict[SinkSpec, tuple[Any, ...]] = {}
        self._answering: dict[AddressSpan, None] = {}
        """The requests that were answered when they were asked last, the latest at the end."""
        self._tried = 0
        """Which request tells whether it is back."""
        self._wake = asyncio.Event()
        self._retry_s = config.retry_s[0]
        self._bad = 0
        """Answers in a row that are none."""
        self.asked = asyncio.Event()
        """Set when it was asked for the first time, whatever it answered."""
        self.is_there = False
        self.detail = f"{name}: not asked yet"

    def end(self, reason: str) -> None:
        """Nothing works any more: the sources are lost."""
        self._go_away(reason)

    def wake(self) -> None:
        """There is something to do. In the thread of the driver."""
        self._wake.set()

    def take(self, write: SinkWrite) -> None:
        """Take a message that is to be written; in the thread of the driver."""
        self._last[write.sink] = write.values
        if not self.is_there:
            return  # the sink says that its last value is written when the device is back
        waiting = self._waiting.setdefault(write.sink, deque())
        if len(waiting) >= MOST_WAITING:
            waiting.popleft()
            self._put(Dropped(Drop.RATE_LIMITED))
        else:
            self._order.append(write.sink)
        waiting.append(write)
        self._wake.set()

    async def run(self) -> None:
        """Work until cancelled."""
        while True:
            wait_s = 0.0
            try:
                if not self.is_there:
                    await self._come_back()
                    self.asked.set()
                await self._turn()
            except _Away as away:
                self._go_away(f"{away}; look at its power, cable, address and unit")
                wait_s = self._retry_s
                self._retry_s = min(2 * self._retry_s, self._config.retry_s[1])
            except _Misbehaves as offence:
                wait_s = self._put_aside(str(offence))
            except Exception as error:  # noqa: BLE001 - one device, one mistake
                _log.exception("a device made the bridge fail", device=self.name)
                wait_s = self._put_aside(f"a mistake of the bridge ({error!r}); report its log")
            self.asked.set()
            if not self.is_there:
                await self._wait_to_retry(wait_s)

    def _put_aside(self, offence: str) -> float:
        """Let go of it; how long."""
        self._bad = 0
        pause_s = self._offenders.put_aside(self.name, offence, time.monotonic())
        self._go_away(f"{offence}; it is put aside for {pause_s:g} s")
        return pause_s

    async def read_plan(self, plan: ReadPlan) -> Mapping[AddressSpan, Sequence[Cell]]:
        """See DeviceRequests."""
        return {request: await self._read(request) for request in list(plan.requests)}

    async def write(self, write: Writing | BitWrite) -> None:
        """Write, asking again as often as configured."""
        line, unit = self._line, self._config.unit
        try:
            if isinstance(write, BitWrite):
                await self._ask(lambda: line.write_bits(unit, write.address, write.mask, write.word))
            else:
                await self._ask(lambda: line.write(unit, write.span, write.cells))
        except NoAnswer as silent:
            await self._check_there(silent)
            raise

    async def _read(self, request: AddressSpan) -> Sequence[Cell]:
        self._answering.pop(request, None)
        try:
            cells = await self._ask(lambda: self._line.read(self._config.unit, request))
        except NoAnswer as silent:
            await self._check_there(silent)
            raise
        except RequestFailed:
            self._answering[request] = None
            raise
        self._answering[request] = None
        return cells

    async def _ask(self, request: Callable[[], Awaitable[_T]]) -> _T:
        """Raises NoAnswer where it is not answered as often as configured."""
        left = self._config.retries
        while True:
            try:
                answer = await request()
            except NoAnswer as silent:
                self._put(Dropped(Drop.NO_ANSWER, 1, f"{self.name}: {silent.reason}"))
                self._look_at_offences()
                if not left or not self._line.connected:
                    raise
                left -= 1
            except RequestFailed as failed:
                self._bad = self._bad + 1 if failed.cause is Drop.MALFORMED else 0
                if self._bad >= MOST_BAD:
                    raise _Misbehaves(f"{MOST_BAD} answers in a row are none, the last: {failed.reason}") from failed
                raise
            else:
                self._bad = 0
                return answer

    def _look_at_offences(self) -> None:
        """Whether what came in place of an answer is more than can be borne; raises _Misbehaves."""
        offence = self._line.take_offence()
        if not offence:
            return
        self._bad += 1
        if self._bad >= MOST_BAD or not self._line.connected:
            raise _Misbehaves(offence)

    async def _check_there(self, silent: NoAnswer) -> None:
        """Raises _Away where the device does not answer what it has answered last either."""
        if not self._answering or not self._line.connected:
            raise _Away(silent.reason)
        request, _ = self._answering.popitem()
        try:
            await self._ask(lambda: self._line.read(self._config.unit, request))
        except NoAnswer:
            raise _Away(silent.reason) from silent
        except RequestFailed:
            pass  # it answers
        self._answering[request] = None

    # Away and back

    async def _come_back(self) -> None:
        if problem := await self._line.connect():
            raise _Away(problem)
        requests = [request for group in self._groups for request in group.plan.requests]
        if requests:
            try:
                await self._read(requests[self._tried % len(requests)])
            except _Away:
                self._tried += 1
                raise
            except RequestFailed:
                pass  # it answers
        for group in self._groups:
            group.plan_anew()
        self.is_there, self._retry_s = True, self._config.retry_s[0]
        self._describe()
        now = time.monotonic()
        for group in self._groups:
            group.due = now
        for sink, values in self._last.items():
            if sink.rewrite:
                self.take(SinkWrite(sink, values))

    def _go_away(self, reason: str) -> None:
        self.is_there = False
        self.detail = f"{self.name} ({self._config.where}): {reason}"
        self._written.clear()
        self._answering.clear()
        for group in self._groups:
            for source in group.sources:
                for event in source.lose():
                    self._put(event)
        dropped = sum(len(waiting) for waiting in self._waiting.values())
        if dropped:
            self._put(Dropped(Drop.NOT_CONNECTED, dropped))
        self._waiting.clear()
        self._order.clear()
        if self._line.devices == 1:
            self._line.close()  # a connection of which the other side knows nothing heals only so

    async def _wait_to_retry(self, wait_s: float) -> None:
        until = time.monotonic() + wait_s
        while (left := until - time.monotonic()) > 0:
            for handshake in self._handshakes:
                handshake.check_time(time.monotonic())
            await asyncio.sleep(min(left, 1.0))

    # There

    async def _turn(self) -> None:
        """Do all that is due, and wait until something else is."""
        self._wake.clear()
        until = time.monotonic() + _WRITING_S
        while self._order and time.monotonic() < until:
            await self._write_next()
        now = time.monotonic()
        for handshake in self._handshakes:
            if not handshake.is_idle and handshake.due <= now:
                await handshake.turn(self, now)
        for group in sorted(self._groups, key=lambda group: group.due):
            if group.due <= now:
                await self._poll(group)
            if self._order:
                break  # a command goes before the next reading
        due = [group.due for group in self._groups]
        due += [handshake.due for handshake in self._handshakes if not handshake.is_idle]
        if self._order or self._wake.is_set():
            await asyncio.sleep(0)
            return
        wait_s = max(min(due) - time.monotonic(), 0.0) if due else None
        try:
            async with asyncio.timeout(wait_s):
                await self._wake.wait()
        except TimeoutError:
            pass

    async def _poll(self, group: _Group) -> None:
        answers: dict[AddressSpan, Answer] = {}
        todo = deque(group.plan.requests)
        while todo:
            request = todo.popleft()
            try:
                answers[request] = await self._read(request)
            except NoAnswer as failed:
                answers[request] = Failed(failed.status, failed.cause, failed.reason)
            except RequestFailed as failed:
                alone = group.plan.split(request) if failed.code == ILLEGAL_ADDRESS else []
                if alone:
                    group.place()
                    todo.extendleft(reversed(alone))
                else:
                    answers[request] = Failed(failed.status, failed.cause, failed.reason)
                self._put(Dropped(failed.cause, 1, f"{self.name}: {failed.reason}"))
        time_ns = time.time_ns()
        for source in group.sources:
            for event in source.take(answers, time_ns):
                self._put(event)
        self._schedule(group)

    def _schedule(self, group: _Group) -> None:
        """At a fixed rate; what could not keep up goes on from now."""
        now = time.monotonic()
        group.due += group.period_s
        if group.is_late is not (group.due < now):
            group.is_late = group.due < now
            self._describe()
        group.due = max(group.due, now)

    def _describe(self) -> None:
        requests = sum(len(group.plan.requests) for group in self._groups)
        saved = sum(group.plan.saved for group in self._groups)
        values = requests + saved
        late = [f"reading takes longer than its {group.period_s:g} s" for group in self._groups if group.is_late]
        read = f"{values} values in {requests} requests, {saved} saved" if values else "nothing is read"
        self.detail = "; ".join([f"{self.name} ({self._config.where}): {read}", *late])

    async def _write_next(self) -> None:
        sink = self._order.popleft()
        values = self._waiting[sink].popleft().values
        if sink.is_same(values, self._written.get(sink)):
            return
        writes = writes_of(
            [(field.register, value) for field, value in zip(sink.fields, values, strict=True)],
            self._config.write_words,
            self._config.write_bits,
        )
        self._written.pop(sink, None)
        try:
            for write in writes:
                await self.write(write)
                if sink.read_back:
                    await self._check(sink, write)
        except NoAnswer:
            pass  # which was counted
        except RequestFailed as failed:
            self._put(Dropped(failed.cause, 1, f"{sink.name} could not be written: {self.name}: {failed.reason}"))
        else:
            self._written[sink] = values

    async def _check(self, sink: SinkSpec, write: Writing | BitWrite) -> None:
        """Whether the device has what was written."""
        if isinstance(write, BitWrite):
            (word,) = await self._read(AddressSpan(Table.HOLDING, write.address, 1))
            is_same, span = (int(word) ^ write.word) & write.mask == 0, AddressSpan(Table.HOLDING, write.address, 1)
        else:
            span = write.span
            is_same = tuple(await self._read(span)) == tuple(write.cells)
        if not is_same:
            raise RequestFailed(0, Drop.REJECTED, f"{span.text} has another value after it was written")


def check_fits(sink: SinkSpec, values: Sequence[Any]) -> None:
    """Raises RegisterUnfit where a value does not fit into its register."""
    for field, value in zip(sink.fields, values, strict=True):
        try:
            writes_of([(field.register, value)], 125, 2000)
        except RegisterUnfit as unfit:
            raise RegisterUnfit(unfit.status, f"{sink.name}: {unfit.reason}") from unfit
