"""What the simulated robot does: it works, it moves, it says where it is."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Final, NamedTuple

__all__ = ["Job", "Robot", "Unable"]

REFUSED: Final = "refuse"
FAILING: Final = "fail"
ENDLESS: Final = "never ends"


class Unable(Exception):
    """The robot does not begin that."""


class Job(NamedTuple):
    """One thing that the robot was told to do."""

    number: int
    skill: str
    arguments: tuple[str, ...]
    seconds: float
    began: float
    """Wall time, so that a robot whose program was restarted knows how far it is."""


class Robot:
    """One robot with a memory in a file, as a PERS variable has it, or without one."""

    def __init__(self, memory: Path | None) -> None:
        self._memory = memory
        self._lock = threading.Lock()
        self._jobs: dict[int, Job] = {}
        self._halted: set[int] = set()
        self._position = (0.0, 0.0)
        if memory is not None and memory.exists():
            for line in memory.read_text(encoding="utf-8").splitlines():
                number, skill, arguments, seconds, began = json.loads(line)
                self._jobs[number] = Job(number, skill, tuple(arguments), seconds, began)

    @property
    def remembers(self) -> bool:
        """Whether it forgets nothing."""
        return self._memory is not None

    def begin(self, number: int, skill: str, arguments: tuple[str, ...]) -> Job:
        """Begin a job; raises Unable."""
        if skill == "work" and len(arguments) == 2:
            seconds = float(arguments[1])
            if arguments[0] == REFUSED:
                raise Unable("the machine does not do that")
            if arguments[0] == ENDLESS:
                seconds = 1e9
        elif skill == "move" and len(arguments) == 3:
            seconds = float(arguments[2])
        elif skill == "stop" and not arguments:
            seconds = 0.0
        else:
            raise Unable(f"the robot cannot {skill} with {len(arguments)} arguments")
        job = Job(number, skill, arguments, seconds, time.time())
        with self._lock:
            self._jobs[number] = job
            if self._memory is not None:
                with self._memory.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(list(job)) + "\n")
        return job

    def find(self, number: int) -> Job | None:
        """What it knows of a number."""
        return self._jobs.get(number)

    def halt(self, number: int) -> None:
        """Stop."""
        self._halted.add(number)

    def state(self, job: Job) -> tuple[str, tuple[str, ...]]:
        """How far a job is, and the data that go with that."""
        if job.number in self._halted:
            return "halted", ()
        passed = time.time() - job.began
        if passed < job.seconds:
            return "running", (f"{passed / job.seconds:.2f}",)
        if job.arguments and job.arguments[0] == FAILING:
            return "failed", ("the machine broke",)
        if job.skill == "move":
            self._position = (float(job.arguments[0]), float(job.arguments[1]))
        return "done", job.arguments

    @property
    def position(self) -> tuple[float, float]:
        """Where it is."""
        for job in self._jobs.values():
            if job.skill == "move":
                self.state(job)
        return self._position
