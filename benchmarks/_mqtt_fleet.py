"""The fleet of the benchmark `mqtt`, and its simulated bridges: what a bridge says over a broker, without robots."""

from __future__ import annotations

import asyncio
import time
from typing import Any, Final

from ua_fleet.counters import Counters
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.mqtt.transport import MqttTransport
from ua_fleet.transport.party import Party
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire import Codec

__all__ = ["FIRST_SPACE", "SimulatedBridge", "fleet", "source", "wall_ticks"]

FIRST_SPACE: Final = 300
_TIMING: Final = PubSubTiming(30.0, 90.0, 60.0)
"""Seconds between keep-alives and until a source is silent: longer than any pause of the benchmark."""


def wall_ticks() -> int:
    return ticks_from_unix_ns(time.time_ns())


def source(number: int, bridges: int) -> Topic:
    """Topic of a source; those of the bridges follow each other."""
    return Topic(FIRST_SPACE + number % bridges, 2, number + 1)


def fleet(urls: list[str], port: int, *, sources: int, bridges: int) -> dict[str, Any]:
    """A fleet.yaml of so many Doubles behind so many bridges, which are all heard over the broker at these URLs."""
    broker: dict[str, Any] = {"nodes": urls[1:]} if len(urls) > 1 else {}
    return {
        "version": 1,
        "server": {
            "port": port,
            "allow_none_security": True,
            "allow_anonymous": True,
            "analog_rate_hz": 1_000_000,  # else most values would give way to newer ones, and could not be counted
        },
        "pubsub": {
            "security": "none",
            "url": urls[0],
            "broker": broker,
            "keep_alive_s": _TIMING.keep_alive_s,
            "receive_timeout_s": _TIMING.receive_timeout_s,
            "repeat_interval_s": _TIMING.repeat_interval_s,
        },
        "bridges": {
            f"hall{each}": {"kind": "virtual", "space": FIRST_SPACE + each, "status_id": 60_000 + each}
            for each in range(bridges)
        },
        "robots": {
            f"robot{number}": {
                "bridge": f"hall{number % bridges}",
                "data": {"value": {"id": number + 1, "type": "Double"}},
            }
            for number in range(sources)
        },
    }


class _Nothing(TopicTree):
    """Topics to send to alone: a hundred bridges that hear each other are a hundred times the load of all brokers."""

    def filters(self, own: int | None) -> list[str]:
        return []

    @property
    def data_filters(self) -> list[str]:
        return []


class SimulatedBridge:
    """A publisher of Doubles and its transport, as the runner of a bridge has them, without a driver and its inlet.

    It hears nothing.
    """

    def __init__(self, space: int, topics: list[Topic], *urls: str) -> None:
        self.topics = topics
        self.publisher = Publisher(space, _TIMING, Counters(), Codec())
        self.transport = MqttTransport(
            urls[0], _Nothing(), client_id=f"benchmark-{space}", more_urls=urls[1:], hears_itself=False
        )
        self.transport.speak_for(
            Party(
                publisher_id=space,
                seal=lambda plain, _now: [plain],
                token=lambda _now: 0,
                is_secured=False,
                names_of=self.publisher.names_of,
                receive_kept=lambda _datagram, _sender: None,
            )
        )
        self._clock = asyncio.get_running_loop().time

    async def start(self) -> None:
        """Connect, and describe the sources."""
        await self.transport.start(lambda _datagram, _sender: None)
        while self.transport.stats.problem:  # noqa: ASYNC110 -- a transport says it in its figures
            await asyncio.sleep(0.01)
        self._send(self.publisher.begin(now=self._clock(), wall_ticks=wall_ticks()))
        field = (make_field("data", BuiltinType.DOUBLE),)
        for topic in self.topics:
            self._send(self.publisher.announce(topic, topic.name, field, now=self._clock(), wall_ticks=wall_ticks()))

    def publish(self, topic: Topic, value: float) -> None:
        """Send a value."""
        self._send(self.made(topic, value, wall_ticks()))

    def made(self, topic: Topic, value: float, ticks: int) -> list[bytes]:
        """The message of a value, not sent."""
        return self.publisher.publish(topic, (value,), timestamp=ticks, now=self._clock())

    def poll(self) -> None:
        """Send what time has brought."""
        self._send(self.publisher.poll(self._clock(), wall_ticks()))

    def _send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            self.transport.send(datagram)
