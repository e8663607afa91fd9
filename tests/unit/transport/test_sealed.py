"""A process's messages on their way out."""

from __future__ import annotations

from typing import Any

from tests.unit.pubsub.security.securing import data, envelope, group_keys
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.transport.base import TransportStats
from ua_fleet.transport.memory import MemoryNetwork
from ua_fleet.transport.sealed import SealedSender, data_group

SPACE = 1


def test_what_is_sent_is_secured_and_told_with_its_size() -> None:
    network = MemoryNetwork()
    sending, hearing, other = network.endpoint(), network.endpoint(), network.endpoint()
    heard: list[bytes] = []
    hearing.attach(lambda datagram, _: heard.append(datagram))
    told: list[tuple[bytes, int]] = []
    counters = Counters()
    secured = envelope(SPACE, counters=counters)
    sender = SealedSender(secured, sending, lambda: 0.0, lambda plain, size: told.append((plain, size)))
    first, second = data("first"), data("second")
    sender.send_all([first])
    assert told == [], "nothing was sent without a key"
    assert counters.drops[Drop.NO_KEY] == 1
    secured.install(telemetry_group(SPACE), group_keys(), 0.0)
    sender.send_all([first, second])
    sender.send(second, other.address)
    network.advance_to(1.0)
    assert [plain for plain, _ in told] == [first, second, second]
    assert [len(datagram) for datagram in heard] == [size for _, size in told[:2]]
    assert first not in b"".join(heard)


def test_what_the_kernel_loses_is_counted() -> None:
    counters, stats = Counters(), TransportStats(send_failed=2, kernel_drops=3)
    for _ in range(2):
        stats.count_drops(counters)
    assert counters.drops == {Drop.SEND_FAILED: 2, Drop.KERNEL: 3}


def test_what_was_not_secured_or_not_sent_is_counted_by_its_writer_group() -> None:
    endpoint = MemoryNetwork().endpoint()
    secured = envelope(SPACE)
    sender = SealedSender(secured, endpoint, lambda: 0.0)
    group = data_group(data("first"))
    assert group is not None
    sender.send(data("first"))
    assert (sender.not_secured, sender.failed) == ({group: 1}, {})
    secured.install(telemetry_group(SPACE), group_keys(), 0.0)
    sender.send(data("first"))
    assert sender.failed == {}
    take = endpoint.send

    def refuse(datagram: bytes, address: Any = None) -> None:
        endpoint.stats.send_failed += 1
        take(datagram, address)

    endpoint.send = refuse  # type: ignore[method-assign]
    sender.send(data("first"))
    assert sender.failed == {group: 1}


def test_a_message_without_data_belongs_to_no_writer_group() -> None:
    assert data_group(b"") is None
    assert data_group(bytes.fromhex("91910407000000000000000102010000000100")) is None
