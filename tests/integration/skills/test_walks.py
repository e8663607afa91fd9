"""How many functions of ours an argument passes from the Call of a Method to the driver."""

from __future__ import annotations

import asyncio
from typing import Final

from tests.contract.skilled import WORK, SkilledDriver
from tests.contract.virtual import Bus
from tests.integration.skills.conftest import SPACE, Hall
from tests.integration.skills.test_methods import started
from tests.waiting import until as until_holds
from tests.walks import Walk
from ua_fleet.bridge import run_bridge
from ua_fleet.transport.udp import UdpTransport

SECONDS: Final = 0.8346214
"""Comes nowhere else."""
MOST: Final = 18
PLACES: Final = {
    "UdpTransport.send": "MethodServices.add",  # before it, a Call request is bytes that nobody has looked into
    "Actions._execute": "BridgeShell.receive",  # it comes from the network, and goes to the driver
}
"""Where an argument leaves a process or comes to the driver, and the function that takes it from the place before."""
FORMS: Final = ("encode_typed", "decode_typed")
"""What packs a value into the bytes of a Variant, and what parses it: a value that is a Variant has no other way."""


async def test_an_argument_passes_few_functions_waits_nowhere_and_is_packed_and_parsed_once(hall: Hall) -> None:
    bus = Bus()
    bus.is_up = True
    transport = UdpTransport(hall.config.pubsub.url, "lo", hears_itself=False)
    bridge = asyncio.ensure_future(
        run_bridge(hall.config, "cell", SkilledDriver(SPACE, bus, hall.machine), transport, state_dir=hall.folder / "b")
    )
    try:
        async with hall.server() as running, running.client() as client:
            await started(client, WORK, "weld", 0.01)
            with Walk(SECONDS, PLACES, FORMS, PLACES.values()) as walk:
                await started(client, WORK, "weld", SECONDS)
                await until_holds(lambda: any(job.seconds == SECONDS for job in hall.machine.told()))
    finally:
        bridge.cancel()
        await asyncio.wait([bridge])
    # Before that, a request is bytes that nobody has looked into.
    ways = {place: way[way.index(PLACES[place]) :] for place, way in walk.ways.items()}
    assert ways.keys() == PLACES.keys()
    passed = list(dict.fromkeys(name for way in ways.values() for name in way))
    assert len(passed) <= MOST, "\n".join(passed)
    assert walk.calls == dict.fromkeys(FORMS, 1)
