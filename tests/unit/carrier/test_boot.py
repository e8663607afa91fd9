"""A bridge whose computer was started anew: its clock may have the time of the last shutdown."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest

from tests.unit.carrier.test_halts import CFG, Asked, records
from tests.unit.carrier.test_stand_ins import PLAN, Cell, hear_all
from ua_fleet.carrying import Holder, Token, encode_part, encode_token, parts_of
from ua_fleet.storage import boot
from ua_fleet.storage.boot import BootNote
from ua_fleet.storage.carried_records import CarriedRecords

__all__ = ["records"]


@pytest.fixture
def boot_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "boot_id"
    file.write_text("one\n")
    monkeypatch.setattr(boot, "BOOT_ID", file)
    return file


def test_a_note_is_of_its_boot(tmp_path: Path, boot_id: Path) -> None:
    note = BootNote(tmp_path)
    assert not note.is_other(), "nothing was noted by the versions before"
    note.write()
    assert not BootNote(tmp_path).is_other()
    boot_id.write_text("two\n")
    assert note.is_other()
    note.write()
    assert not note.is_other()
    (tmp_path / boot.BOOT_FILE).write_text("")
    assert note.is_other(), "the power failed while it was written"
    boot_id.unlink()
    assert not note.is_other(), "a system that has none"
    note.write()


@pytest.mark.parametrize("is_other_boot", [False, True])
def test_after_another_boot_a_robot_begins_nothing_before_others_were_asked(
    tmp_path: Path, records: CarriedRecords, monkeypatch: pytest.MonkeyPatch, boot_id: Path, *, is_other_boot: bool
) -> None:
    """The process was killed behind the sync of a token, and the clock says that it was away for a second."""
    world = Asked(monkeypatch)
    part = parts_of(PLAN, "run", "made", {}, "eva", adopt_after_s=60.0)[300]
    holder = Holder(300, records.note)
    holder.take_part(encode_part(part), 4.0)
    holder.take_token(encode_token(Token("run", part.plan_hash, 1, 0, 0), ()), 0, 4.0)
    BootNote(tmp_path).write()
    if is_other_boot:
        boot_id.write_text("two\n")
    cell = Cell("cell", tmp_path, records, CFG)
    side = cast("Any", cell.side)
    assert side._holder.in_doubt == ({"run"} if is_other_boot else set())
    if not is_other_boot:
        hear_all(cell)
    cell.go_on(0.5)
    assert [robot for robot, _ in world.asked] == (["hall"] if is_other_boot else ["a"]), "hall: for the epoch"
    again = Cell("cell", tmp_path, records, CFG)
    assert cast("Any", again.side)._holder.in_doubt == side._holder.in_doubt, "a doubt is written down"


def test_the_boot_is_noted_with_the_first_part(tmp_path: Path, boot_id: Path) -> None:
    made: list[CarriedRecords] = []

    def opened() -> CarriedRecords:
        made.append(CarriedRecords(tmp_path))
        return made[-1]

    cell = Cell("cell", tmp_path, cast("Any", None), CFG)
    side = cast("Any", cell.side)
    side._make_records, side._records = opened, None
    assert not (tmp_path / boot.BOOT_FILE).exists()
    side._take_part(encode_part(parts_of(PLAN, "run", "made", {}, "eva")[300]), cell.now)
    assert (tmp_path / boot.BOOT_FILE).read_text() == boot_id.read_text()
    made[0].close()
