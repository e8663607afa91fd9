"""How a fleet stands, on one screen."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from ua_fleet.cli.status_text import problems_of, status_json, status_lines
from ua_fleet.cli.table import width_of
from ua_fleet.client import (
    BridgeStatus,
    FaultStatus,
    FleetStatus,
    NamespaceStatus,
    OpenDecision,
    RobotStatus,
    RunStatus,
    ServerStatus,
)
from ua_fleet.counters import Drop
from ua_fleet.drop_meanings import drop_meanings, is_loss

NOON = datetime(2030, 1, 31, 12, tzinfo=UTC)
SERVER = ServerStatus(
    "opc.tcp://hall:4840", "Hall", "1.0", "Running", NOON - timedelta(hours=2), NOON, NOON + timedelta(days=400)
)
FLOOR = BridgeStatus("floor", "ros2", 2, True, NOON - timedelta(minutes=5), True, "domain 2", {"repeated": 7})
ROVER = RobotStatus("rover", "idle", NOON, {"Good": 12}, 87.5, "%")
FINE = FleetStatus(SERVER, (FLOOR,), (ROVER,), (), (), (), {"loop": 3})
FAULT = FaultStatus("rover.skill", "rover", "skill", "drive did not end", True, False, NOON)


def changed(**parts: Any) -> FleetStatus:
    return replace(FINE, **parts)


def shown(status: FleetStatus, **options: Any) -> list[str]:
    return status_lines(status, NOON, zone=UTC, **options)


def test_what_the_terminal_has_no_room_for_is_said_of_the_server_in_a_second_line() -> None:
    assert shown(FINE, width=75)[:3] == [
        "server  Hall  opc.tcp://hall:4840",
        "        ua_fleet 1.0  Running for 2 h  certificate until 2031-03-07",
        "nothing is wrong",
    ]


def test_a_fleet_that_is_well() -> None:
    assert problems_of(FINE, NOON) == []
    assert shown(FINE) == [
        "server  Hall  opc.tcp://hall:4840  ua_fleet 1.0  Running for 2 h  certificate until 2031-03-07",
        "nothing is wrong",
        "",
        "bridges  1 of 1 heard",
        "  bridge  kind  space             since     detail",
        "  floor   ros2  2      connected  11:55:00  domain 2",
        "",
        "robots  1: 1 idle",
        "  robot  state  since     values   battery  does",
        "  rover  idle   12:00:00  12 Good  87.5 %",
        "",
        "faults  0 active",
        "",
        "runs  0 under way",
        "",
        "drops  messages dropped since each process started",
        "  as it should be: repeated 7, loop 3",
    ]


WRONG: Mapping[str, tuple[FleetStatus, str, str]] = {
    "server": (changed(server=replace(SERVER, state="Shutdown")), "the server is Shutdown", ""),
    "soon": (
        changed(server=replace(SERVER, certificate_until=NOON + timedelta(days=29))),
        "the server's certificate expires on 2030-03-01",
        "ua-fleet cert create --help",
    ),
    "expired": (
        changed(server=replace(SERVER, certificate_until=NOON - timedelta(days=1))),
        "the server's certificate has expired on 2030-01-30",
        "ua-fleet cert create --help",
    ),
    "bridge": (changed(bridges=(replace(FLOOR, online=False),)), "bridge floor is not heard", "ua-fleet bridge floor"),
    "space": (
        changed(bridges=(replace(FLOOR, connected=False, detail="no ROS master"),)),
        "bridge floor is not connected: no ROS master",
        "",
    ),
    "robot": (changed(robots=(replace(ROVER, state="offline"),)), "rover is offline", "ua-fleet read rover"),
    "fault": (
        changed(robots=(replace(ROVER, state="faulted"),), faults=(FAULT,)),
        "rover.skill: drive did not end",
        "ua-fleet fault clear rover.skill",
    ),
    "silent": (changed(faults=(replace(FAULT, source="silent"),)), "rover.skill: drive did not end", ""),
    "decision": (
        changed(decisions=(OpenDecision("r.0", "fetch", "rover", "it is silent"),)),
        "fetch waits for a robot: it is silent",
        "ua-fleet decision confirm r.0 ROBOT",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_each_thing_that_is_wrong_is_told_once_with_the_next_command(name: str) -> None:
    status, text, remedy = WRONG[name]
    assert [(one.text, one.remedy) for one in problems_of(status, NOON)] == [(text, remedy)]
    lines = shown(status)
    assert lines[1] == "1 wrong"
    assert lines[2] == f"  {text}  {remedy}".rstrip()


def test_what_is_not_wrong() -> None:
    over = replace(FAULT, active=False)
    run = RunStatus("r1", "round", "running", NOON, "", (("out", "rover", "accepted"), ("back", "", "done")))
    busy = replace(
        ROVER, state="busy", values={"Good": 1, "BadNoCommunication": 2}, tasks=("out of r1",), held_by="anna"
    )
    status = changed(faults=(over,), runs=(run,), robots=(busy,), drops={"inlet_full": 1200})
    assert problems_of(status, NOON) == []
    lines = shown(status)
    assert "faults  0 active, 1 over and not acknowledged" in lines
    assert any(line.endswith("ua-fleet fault ack rover.skill") for line in lines)
    assert "  r1  round  running since 12:00:00" in lines
    assert "    out  rover  accepted" in lines
    assert "  rover  busy   12:00:00  2 of 3 BadNoCommunication  87.5 %   out of r1, held by anna" in lines
    (drop,) = [line for line in lines if "inlet_full" in line]
    assert drop.startswith("  inlet_full  1,200     More messages than the bridge could hand on")
    assert drop.endswith("server 1,200")


def test_of_a_large_fleet_those_are_listed_that_are_not_idle() -> None:
    robots = tuple(RobotStatus(f"r{number}", "idle", NOON, None) for number in range(5000))
    status = changed(robots=(*robots, replace(ROVER, state="offline", values=None)))
    lines = shown(status)
    assert "robots  5,001: 5,000 idle, 1 offline" in lines
    assert "  5,000 more robots; --all lists them" in lines
    assert len(lines) < 30
    assert len(shown(status, all_robots=True)) > 5000


def test_of_robots_whose_values_nobody_has_read_the_worst_is_shown() -> None:
    unread = replace(ROVER, values=None, battery=None)
    told = ("Good", "UncertainLastUsableValue", "BadNoCommunication", "BadWaitingForInitialData", "")
    robots = tuple(replace(unread, name=f"r{number}", quality=quality) for number, quality in enumerate(told))
    lines = shown(changed(robots=robots))
    found = [line.split("12:00:00", 1)[1].strip() for line in lines if line.startswith("  r") and "idle" in line]
    assert found == ["Good", "UncertainLastUsableValue", "BadNoCommunication", "none came", "not read"]


def test_no_line_is_wider_than_the_terminal_and_nothing_reaches_it_that_it_obeys() -> None:
    evil = replace(ROVER, name="r\x1b[2J" * 20, state="offline")
    status = changed(robots=(evil,), faults=(replace(FAULT, reason="x" * 300),), drops={"no_metadata": 4})
    lines = shown(status, width=100)
    assert max(map(width_of, lines)) <= 100
    assert not any("\x1b" in line for line in lines)
    assert any("\x1b[31m" in line for line in shown(status, colours=True))


def test_the_unified_namespace_where_there_is_one() -> None:
    namespace = NamespaceStatus(True, "mqtts://broker:8883", 1200, 34567, {"broker_away": 5, "rate_limited": 9})
    lines = shown(changed(namespace=namespace))
    assert problems_of(changed(namespace=namespace), NOON) == []
    assert "Unified Namespace  mqtts://broker:8883  1,200 topics, 34,567 messages published" in lines
    (drop,) = [line for line in lines if "broker_away" in line]
    assert drop.endswith("Unified Namespace 5")
    assert "  as it should be: rate_limited 9, repeated 7, loop 3" in lines
    away = changed(namespace=replace(namespace, connected=False, detail="mqtt://b: \x1b[2J no route"))
    assert [one.text for one in problems_of(away, NOON)] == [
        "the Unified Namespace is not published: mqtt://b: \x1b[2J no route"
    ]
    assert "Unified Namespace  not connected  1,200 topics, 34,567 messages published" in shown(away)
    assert not any("\x1b" in line for line in shown(away))
    assert status_json(away, [])["namespace"]["published"] == 34567


def test_each_cause_of_a_drop_has_a_meaning() -> None:
    assert drop_meanings().keys() == {drop.value for drop in Drop}
    assert drop_meanings()["replayed"] == "A nonce that was used before or is too old for the replay window."
    assert [cause for cause in ("loop", "unmapped", "rate_limited", "inlet_full") if is_loss(cause)] == ["inlet_full"]


def test_programs_have_json_also_where_a_number_is_none() -> None:
    shown = status_json(changed(robots=(replace(ROVER, battery=float("nan")),)), [])
    assert shown["robots"][0]["battery"] == "nan"
    assert shown["server"]["started"] == "2030-01-31T10:00:00+00:00"
    json.dumps(shown, allow_nan=False)
