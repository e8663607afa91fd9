"""A bridge that asks another one for the epoch of a run, over messages that both decode."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from tests.unit.carrier.test_side import Bridge
from tests.unit.carrying.test_adoption import second_epoch, three
from ua_fleet.carrying import Holder, Token, encode_part, encode_token
from ua_fleet.carrying.facts import CarryFact
from ua_fleet.pubsub.events import ActionReceived
from ua_fleet.storage.carried_records import CarriedRecords


def bring(source: Bridge, target: Bridge) -> None:
    """Bring all that one bridge has sent to another one."""
    sent, source.sent[:] = list(source.sent), []
    for datagram in sent:
        for event in target.subscriber.receive(datagram, target.now, ("", 0)):
            if isinstance(event, ActionReceived):
                target.side.receive(event, target.now)
            else:
                target.side.hear(event, target.now)


def journaled(folder: Path, facts: list[CarryFact]) -> CarriedRecords:
    folder.mkdir()
    records = CarriedRecords(folder)
    for fact in facts:
        records.note(fact)
    return records


def test_a_bridge_asks_now_and_then_until_its_part_of_the_new_epoch_comes(tmp_path: Path) -> None:
    behind, heir = list[CarryFact](), list[CarryFact]()
    late, other = Holder(301, behind.append), Holder(300, heir.append)
    late.take_part(encode_part(three()[301]), -100.0)
    late.take_token(encode_token(Token("run", three()[301].plan_hash, 1, 1, 0), ()), 300, -100.0)
    other.take_part(encode_part(three()[300]), 4.0)
    other.take_adoption(second_epoch(300), 4.5)
    with journaled(tmp_path / "hall", behind) as of_hall, journaled(tmp_path / "cell", heir) as of_cell:
        hall, cell = Bridge("hall", tmp_path / "hall", of_hall), Bridge("cell", tmp_path / "cell", of_cell)
        asked = 0
        for _ in range(300):
            bring(cell, hall)
            asked += hall.requests()
            bring(hall, cell)
            hall.go_on(0.1)
            cell.go_on(0.1)
        side = cast("Any", hall.side)
        assert side._holder.in_doubt == {"run"}
        reasons = [one.reason for one in side._outbox._unsaid.values()]
        assert "the bridge of space 300 has epoch 2, and this one 1 still" in reasons
        assert 5 <= asked <= 25, "about ten questions in 30 s, each said once or twice"
        side._take_adoption(second_epoch(301), hall.now)
        hall.go_on(0.1)
        assert not side._holder.in_doubt
        assert not side._outbox.waits()
