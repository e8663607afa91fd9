"""The events of a run as a DataSet: what a client is told, subscribers without our code get once, field by field."""

from __future__ import annotations

import asyncio
import base64
import datetime as dt
import json
import socket
from collections.abc import AsyncGenerator, Callable, Generator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any, Final, cast
from urllib.parse import urlsplit

import pytest
from asyncua.client.client import Client
from asyncua.common.utils import Buffer
from asyncua.pubsub.uadp import UadpNetworkMessage

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.conftest import broker
from tests.integration.scenarios.conftest import ROBOTS, Plant, Seen, all_heard, call, run, run_is, watching
from tests.integration.server_model.harness import ua
from tests.system import Child, Processes
from tests.waiting import until

__all__ = ["broker"]

EVENTS_ID: Final = 1990
TOPIC: Final = f"ua_0_2_{EVENTS_ID}"
RUN, STEP, DECISION = 1026, 1027, 1028
FIELDS: Final = (
    *("EventId", "EventType", "SourceNode", "SourceName", "Time", "Message", "Severity"),
    *("RunId", "Scenario", "State", "Fact", "Step", "Task", "Robot", "Skill", "Outcome", "Detail"),
    *("DecisionId", "DecisionState", "Failed", "Reason", "Chosen", "ChosenBy"),
)
BASE: Final = 10
"""Fields that events of all three types have."""
REPEAT_S: Final = 0.5
STEPS: Final = (
    "  - {task: first, skill: work, robot: left}\n"
    f"  - {{task: long, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 60}}\n"
)

Row = dict[str, Any]
"""The fields of one event by their names: texts, numbers, the bytes of the EventId, the ticks of its time in 0.1 µs."""


def a_plant(folder: Path, url: str, port: int, processes: Processes, **pubsub: Any) -> Plant:
    """A fleet that publishes its events, and one scenario with a robot that fails."""
    plant = Plant(folder, url, port, processes, "automatic", {"repeat_interval_s": REPEAT_S, **pubsub})
    plant.declare(lambda raw: raw.update(scenarios={"events_id": EVENTS_ID}))
    plant.scenario("told", STEPS)
    return plant


# The subscribers.


def from_uadp(datagram: bytes) -> list[Row]:
    """The events of a NetworkMessage, by the decoder of asyncua."""
    # Version 1 with PublisherId, GroupHeader, PayloadHeader and ExtendedFlags1 (UInt16): data of the server, group 2.
    if not datagram.startswith(b"\xf1\x01\x00\x00\x01\x02\x00"):
        return []
    message: Any = UadpNetworkMessage.from_binary(Buffer(datagram))
    if message.DataSetPayloadHeader != [EVENTS_ID]:
        return []
    [data] = message.Payload
    flags, flags_2 = datagram[10:12]
    if flags & 0x80 and flags_2 & 0x0F == 3:
        return []  # a keep-alive
    assert flags & 0x80, datagram.hex()
    assert flags_2 & 0x0F == 2, datagram.hex()  # an event (OPC 10000-14 table 162)
    values = [variant.Value for variant in data.Data]
    row: Row = dict(zip(FIELDS, values, strict=True))
    row["EventType"], row["SourceNode"] = row["EventType"].to_string(), row["SourceNode"].to_string()
    row["Message"], row["Time"] = row["Message"].Text, ticks(row["Time"])
    return [row]


def from_json(text: str, names: Sequence[str]) -> list[Row]:
    """The events of a JSON message; `names` are those of the metadata."""
    message = json.loads(text)
    if message["MessageType"] != "ua-data":
        return []
    rows: list[Row] = []
    for each in message["Messages"]:
        assert each["DataSetWriterId"] == EVENTS_ID
        if each["MessageType"] == "ua-keepalive":
            continue
        assert each["MessageType"] == "ua-event"
        payload = {name: plain(value) for name, value in each["Payload"].items()}
        assert set(payload) <= set(names)
        row: Row = {name: payload.get(name) for name in names}
        row["EventId"] = base64.b64decode(row["EventId"], validate=True)
        row["Message"] = row["Message"]["Text"]
        row["Time"] = ticks(dt.datetime.fromisoformat(row["Time"]))
        row["Severity"] = row["Severity"] or 0
        rows.append(row)
    return rows


def plain(value: Any) -> Any:
    """The value of a Variant in any form of JSON."""
    if type(value) is not dict:
        return value
    members = cast("dict[str, Any]", value)
    return members.get("Value") if {"UaType", "Value"} & set(members) else members


def ticks(at: dt.datetime) -> int:
    """Microseconds since 1970."""
    whole = at if at.tzinfo else at.replace(tzinfo=dt.UTC)
    return round((whole - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)) / dt.timedelta(microseconds=1))


@contextmanager
def group_member(url: str) -> Generator[list[bytes]]:
    """The datagrams of a multicast group, taken by a plain socket."""
    parts = urlsplit(url)
    assert parts.hostname is not None
    taken: list[bytes] = []
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as member:
        member.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        member.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        member.bind((parts.hostname, parts.port or 4840))
        where = socket.inet_aton(parts.hostname) + socket.inet_aton("127.0.0.1")
        member.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, where)
        member.setblocking(False)
        loop.add_reader(member, lambda: taken.append(member.recv(65_536)))
        yield taken
        loop.remove_reader(member)


Subscribe = Callable[..., Child]


@pytest.fixture
def subscribe(processes: Processes) -> Subscribe:
    """Starts mosquitto_sub for a topic; a line for each message: retain flag and payload in a `form`."""

    def subscribed(broker: Broker, topic: str, form: str) -> Child:
        arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-t", topic, "-F", f"%r {form}"]
        return processes.start("mosquitto_sub", *arguments, whole=True)

    return subscribed


# The run.


def told(seen: Seen) -> dict[bytes, Row]:
    """What the client was told, by EventId, in order. It has a subscription for each type, with its fields."""
    rows: dict[bytes, Row] = {}
    for event in seen.events:
        row = rows.setdefault(event.EventId, dict.fromkeys(FIELDS))
        for name in FIELDS:
            value = getattr(event, name, None)
            if value is not None:
                row[name] = value
    for row in rows.values():
        row["EventType"], row["SourceNode"] = row["EventType"].to_string(), row["SourceNode"].to_string()
        row["Message"], row["Time"] = row["Message"].Text, ticks(row["Time"])
    return rows


@asynccontextmanager
async def after_the_run(plant: Plant) -> AsyncGenerator[tuple[dict[bytes, Row], Client]]:
    """A run in which a robot fails and another one takes over, and what a client was told of it; the server goes on."""
    for robot in ROBOTS:
        plant.bridge(robot)
    async with plant.server() as server, server.client() as client:
        await all_heard(client)
        async with watching(client, RUN, STEP, DECISION) as seen:
            run_id = await run(client, "told")
            await seen.wait_for("TaskAccepted long left")
            assert (await call(client, "Faults", "RaiseFault", "left", "stuck")) is not None
            await seen.wait_for("TaskAccepted long middle")
            await call(client, "Scenarios", "Abort", run_id, "seen enough")
            state = await run_is(client, run_id, "aborted", "failed")
            await seen.wait_for(f"{run_id}: {state}")
            rows = told(seen)
        kinds = {row["EventType"] for row in rows.values()}
        assert kinds == {f"ns=3;i={kind}" for kind in (RUN, STEP, DECISION)}
        yield rows, client


def check(got: Sequence[Row], rows: Mapping[bytes, Row]) -> None:
    """What came is what the client was told: each event once, in its order, with its fields."""
    ids = [row["EventId"] for row in got]
    assert ids == list(rows), (len(ids), len(rows))
    for row in got:
        assert row == rows[row["EventId"]]
        own = {STEP: FIELDS[BASE:17], DECISION: ("Task", *FIELDS[17:]), RUN: ()}[int(row["EventType"].split("=")[-1])]
        absent = [name for name in FIELDS[BASE:] if name not in own]
        assert [row[name] for name in absent] == [None] * len(absent)
        assert all(isinstance(row[name], str) for name in own)


async def repeated() -> None:
    """Longer than after which a last value is said again: that nothing comes cannot be waited for."""
    await asyncio.sleep(4 * REPEAT_S)


async def names_read(client: Client) -> tuple[str, ...]:
    """The fields of the DataSet as the address space says them."""
    node = client.get_node(ua.NodeId(ua.ObjectIds.PublishSubscribe_PublishedDataSets))
    for name in ("Fleet server", "ScenarioEvents", "DataSetMetaData"):
        [node] = [child for child in await node.get_children() if (await child.read_browse_name()).Name == name]
    metadata: Any = await node.read_value()
    return tuple(field.Name for field in metadata.Fields)


async def test_over_udp(tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> None:
    plant = a_plant(tmp_path, udp_url, tcp_port, processes)
    with group_member(udp_url) as datagrams:

        def got() -> list[Row]:
            return [row for datagram in datagrams for row in from_uadp(datagram)]

        async with after_the_run(plant) as (rows, client):
            assert await names_read(client) == FIELDS
            await until(lambda: len(got()) >= len(rows))
            await repeated()
        check(got(), rows)
        async with plant.server() as server, server.client() as client:  # a server that is started anew
            await all_heard(client)
            await repeated()
        check(got(), rows)


@pytest.mark.needs("mosquitto")
async def test_as_uadp_over_a_broker(
    tmp_path: Path, broker: Broker, tcp_port: int, processes: Processes, subscribe: Subscribe
) -> None:
    plant = a_plant(tmp_path, broker.url, tcp_port, processes)
    child = subscribe(broker, TOPIC, "%x")

    def got(of: Child) -> list[Row]:
        return [row for line in of.lines for row in from_uadp(bytes.fromhex(line.split(" ")[1]))]

    async with after_the_run(plant) as (rows, _):
        await until(lambda: len(got(child)) >= len(rows))
        late = subscribe(broker, TOPIC, "%x")
        await repeated()
    check(got(child), rows)
    assert got(late) == []  # an event is no state: the broker keeps none


@pytest.mark.needs("mosquitto")
@pytest.mark.parametrize("form", ["verbose", "compact", "raw"])
async def test_as_json(
    tmp_path: Path, broker: Broker, tcp_port: int, processes: Processes, subscribe: Subscribe, form: str
) -> None:
    json_road = {"security": "broker", "encoding": "json", "actions": True, "json_form": form}
    plant = a_plant(tmp_path, broker.url, tcp_port, processes, **json_road)
    child, described = subscribe(broker, TOPIC, "%p"), subscribe(broker, "opcua/json/metadata/#", "%p")

    def names() -> list[str]:
        texts = [json.loads(line.split(" ", 1)[1]) for line in described.lines]
        found = [text["MetaData"]["Fields"] for text in texts if text.get("DataSetWriterId") == EVENTS_ID]
        return [field["Name"] for field in found[-1]] if found else []

    def got(of: Child) -> list[Row]:
        return [row for line in of.lines for row in from_json(line.split(" ", 1)[1], names())]

    async with after_the_run(plant) as (rows, _):
        await until(lambda: names() == list(FIELDS), "its metadata")
        await until(lambda: len(got(child)) >= len(rows))
        late = subscribe(broker, TOPIC, "%p")
        await repeated()
    check(got(child), rows)
    assert got(late) == []
