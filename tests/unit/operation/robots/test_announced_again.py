"""What is announced and cannot be taken is looked at again, and costs nobody else a place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import structlog

from tests.unit.operation.robots.test_roster import ANNOUNCED, ARM, STATUS, Server
from ua_fleet.errors import StorageUnavailable
from ua_fleet.fleet.model import RobotOrigin
from ua_fleet.operation.robots.waiting import MOST_AT_ONCE, WaitingAnnouncements
from ua_fleet.topics import Topic

OTHER_ARM = json.dumps({"skill_status_id": 1610, "skills": {"turn": {"id": 1611}}})
RENAMED = json.dumps({"robots": {"left_arm": ARM}})
TAKEN = {"arm": RobotOrigin.ANNOUNCED}


@pytest.fixture
def server(tmp_path: Path) -> Server:
    return Server(tmp_path)


def no_space(*_: Any, **__: Any) -> None:
    raise StorageUnavailable("robots.db: no space left on device; free some")


def test_after_a_full_disk_it_is_taken(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    with structlog.testing.capture_logs() as logs, monkeypatch.context() as full:
        full.setattr(server.registry, "put", no_space)
        server.roster.announced(STATUS, ANNOUNCED)
        server.roster.announced(STATUS, ANNOUNCED)
        server.roster.tick()
        server.roster.tick()
    assert [log["event"] for log in logs] == ["a robot that is announced gets no nodes"], "once for each reason"
    server.roster.tick()
    assert server.names() == TAKEN


def test_a_full_disk_takes_no_robot_that_gets_another_name(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    with monkeypatch.context() as full:
        full.setattr(server.registry, "put", no_space)
        server.roster.announced(STATUS, RENAMED)
        assert server.names() == TAKEN
    server.roster.tick()
    assert server.names() == {"left_arm": RobotOrigin.ANNOUNCED}
    assert [robot.name for robot in server.registry.robots()] == ["left_arm"]


def test_the_name_of_another_is_taken_once_that_is_gone(server: Server) -> None:
    server.register(OTHER_ARM)
    with structlog.testing.capture_logs() as logs:
        server.roster.announced(STATUS, ANNOUNCED)
        server.roster.tick()
    assert [log["reason"] for log in logs] == ["there is another robot arm; give one of them another name"]
    server.roster.unregister("arm", "eva")
    server.roster.tick()
    assert server.names() == TAKEN


def test_a_bridge_that_is_gone_makes_no_robot_until_it_is_back(server: Server) -> None:
    server.register(OTHER_ARM)
    server.roster.announced(STATUS, ANNOUNCED)
    server.parts.silent = {STATUS}
    server.roster.unregister("arm", "eva")
    server.roster.tick()
    assert server.names() == {}
    server.parts.silent = set()
    server.roster.tick()
    assert server.names() == TAKEN


def test_what_waits_goes_with_its_robot(server: Server) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    server.parts.users = ["skill turn is under way"]
    server.roster.announced(STATUS, RENAMED)
    server.parts.users = []
    server.roster.unregister("arm", "eva")
    server.roster.tick()
    assert server.names() == {}


def test_what_is_announced_as_before_waits_no_longer(server: Server) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    server.parts.users = ["skill turn is under way"]
    server.roster.announced(STATUS, RENAMED)
    server.roster.announced(STATUS, ANNOUNCED)
    server.parts.users = []
    server.roster.tick()
    assert server.names() == TAKEN


def test_those_that_get_no_nodes_take_no_place(tmp_path: Path) -> None:
    server = Server(tmp_path, most=9)
    for number in range(20):
        server.roster.announced(Topic(2, 2, 2000 + number), "no definition")
    server.roster.announced(STATUS, ANNOUNCED)
    assert server.names() == TAKEN


def test_a_place_that_becomes_free_is_taken(tmp_path: Path) -> None:
    server = Server(tmp_path, most=1)
    server.roster.announced(STATUS, ANNOUNCED)
    second = json.dumps({"robots": {"second": {"skill_status_id": 1600, "skills": {"turn": {"id": 1601}}}}})
    server.roster.announced(Topic(3, 2, 1600), second)
    server.roster.tick()
    assert server.names() == TAKEN
    server.roster.unregister("arm", "eva")
    server.roster.tick()
    assert server.names() == {"second": RobotOrigin.ANNOUNCED}


def test_what_waits_is_bounded_and_looked_at_in_turns() -> None:
    waiting = WaitingAnnouncements(20)
    topics = [Topic(2, 2, 2000 + number) for number in range(21)]
    silent = set[Topic]()

    def is_heard(topic: Topic) -> bool:
        return topic not in silent

    kept = [waiting.put(topic, "text", "why", is_known=False, is_heard=is_heard) for topic in topics]
    assert (kept.count(True), len(waiting)) == (20, 20)
    assert waiting.put(topics[20], "text", "in use", is_known=True, is_heard=is_heard), "its robot has a place"
    waiting.discard(topics[20])
    looked_at: list[Topic] = []
    for _ in range(3):
        due = waiting.due((), is_heard)
        assert len(due) == MOST_AT_ONCE
        for topic, text in due:
            looked_at.append(topic)
            waiting.put(topic, text, "why", is_known=False, is_heard=is_heard)
    assert looked_at[:20] == topics[:20]
    silent.add(topics[5])
    assert waiting.put(topics[20], "text", "why", is_known=False, is_heard=is_heard)
    assert not waiting.waits(topics[5], "text")
