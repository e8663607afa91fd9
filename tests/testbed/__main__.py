"""Prove the testbed on a real engine: `python -m tests.testbed`; see the package, and `make testbed`.

Environment: COMPOSE (`docker compose` or `docker-compose`), PIP_INDEX_URL and NPM_CONFIG_REGISTRY (for building), ONLY
(services, or `service:killed`, or `:killed`: these disturbances alone, and no table), KEEP=1 (talkrobots stays up).
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
from tests.testbed.profiles import pal_problems, talkrobots_problems

PAL_S, TALKROBOTS_S = 180.0, 240.0
SPEED = "10"


def _pal(bed: Bed) -> list[str]:
    with bed.up("pal", UA_FLEET_SPEED=SPEED) as compose:
        report = bed.result(compose, "line", PAL_S)
        say(f"pal: {len(report['covers'])} covers, looped {report['looped']}, secure {report['secure']}")
        return [f"pal: {problem}" for problem in pal_problems(report)]


def _talkrobots(bed: Bed, only: str, *, keep: bool) -> list[str]:
    from tests.testbed.session import disturbances, first_looks

    with bed.up("talkrobots", keep=keep, UA_FLEET_SPEED=SPEED, UA_FLEET_RESILIENCE="automatic") as compose:
        report = bed.result(compose, "tasks", TALKROBOTS_S)
        found = [f"talkrobots: {problem}" for problem in talkrobots_problems(report)]
        fault = report["fault"]
        say(f"talkrobots: {len(report['tasks'])} tasks, {fault['replacement']} took over from {fault['robot']}")
        if not only:
            found += first_looks(bed, compose)
        return found + asyncio.run(disturbances(bed, compose, only))


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
        found += _talkrobots(bed, only, keep=keep)
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
