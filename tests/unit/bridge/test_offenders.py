from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.bridge.offenders import MOST_CHARS, MOST_OFFENDERS, Offenders
from ua_fleet.counters import Drop


class Inlet:
    def __init__(self) -> None:
        self.events: list[DriverEvent] = []

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)


def test_a_source_is_put_aside_counted_and_tried_again() -> None:
    inlet = Inlet()
    offenders = Offenders(inlet, first_pause_s=2.0)
    assert not offenders.is_aside("/a", 0.0)
    assert offenders.put_aside("/a", "its header has no `type`", 0.0) == 2.0
    assert inlet.events == [Dropped(Drop.MISBEHAVED)]
    assert offenders.is_aside("/a", 1.9)
    assert not offenders.is_aside("/b", 1.9)
    assert not offenders.is_aside("/a", 2.0)
    assert offenders.told(2.0) == {"/a": "its header has no `type`"}  # on trial


def test_the_pause_grows_while_it_goes_on_and_begins_anew_when_it_has_behaved() -> None:
    offenders = Offenders(Inlet(), first_pause_s=1.0, longest_pause_s=60.0)
    now, pauses = 0.0, list[float]()
    for _ in range(8):
        pauses.append(pause := offenders.put_aside("/a", "rubbish", now))
        now += pause
    assert pauses == [1, 2, 4, 8, 16, 32, 60, 60]
    assert offenders.put_aside("/a", "rubbish", now + 59.0) == 60
    assert offenders.told(now + 59.0 + 60 + 60) == {}
    assert offenders.put_aside("/a", "rubbish", now + 59.0 + 60 + 60) == 1


def test_what_a_stranger_wrote_is_harmless_and_short() -> None:
    offenders = Offenders(Inlet())
    offenders.put_aside("/a\x1b[2J", "\x1b[31m" + "x" * 10_000, 0.0)
    ((name, reason),) = offenders.told(0.0).items()
    assert name == "/a\\x1b[2J"
    assert reason.startswith("\\x1b[31mx")
    assert len(reason) == MOST_CHARS


def test_many_offenders_are_bounded_and_the_greedy_lose_their_own_place() -> None:
    offenders = Offenders(Inlet(), first_pause_s=1.0)
    for number in range(4):
        for _ in range(number + 1):
            offenders.put_aside(f"/old{number}", "rubbish", 0.0)
    for number in range(2 * MOST_OFFENDERS):
        offenders.put_aside(f"/{number}", "rubbish", 0.5)
    assert len(offenders.told(0.5)) == MOST_OFFENDERS
    assert offenders.is_aside("/old3", 0.5)  # the worst is remembered


def test_a_source_that_is_gone_for_good_is_forgotten() -> None:
    offenders = Offenders(Inlet())
    offenders.put_aside("/a", "rubbish", 0.0)
    offenders.forget("/a")
    offenders.forget("/a")
    assert not offenders.is_aside("/a", 0.0)
    assert offenders.told(0.0) == {}


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 500)), max_size=60))
def test_one_source_never_changes_what_is_known_of_another(offences: list[tuple[str, float]]) -> None:
    together = Offenders(Inlet())
    alone = {name: Offenders(Inlet()) for name in "abc"}
    now = 0.0
    for name, wait in offences:
        now += wait
        assert together.put_aside(name, "rubbish", now) == alone[name].put_aside(name, "rubbish", now)
        for other, only in alone.items():
            assert together.is_aside(other, now) == only.is_aside(other, now)
