"""Prove the testbed on a real engine: `python -m tests.testbed`; see the package, and `make testbed`.

Environment: COMPOSE (`docker compose` or `docker-compose`), PIP_INDEX_URL and NPM_CONFIG_REGISTRY (for building), ONLY
(services, or `service:killed`, or `:killed`, or a profile: these disturbances alone, and no table), KEEP=1 (the profile
that is disturbed stays up; the last, where there are two).
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from types import FrameType

from tests.testbed.bed import Bed, CannotStart, Missing, make_bed, say
from tests.testbed.engine import CommandFailed
from tests.testbed.profiles import brokered_problems, pal_problems, talkrobots_problems

PAL_S, TALKROBOTS_S, BROKERED_S = 180.0, 240.0, 120.0
SPEED = "10"


def _pal(bed: Bed) -> list[str]:
    with bed.up("pal", UA_FLEET_SPEED=SPEED) as compose:
        report = bed.result(compose, "line", PAL_S)
        say(f"pal: {len(report['covers'])} covers, looped {report['looped']}, secure {report['secure']}")
        return [f"pal: {problem}" for problem in pal_problems(report)]


def _talkrobots(bed: Bed, only: str, *, keep: bool) -> list[str]:
    from tests.testbed.scenes import TALKROBOTS
    from tests.testbed.session import disturbances, first_looks

    with bed.up("talkrobots", keep=keep, UA_FLEET_SPEED=SPEED, UA_FLEET_RESILIENCE="automatic") as compose:
        report = bed.result(compose, "tasks", TALKROBOTS_S)
        found = [f"talkrobots: {problem}" for problem in talkrobots_problems(report)]
        fault = report["fault"]
        say(f"talkrobots: {len(report['tasks'])} tasks, {fault['replacement']} took over from {fault['robot']}")
        if not only:
            found += first_looks(bed, compose)
        return found + asyncio.run(disturbances(bed, compose, TALKROBOTS, only))


def _brokered(bed: Bed, only: str, *, keep: bool) -> list[str]:
    from tests.testbed.scenes import BROKERED
    from tests.testbed.session import disturbances, first_looks_at_the_yard

    with bed.up("brokered", keep=keep, UA_FLEET_SPEED=SPEED) as compose:
        report = bed.result(compose, BROKERED.conductor, BROKERED_S)
        found = [f"brokered: {problem}" for problem in brokered_problems(report)]
        say(f"brokered: {len(report['tasks'])} tasks")
        if not only:
            found += first_looks_at_the_yard(bed, compose)
        return found + asyncio.run(disturbances(bed, compose, BROKERED, only))


def _disturbed(bed: Bed, only: str, *, keep: bool) -> list[str]:
    """The profiles that are disturbed, one after the other."""
    from tests.testbed.scenes import BROKERED, TALKROBOTS
    from tests.testbed.session import meant, with_runs

    wanted = meant(only)
    with_talkrobots = bool(wanted[TALKROBOTS.profile]) or with_runs(TALKROBOTS, only)
    with_brokered = bool(wanted[BROKERED.profile])
    found = _talkrobots(bed, only, keep=keep and not with_brokered) if with_talkrobots else []
    return [*found, *(_brokered(bed, only, keep=keep) if with_brokered else [])]


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def main() -> int:
    """Run all; the exit code."""
    signal.signal(signal.SIGTERM, _interrupt)
    only, keep = os.environ.get("ONLY", ""), bool(os.environ.get("KEEP"))
    begun = time.monotonic()
    try:
        bed = make_bed()
        bed.build()
        found: list[str] = []
        if not only:
            from tests.testbed.wrong import wrong_starts

            found += [*wrong_starts(bed), *_pal(bed)]
        found += _disturbed(bed, only, keep=keep)
    except Missing as error:
        for line in str(error).splitlines():
            print(f"testbed: {line}", file=sys.stderr)
        return 2
    except (CannotStart, CommandFailed) as error:
        for line in str(error).splitlines():
            print(f"testbed: {line}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("testbed: interrupted; everything was taken down", file=sys.stderr)
        return 130
    for problem in found:
        print(f"testbed: NOT AS IT SHOULD BE: {problem}", file=sys.stderr)
    say(f"{'all as it should be' if not found else 'the end'}, after {(time.monotonic() - begun) / 60:.0f} min")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
