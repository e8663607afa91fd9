"""`relays` of `fleet.yaml`: what is forwarded, under which keys, and what is refused before anything goes round."""

from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.config.load import load_content
from ua_fleet.config.relays import (
    directions_of,
    origins_on,
    relay_connections,
    relay_groups,
    relays_of_publishers,
    speakers_on,
)
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups, envelopes_of, groups_of, relay_envelopes
from ua_fleet.config.transports import client_id_of, connections_of, open_transport, relay_transports
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigInvalid
from ua_fleet.pubsub.origins import Direction, Origins
from ua_fleet.server.key_service.access import KeyAccess
from ua_fleet.topics import Topic

FLEET = """\
version: 1
pubsub:
  - {name: hall, security: sign_and_encrypt, url: "opc.udp://224.0.2.14:4840"}
  - {name: site, security: sign_and_encrypt, url: "mqtt://127.0.0.1:1883"}
  - {name: office, security: broker, encoding: json, url: "mqtt://127.0.0.1:1883", broker: {queue: "json/{topic}"}}
server: {connections: [site]}
bridges:
  cell: {kind: ros2, space: 2, status_id: 1, connections: [hall]}
  yard: {kind: ros2, space: 3, status_id: 2, connections: [site]}
robots:
  arm: {bridge: cell, data: {level: {id: 5, type: Double}}}
relays:
  gate:
    forwards:
      - {source: hall, target: site, origins: [cell]}
      - {source: site, target: hall, origins: [0, ua_3_2_7]}
  out:
    forwards:
      - {source: site, target: office, origins: [2, yard]}
      - {source: office, target: site, origins: [ua_77_2_3001]}
"""


def load(text: str = FLEET) -> FleetConfig:
    return load_content(text.encode(), "fleet.yaml", {})


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load(text)
    return [str(problem) for problem in caught.value.problems]


def test_directions_are_between_the_connections_of_a_relay() -> None:
    config = load()
    assert relay_connections(config, "gate") == (0, 1)
    assert relay_connections(config, "out") == (1, 2)
    assert directions_of(config, "gate") == [
        Direction(0, 1, Origins([2])),
        Direction(1, 0, Origins([0], [Topic(3, 2, 7)])),
    ]
    assert directions_of(config, "out") == [
        Direction(0, 1, Origins([2, 3])),
        Direction(1, 0, Origins(sources=[Topic(77, 2, 3001)])),
    ]


def test_who_is_heard_by_a_relay_on_each_connection() -> None:
    config = load()
    assert origins_on(config, 0) == Origins([0], [Topic(3, 2, 7)])
    assert speakers_on(config, 1) == {"gate": Origins([2]), "out": Origins(sources=[Topic(77, 2, 3001)])}
    assert relays_of_publishers(config, 1) == {2: "r-gate", 77: "r-out"}
    assert relays_of_publishers(config, 2) == {2: "r-out", 3: "r-out"}


def test_a_relay_has_the_keys_of_what_it_forwards_and_no_commands() -> None:
    config = load()
    assert relay_groups(config, "gate") == ("r-gate", "t-2", "t-0", "t-3")
    assert relay_groups(config, "out") == ("r-out", "r-gate", "t-3")  # space 2 comes to the site by another relay
    assert all_groups(config) == ("t-0", "t-2", "c-2", "t-3", "c-3", "r-gate", "r-out")
    assert groups_of(config, 0) == ("t-0", "t-2", "t-3", "c-2", "c-3", "r-gate", "r-out")
    assert groups_of(config, 2) == ("t-2", "t-0", "t-3", "c-2", "r-gate")
    access = KeyAccess(config)
    assert access.bridge_may("gate", "t-2")
    assert access.bridge_may("gate", "r-gate")
    assert not access.bridge_may("gate", "c-2")
    assert not access.bridge_may("gate", "r-out")
    assert access.bridge_may("out", "r-gate")
    assert access.bridge_may("yard", "r-gate")
    assert not access.bridge_may("cell", "r-out")
    assert access.space_may(0, "r-gate")


def test_each_process_wants_the_relays_keys_in_place_of_the_origins_where_it_hears_them(tmp_path: Path) -> None:
    config = load()
    [served] = envelopes_of(config, 0, Counters(), tmp_path / "server")
    assert served.groups_wanted() == ["t-0", "r-gate", "r-out", "t-3", "c-3"]
    hall, site = relay_envelopes(config, "gate", Counters(), tmp_path / "gate")
    assert hall.groups_wanted() == ["r-gate", "t-2", "t-0", "t-3"]
    assert site.groups_wanted() == ["r-gate", "r-out", "t-2", "t-0", "t-3"]


def test_connections_take_what_relays_bring_and_nothing_more(tmp_path: Path) -> None:
    config = load()
    [only] = connections_of(config, 0, Counters(), tmp_path, open_transport(config, tmp_path, space=0, number=1)).all
    assert only.barred == {2}
    assert only.relayed == Origins([2], [Topic(77, 2, 3001)])


def test_the_client_id_at_a_broker_has_the_group_of_the_relay(tmp_path: Path) -> None:
    config = load()
    assert client_id_of(config, "r-gate", 1) == "ua-fleet-Fleet-r-gate-site"
    assert len(relay_transports(config, tmp_path, "out")) == 2


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("target: site, origins: [cell]", "target: seite, origins: [cell]", "there is no connection `seite`"),
        ("origins: [cell]", "origins: [zelle]", "relays.gate.forwards[0].origins[0]: there is no bridge `zelle`"),
        ("origins: [cell]", "origins: [240]", "`240` is no origin: space ids 233..255 are reserved"),
        ("origins: [cell]", "origins: [ua_2_2_0]", "`ua_2_2_0` is no origin: a identifier is 1..65535"),
        ("origins: [cell]", "origins: []", "relays.gate.forwards[0].origins"),
        ("origins: [cell]", "origins: [70000]", "relays.gate.forwards[0].origins[0]"),
        ("source: hall, target: site", "source: site, target: site", "leads back to where it comes from"),
        ("origins: [cell]", "origins: [yard]", "the bridge of space 3 is on site itself, where no relay speaks for it"),
        ("origins: [0,", "origins: [2,", "the bridge of space 2 is on hall itself"),
        (
            "target: hall, origins: [0",
            "target: office, origins: [0",
            "relay out brings space 3 from site to office, too",
        ),
        (
            "source: hall, target: site, origins: [cell]",
            "source: office, target: hall, origins: [cell, ua_3_2_9]",
            "relays.gate.forwards[0].origins[0]: office is JSON, which is not signed, so only single sources",
        ),
        ("origins: [2, yard]", "origins: [2, yard, 9]", "space 9 is no bridge's, so that the key service has no keys"),
        ("relays:\n  gate:", "relays:\n  cell:", "relays.cell: `cell` is the name of a bridge, too"),
        ("  gate:", f"  {'g' * 62}:", "the name of a relay has at most 61 characters"),
        ("relays:\n", "relays:\n  idle: {forwards: []}\n", "relays.idle.forwards"),
        ("relays:\n", "relays:\n  idle: {}\n", "relays.idle.forwards: `forwards` is missing"),
        (
            "      - {source: hall, target: site, origins: [cell]}\n",
            "",
            "bridges.cell.connections: the server is on `site` alone, so that it never hears this bridge",
        ),
        (
            "level: {id: 5, type: Double}}}",
            "level: {id: 5, type: Double}}, skill_status_id: 6, skills: {go: {via: {action: /go, type: a_msgs/Go}}}}",
            "robots.arm.skills: the server hears bridge cell by a relay alone, which forwards no commands",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_place(old: str, new: str, expected: str) -> None:
    assert old in FLEET
    found = problems(FLEET.replace(old, new, 1))
    assert any(expected in problem for problem in found), found


TEXTS = """\
sources:
  press: {publisher_id: Press 7, data_set_writer_id: 3, robot: arm, data: force}
  saw: {publisher_id: 78, data_set_writer_id: 3, robot: arm, data: depth}
"""


@pytest.mark.parametrize(
    ("origin", "expected"),
    [
        (
            "Press 7",
            "the PublisherId of `sources.press` is a text, and a relay knows publishers by their numbers; give",
        ),
        ("press", "the PublisherId of `sources.press` is a text, and a relay knows publishers by their numbers"),
        ("saw", "`saw` is in `sources`, and publishers are listed by their numbers; write 78"),
        ("Cell 1", "`Cell 1` is a PublisherId, and bridges are listed by their names; write `cell`"),
    ],
)
def test_an_origin_that_is_named_by_another_text_is_told_with_its_place(origin: str, expected: str) -> None:
    text = FLEET.replace("origins: [cell]", f"origins: [{origin}]", 1)
    text = text.replace("{kind: ros2, space: 2,", "{kind: ros2, space: 2, publisher_id: Cell 1,")
    text = text.replace("level: {id: 5, type: Double}", "force: {id: 5, type: Double}, depth: {id: 6, type: Double}")
    [found] = [each for each in problems(text + TEXTS) if "relays.gate.forwards[0]" in each]
    assert found.startswith(f"fleet.yaml:15:relays.gate.forwards[0].origins[0]: {expected}")


RING = """\
version: 1
pubsub:
  - {name: a, security: none, url: "opc.udp://224.0.2.14:4840"}
  - {name: b, security: none, url: "opc.udp://224.0.2.14:4841"}
  - {name: c, security: none, url: "opc.udp://224.0.2.14:4842"}
relays:
  one: {forwards: [{source: a, target: b, origins: [77]}]}
  two: {forwards: [{source: b, target: c, origins: [77]}]}
"""


def test_a_chain_of_relays_is_no_ring() -> None:
    config = load(RING)
    assert [speakers_on(config, number) for number in range(3)] == [
        {},
        {"one": Origins([77])},
        {"two": Origins([77])},
    ]


@pytest.mark.parametrize(
    "back", ["{source: c, target: a, origins: [77]}", "{source: b, target: a, origins: [ua_77_2_1]}"]
)
def test_a_ring_of_relays_is_refused(back: str) -> None:
    found = problems(f"{RING}  back: {{forwards: [{back}]}}\n")
    assert any("space 77 would go round by" in problem for problem in found), found


def test_relays_without_a_list_of_connections_are_refused() -> None:
    [problem] = problems(
        "version: 1\npubsub: {security: none}\nrelays: {gate: {forwards: [{source: a, target: b, origins: [2]}]}}\n"
    )
    assert "relays.gate: `pubsub` is no list of connections" in problem


def test_a_relay_between_two_unsecured_connections_needs_no_keys() -> None:
    config = load(RING)
    assert relay_groups(config, "one") == ("r-one",)
