"""Summaries of robots as a client reads them: structures by their definitions, and what is new of a group."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asyncua import ua

from ua_fleet.client import RobotSummary
from ua_fleet.client.convert import plain_value
from ua_fleet.client.structures import layout_of
from ua_fleet.client.summaries import _Known, _summary  # pyright: ignore[reportPrivateUsage]
from ua_fleet.errors import RemoteWireError
from ua_fleet.fleet import summaries as server
from ua_fleet.nodes.summary_nodes import SUMMARY_SHAPE
from ua_fleet.values import StatusCode, ticks_from_datetime

ENCODING = ua.NodeId(ua.Int32(5002), ua.Int16(3))
STATES = ua.NodeId(ua.Int32(3001), ua.Int16(3))
ELSEWHERE = ua.NodeId(ua.Int32(7), ua.Int16(9))
NOON = datetime(2026, 11, 23, 12, tzinfo=UTC)

FIELDS: tuple[tuple[str, int | ua.NodeId, int], ...] = (
    ("Name", 12, -1),
    ("State", STATES, -1),
    ("StateSince", 294, -1),
    ("Quality", 19, -1),
    ("LastUpdate", 294, -1),
    ("Task", 12, -1),
    ("RunId", 12, -1),
    ("Held", 1, -1),
    ("HeldBy", 12, -1),
    ("HeldSince", 294, -1),
    ("HeldReason", 12, -1),
    ("Faults", 7, -1),
    ("Fault", 12, -1),
    ("Bridge", 12, -1),
    ("Capacities", 12, 1),
)
ROVER = server.SummaryRecord(
    "rover",
    2,
    ticks_from_datetime(NOON),
    int(StatusCode.BAD_NO_COMMUNICATION),
    ticks_from_datetime(NOON - timedelta(seconds=5)),
    "fetch",
    "r1",
    True,
    "anna",
    ticks_from_datetime(NOON),
    "tyre",
    1,
    "it is silent",
    "floor",
    ("lift", "mobile"),
)


def definition(*fields: tuple[str, int | ua.NodeId, int]) -> ua.StructureDefinition:
    made = ua.StructureDefinition(DefaultEncodingId=ENCODING)
    for name, kind, rank in fields:
        data_type = kind if isinstance(kind, ua.NodeId) else ua.NodeId(ua.Int32(kind))
        made.Fields.append(ua.StructureField(Name=ua.String(name), DataType=data_type, ValueRank=ua.Int32(rank)))
    return made


def encoded(summary: server.SummaryRecord) -> ua.ExtensionObject:
    body = bytearray()
    SUMMARY_SHAPE.encode(body, summary)
    return ua.ExtensionObject(ENCODING, ua.ByteString(bytes(body)))


def test_what_the_server_encodes_is_read_by_its_definition() -> None:
    told = layout_of(definition(*FIELDS), {STATES}).read(encoded(ROVER))
    assert told is not None
    assert _summary(told, NOON) == RobotSummary(
        name="rover",
        state="busy",
        state_since=NOON,
        status=StatusCode.BAD_NO_COMMUNICATION,
        last_update=NOON - timedelta(seconds=5),
        task="fetch",
        run_id="r1",
        held=True,
        held_by="anna",
        held_since=NOON,
        held_reason="tyre",
        faults=1,
        fault="it is silent",
        bridge="floor",
        capacities=("lift", "mobile"),
    )


def test_times_that_are_null_are_none_and_ages_are_by_the_servers_clock() -> None:
    told = layout_of(definition(*FIELDS), {STATES}).read(encoded(ROVER._replace(last_update=0)))
    assert told is not None
    never, since = _summary(told, NOON), RobotSummary("a", last_update=NOON - timedelta(seconds=5), told=NOON)
    assert (never.last_update, never.age_s()) == (None, None)
    assert (since.age_s(), since.age_s(NOON + timedelta(seconds=1))) == (5.0, 6.0)
    assert since.age_s(NOON - timedelta(hours=1)) == 0.0
    assert (since.is_good, RobotSummary("a", status=0x8031_0000).status_text) == (True, "BadNoCommunication")


def test_a_server_of_another_version_is_read_as_far_as_both_know() -> None:
    newer = definition(*FIELDS[:2], ("Colour", 12, -1), *FIELDS[2:4], ("Place", ELSEWHERE, -1), *FIELDS[4:])
    body = bytearray()
    for value in (b"rover", b"red"):
        body += len(value).to_bytes(4, "little") + value
        if value == b"rover":
            body += (1).to_bytes(4, "little")
    body += bytes(8) + bytes(4) + b"what nobody here can read"
    told = layout_of(newer, {STATES}).read(ua.ExtensionObject(ENCODING, ua.ByteString(bytes(body))))
    assert told is not None
    assert told == {"Name": "rover", "State": 1, "Colour": "red", "StateSince": None, "Quality": 0}
    assert _summary(told, None) == RobotSummary("rover", "idle")
    # What it does not say of the quality is not good.
    assert not _summary({"Name": "old"}, None).is_good


def test_other_values_are_none_and_broken_ones_an_error() -> None:
    layout = layout_of(definition(*FIELDS), {STATES})
    assert layout.read(ua.ExtensionObject(ELSEWHERE, ua.ByteString(b"abc"))) is None
    assert layout.read(ua.ExtensionObject()) is None
    assert layout.read(None) is None
    assert layout.read(5) is None
    with pytest.raises(RemoteWireError):
        layout.read(ua.ExtensionObject(ENCODING, ua.ByteString(b"abc")))


def test_for_people_statuscodes_have_names_and_what_cannot_be_read_stays() -> None:
    layout = layout_of(definition(*FIELDS), {STATES})
    shown = plain_value(layout.shown(encoded(ROVER)))
    assert (shown["Quality"], shown["StateSince"], shown["Faults"]) == ("BadNoCommunication", NOON.isoformat(), 1)
    broken = ua.ExtensionObject(ENCODING, ua.ByteString(b"abc"))
    assert layout.shown(broken) is broken
    other = ua.ExtensionObject(ELSEWHERE, ua.ByteString(b"abc"))
    assert layout.shown(other) is other


def told(known: _Known, group: int, *robots: RobotSummary) -> tuple[list[str], list[str]]:
    number: Any = group
    changed, gone = known.take(ua.NodeId(number), robots)
    return [robot.name for robot in changed], gone


def test_only_what_has_changed_is_told() -> None:
    known = _Known()
    assert told(known, 1, RobotSummary("a"), RobotSummary("b")) == (["a", "b"], [])
    assert told(known, 1, RobotSummary("a", task="fetch"), RobotSummary("b", told=NOON)) == (["a"], [])
    assert told(known, 1, RobotSummary("b")) == ([], ["a"])
    assert known.count() == 1


def test_a_robot_that_has_moved_to_another_group_is_not_gone() -> None:
    known = _Known()
    told(known, 1, RobotSummary("a"), RobotSummary("b"))
    assert told(known, 2, RobotSummary("a")) == (["a"], [])
    assert told(known, 1, RobotSummary("b")) == ([], [])
    assert told(known, 2) == ([], ["a"])
    # In the other order it is gone for a moment.
    assert told(known, 1) == ([], ["b"])
    assert told(known, 2, RobotSummary("b")) == (["b"], [])


def test_a_robot_that_was_gone_before_its_old_group_was_told() -> None:
    known = _Known()
    told(known, 1, RobotSummary("a"))
    told(known, 2, RobotSummary("a"))
    assert told(known, 2) == ([], ["a"])
    assert told(known, 1) == ([], [])
