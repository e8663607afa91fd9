"""The virtual driver with a skill, and the machine that does it.

The machine stands for a robot's own controller: it goes on when the bridge is killed, and remembers what it was told,
unless it is forgetful. It is a folder, so that a bridge in another process, or the next one, finds the same machine.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from tests.contract.harness import SkillCase
from tests.contract.virtual import Bus, VirtualDriver, VirtualSpace
from tests.system import Processes
from ua_fleet.bridge import (
    Driver,
    Execution,
    ExecutionEnded,
    ExecutionFact,
    ExecutionForgotten,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
    Inlet,
    Skill,
    SkillTarget,
)
from ua_fleet.errors import SkillRejected
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

WORK: Final = 1900
"""DataSetWriterId of the skill."""
QUICK: Final = 1901
"""The same as an immediate skill."""
STATUS: Final = 1902
"""Of the machine's SkillStatus."""
TARGET: Final = 7
FIELDS: Final = (make_field("work", BuiltinType.STRING), make_field("seconds", BuiltinType.DOUBLE))
RESULTS: Final = (make_field("done", BuiltinType.STRING), make_field("seconds", BuiltinType.DOUBLE))

REFUSED_WORK: Final = "refuse"
FAILING_WORK: Final = "fail"
ENDLESS_WORK: Final = "never ends"
DEADLY_WORK: Final = "kill the bridge before the machine is told"
DEADLY_BEGUN_WORK: Final = "kill the bridge after the machine was told"


class Job(NamedTuple):
    """What the machine was told."""

    execution_id: bytes
    work: str
    seconds: float
    began: float


class Machine:
    """The robot's controller."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self._log = folder / "told.jsonl"
        self._forgetful, self._weak, self._frozen = folder / "forgetful", folder / "weak", folder / "frozen"
        self._mute = folder / "mute"
        self._values = folder / "values.json"

    def begin(self, execution_id: bytes, work: str, seconds: float) -> Job:
        """Tell the machine to begin."""
        job = Job(execution_id, work, seconds, time.time())
        line = json.dumps([execution_id.hex(), *job[1:]]) + "\n"
        with self._log.open("ab", buffering=0) as log:
            log.write(line.encode())
        return job

    def told(self) -> list[Job]:
        """All that it was ever told, twice where it was told twice."""
        if not self._log.exists():
            return []
        lines: list[list[Any]] = [json.loads(line) for line in self._log.read_text().splitlines()]
        return [Job(bytes.fromhex(line[0]), *line[1:]) for line in lines]

    def find(self, execution_id: bytes) -> Job | None:
        """What it remembers of a job."""
        if self.is_forgetful:
            return None
        return next((job for job in self.told() if job.execution_id == execution_id), None)

    def stand(self, execution_id: bytes, *, stands: bool) -> None:
        """Stand in the middle of a job, or go on."""
        if stands:
            self._standing(execution_id).touch()
        else:
            self._standing(execution_id).unlink(missing_ok=True)

    def is_standing(self, execution_id: bytes) -> bool:
        """Whether it stands in the middle of a job."""
        return self._standing(execution_id).exists()

    def _standing(self, execution_id: bytes) -> Path:
        return self._log.with_name(f"standing {execution_id.hex()}")

    @property
    def is_forgetful(self) -> bool:
        """Whether it remembers nothing of what it was told."""
        return self._forgetful.exists()

    @property
    def is_frozen(self) -> bool:
        """Whether it heeds no halt."""
        return self._frozen.exists()

    def freeze(self) -> None:
        """Heed no halt from now on."""
        self._frozen.touch()

    @property
    def is_mute(self) -> bool:
        """Whether it tells no values."""
        return self._mute.exists()

    def mute(self, *, is_mute: bool) -> None:
        """Tell no values from now on, or tell them again; what it is at goes on."""
        if is_mute:
            self._mute.touch()
        else:
            self._mute.unlink(missing_ok=True)

    def tell(self, **values: float) -> None:
        """Tell these values from now on, by the names of the data; what is not named is 1."""
        new = self._values.with_suffix(".new")
        new.write_text(json.dumps(values))
        new.replace(self._values)

    @property
    def values(self) -> dict[str, float]:
        """What it tells of some of its data."""
        return dict(json.loads(self._values.read_text())) if self._values.exists() else {}

    @property
    def is_weak(self) -> bool:
        """Whether it fails at heavy work."""
        return self._weak.exists()

    def weaken(self) -> None:
        """Fail at heavy work from now on."""
        self._weak.touch()

    def forget(self) -> None:
        """Remember nothing from now on, as most robots do after their power was off."""
        self._forgetful.touch()


class SkilledDriver(VirtualDriver):
    """See Driver."""

    def __init__(self, space: int, bus: Bus, machine: Machine) -> None:
        super().__init__(space, bus)
        self._number, self._machine = space, machine
        self._to: Inlet | None = None
        self._timers: list[asyncio.TimerHandle] = []

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._to = inlet
        await super().start(inlet)

    async def stop(self) -> None:
        """See Driver."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        await super().stop()

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        targets = (SkillTarget(TARGET, "machine", Topic(self._number, 2, STATUS)),)
        return (
            Skill(
                Topic(self._number, 2, WORK), "work", targets, FIELDS, RESULTS, limits=SkillLimits(requests_at_once=8)
            ),
            Skill(Topic(self._number, 2, QUICK), "quick", targets, FIELDS, RESULTS, is_immediate=True),
        )

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        work, seconds = execution.values
        if work == REFUSED_WORK:
            raise SkillRejected("the machine does not do that")
        if work == DEADLY_WORK:
            os.kill(os.getpid(), signal.SIGKILL)
        job = self._machine.begin(execution.execution_id, work, seconds)
        if work == DEADLY_BEGUN_WORK:
            os.kill(os.getpid(), signal.SIGKILL)
        self._follow(job)

    def halt(self, execution: Execution) -> None:
        """See Driver. Only endless work can be stopped."""
        self._check_endless(execution)
        if self._machine.is_frozen:
            return
        status = int(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT)
        self._put(ExecutionEnded(execution.execution_id, status, (), "halted"))

    def suspend(self, execution: Execution) -> None:
        """See Driver. Only endless work can be suspended."""
        self._check_endless(execution)
        self._machine.stand(execution.execution_id, stands=True)
        self._put(ExecutionSuspended(execution.execution_id, "it stands"))

    def resume(self, execution: Execution) -> None:
        """See Driver."""
        self._check_endless(execution)
        self._machine.stand(execution.execution_id, stands=False)
        self._put(ExecutionResumed(execution.execution_id))

    @staticmethod
    def _check_endless(execution: Execution) -> None:
        if execution.values[0] != ENDLESS_WORK:
            raise SkillRejected("the machine finishes what it has begun")

    def _put(self, fact: ExecutionFact) -> None:
        assert self._to is not None
        self._to.put(fact)

    def query(self, execution: Execution) -> None:
        """See Driver."""
        assert self._to is not None
        job = self._machine.find(execution.execution_id)
        if job is None:
            self._to.put(ExecutionForgotten(execution.execution_id, "the machine remembers nothing of it"))
        else:
            self._follow(job)

    def _follow(self, job: Job) -> None:
        """Tell how far the machine is, and later how it ended."""
        assert self._to is not None
        left = job.began + job.seconds - time.time()
        if self._machine.is_standing(job.execution_id):
            self._to.put(ExecutionSuspended(job.execution_id, "it stands"))
        elif job.work == ENDLESS_WORK or left > 0:
            self._to.put(ExecutionProgressed(job.execution_id, 0.5, "working"))
        if job.work != ENDLESS_WORK:
            self._timers.append(asyncio.get_running_loop().call_later(max(left, 0.0), self._end, job))

    def _end(self, job: Job) -> None:
        assert self._to is not None
        if job.work == FAILING_WORK:
            ended = ExecutionEnded(job.execution_id, int(StatusCode.BAD_OUT_OF_SERVICE), (), "the machine broke")
        else:
            ended = ExecutionEnded(job.execution_id, 0, (job.work, job.seconds))
        self._to.put(ended)


class SkilledSpace(VirtualSpace):
    """See SkillSpace."""

    skill_case = SkillCase(
        Topic(VirtualSpace.number, 2, WORK),
        TARGET,
        succeeds=("weld", 0.0),
        lasts=("weld", 0.5),
        fails=(FAILING_WORK, 0.1),
        refused=(REFUSED_WORK, 0.0),
    )

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._machine = Machine(folder / "machine")

    def make_driver(self) -> Driver:
        """See Space."""
        return SkilledDriver(self.number, self.bus, self._machine)

    def begun(self, execution_id: bytes) -> int:
        """See SkillSpace."""
        return sum(job.execution_id == execution_id for job in self._machine.told())


@asynccontextmanager
async def open_space(folder: Path, processes: Processes) -> AsyncGenerator[SkilledSpace]:
    """A new space."""
    yield SkilledSpace(folder)


class SkilledVirtualSpace:
    """See `harness.SkilledSpace`."""

    remembers = True

    def __init__(self, folder: Path) -> None:
        self._bus, self._machine = Bus(), Machine(folder)

    def make_driver(self) -> Driver:
        """See SkilledSpace."""
        return SkilledDriver(300, self._bus, self._machine)

    def told(self) -> list[str]:
        """See SkilledSpace."""
        return [job.work for job in self._machine.told()]

    def freeze(self) -> None:
        """See SkilledSpace."""
        self._machine.freeze()

    def cut(self) -> None:
        """See SkilledSpace: the driver has the machine itself, and no link that could break."""
