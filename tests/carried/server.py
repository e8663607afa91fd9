"""The server of a virtual world as it is: its own code and a real file, and the words of bridges over the bad network.

It is killed at writes of its journal, and a new one goes on with the file. Adoptions and pauses are the business of
`world`, whose server has no file.
"""

from __future__ import annotations

import secrets
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from random import Random
from typing import Any, Final

import structlog

from tests.carried.plans import ROBOTS, SPACES
from tests.carried.world import AGAIN_S, END_S, HEALED_S, RUN, Bridge, World
from tests.unit.operation.runs.world import FailingJournal
from tests.unit.operation.runs.world import World as Service
from ua_fleet.carrier.side import RunUnknown
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ScenarioError
from ua_fleet.operation.runs.carried import ANSWER_S, CarriedRuns
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import Fact, StepStarted
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, pack
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = ["IsKilled", "ServedWorld", "at_the_beginning", "by_chance"]

LATE_S: Final = 10.0
"""So long after it was given up a request is still taken."""
_DOUBLE: Final = {"type": "Double"}
_WORK: Final = {"arguments": {"x": {**_DOUBLE, "default": 0}}, "results": {"out": _DOUBLE}, "timeout_s": 1000}
CONFIG: Final = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {
            f"c{space}": {"kind": "virtual", "space": space, "status_id": space, "requestors": [0, *SPACES]}
            for space in SPACES
        },
        "robots": {
            name: {
                "bridge": f"c{space}",
                "skill_status_id": 1200 + number,
                "data": {"level": {"id": 1300 + number, **_DOUBLE}},
                "skills": {"work": {"id": 1100 + number, **_WORK}},
            }
            for number, (name, space) in enumerate(ROBOTS.items())
        },
    }
)
NOBODY: Final = RequestOutcome(OutcomeKind.UNKNOWN, ExecutionReport(ExecutionState.UNKNOWN))

IsKilled = Callable[[list[Fact]], str]
"""Whether a write of these facts kills the server, and when: `before` it, `after` it, or never (empty)."""


class ServerKilled(BaseException):
    """The server ends at a write: nothing of it may go on."""


def at_the_beginning(when: str) -> IsKilled:
    """Killed where it writes down that the first bridge has the token, the first time."""
    left = [when]

    def is_killed(facts: list[Fact]) -> str:
        is_it = any(isinstance(fact, StepStarted) and not fact.step for fact in facts)
        return left.pop() if left and is_it else ""

    return is_killed


def by_chance(seed: int, rate: float = 0.15) -> IsKilled:
    """Killed at any write."""
    random = Random(f"server {seed}")
    return lambda _facts: random.choice(("before", "after")) if random.random() < rate else ""


def _never(_facts: list[Fact]) -> str:
    return ""


class _Journal(FailingJournal):
    """Which may kill the process that writes."""

    is_killed: IsKilled = staticmethod(_never)

    def write(self, facts: Iterable[tuple[str, Fact]], *args: Any, **kwargs: Any) -> None:
        facts = list(facts)
        when = self.is_killed([fact for _, fact in facts]) if facts else ""
        if when == "before":
            raise ServerKilled
        super().write(facts, *args, **kwargs)
        if when:
            raise ServerKilled


class _Process(Service):
    """One life of the server."""

    def __init__(self, world: ServedWorld, folder: Path) -> None:
        self._world, journal = world, _Journal(folder / "runs.db")
        super().__init__(folder, heard=(), config=CONFIG, journal=journal)
        self._told: Callable[[bytes, RequestOutcome], None] = lambda _id, _outcome: None
        self._open: dict[bytes, float] = {}
        """Questions that are not answered, and until when they are asked."""
        self._answers: list[tuple[bytes, RequestOutcome]] = []

        def commands(*, told: Callable[[bytes, RequestOutcome], None], **_: object) -> Any:
            self._told = told
            return self

        self.carried = CarriedRuns(
            CONFIG,
            self.service,
            commands,
            reserve=lambda _robot, _why: None,
            sooner=lambda: None,
            clock=lambda: self.now,
            wall_s=lambda: self.now,
            mistakes=self.mistakes,
            log=structlog.get_logger(),
            new_id=lambda _now: RUN,
        )
        journal.is_killed = world.is_killed

    @property
    def now(self) -> float:
        return self._world.now

    @now.setter
    def now(self, _now: float) -> None: ...  # pyright: ignore[reportIncompatibleVariableOverride]

    # In place of SkillCommands.

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        del robot, skill, timeout_s
        word, content = Word(arguments["Word"]), arguments["Content"]
        self._open[execution_id] = self.now + ANSWER_S
        bridge = self._world.bridges[topic.space]
        for after_s in (0.0, 0.5, 1.0):
            self._world.at(self.now + after_s, lambda: self._say(bridge, word, content, execution_id))

    def receive(self, *_: object) -> None: ...

    def announced(self, *_: object) -> None: ...

    def next_deadline(self) -> float | None:
        return None

    def poll(self, now: float) -> None:
        late = [(one, NOBODY) for one, until in self._open.items() if now >= until]
        answers, self._answers = [*self._answers, *late], []
        for execution_id, outcome in answers:
            if self._open.pop(execution_id, None) is not None:
                self._told(execution_id, outcome)

    def _say(self, bridge: Bridge, word: Word, content: bytes, execution_id: bytes) -> None:
        world = self._world
        if world.server is not self or execution_id not in self._open:
            return
        until = self._open[execution_id] + LATE_S

        def answer(outcome: RequestOutcome) -> None:
            world.carry(bridge.space, 0, lambda: self._answers.append((execution_id, outcome)))

        def take() -> None:
            if world.now > until:
                return
            try:
                said = _answer(bridge, word, content, world.now)
            except ScenarioError as error:
                report = ExecutionReport(ExecutionState.FAILED, error.ua_status, str(error))
                answer(RequestOutcome(OutcomeKind.REFUSED, report))
                return
            report = ExecutionReport(ExecutionState.DONE, result=pack((int(BuiltinType.BYTE_STRING),), (said,)))
            answer(RequestOutcome(OutcomeKind.ACCEPTED, report))

        world.carry(0, bridge.space, lambda: bridge.act(take))


def _answer(bridge: Bridge, word: Word, content: bytes, now: float) -> bytes:
    """What a bridge does with a word of the server; see `carrier.side`."""
    holder = bridge.holder
    match word:
        case Word.PART:
            holder.take_part(content, now)
        case Word.TOKEN:
            bridge.do(holder.take_token(content, 0, now))
        case Word.END:
            words = decode_words(content)
            bridge.do(holder.take_end(words["run"], words["outcome"], words["reason"], 0, now))
        case Word.FETCH:
            answer = _page(bridge)
            holder.fetched(RUN, now)
            return answer
        case _:
            raise AssertionError(f"the server says {word}")
    return b""


def _page(bridge: Bridge) -> bytes:
    """All that is on its disk, each time: the server knows what it has."""
    held = bridge.holder.runs.get(RUN)
    if held is None:
        raise RunUnknown("the run is not known here")
    lines = [line for each in bridge.segments.values() for line in each]
    closed = held.closed
    words: dict[str, Any] = {"facts": lines, "last": 0, "more": False, "told": 0, "waits": "", "decisions": []}
    words |= {"active": [str(place) for place in held.active], "holds": [str(place) for place in held.holds]}
    words["closed"] = None if closed is None else [closed.at, closed.outcome, closed.reason]
    return zlib.compress(encode_words(**words))


class ServedWorld(World):
    """A world with such a server."""

    def __init__(self, seed: int, folder: Path, is_killed: IsKilled) -> None:
        """Make it; the server is killed at writes by `is_killed`, in the time in which the world is bad."""
        super().__init__(seed)
        self._folder, self._is_killed = folder / f"{seed}-{secrets.token_hex(2)}", is_killed
        self._folder.mkdir()
        self.server: _Process | None = None
        self.server_kills = 0
        self.facts: list[Fact] = []
        """Those of the server, at the end."""
        self._server_random = Random(f"server rises {seed}")

    def run(self) -> None:
        """Let it go until bridges and server say that it is over, or for a long time."""
        self.offs[0].at = END_S * 2
        super().run()
        if self.server is not None:
            self.facts = self.server.service.facts_of(RUN)
            self.server.journal.close()

    def is_killed(self, facts: list[Fact]) -> str:
        """Whether this write kills the server."""
        return self._is_killed(facts) if 0.0 < self.now < HEALED_S else ""

    @property
    def is_over(self) -> bool:
        """Whether the server knows it, too."""
        return self.server is not None and not self.server.carried.has(RUN) and super().is_over

    def _server(self) -> None:
        """Ten times in a second, while it lives."""
        self.at(self.now + AGAIN_S / 5, self._server)
        try:
            if self.server is None:
                self._start()
            else:
                self.server.service.poll()
                self.server.carried.poll(self.now)
        except ServerKilled:
            self._die()

    def _start(self) -> None:
        is_first = not (self._folder / "runs.db").exists()
        if not is_first and self.now < self.server_is_back_at:
            return
        self.server = _Process(self, self._folder)
        if is_first:
            self.server.carried.start(self.scenario, (), (), "anna")

    def _die(self) -> None:
        assert self.server is not None
        self.server.journal.close()
        self.server, self.server_kills = None, self.server_kills + 1
        self.server_is_back_at = self.now + self._server_random.uniform(0.5, 20.0)
