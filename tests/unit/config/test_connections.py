"""`pubsub` as a list of connections, and who is on which of them."""

from __future__ import annotations

import json
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from ua_fleet.cli.endings import NotFound
from ua_fleet.cli.pubsub_connection import on_connection
from ua_fleet.config.applications import bridge_application
from ua_fleet.config.connections import action_routes, barred_on, connection_numbers, needs_keys, takes_actions
from ua_fleet.config.json_schema import fleet_schema
from ua_fleet.config.load import load_content, load_document
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.show import as_yaml, settings
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigInvalid
from ua_fleet.pubsub import Publisher, PubSubTiming
from ua_fleet.pubsub.application import MQTT_UADP, UDP_UADP
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ConnectionsAnnouncement, NetworkAddressUrl
from ua_fleet.wire.messages import Probe, ProbeKind

TWO = """\
version: 1
pubsub:
  - name: hall
    security: sign_and_encrypt
    url: opc.udp://224.0.2.14:4840
    keep_alive_s: 0.5
    keys: {source: files}
  - name: site
    security: sign_and_encrypt
    url: mqtt://127.0.0.1:1883
    broker: {user: "${BROKER_USER}"}
bridges:
  arm: {kind: ros2, space: 2, status_id: 1, connections: [hall, site]}
  cart: {kind: ros2, space: 3, status_id: 2}
  crane: {kind: ros2, space: 4, status_id: 3, connections: [site]}
"""
ENVIRONMENT = {"BROKER_USER": "peter"}


def load(text: str, **overrides: object) -> FleetConfig:
    return load_content(text.encode(), "fleet.yaml", ENVIRONMENT, overrides=overrides or None)


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load(text)
    return [str(problem) for problem in caught.value.problems]


def test_a_list_has_the_connections_in_its_order_and_what_holds_for_all_is_the_first_ones() -> None:
    config = load(TWO)
    assert [connection.name for connection in config.connections] == ["hall", "site"]
    assert config.pubsub is config.connections[0]
    assert [connection.keep_alive_s for connection in config.connections] == [0.5, 0.5]
    assert {connection.keys.source for connection in config.connections} == {"files"}
    assert [connection.is_brokered for connection in config.connections] == [False, True]
    assert config.is_secured


def test_one_connection_stays_what_it_was() -> None:
    config = load("version: 1\npubsub: {security: none}\nbridges: {arm: {kind: ros2, space: 2, status_id: 1}}\n")
    assert config.connections == (config.pubsub,)
    assert connection_numbers(config, 0) == connection_numbers(config, 2) == (0,)
    assert barred_on(config, 0) == frozenset()
    assert action_routes(config, 0) == {2: (0,)}


def test_a_bridge_is_on_the_first_connection_and_the_server_on_all_unless_they_say_otherwise() -> None:
    config = load(TWO)
    assert connection_numbers(config, 0) == (0, 1)
    assert connection_numbers(config, 2) == (0, 1)
    assert connection_numbers(config, 3) == (0,)
    assert connection_numbers(config, 4) == (1,)
    alone = load(TWO.replace("connections: [site]", "connections: [hall]") + "server: {connections: [hall]}\n")
    assert connection_numbers(alone, 0) == (0,)


def test_a_space_is_barred_where_its_process_is_not() -> None:
    config = load(TWO)
    assert barred_on(config, 0) == {4}
    assert barred_on(config, 1) == {3}


def test_actions_go_to_the_connections_of_their_bridge() -> None:
    config = load(TWO)
    assert action_routes(config, 0) == {2: (0, 1), 3: (0,), 4: (1,)}
    assert action_routes(config, 4) == {2: (0,), 3: (), 4: (0,)}


def test_actions_do_not_go_by_an_unsecured_connection_beside_a_secured_one() -> None:
    text = TWO.replace("    security: sign_and_encrypt\n    url: mqtt", "    security: none\n    url: mqtt")
    config = load(text)
    assert [needs_keys(config, space) for space in (0, 2, 3, 4)] == [True, True, True, False]
    assert not takes_actions(config, 0, 1)
    assert not takes_actions(config, 2, 1)
    assert takes_actions(config, 4, 1)  # it has no other one, ...
    assert action_routes(config, 0) == {2: (0,), 3: (0,), 4: ()}  # ... but the server has


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("name: site", "name: hall", "fleet.yaml:8:pubsub[1].name: hall is the name of two connections"),
        ("  - name: site\n    security", "  - security", "fleet.yaml:8:pubsub[1]: `name` is missing"),
        ("[site]", "[seite]", "bridges.crane.connections[0]: there is no connection `seite`"),
        ("[hall, site]", "[hall, hall]", "bridges.arm.connections[1]: `hall` is named twice"),
        (
            "mqtt://127.0.0.1:1883",
            "opc.udp://224.0.2.14:4840",
            "pubsub[1].url: leads where connection 1 of the list leads, too",
        ),
        (
            "    url: mqtt",
            "    keep_alive_s: 2.0\n    url: mqtt",
            "pubsub[1].keep_alive_s: holds for all connections",
        ),
        (
            "version: 1\n",
            "version: 1\nserver: {connections: [hall]}\n",
            "bridges.crane.connections: the server is on `hall` alone, so that it never hears this bridge",
        ),
        (
            "version: 1\n",
            "version: 1\nserver: {connections: [site]}\n",
            "bridges.cart: the server is on `site` alone, so that it never hears this bridge",
        ),
        (
            "status_id: 3, ",
            "status_id: 3, requestors: [0, 3], ",
            "bridges.crane.requestors[1]: the bridge of space 3 is on no connection of this one",
        ),
        ("version: 1\n", "version: 1\nserver: {connections: [hal]}\n", "server.connections[0]: there is no connection"),
        ("127.0.0.1:1883", "", "pubsub[1].url"),
        ("opc.udp://224.0.2.14:4840", "opc.udp://224.0.2.14:0", "pubsub[0].url: a port is 1 to 65535"),
        ("{source: files}", "{source: files, endpoint: 'opc.tcp://a:1/b'}", "pubsub[0].keys.endpoint: key files"),
        ("    security: sign_and_encrypt\n    url: mqtt", "    url: mqtt", "pubsub[1].security: `security` is missing"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(old: str, new: str, expected: str) -> None:
    assert old in TWO
    found = problems(TWO.replace(old, new))
    assert any(expected in problem for problem in found), found


def test_a_tool_sees_the_fleet_over_one_connection_alone() -> None:
    config = on_connection(load(TWO), "site")
    assert config.connections == (config.pubsub,)
    assert (config.pubsub.name, config.pubsub.keys.source) == ("site", "files")
    assert connection_numbers(config, 3) == (0,)
    assert on_connection(load(TWO), None).pubsub.name == "hall"
    with pytest.raises(NotFound, match="there is no connection 'roof' in `pubsub`; there are: `hall`, `site`"):
        on_connection(load(TWO), "roof")


def test_names_of_connections_without_a_list_are_refused() -> None:
    text = "version: 1\npubsub: {security: none}\nbridges: {arm: {kind: ros2, space: 2, status_id: 1, "
    [problem] = problems(text + "connections: [hall]}}\n")
    assert "bridges.arm.connections[0]: `pubsub` is no list of connections" in problem


def test_an_empty_list_and_one_of_no_mappings() -> None:
    assert any("pubsub: names no connection" in problem for problem in problems("version: 1\npubsub: []\n"))
    assert any("pubsub[0]: must have keys with values" in each for each in problems("version: 1\npubsub: [hall]\n"))


def test_a_key_of_a_list_is_not_changed_from_outside() -> None:
    with pytest.raises(ConfigInvalid, match="`pubsub` is a list in the file"):
        load_content(TWO.encode(), "fleet.yaml", {**ENVIRONMENT, "UA_FLEET__PUBSUB__URL": "mqtt://a:1"})


def test_what_is_shown_is_read_as_the_same_and_hides_what_came_from_outside() -> None:
    config, document = load_document(TWO.encode(), "fleet.yaml", ENVIRONMENT)
    text = as_yaml(settings(config, document), ["${BROKER_USER}"])
    assert "peter" not in text
    assert load(text) == config


def test_the_schema_takes_both_forms() -> None:
    validator: Any = Draft202012Validator(json.loads(json.dumps(fleet_schema())))
    bridges = {"arm": {"kind": "ros2", "space": 2, "status_id": 1, "connections": ["a"]}}
    whole = {"version": 1, "bridges": bridges}
    assert validator.is_valid({**whole, "pubsub": {"security": "none"}})
    assert validator.is_valid({**whole, "pubsub": [{"name": "a", "security": "none"}]})
    assert not validator.is_valid({**whole, "pubsub": [{"security": "none"}]})
    assert not validator.is_valid({**whole, "pubsub": []})
    assert not validator.is_valid({**whole, "pubsub": [{"name": "a", "security": "none", "urll": "x"}]})


def test_a_process_announces_each_connection_that_it_is_on() -> None:
    config = load(TWO)
    publisher = Publisher(2, PubSubTiming(), Counters(), Codec(), bridge_application(config, "arm"))
    publisher.begin(now=0.0, wall_ticks=0)
    publisher.answer(Probe(2, 1, ProbeKind.PUBSUB_CONNECTIONS.value), 1.0)
    said = [Codec().decode(each) for each in publisher.poll(2.0)]
    said += [Codec().decode(each) for each in publisher.begin(now=5.0, wall_ticks=0)]
    [announced] = [each for each in said if isinstance(each, ConnectionsAnnouncement)][:1]
    urls = [each.address.url for each in announced.connections if isinstance(each.address, NetworkAddressUrl)]
    assert urls == ["opc.udp://224.0.2.14:4840", "mqtt://127.0.0.1:1883"]
    assert [each.name for each in announced.connections] == ["bridge arm hall", "bridge arm site"]
    assert [each.transport_profile_uri for each in announced.connections] == [UDP_UADP, MQTT_UADP]
    alone = bridge_application(config, "cart")
    assert (alone.further, alone.connection_name) == ((), "")
