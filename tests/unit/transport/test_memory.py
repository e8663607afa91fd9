from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork


def listener(network: MemoryNetwork) -> tuple[MemoryEndpoint, list[tuple[float, bytes, Address]]]:
    endpoint = network.endpoint()
    heard: list[tuple[float, bytes, Address]] = []
    endpoint.attach(lambda datagram, sender: heard.append((network.now, datagram, sender)))
    return endpoint, heard


def test_everybody_hears_a_datagram_the_sender_too() -> None:
    network = MemoryNetwork()
    (one, heard_by_one), (_, heard_by_other) = listener(network), listener(network)
    one.send(b"a")
    assert heard_by_one == [], "nothing moves before the clock"
    network.advance_to(0.0)
    assert heard_by_one == heard_by_other == [(0.0, b"a", one.address)]


def test_an_endpoint_is_a_transport() -> None:
    transport: Transport = MemoryNetwork().endpoint()
    assert transport.stats.sent == 0


async def test_an_endpoint_starts_and_closes_like_a_transport() -> None:
    network = MemoryNetwork()
    endpoint = network.endpoint()
    heard: list[bytes] = []
    await endpoint.start(lambda datagram, _: heard.append(datagram))
    endpoint.send(b"a")
    network.step()
    await endpoint.close()
    await endpoint.close()
    endpoint.send(b"b")
    network.step()
    assert heard == [b"a"]
    assert (endpoint.stats.sent, endpoint.stats.received) == (2, 1)


def test_without_delays_the_order_is_kept() -> None:
    network = MemoryNetwork()
    endpoint, heard = listener(network)
    for number in range(100):
        endpoint.send(bytes([number]))
    network.advance_to(1.0)
    assert [datagram[0] for _, datagram, _ in heard] == list(range(100))
    assert network.now == 1.0


def test_delays_stay_in_their_bounds_and_reorder() -> None:
    network = MemoryNetwork(3, min_delay_s=0.5, max_delay_s=1.5, now=10.0)
    endpoint, heard = listener(network)
    for number in range(100):
        endpoint.send(bytes([number]))
    assert network.next_delivery() is not None
    while network.step():
        pass
    assert network.next_delivery() is None
    times = [time for time, _, _ in heard]
    assert times == sorted(times)
    assert 10.5 <= times[0] < times[-1] <= 11.5
    order = [datagram[0] for _, datagram, _ in heard]
    assert sorted(order) == list(range(100)) != order


@given(seed=st.integers())
def test_the_same_seed_does_the_same(seed: int) -> None:
    def run() -> list[tuple[float, bytes, Address]]:
        network = MemoryNetwork(seed, loss=0.3, duplicate=0.3, max_delay_s=0.2)
        endpoint, heard = listener(network)
        for number in range(50):
            endpoint.send(bytes([number]))
        network.advance_to(1.0)
        return heard

    assert run() == run()


def test_loss_and_duplication_have_the_rates_that_were_asked_for() -> None:
    network = MemoryNetwork(1, loss=0.25, duplicate=0.5)
    endpoint, heard = listener(network)
    for _ in range(4000):
        endpoint.send(b"x")
    network.advance_to(1.0)
    assert 4200 < len(heard) < 4800, "4000 x 0.75 x 1.5"


def test_a_member_that_is_cut_off_neither_sends_nor_hears() -> None:
    network = MemoryNetwork()
    (one, heard_by_one), (other, heard_by_other) = listener(network), listener(network)
    other.reachable = False
    one.send(b"a")
    other.send(b"b")
    network.advance_to(1.0)
    assert [datagram for _, datagram, _ in heard_by_one] == [b"a"]
    assert heard_by_other == []
    assert other.stats.send_failed == 1


def test_answers_that_arrive_in_time_are_delivered_in_the_same_advance() -> None:
    network = MemoryNetwork(min_delay_s=0.1, max_delay_s=0.1)
    one, heard = listener(network)
    other = network.endpoint()
    other.attach(lambda datagram, _: other.send(b"answer") if datagram == b"question" else None)
    one.send(b"question")
    network.advance_to(0.5)
    assert [datagram for _, datagram, _ in heard] == [b"question", b"answer"]


def test_a_datagram_to_an_address_reaches_that_member_alone() -> None:
    network = MemoryNetwork()
    (one, heard_by_one), (other, heard_by_other) = listener(network), listener(network)
    one.send(b"a", other.address)
    one.send(b"b", ("192.0.2.1", 1))
    network.advance_to(0.0)
    assert (heard_by_one, heard_by_other) == ([], [(0.0, b"a", one.address)])
    assert one.stats.sent == 2


def test_a_route_says_who_could_use_a_datagram() -> None:
    asked: list[bytes] = []
    members: list[Address] = []

    def route(datagram: bytes, sender: Address) -> list[Address] | None:
        asked.append(datagram)
        assert sender == members[0]
        return None if datagram == b"all" else members[1:2]

    network = MemoryNetwork(route=route)
    listeners = [listener(network) for _ in range(3)]
    members += [endpoint.address for endpoint, _ in listeners]
    sender = listeners[0][0]
    sender.send(b"some")
    sender.send(b"all")
    sender.send(b"one", members[2])
    network.advance_to(1.0)
    heard = [[datagram for _, datagram, _ in heard] for _, heard in listeners]
    assert heard == [[b"all"], [b"some", b"all"], [b"all", b"one"]]
    assert asked == [b"some", b"all"]
