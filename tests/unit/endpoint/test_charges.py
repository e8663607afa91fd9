from __future__ import annotations

import pytest

from ua_fleet.endpoint.charges import GATEWAY_AT_ONCE_S, LOGIN_S, Charge, Charges
from ua_fleet.endpoint.strangers import AT_ONCE_S

ADDRESS, ELSEWHERE = "10.0.0.9", "192.168.0.1"


def shown() -> bool | None:
    return True


def not_shown() -> bool | None:
    return False


def silent() -> bool | None:
    return None


@pytest.fixture
def charges() -> Charges:
    return Charges()


def gateway_at(charges: Charges, address: str = ADDRESS) -> Charge:
    charge = Charge(charges, address)
    assert charge.belongs_to("console", 0.0)
    return charge


def test_a_gateway_pays_for_its_connections_and_its_address_does_not(charges: Charges) -> None:
    for _ in range(50):
        charge = Charge(charges, ADDRESS)
        charge.spend(0.04, 0.0)
        assert charge.belongs_to("console", 0.0)
        charge.spend(0.01, 0.0)
    assert not charges.strangers.exhausted(ADDRESS, 0.0)
    assert not charges.gateways.exhausted("console", 0.0)
    gateway_at(charges).spend(GATEWAY_AT_ONCE_S, 0.0)
    assert not Charge(charges, ADDRESS).belongs_to("console", 0.0), "it has a bound too"
    assert Charge(charges, ADDRESS).belongs_to("board", 0.0), "and each one of its own"


def test_a_login_that_has_begun_is_done(charges: Charges) -> None:
    begun, greedy = gateway_at(charges), gateway_at(charges)
    greedy.spend(GATEWAY_AT_ONCE_S, 0.0)
    assert greedy.is_exhausted(0.0, shown)
    assert not begun.is_exhausted(0.0, shown)
    begun.spend(LOGIN_S, 0.0)
    assert begun.is_exhausted(0.0, shown)


def test_who_logs_in_owes_nothing(charges: Charges) -> None:
    for _ in range(100):
        charge = gateway_at(charges)
        charge.spend(0.1, 0.0)
        charge.repay()
    assert not charges.gateways.exhausted("console", 0.0)
    for _ in range(100):
        charge = Charge(charges, ADDRESS)
        charge.spend(0.1, 0.0)
        charge.repay()
    assert not charges.strangers.exhausted(ADDRESS, 0.0)


def test_without_a_gateway_an_address_has_no_reserve(charges: Charges) -> None:
    gateway_at(charges, ELSEWHERE)
    charge = Charge(charges, ADDRESS)
    charge.spend(AT_ONCE_S, 0.0)
    assert charge.is_exhausted(0.0, shown)
    assert charges.is_exhausted(ADDRESS, 0.0)


def test_where_a_gateway_is_connected_those_who_show_its_certificate_have_a_reserve(charges: Charges) -> None:
    connected = gateway_at(charges)
    Charge(charges, ADDRESS).spend(AT_ONCE_S, 0.0)
    assert not charges.is_exhausted(ADDRESS, 0.0)
    stranger, next_one = Charge(charges, ADDRESS), Charge(charges, ADDRESS)
    for charge in (stranger, next_one):
        assert not charge.is_exhausted(0.0, silent)
        assert charge.is_on_trial
    assert stranger.is_exhausted(0.0, not_shown)
    assert not next_one.is_exhausted(0.0, shown)
    assert not next_one.is_on_trial
    next_one.spend(0.5, 0.0)
    assert next_one.belongs_to("console", 0.0)
    assert not charges.reserve.exhausted(ADDRESS, 0.0)
    for charge in (connected, next_one):
        assert not charges.is_exhausted(ADDRESS, 0.0)
        charge.end()
        charge.end()
    assert charges.is_exhausted(ADDRESS, 0.0), "no gateway is connected any more"


def test_who_has_shown_another_certificate_before_is_refused_at_once(charges: Charges) -> None:
    gateway_at(charges)
    Charge(charges, ADDRESS).spend(AT_ONCE_S, 0.0)
    assert Charge(charges, ADDRESS).is_exhausted(0.0, not_shown)
    assert not Charge(charges, ADDRESS).is_exhausted(0.0, shown)


def test_the_reserve_has_an_end(charges: Charges) -> None:
    """Who has seen the bytes of a gateway's OpenSecureChannel can send them again."""
    gateway_at(charges)
    Charge(charges, ADDRESS).spend(AT_ONCE_S, 0.0)
    replayed = Charge(charges, ADDRESS)
    assert not replayed.is_exhausted(0.0, silent)
    assert not replayed.is_exhausted(0.0, shown)
    replayed.spend(AT_ONCE_S, 0.0)
    assert replayed.is_exhausted(0.0, shown)
    assert Charge(charges, ADDRESS).is_exhausted(0.0, shown)
    assert not Charge(charges, ADDRESS).is_exhausted(10.0, shown)


def test_hearing_who_comes_beside_a_gateway_has_an_end_too(charges: Charges) -> None:
    gateway_at(charges)
    Charge(charges, ADDRESS).spend(100 * AT_ONCE_S, 0.0)
    bare = Charge(charges, ADDRESS)
    assert not bare.is_exhausted(0.0, silent)
    bare.spend(AT_ONCE_S, 0.0)
    assert bare.is_exhausted(0.0, silent)
    assert charges.is_exhausted(ADDRESS, 0.0)
    assert not charges.is_exhausted(ADDRESS, 4.0)


def test_what_strangers_cost_stays_theirs(charges: Charges) -> None:
    gateway_at(charges)
    stranger = Charge(charges, ADDRESS)
    stranger.spend(AT_ONCE_S, 0.0)
    assert not stranger.is_exhausted(0.0, shown)
    stranger.repay()
    assert charges.strangers.exhausted(ADDRESS, 0.0)
    assert not charges.reserve.exhausted(ADDRESS, 0.0)


def test_a_mark_that_is_taken_away(charges: Charges) -> None:
    charge = gateway_at(charges)
    charge.spend(AT_ONCE_S, 0.0)
    assert charge.belongs_to("", 0.0)
    assert not charges.has_gateway(ADDRESS)
    assert charges.strangers.exhausted(ADDRESS, 0.0)
    assert charge.belongs_to("console", 0.0)
    assert charge.belongs_to("board", 0.0)
    assert charges.has_gateway(ADDRESS)
    charge.end()
    assert not charges.has_gateway(ADDRESS)


def test_a_connection_that_is_gone_is_nobodys_any_more(charges: Charges) -> None:
    """A mark that comes while it is taken down counted it again, for ever."""
    charge = gateway_at(charges)
    charge.end()
    assert charge.belongs_to("console", 0.0)
    assert not charges.has_gateway(ADDRESS)
