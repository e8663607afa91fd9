"""A process's messages on their way out."""

from __future__ import annotations

from tests.unit.pubsub.security.securing import data, envelope, group_keys
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.transport import MemoryNetwork, SealedSender, TransportStats

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
