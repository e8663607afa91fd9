"""Which robots there are: registered, announced, changed and gone, and what must not happen."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import structlog

from tests.unit.fleet.fleet_of import fleet_config
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.registration import RobotText, announced_robots, definition_text
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import AccessRefused, ConfigInvalid
from ua_fleet.fleet.model import RobotModel, RobotOrigin
from ua_fleet.operation.robots.roster import RobotFixed, RobotInUse, RobotRegistry, RobotUnknown
from ua_fleet.storage.registry import Registry
from ua_fleet.topics import Topic

ARM: Mapping[str, Any] = {
    "capacities": ["grab"],
    "skill_status_id": 1510,
    "skills": {"turn": {"id": 1511, "needs": ["grab"]}},
}
TEXT = json.dumps(ARM)
ANNOUNCED = json.dumps({"robots": {"arm": ARM}})
STATUS = Topic(2, 2, 1510)
"""The fleet's bridge stands in space 2."""


class Parts:
    """The rest of a server."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []
        self.users: list[str] = []
        self.told: list[str] = []
        self.heard = False
        self.silent: set[Topic] = set()
        self.strangers: dict[int, Topic] = {}

    def take_in(self, robot: RobotModel) -> None:
        self.events.append(("in", robot.name))

    def let_go(self, robot: RobotModel, *, is_replaced: bool) -> None:
        self.events.append(("changed" if is_replaced else "out", robot.name))

    def users_of(self, robot: RobotModel) -> list[str]:
        return self.users

    def told_of(self, robot: RobotModel) -> list[str]:
        return self.told

    def is_heard(self, robot: RobotModel) -> bool:
        return self.heard

    def hears(self, topic: Topic) -> bool:
        return topic not in self.silent

    def stranger(self, ns: int, identifier: int) -> Topic | None:
        return self.strangers.get(identifier)


class Server:
    def __init__(
        self, folder: Path, policy: str = "create", robots: Mapping[str, Any] | None = None, most: int = 9
    ) -> None:
        raw = fleet_config(robots or {}).model_dump(mode="json")
        raw["server"] |= {"unknown_sources": policy, "max_discovered_sources": most}
        self.config = FleetConfig.model_validate(raw)
        self.registry = Registry(folder / "robots.db")
        self.parts = Parts()
        self.roster = RobotRegistry(
            self.config, fleet_model(self.config), self.registry, lambda: 5.0, structlog.get_logger()
        )
        self.restored = [robot.name for robot in self.roster.restore().robots]
        self.roster.connect(self.parts)

    def register(self, text: str = TEXT, name: str = "arm", bridge: str = "mobile") -> RobotModel:
        return self.roster.register(RobotText(name, bridge, text=text), "eva")

    def names(self) -> dict[str, RobotOrigin]:
        return {robot.name: robot.origin for robot in self.roster}


@pytest.fixture
def server(tmp_path: Path) -> Server:
    return Server(tmp_path)


def test_a_registered_robot_is_there_again_after_a_restart(server: Server, tmp_path: Path) -> None:
    model = server.register()
    assert (model.origin, server.parts.events) == (RobotOrigin.REGISTERED, [("in", "arm")])
    assert server.register() == model
    assert server.parts.events == [("in", "arm")]
    server.registry.close()
    again = Server(tmp_path)
    assert again.restored == ["arm"]
    assert again.roster.find("arm") == model
    again.roster.unregister("arm", "eva")
    assert again.parts.events == [("out", "arm")]
    again.registry.close()
    assert Server(tmp_path).restored == []


def test_one_of_the_file_goes_before(server: Server, tmp_path: Path) -> None:
    server.register()
    server.registry.close()
    again = Server(tmp_path, robots={"arm": {"bridge": "mobile"}})
    assert again.names() == {"arm": RobotOrigin.FILE}
    with pytest.raises(RobotFixed, match=r"stands in fleet\.yaml; change it there"):
        again.register()
    with pytest.raises(RobotFixed, match=r"stands in fleet\.yaml; remove it there"):
        again.roster.unregister("arm", "eva")
    again.roster.announced(STATUS, ANNOUNCED)
    assert again.names() == {"arm": RobotOrigin.FILE}


def test_one_that_does_not_fit_any_more_is_left_out_and_kept(server: Server, tmp_path: Path) -> None:
    server.register()
    server.registry.close()
    taken = {"other": {"bridge": "mobile", "data": {"x": {"id": 1511, "type": "Double"}}}}
    again = Server(tmp_path, robots=taken)
    assert again.restored == ["other"]
    again.registry.close()
    assert Server(tmp_path).restored == ["arm"]


def test_another_robot_of_that_name_is_refused(server: Server) -> None:
    server.register()
    with pytest.raises(RobotFixed, match="another robot arm, registered before"):
        server.register(json.dumps({"capacities": ["fly"]}))
    with pytest.raises(ConfigInvalid, match=r"1511 is in use already \(robots\.arm\)"):
        server.register(name="second")
    with pytest.raises(RobotUnknown):
        server.roster.unregister("third", "eva")


def test_a_robot_in_use_stays(server: Server) -> None:
    server.register()
    server.parts.users = ["run 7"]
    with pytest.raises(RobotInUse, match="robot arm is in use: run 7"):
        server.roster.unregister("arm", "eva")
    assert server.names() == {"arm": RobotOrigin.REGISTERED}


def test_an_announced_robot_is_the_same_as_a_registered_one(server: Server, tmp_path: Path) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    announced = server.roster.find("arm")
    server.roster.announced(STATUS, ANNOUNCED)
    assert server.parts.events == [("in", "arm")]
    server.parts.heard = True
    with pytest.raises(RobotFixed, match="announced by the bridge of space 2; stop that first"):
        server.roster.unregister("arm", "eva")
    server.registry.close()
    careful = Server(tmp_path, policy="quarantine")
    assert careful.restored == []
    careful.registry.close()
    again = Server(tmp_path)
    assert again.names() == {"arm": RobotOrigin.ANNOUNCED}
    again.roster.unregister("arm", "eva")
    registered = again.register()
    assert {registered.skills, registered.skill_status} == {announced.skills, announced.skill_status}
    again.roster.announced(STATUS, ANNOUNCED)
    assert again.names() == {"arm": RobotOrigin.REGISTERED}


def test_registering_an_announced_robot_makes_it_a_registered_one(server: Server) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    server.register()
    assert server.names() == {"arm": RobotOrigin.REGISTERED}
    assert server.parts.events == [("in", "arm"), ("changed", "arm"), ("in", "arm")]


def test_what_is_announced_anew_waits_until_the_robot_has_nothing_to_do(server: Server) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    server.parts.users = ["skill turn is under way"]
    renamed = json.dumps({"robots": {"left_arm": {**ARM, "capacities": ["grab", "lift"]}}})
    server.roster.announced(STATUS, renamed)
    server.roster.tick()
    assert server.names() == {"arm": RobotOrigin.ANNOUNCED}
    server.parts.users = []
    server.roster.tick()
    assert server.names() == {"left_arm": RobotOrigin.ANNOUNCED}
    assert server.roster.find("left_arm").capacities == ("grab", "lift")
    server.parts.events.clear()
    server.roster.tick()
    assert server.parts.events == []


def test_one_of_which_people_say_something_gets_another_definition_and_no_other_name(server: Server) -> None:
    server.roster.announced(STATUS, ANNOUNCED)
    server.parts.told = ["arm is held by anna"]
    server.parts.events.clear()
    server.roster.announced(STATUS, json.dumps({"robots": {"arm": {**ARM, "description": "newer"}}}))
    assert server.parts.events == [("changed", "arm"), ("in", "arm")]
    server.roster.announced(STATUS, json.dumps({"robots": {"left_arm": ARM}}))
    with structlog.testing.capture_logs() as logs:
        server.roster.tick()
        server.roster.tick()
    assert logs == [], "it was said before"
    assert server.names() == {"arm": RobotOrigin.ANNOUNCED}
    server.parts.told = []
    server.roster.tick()
    assert server.names() == {"left_arm": RobotOrigin.ANNOUNCED}


@pytest.mark.parametrize(
    ("topic", "text"),
    [
        (STATUS, "no JSON"),
        (STATUS, "[1]"),
        (STATUS, "[" * 30_000),
        (STATUS, '{"robots": {}}'),
        (STATUS, '{"robots": {"a": {}, "b": {}}}'),
        (STATUS, json.dumps({"robots": {"arm": {}}}) + " " * 70_000),
        (STATUS, '{"robots": {"arm": {"skills": {"turn": {"id": 5}}}}}'),
        (Topic(2, 2, 1599), ANNOUNCED),
        (STATUS, json.dumps({"robots": {"bad name": ARM}})),
    ],
)
def test_what_is_no_definition_makes_no_robot(server: Server, topic: Topic, text: str) -> None:
    server.roster.announced(topic, text)
    assert (server.names(), server.parts.events) == ({}, [])


def test_no_bridge_takes_the_robot_or_the_ids_of_another(server: Server) -> None:
    server.register()
    other = json.dumps({"robots": {"arm": {"skill_status_id": 1600, "skills": {"turn": {"id": 1601}}}}})
    server.roster.announced(Topic(3, 2, 1600), other)
    stolen = json.dumps({"robots": {"second": {"skill_status_id": 1600, "skills": {"turn": {"id": 1511}}}}})
    server.roster.announced(Topic(3, 2, 1600), stolen)
    server.parts.strangers = {1601: Topic(4, 2, 1601)}
    claimed = json.dumps({"robots": {"third": {"skill_status_id": 1600, "skills": {"turn": {"id": 1601}}}}})
    server.roster.announced(Topic(3, 2, 1600), claimed)
    assert server.names() == {"arm": RobotOrigin.REGISTERED}


@pytest.mark.parametrize("policy", ["quarantine", "ignore"])
def test_the_policy_decides(tmp_path: Path, policy: str) -> None:
    server = Server(tmp_path, policy)
    server.roster.announced(STATUS, ANNOUNCED)
    assert server.names() == {}


def test_no_more_are_taken_than_may_be(tmp_path: Path) -> None:
    server = Server(tmp_path, most=2)
    for number in range(4):
        robot = {"skill_status_id": 1600 + number, "skills": {"turn": {"id": 1700 + number}}}
        server.roster.announced(Topic(3, 2, 1600 + number), json.dumps({"robots": {f"r{number}": robot}}))
    assert set(server.names()) == {"r0", "r1"}


def test_what_a_bridge_says_is_what_the_server_takes(server: Server) -> None:
    theirs = fleet_config({"arm": {"bridge": "mobile", **ARM}})
    said = announced_robots(theirs, "mobile")
    assert said == {STATUS: definition_text("arm", theirs.robots["arm"])}
    server.roster.announced(STATUS, said[STATUS])
    assert server.names() == {"arm": RobotOrigin.ANNOUNCED}


def test_a_skill_of_clients_is_added_kept_and_changed_by_engineers_alone(server: Server, tmp_path: Path) -> None:
    with pytest.raises(AccessRefused, match="only an engineer may change that"):
        server.roster.offer("mechanic", "fix", "needs: [repair]", "oscar", may_change=False)
    first = server.roster.offer("mechanic", "fix", "needs: [repair]", "eva", may_change=True)
    assert first.capacities == ("repair",)
    second = server.roster.offer("mechanic", "look", "timeout_s: 5", "eva", may_change=True)
    assert next((skill.name, skill.id) for skill in second.skills) == ("fix", first.skills[0].id)
    assert server.roster.offer("mechanic", "look", "timeout_s: 5", "oscar", may_change=False) == second
    assert server.roster.offer("mechanic", "fix", "", "oscar", may_change=False) == second
    with pytest.raises(RobotUnknown, match="no skill 'dance' that clients do"):
        server.roster.offer("mechanic", "dance", "", "oscar", may_change=False)
    server.parts.users = ["run 7"]
    with pytest.raises(RobotInUse):
        server.roster.offer("mechanic", "look", "timeout_s: 6", "eva", may_change=True)
    server.registry.close()
    again = Server(tmp_path)
    assert again.roster.of_clients("mechanic", "look") == second
    server = again
    server.register()
    with pytest.raises(RobotFixed, match="one of a bridge"):
        server.roster.offer("arm", "fix", "timeout_s: 1", "eva", may_change=True)
    with pytest.raises(ConfigInvalid, match=r"definition:2:robots\.mechanic\.skills\.fix\.arguments\.x\.type"):
        server.roster.offer("mechanic", "fix", "arguments:\n  x: {type: Dbl}", "eva", may_change=True)
