"""What happens in a run, by its seed alone. Pure.

Seeds of one `ROUND` run at the same time, a robot each. Where what is stopped is shared (the server, the console), all
of them have the same disturbance; else each has its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import Final

__all__ = ["LANES", "Disturbance", "Plan", "plan_of", "round_of"]

LANES: Final = 4

CONSOLE_KINDS: Final = ("drop", "hold", "hold there", "hold back", "delay")
BRIDGE_KINDS: Final = (*("drop", "drop there", "drop back"), *("hold", "hold there", "delay", "jitter", "repeat"))

OWN: Final = (
    ("stop", "tab"),
    ("bridge link", "drop"),
    ("tab link", "hold"),
    ("server link", "hold"),
    ("lease", "stolen"),
    ("stop", "bridge"),
    ("tab link", "drop"),
    ("bridge link", "hold"),
    ("setpoints", "stale"),
    ("server link", "drop"),
    ("stop", "bridge"),
    ("lease", "second"),
    ("bridge link", "repeat"),
    ("tab link", "hold there"),
    ("setpoints", "queued"),
    ("server link", "hold there"),
    ("bridge link", "drop there"),
    ("stop", "tab"),
    ("lease", "stolen while held"),
    ("tab link", "delay"),
    ("bridge link", "hold there"),
    ("setpoints", "repeated"),
    ("server link", "hold back"),
    ("bridge link", "drop back"),
    ("lease", "forged"),
    ("tab link", "hold back"),
    ("server link", "delay"),
    ("bridge link", "delay"),
    ("tab", "killed"),
    ("bridge link", "jitter"),
    ("tab", "key up"),
)
"""What a lane can have for itself. Their number is prime, so each comes to each lane."""
SHARED: Final = (("stop", "server"), ("stop", "console"))
PAGE_EVERY: Final = 20
"""Of so many seeds one is driven in a real browser: a multiple of LANES, so that one lane needs one."""
PAGE: Final = 3
SHARED_EVERY: Final = 3
"""Of so many rounds one has a shared disturbance."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What is done, and how long."""

    where: str
    what: str
    length_s: float
    seconds: float
    """Of a delay."""

    @property
    def is_shared(self) -> bool:
        return (self.where, self.what) in SHARED


@dataclass(frozen=True, slots=True)
class Plan:
    """One run."""

    seed: int
    disturbance: Disturbance
    by: str
    """`console` or `opcua`: what the operator's device speaks."""
    is_page: bool
    """Whether that is a tab of a real browser."""
    speed: float
    """Share of the axis's greatest; in tenths, as the page has it."""
    at: float
    """Begins when it has so much of that, and `after_s` later."""
    after_s: float

    @property
    def lane(self) -> int:
        return self.seed % LANES

    def __str__(self) -> str:
        what = self.disturbance
        delay = f" of {what.seconds:.3f} s" if what.seconds else ""
        by = "page" if self.is_page else self.by
        return (
            f"seed {self.seed}, lane {self.lane}, by {by}: {what.where}, {what.what}{delay} for {what.length_s:.3f} s,"
            f" {self.after_s:.3f} s after {self.at:.0%} of a speed of {self.speed:.0%}"
        )


def round_of(seed: int) -> int:
    """Which seeds run together with it."""
    return seed // LANES


def plan_of(seed: int) -> Plan:
    """The plan of a run."""
    number, random = round_of(seed), Random(f"seed {seed}")
    rounds, place = divmod(number, SHARED_EVERY)
    if place == SHARED_EVERY - 1:
        together = Random(f"round {number}")
        disturbance = _disturbance(*SHARED[rounds % len(SHARED)], together)
    else:
        own = (rounds * (SHARED_EVERY - 1) + place) * LANES + seed % LANES
        disturbance = _disturbance(*OWN[own % len(OWN)], random)
    needs_console = disturbance.where == "tab link" or disturbance.what == "console"
    # What the console would not let through at all.
    needs_opcua = disturbance.where == "setpoints" and seed % 2 == 0
    # A browser is not started in no time, and the page sends no setpoint twice.
    is_page = seed % PAGE_EVERY == PAGE and disturbance.what != "killed" and disturbance.where != "setpoints"
    by = "console" if needs_console or is_page or (not needs_opcua and random.random() < 0.7) else "opcua"
    is_rising = random.random() < 0.3
    return Plan(
        seed,
        disturbance,
        by,
        is_page,
        random.randint(5, 10) / 10,
        random.uniform(0.2, 0.9) if is_rising else 1.0,
        random.uniform(0.0, 0.1),
    )


def _disturbance(where: str, what: str, random: Random) -> Disturbance:
    seconds = {
        "delay": random.uniform(0.05, 1.3),
        "jitter": random.uniform(0.05, 1.0),
        "repeat": random.uniform(0.02, 1.0),
    }.get(what, 0.0)
    # Some of them are short enough to be ridden out, or nearly so.
    length_s = random.uniform(0.05, 1.1) if random.random() < 0.3 else random.uniform(1.1, 2.1)
    return Disturbance(where, what, length_s, seconds)
