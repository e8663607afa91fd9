"""What docs/json.md and docs/brokers.md show of JSON over a broker is what is sent and read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.unit.pubsub.publishing import TOPIC, WALL, only
from tests.unit.transport.mqtt.json_connection import Process
from ua_fleet.config.load import load_content
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.transport.mqtt.json.undescribed import LATE_S
from ua_fleet.values import BuiltinType
from ua_fleet.wire.json import Form

DOCS = Path(__file__).parents[4] / "docs"
PAGE = (DOCS / "json.md").read_text()
SPEED = (make_field("speed", BuiltinType.DOUBLE),)
PRINTED = re.findall(r"\| `json_form: (\w+)` \| `mosquitto_sub -h broker -t (\S+)` \| `(.+)` \|", PAGE)
WRITTEN = re.findall(r"\| `mosquitto_pub -h broker -t (\S+) -m '(.+)'` \|", PAGE)
FORMS = {"verbose": Form.VERBOSE, "compact": Form.COMPACT, "raw": Form.RAW_DATA}


def announced(process: Process) -> list[bytes]:
    return process.publisher.announce(TOPIC, "speed", SPEED, now=process.now, wall_ticks=WALL)


def test_the_table_has_all_forms() -> None:
    assert [form for form, _, _ in PRINTED] == list(FORMS)
    assert len(WRITTEN) == 3


@pytest.mark.parametrize(("form", "topic", "printed"), PRINTED)
def test_a_line_prints_the_value_as_the_table_says(form: str, topic: str, printed: str) -> None:
    process = Process(1, form=FORMS[form])
    process.send(announced(process))
    (sent,) = process.send(process.publisher.publish(TOPIC, (1.5,), timestamp=WALL, now=process.now))
    assert sent.topic == topic
    assert printed in sent.payload.decode()


def test_the_bytes_are_those_that_the_table_says() -> None:
    process = Process(1)
    announced(process)
    (datagram,) = process.publisher.publish(TOPIC, (1.5,), timestamp=WALL, now=process.now)
    (printed,) = re.findall(r"\| `encoding: uadp` \| .* \| `…(\w+)` ", PAGE)
    assert datagram.hex().endswith(printed)


@pytest.mark.parametrize(("topic", "text"), WRITTEN)
def test_a_foreign_line_is_that_value(topic: str, text: str) -> None:
    one, other = Process(1), Process(0)
    other.hear_all([each for each in one.send(announced(one)) if each.is_retained])
    (data,) = only(DataReceived, other.hear(topic, text.encode()))
    assert (data.topic, data.message.values) == (TOPIC, (1.5,))


def test_without_metadata_it_is_the_text_that_the_page_says() -> None:
    other = Process(0)
    other.hear(*next((topic, text.encode()) for topic, text in WRITTEN))
    (data,) = only(DataReceived, other.wait(LATE_S))
    assert f"the text `{data.message.values[0]}`" in PAGE


def test_the_file_of_the_page_about_brokers_can_be_loaded() -> None:
    section = (DOCS / "brokers.md").read_text().partition("## JSON")[2]
    text = re.search(r"```yaml\n(.*?)```", section, re.DOTALL)
    assert text is not None
    assert load_content(text[1].encode(), "fleet.yaml", {}).pubsub.is_json
