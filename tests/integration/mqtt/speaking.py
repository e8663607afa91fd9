"""A transport over a broker, without the process above it."""

from __future__ import annotations

from typing import Any

from tests.waiting import until
from ua_fleet.transport.mqtt.credentials import Credentials
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.mqtt.transport import MqttTransport
from ua_fleet.transport.party import Party


class Speaking:
    """A started transport of one space, what it heard, and what the broker had kept of it."""

    def __init__(self, url: str, space: int | None, credentials: Credentials | None = None, **options: Any) -> None:
        self.transport = MqttTransport(
            url,
            TopicTree(),
            credentials,
            client_id=None if space is None else f"test-{space}",
            hears_itself=False,
            **options,
        )
        self.heard: list[bytes] = []
        self.kept: list[bytes] = []
        self.taken_over = 0
        self.transport.speak_for(
            Party(
                publisher_id=space,
                seal=lambda plain, _now: [plain],
                token=lambda _now: 0,
                is_secured=False,
                names_of=lambda writer_id: ("group-2", f"source-{writer_id}"),
                receive_kept=lambda datagram, _sender: self.kept.append(datagram),
                taken_over=self._note,
            )
        )

    def _note(self) -> None:
        self.taken_over += 1

    async def start(self, *, wait: bool = True) -> None:
        await self.transport.start(lambda datagram, _sender: self.heard.append(datagram))
        if wait:
            await until(lambda: not self.transport.stats.problem, "a connection")
