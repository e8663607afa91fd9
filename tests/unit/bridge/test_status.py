from __future__ import annotations

from pathlib import Path

import ua_fleet
from ua_fleet.bridge import STATUS_FIELDS, DriverStatus, status_topic, status_values
from ua_fleet.bridge.status import aside_text
from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.counters import OF_BRIDGES, Counters, Drop
from ua_fleet.fleet.model import BRIDGE_FIELDS, drop_field
from ua_fleet.pubsub.components import writer_group
from ua_fleet.pubsub.group_figures import FIGURES_FIELD, GroupFigures, unpacked
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

CONFIG = FleetConfig(version=1, pubsub=PubSubConfig(security=PubSubSecurity.NONE))


def test_every_drop_has_its_field_and_its_value() -> None:
    counters = Counters(messages_in=1, messages_out=2, from_space=3, to_space=4, gaps=5, looped=6)
    for number, drop in enumerate(OF_BRIDGES):
        counters.drop(drop, 10 + number)
    values = status_values(
        "arm", "ros1", DriverStatus(True, "up"), counters, lag_p99_s=0.0123, oldest_s=1.5, figures=[GroupFigures(2, 7)]
    )
    fields = dict(zip((field.name for field in STATUS_FIELDS), values, strict=True))
    assert list(fields.values())[:10] == ["arm", "ros1", True, "up", 1, 2, 3, 4, 5, 6]
    assert (fields["LagP99"], fields["OldestWaiting"]) == (12.3, 1500.0)
    assert {name: fields[f"Drops.{name}"] for name in OF_BRIDGES} == dict(counters.drops)
    assert unpacked(fields[FIGURES_FIELD]) == {(0, writer_group(2)): GroupFigures(2, 7)}


def test_only_what_a_relay_alone_counts_has_no_field() -> None:
    assert set(Drop) - set(OF_BRIDGES) == {Drop.NOT_RELAYED, Drop.NOT_LISTED}
    package = Path(ua_fleet.__file__).parent
    counting = {path.parent.name for path in package.rglob("*.py") if "Drop.NOT_LISTED" in path.read_text()}
    assert counting == {"ua_fleet", "relay"}


def test_all_counters_are_uint64() -> None:
    assert {field.builtin_type for field in STATUS_FIELDS[4:-3]} == {BuiltinType.UINT64}


def test_fields_are_those_that_the_server_shows() -> None:
    wanted = {(name, int(kind)) for name, kind in BRIDGE_FIELDS}
    wanted |= {(drop_field(drop.value), int(BuiltinType.UINT64)) for drop in OF_BRIDGES}
    published = {(field.name, field.builtin_type) for field in STATUS_FIELDS}
    assert wanted <= published


def test_topic_is_in_the_bridges_space_and_needs_an_id() -> None:
    assert status_topic(CONFIG, BridgeConfig(kind="ros1", space=1, status_id=900)) == Topic(1, 2, 900)
    assert status_topic(CONFIG, BridgeConfig(kind="ros1", space=1)) is None


def test_sources_that_are_put_aside_are_named_up_to_three() -> None:
    aside = {f"/{number}": "rubbish" for number in range(5)}
    assert aside_text(dict([*aside.items()][:1])) == "put aside, and tried again later: /0 (rubbish)"
    assert aside_text(aside).endswith("/0 (rubbish), /1 (rubbish), /2 (rubbish), 2 more")
