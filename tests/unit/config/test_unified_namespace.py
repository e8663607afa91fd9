"""The section `unified_namespace`: what is refused, with its key and a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig, UnifiedNamespaceConfig
from ua_fleet.errors import ConfigInvalid, TransportError
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.server.unified_namespace import make_namespace
from ua_fleet.uns.payloads import Payload

FLEET = """\
version: 1
pubsub: {{security: none, url: "{pubsub}", broker: {{queue: "{queue}"}}}}
bridges: {{floor: {{kind: ros2, space: 2, status_id: 1}}}}
robots: {{rover: {{bridge: floor, data: {{{data}: {{id: 5, type: Double}}}}}}}}
unified_namespace: {section}
"""


def fleet(
    section: str, pubsub: str = "opc.udp://239.1.2.3:4840", queue: str = "{topic}", data: str = "speed"
) -> FleetConfig:
    text = FLEET.format(section=section, pubsub=pubsub, queue=queue, data=data)
    return load_content(text.encode(), "fleet.yaml", {})


def problem(section: str, **options: str) -> str:
    with pytest.raises(ConfigInvalid) as raised:
        fleet(section, **options)
    (found,) = raised.value.problems
    assert found.line in (2, 5)
    return str(found)


def test_the_defaults() -> None:
    section = fleet("{url: mqtt://broker, site: acme/lyon}").unified_namespace
    assert section == UnifiedNamespaceConfig(url="mqtt://broker", site="acme/lyon")
    assert section is not None
    assert (section.topic, section.payload) == ("{site}/{fleet}/{robot}/{data}", Payload.OBJECT)
    assert fleet("").unified_namespace is None


@pytest.mark.parametrize(
    ("section", "key", "text"),
    [
        ("{site: plant}", "unified_namespace.url", "`url` is missing"),
        ("{url: mqtt://broker}", "unified_namespace", "write `site` too, or remove {site}"),
        ("{url: mqtt://b, topic: 'a/{robot}'}", "unified_namespace", "two data sources would share a topic"),
        ("{url: mqtt://b, topic: '#/{robot}/{data}'}", "unified_namespace", "wildcard"),
        ("{url: 'opc.udp://b:1', site: p}", "unified_namespace.url", ""),
        ("{url: 'mqtt://u:geheim@b', site: p}", "unified_namespace.url", "broker.password_file"),
        ("{url: 'mqtt://b:99999', site: p}", "unified_namespace.url", "port"),
        ("{url: mqtt://b, site: p, payload: bare}", "unified_namespace.payload", "`value`, `object`"),
        ("{url: mqtt://b, site: p, paylod: value}", "unified_namespace.paylod", "did you mean `payload`"),
        ("{url: mqtt://b, site: p, rate_hz: 0}", "unified_namespace.rate_hz", ""),
        ("{url: mqtt://b, site: p, expiry_s: 1}", "unified_namespace.expiry_s", ""),
        ("{url: mqtt://b, site: p, broker: {ca_file: c}}", "unified_namespace.broker.ca_file", "mqtts://"),
        ("{url: mqtts://b, site: p, broker: {key_file: c}}", "unified_namespace.broker", "belong together"),
        ("{url: mqtts://b, site: p, broker: {nodes: [mqtt://c]}}", "unified_namespace.broker.nodes[0]", "mqtts"),
        ("{url: mqtts://b, site: p, broker: {prefix: p}}", "unified_namespace.broker.prefix", "unknown key"),
    ],
)
def test_what_cannot_be_is_told_with_its_place(section: str, key: str, text: str) -> None:
    told = problem(section)
    assert f":{key}: " in told
    assert text in told
    assert "geheim" not in told


def test_no_value_stands_where_pubsub_looks_on_the_same_broker() -> None:
    section = "{url: mqtt://b, topic: 'opcua/{robot}/{data}'}"
    assert "opcua/_server is a topic of PubSub on the same broker; begin with another level" in problem(
        section, pubsub="mqtt://b"
    )
    assert fleet(section, pubsub="mqtt://other").unified_namespace is not None
    section = "{url: mqtt://b, topic: 'x/{robot}/{data}'}"
    assert "x/rover/ua_1_2_3 is a topic of PubSub" in problem(
        section, pubsub="mqtt://b", queue="x/rover/{topic}", data="ua_1_2_3"
    )


def test_a_file_that_is_no_use_is_named_with_its_key(tmp_path: Path) -> None:
    config = fleet("{url: mqtt://b, site: p, broker: {user: u, password_file: none}}")
    with pytest.raises(TransportError, match=r"^unified_namespace\.broker\.password_file: .*no such file"):
        make_namespace(config, tmp_path, [], lambda: pytest.fail("that is too late"), Mistakes(), int)
