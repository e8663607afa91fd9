"""Tables of a device in memory."""

from __future__ import annotations

import pytest

from ua_fleet.registers import AddressSpan, Register, RegisterType, RegisterUnfit, Table, Tables


def test_of_a_word_with_bits_only_the_one_is_changed() -> None:
    tables = Tables({Table.HOLDING: 4, Table.COIL: 2})
    tables.put_cells(AddressSpan(Table.HOLDING, 1, 1), [0b1010])
    tables.put(Register(Table.HOLDING, 1, RegisterType.BOOL, bit=0), True)
    tables.put(Register(Table.HOLDING, 1, RegisterType.BOOL, bit=3), False)
    assert tables.cells(AddressSpan(Table.HOLDING, 0, 4)) == [0, 0b0011, 0, 0]
    tables.put(Register(Table.COIL, 1, RegisterType.BOOL), True)
    assert tables.cells(AddressSpan(Table.COIL, 0, 2)) == [False, True]


def test_what_does_not_fit_changes_nothing() -> None:
    tables = Tables({Table.HOLDING: 2})
    register = Register(Table.HOLDING, 0, RegisterType.UINT16)
    tables.put(register, 7)
    with pytest.raises(RegisterUnfit):
        tables.put(register, 65_536)
    assert tables.get(register) == 7


@pytest.mark.parametrize(("address", "count", "there"), [(0, 4, True), (3, 1, True), (3, 2, False), (0, 0, False)])
def test_addresses_end_somewhere(address: int, count: int, there: bool) -> None:
    assert Tables({Table.INPUT: 4}).has(AddressSpan(Table.INPUT, address, count)) is there
