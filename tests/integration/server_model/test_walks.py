"""How many functions of ours a value passes from a driver's callback to a client's notification, and where it waits."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any, Final

from tests.integration.server_model.harness import SPEED, fleet_config, reader, serving, until
from tests.waiting import until as until_holds
from tests.walks import Walk
from ua_fleet.bridge import Driver, DriverStatus, Inlet, SampleRead, SourceFound, run_bridge
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

FIELDS: Final = (make_field("data", BuiltinType.DOUBLE),)
VALUE: Final = 0.8346214
"""Comes nowhere else."""
MOST: Final = 14
PLACES: Final = {
    "BoundedInlet.put": "BoundedInlet.put",  # the driver's callback has it
    "UdpTransport.send": "BoundedInlet._hand_on",  # it has waited in the inlet
    "Item.put": "Hub._receive",  # it comes from the network
    "Processor.respond": "Processor.respond",  # it has waited in the client's subscription
}
"""Where a value waits or leaves a process, and the function that takes it from the place before."""


class OneSource(Driver):
    """A space with one source, which says what a test has it say."""

    def __init__(self) -> None:
        self.inlet: Inlet | None = None

    async def start(self, inlet: Inlet) -> None:
        self.inlet = inlet
        inlet.put(SourceFound(SPEED, "speed", FIELDS))

    def heard(self, value: float) -> None:
        """What a client library of the space calls."""
        assert self.inlet is not None
        self.inlet.put(SampleRead(SPEED, (value,), time.time_ns()))

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        del topic, metadata, message
        return True

    def status(self) -> DriverStatus:
        return DriverStatus(True, "here")

    async def stop(self) -> None:
        self.inlet = None


async def test_a_value_passes_few_functions_and_waits_in_the_inlet_and_in_the_subscription(
    tmp_path: Path, udp_url: str, tcp_port: int
) -> None:
    config, source, told = fleet_config(udp_url, tcp_port), OneSource(), list[Any]()

    class Handler:
        def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
            del node, data
            told.append(val)

    async with serving(tmp_path, config) as running, running.client() as client:
        transport = UdpTransport(udp_url, "lo", hears_itself=False)
        bridge = asyncio.ensure_future(
            run_bridge(config, "mobile_side", source, transport, state_dir=tmp_path / "bridge")
        )
        try:
            # The bridge says that it is there after it has announced its source. The first value waits for none before.
            online = reader(client, "ns=2;s=1900.Online")
            await until(online, lambda data: data.StatusCode.is_good() and data.Value.Value)
            subscription: Any = await client.create_subscription(50, Handler())
            await subscription.subscribe_data_change([client.get_node("ns=2;i=1001")], sampling_interval=0)
            with Walk(VALUE, PLACES) as walk:
                source.heard(VALUE)
                await until_holds(lambda: VALUE in told)
        finally:
            bridge.cancel()
            await asyncio.wait([bridge])
    assert {place: way[0] for place, way in walk.ways.items()} == PLACES
    assert 1 + len(walk.functions) <= MOST, "\n".join(walk.functions)  # the driver's callback is one
