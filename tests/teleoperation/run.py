"""One run: a robot is driven, something happens, and it is driven anew; then its record is judged."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from tests.system import Child
from tests.teleoperation.judge import Blocked, Facts, Frozen, Stop, judge
from tests.teleoperation.plan import Plan
from tests.teleoperation.stack import RULES, SPEED, Controlled, Lane

__all__ = ["Outcome", "run_round"]

WAIT_S: Final = 60.0
AGAIN: Final = 0.4
"""Share of the first speed that is driven afterwards: an old setpoint would be seen to be one."""
ENGINEERS_SPEED: Final = -0.3
"""The other way: so the record says whose wish it is."""
CONTINUED_S: Final = 0.01
"""So long it may take until a process goes on that stood."""
MOST_TOLD: Final = 4
"""Problems of a record: what follows the first ones is their consequence."""
IGNORED_S: Final = 1.0
"""A robot that does not follow for so long does not follow any more before it has heard a zero."""
STANDING_S: Final = 0.3
"""So long it is looked at when it stands."""


@dataclass
class Outcome:
    """What came out of a run."""

    plan: Plan
    problems: list[str] = field(default_factory=list[str])
    stops: list[Stop] = field(default_factory=list[Stop])


class _Failed(Exception):
    """A run could not be carried out."""


async def _stopped(process: Child | Controlled, length_s: float) -> tuple[float, float]:
    """Have a process stand still for a time; from when to when."""
    process.freeze()
    since = time.monotonic()
    await asyncio.sleep(length_s)
    until = time.monotonic()
    process.go_on()
    return since, until


class Together:
    """The runs of a round, where something is stopped that all of them need."""

    def __init__(self, runs: int) -> None:
        self._barrier = asyncio.Barrier(runs)
        self._stopped: asyncio.Future[tuple[float, float]] = asyncio.get_running_loop().create_future()

    async def stop(self, process: Child | Controlled, length_s: float) -> tuple[float, float]:
        """Have a process stand still once all runs have come to that; from when to when."""
        if not await self._barrier.wait():
            self._stopped.set_result(await _stopped(process, length_s))
        return await asyncio.shield(self._stopped)

    async def give_up(self) -> None:
        """One of them does not come."""
        await self._barrier.abort()


class Run:
    """See the module."""

    def __init__(self, lane: Lane, plan: Plan, together: Together) -> None:
        self._lane, self._plan, self._together = lane, plan, together
        self._device = lane.page if plan.is_page else lane.tab
        self._began = time.monotonic()
        self._blocked: list[Blocked] = []
        self._frozen: list[Frozen] = []
        self._speed = plan.speed * SPEED
        self._lease = 0
        self._said = ""
        """Why it was not driven last."""

    async def done(self) -> Outcome:
        """Carry it out, and judge it."""
        outcome = Outcome(self._plan)
        try:
            async with asyncio.timeout(110):
                await self._carry_out()
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one run, the others go on
            await self._together.give_up()
            outcome.problems.append(f"{type(error).__name__}: {error}")
            await self._lane.heal()
        await self._device.ask(do="state")
        await asyncio.sleep(0.05)  # until what it prints is read
        lane, since = self._lane, self._began
        grants, wishes = lane.grants(since), lane.wishes(since)
        until = time.monotonic()
        waited = lane.waited(since)
        facts = Facts(lane.moved(since), until, grants, wishes, self._blocked, self._frozen, waited)
        verdict = judge(replace(facts, takes_last=waited[-1]), RULES)
        outcome.problems += verdict.problems[:MOST_TOLD]
        outcome.stops = verdict.stops
        # What the bridge wrote is as good, and where it stood it had no watch of the robot's above it.
        rules = RULES._replace(robot_timeout_s=60.0)
        heard = judge(replace(facts, entries=lane.heard(since)), rules)
        outcome.problems += [f"what the bridge wrote: {problem}" for problem in heard.problems[:MOST_TOLD]]
        return outcome

    async def _carry_out(self) -> None:
        plan, lane = self._plan, self._lane
        await self._drive(self._speed, plan.at)
        await asyncio.sleep(plan.after_s)
        await self._disturb()
        await asyncio.sleep(0.3)  # the stick is still held
        await self._let_go()
        before = self._lease
        await self._drive(SPEED * round(plan.speed * AGAIN, 1), 1.0)
        await self._let_go()
        moves = [wish.lease for wish in lane.wishes(self._began) if wish.lease > before and wish.speed]
        if not moves:
            raise _Failed("it was not driven anew")

    # ------------------------------------------------------------------ driving

    async def _drive(self, speed: float, share: float) -> None:
        """Drive until it has a share of a speed; where a busy machine has ended the lease before that, again."""
        try:
            async with asyncio.timeout(WAIT_S):
                while True:
                    await self._acquire()
                    if await self._reached(speed, share):
                        return
                    await self._stands()
        except TimeoutError:
            raise _Failed(f"not driven with {speed:.2f} within {WAIT_S:g} s: {self._said}") from None

    async def _acquire(self) -> None:
        tab, by = self._device, self._plan.by
        while "refused" in (granted := await tab.ask(do="acquire", by=by)):
            self._said = granted["refused"]
            await asyncio.sleep(0.1)
        self._lease = granted["lease"]

    async def _reached(self, speed: float, share: float) -> bool:
        tab, since = self._device, time.monotonic()
        await tab.ask(do="wish", speed=0.0)
        await asyncio.sleep(0.15)
        await tab.ask(do="wish", speed=speed)
        while not [entry for entry in self._lane.moved(since) if entry.speed >= speed * share - 1e-6]:
            await asyncio.sleep(0.005)
            if over := (await tab.ask(do="state"))["over"] or self._stopped_itself(since):
                self._said = over
                return False
        return True

    def _stopped_itself(self, since: float) -> str:
        """Where a busy machine has had the robot's own watch stop it: it stands until it hears a zero, as it should."""
        moved, heard = self._lane.moved(since), self._lane.heard(since)
        stands = bool(moved and not moved[-1].speed and heard and heard[-1].speed)
        return "its own watch has stopped it" if stands and heard[-1].at > moved[-1].at + IGNORED_S else ""

    async def _let_go(self) -> None:
        """Let go of the stick, and see that the robot stands and stays so."""
        tab = self._device
        await tab.ask(do="wish", speed=0.0)
        await asyncio.sleep(0.1)
        await tab.ask(do="release")
        await self._stands()
        await asyncio.sleep(STANDING_S)

    async def _stands(self) -> None:
        until = time.monotonic() + WAIT_S
        while (moved := self._lane.moved(self._began)) and moved[-1].speed:
            if time.monotonic() > until:
                raise _Failed(f"it still moves after {WAIT_S:g} s")
            await asyncio.sleep(0.01)

    # ------------------------------------------------------------------ what happens

    async def _disturb(self) -> None:
        what = self._plan.disturbance
        match what.where:
            case "stop":
                await self._stop(what.what, what.length_s)
            case "tab":
                await self._kill_tab() if what.what == "killed" else await asyncio.sleep(what.length_s)
            case "lease":
                await self._contend(what.what, what.length_s)
            case "setpoints":
                await self._device.ask(do="wish", speed=self._speed, **{"as": what.what})
                await asyncio.sleep(what.length_s)
                await self._device.ask(do="wish", speed=self._speed)
            case where:
                await self._cut(where, what.what, what.length_s)

    async def _stop(self, what: str, length_s: float) -> None:
        lane, stack = self._lane, self._lane.stack
        processes: dict[str, Child | Controlled] = {
            "tab": self._device,
            "bridge": lane.bridge,
            "server": stack.server,
            "console": stack.console,
        }
        process = processes[what]
        if self._plan.disturbance.is_shared:
            since, until = await self._together.stop(process, length_s)
        else:
            since, until = await _stopped(process, length_s)
        if what == "bridge":
            self._frozen.append(Frozen(since, until + CONTINUED_S))
        elif what == "server" or (what == "console" and self._plan.by == "console"):
            self._blocked.append(Blocked(since, until, is_lost=False))

    async def _kill_tab(self) -> None:
        lane = self._lane
        lane.tab.child.end(9)
        await lane.tab.close()
        lane.start_tab()
        self._device = lane.tab

    async def _cut(self, where: str, what: str, length_s: float) -> None:
        lane, seconds = self._lane, self._plan.disturbance.seconds
        mode, _, way = what.partition(" ")
        since = (await lane.set_link(where, mode, way or "both", seconds))["after"]
        await asyncio.sleep(length_s)
        until = (await lane.set_link(where, "pass"))["before"]
        if mode in ("drop", "hold") and way != "back":
            self._blocked.append(Blocked(since, until, is_lost=mode == "drop"))

    async def _contend(self, what: str, length_s: float) -> None:
        lane = self._lane
        if what == "forged":
            said = await lane.engineer.ask(do="forge", lease=self._lease, speed=ENGINEERS_SPEED)
            if said["sent"] != len(said["refusals"]):
                raise _Failed(f"a forged setpoint was not refused: {said}")
            return
        if what == "second":
            said = await lane.engineer.ask(do="acquire", by=self._plan.by)
            over = (await self._device.ask(do="state"))["over"]
            if "refused" not in said and not over:
                raise _Failed("two have a lease at once")
            await lane.engineer.ask(do="release")
            return
        since, before = 0.0, self._lease
        if what == "stolen while held":
            since = (await lane.set_link("server link", "hold"))["after"]
        await lane.engineer.ask(do="wish", speed=None)
        said = await lane.engineer.ask(do="acquire", by=self._plan.by, take_over=True)
        if "refused" in said:
            raise _Failed(f"the engineer is refused: {said}")
        self._lease = said["lease"]
        await lane.engineer.ask(do="wish", speed=ENGINEERS_SPEED)
        await asyncio.sleep(length_s / 2)
        if what == "stolen while held":
            until = (await lane.set_link("server link", "pass"))["before"]
            self._blocked.append(Blocked(since, until, False, before))
        await asyncio.sleep(length_s / 2)
        await lane.engineer.ask(do="wish", speed=0.0)
        await asyncio.sleep(0.1)
        await lane.engineer.ask(do="release")


async def run_round(lanes: Sequence[Lane], plans: Sequence[Plan]) -> list[Outcome]:
    """Carry out the runs of one round, each in its lane."""
    together = Together(len(plans))
    return list(await asyncio.gather(*[Run(lanes[plan.lane], plan, together).done() for plan in plans]))
