from __future__ import annotations

from ua_fleet.console.setpoints import SetpointDesk, Wish

DEADMAN_S = 0.3


def desk(*told: int) -> SetpointDesk:
    made = SetpointDesk(DEADMAN_S)
    for place, counter in enumerate(told):
        made.told(counter, 0.05 * place)
    return made


def test_a_setpoint_goes_on_with_the_echo_of_the_page() -> None:
    made = desk(7)
    wish = Wish(1, 7, (0.1, 0.0))
    assert made.take(wish, 0.1) == ""
    assert made.next() == wish
    assert made.next() is None


def test_of_those_that_wait_the_newest_goes_on() -> None:
    made = desk(7, 8)
    assert made.take(Wish(1, 7, (0.5,)), 0.1) == ""
    assert made.take(Wish(2, 8, (0.0,)), 0.1) == "setpoint_overtaken"
    assert made.next() == Wish(2, 8, (0.0,))
    assert made.drops == {"setpoint_overtaken": 1}


def test_a_number_counts_once() -> None:
    made = desk(7)
    made.take(Wish(5, 7, (0.5,)), 0.1)
    for number in (5, 4, 0):
        assert made.take(Wish(number, 7, (0.5,)), 0.1) == "setpoint_repeated"
    assert made.take(Wish(6, 7, (0.5,)), 0.1) == "setpoint_overtaken"


def test_an_echo_has_to_have_been_told() -> None:
    made = desk(7)
    for echo in (0, 6, 8, 0xFFFF_FFFF):
        assert made.take(Wish(1, echo, (0.5,)), 0.1) == "setpoint_forged"
    assert made.next() is None


def test_an_echo_is_late_after_the_dead_man_s_time() -> None:
    made = desk(7)
    assert made.take(Wish(1, 7, (0.5,)), DEADMAN_S - 0.001) == ""
    assert made.take(Wish(2, 7, (0.5,)), DEADMAN_S) == "setpoint_late"
    made.told(8, 10.0)
    assert made.take(Wish(2, 7, (0.5,)), 10.0) == "setpoint_late", "it is no forged one, however long ago"


def test_a_counter_that_is_told_again_is_no_newer() -> None:
    made = desk(7)
    made.told(7, 0.29)
    assert made.take(Wish(1, 7, (0.5,)), 0.31) == "setpoint_late"
    made.told(8, 0.32)
    made.told(8, 0.7)
    assert made.take(Wish(1, 7, (0.5,)), 0.71) == "setpoint_late"
    assert made.take(Wish(1, 8, (0.5,)), 0.71) == "setpoint_late"


def test_counters_go_round() -> None:
    made = desk(0xFFFF_FFFF, 1)
    assert made.take(Wish(1, 0xFFFF_FFFF, (0.5,)), 0.1) == ""
    assert made.take(Wish(2, 1, (0.5,)), 0.1) == "setpoint_overtaken"
    assert made.take(Wish(3, 1, (0.5,)), 0.5) == "setpoint_late"
    assert made.take(Wish(3, 2, (0.5,)), 0.5) == "setpoint_forged"


def test_the_page_hears_of_its_own_numbers() -> None:
    made = desk(7)
    assert made.taken(0) == 0
    for number, wish in ((1, Wish(10, 7, ())), (2, Wish(13, 7, ())), (3, Wish(14, 7, ()))):
        made.sent(wish, number)
    assert made.answered == 14
    assert made.taken(2) == 13
    assert made.taken(2) == 13
    assert made.taken(1) == 13
    assert made.taken(3) == 14
