"""`fuzzing.py COUNT SEED`: decode bombs as the server does, under a limit of memory; what came of them as JSON."""

from __future__ import annotations

import asyncio
import collections
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

from asyncua.common.utils import Buffer

from tests.attacks.bombs import BombMaker, ua
from ua_fleet.endpoint import decoding
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.stack import Refusal, name_of
from ua_fleet.endpoint.turns import TurnPlace, Turns
from ua_fleet.errors import RemoteWireError

EARLY = ("GetEndpoints", "FindServers", "CreateSession", "ActivateSession")
LATER = (
    *("Read", "Write", "HistoryRead", "Browse", "TranslateBrowsePathsToNodeIds", "Call"),
    *("CreateMonitoredItems", "ModifyMonitoredItems", "CreateSubscription", "Publish"),
)
ROOM_BYTES = 400 * 1024 * 1024
REPEATED = 2


async def decoded_s(
    structure: Any, body: bytes, *, later: bool, has_head: bool, outcomes: collections.Counter[str]
) -> float:
    """Decode a bomb; the CPU that it took."""
    limits = EndpointLimits()
    began = time.process_time()
    try:
        buffer = Buffer(body)
        if has_head:
            decoding.decode_request_head(buffer)
        await decoding.decode_parameters(
            structure,
            buffer,
            most_operations=limits.nodes_per_request if later else decoding.OPERATIONS_BEFORE_SESSION,
            most_memory=limits.request_memory_bytes if later else decoding.BYTES_BEFORE_SESSION,
            turns=Turns(TurnPlace()) if later else None,
        )
        outcomes["decoded"] += 1
    except Refusal as error:
        outcomes[name_of(error.ua_status)] += 1
        # The budget ends before the memory does, the levels before the recursion, and both readers read the same.
        outcomes["too late"] += any(f": {late}" in str(error) for late in ("Mem", "Recursion", "ambiguous"))
    except RemoteWireError:
        outcomes["BadDecodingError"] += 1
    return time.process_time() - began


async def main(count: int, seed: int) -> None:
    """Every fourth bomb is for a client who is logged in; every eighth begins at the RequestHeader."""
    outcomes, uncounted = collections.Counter[str](), collections.Counter[str]()
    slowest_s = 0.0
    makers = BombMaker(seed, 20_000), BombMaker(seed + 1, 60_000)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(count):
        later = number % 4 == 0
        maker = makers[later]
        structure = getattr(ua, f"{maker.random.choice(LATER if later else EARLY)}Parameters")
        body = maker.parameters(structure)
        if number % 8 == 1:
            body = b"\1\0\xae\1" + maker.value(ua.RequestHeader) + body
        if not later:
            body = body[:65_536]
        taken_s = await decoded_s(structure, body, later=later, has_head=number % 8 == 1, outcomes=outcomes)
        for _ in range(REPEATED if taken_s > slowest_s else 0):  # what else the machine did is not in all of them
            taken_s = min(
                taken_s, await decoded_s(structure, body, later=later, has_head=number % 8 == 1, outcomes=uncounted)
            )
        slowest_s = max(slowest_s, taken_s)
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb
    print(json.dumps({"outcomes": outcomes, "slowest_s": slowest_s, "grown_mb": grown_kb / 1024}))


if __name__ == "__main__":
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + ROOM_BYTES, size + ROOM_BYTES))
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2])))
