"""A driver that leaves all to the base class."""

from __future__ import annotations

from ua_fleet.bridge import Driver, DriverStatus, Inlet
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData


class Mute(Driver):
    """It has what every driver has to write, and no skills."""

    async def start(self, inlet: Inlet) -> None: ...

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        raise AssertionError(f"nothing is published into the space here, but {topic} {metadata} {message}")

    def status(self) -> DriverStatus:
        return DriverStatus(True, "up")

    async def stop(self) -> None: ...
