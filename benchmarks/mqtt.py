"""OPC UA PubSub over MQTT: how late a value comes to its node, how many a server takes, and a broker's node that dies.

Each process beside the bare library (`transport.mqtt` uses the same one): the same broker, the same messages from the
same sender, in turn. A floor acknowledges each message and counts it, and does nothing else.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks._mqtt_fleet import fleet
from benchmarks._ros import Node, median_and_p99
from benchmarks.harness import FEWEST_ROUNDS, Failed, Figure, Unavailable, at_most, shown, within
from benchmarks.mqtt_clients import broker
from tests import system
from tests.integration.mqtt.broker import Cluster

WARM_UP, MEASURED, RATE_HZ = 100, 500, 100.0
SOURCES, FLOOD = 100, 20_000
GOAL_LATENCY, GOAL_INGEST = 2.0, 0.7
LEAST_PER_SECOND, LASTS_S = 2_000.0, 60.0
BRIDGES, CLUSTER_RATE, CLUSTER_S, KILLED_AT_S = 100, 1_000.0, 30.0, 10.0
ARRIVES_S = 60.0
LIBRARY = "bare mqttium"


class Taken(NamedTuple):
    """What a subject has heard of a sending."""

    values: int
    disordered: int
    per_second: float
    cpu_s: float
    seconds: float
    memory_mb: float


class Stand:
    """Processes at one broker."""

    def __init__(self, stack: contextlib.ExitStack, urls: list[str], *, sources: int, bridges: int) -> None:
        self._stack, self.url = stack, urls[0]
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        self.fleet = folder / "fleet.json"
        raw = fleet(urls, system.free_tcp_port(), sources=sources, bridges=bridges)
        self.fleet.write_text(json.dumps(raw), encoding="utf-8")

    def start(self, module: str, *arguments: object) -> Node:
        """A process; -P, else the `json` that it imports would be the group of that name."""
        command = [sys.executable, "-P", "-m", f"benchmarks.{module}", *map(str, arguments)]
        node = Node(*command, env=os.environ | {"PYTHONPATH": f"{system.ROOT}:{system.ROOT / 'bridges'}"})
        self._stack.callback(node.end)  # also where it was ended before
        return node


def taken(subject: Node) -> dict[str, Any]:
    """What a subject has heard since it was asked last."""
    subject.tell("take")
    told: dict[str, Any] = json.loads(subject.read())
    return told


def numbers(subject: Node) -> tuple[Counter[int], int]:
    """How often which values were written since this was asked last, and how often one was kept with another status."""
    subject.tell("numbers")
    written, statuses = json.loads(subject.read())
    return Counter(map(int, written)), statuses


def told_by(sender: Node) -> dict[str, Any]:
    figures: dict[str, Any] = json.loads(sender.expect("done").removeprefix("done "))
    return figures


# How late.


def ages_us(sender: Node, subject: Node) -> tuple[float, float]:
    """Median and 99th percentile of what a sender sends."""
    for count in (WARM_UP, MEASURED):
        taken(subject)
        sender.tell(f"{count} {RATE_HZ}")
        told_by(sender)
        time.sleep(0.3)
    # The server has values of its own that are no clock; they are far from it.
    return median_and_p99([age * 1e6 for age in taken(subject)["ages"] if 0.0 <= age < ARRIVES_S])


def latency(rounds: int) -> list[Figure]:
    with contextlib.ExitStack() as stack:
        url = f"mqtt://127.0.0.1:{stack.enter_context(broker())}"
        stand = Stand(stack, [url], sources=1, bridges=1)
        ours = stand.start("_mqtt_subject", "ours", stand.fleet)
        pairs = [
            (stand.start("_mqtt_sender", "bare", url), stand.start("_mqtt_subject", "bare", url)),
            (stand.start("_mqtt_sender", "robot", stand.fleet), ours),
        ]
        samples = [[ages_us(*pair) for pair in pairs] for _ in range(max(rounds, FEWEST_ROUNDS))]
    (floor, floor_late), (value, value_late) = (
        [statistics.median(column) for column in zip(*ages, strict=True)] for ages in zip(*samples, strict=True)
    )
    echo = f"two clients of {LIBRARY.removeprefix('bare ')}, one way"
    return [
        at_most(
            "robot's value to its node, p50", value, "us", reference=echo, reference_value=floor, goal=GOAL_LATENCY
        ),
        shown("robot's value to its node, p99", value_late, "us", reference=echo, reference_value=floor_late),
    ]


# How many.


def flooded(stand: Stand, sender: Node, role: str, *, count: int, rate: float) -> Taken:
    """What a new subject takes of so many messages."""
    subject = stand.start("_mqtt_subject", role, stand.fleet if role == "ours" else stand.url)
    sender.tell("2000 2000")  # decoders have their plans, sockets their buffers
    told_by(sender)
    time.sleep(0.5)
    taken(subject)
    sender.tell(f"{count} {rate}")
    found = arrived(subject, count, told_by(sender)["began"])
    subject.end()
    return found


def arrived(subject: Node, count: int, began: float) -> Taken:
    """Wait until so many have come, or no more do."""
    heard, since = -1, time.monotonic()
    while heard < count and time.monotonic() - since < ARRIVES_S:
        time.sleep(0.05)
        subject.tell("look")
        if (now := json.loads(subject.read())["count"]) != heard:
            heard, since = now, time.monotonic()
    told = taken(subject)
    seconds = told["last_at"] - began
    return Taken(
        told["count"],
        told["disordered"],
        told["count"] / seconds,
        told["cpu_s"],
        seconds,
        told["memory_mb"],
    )


@contextlib.contextmanager
def flood(role: str) -> Generator[tuple[Stand, Node]]:
    """A broker and a sender."""
    with contextlib.ExitStack() as stack:
        url = f"mqtt://127.0.0.1:{stack.enter_context(broker())}"
        stand = Stand(stack, [url], sources=SOURCES, bridges=1)
        yield stand, stand.start("_mqtt_sender", role, url, SOURCES)


def ingest(rounds: int) -> list[Figure]:
    rows: list[Figure] = []
    for role, by in (("library", "sent by the library"), ("socket", "sent by a bare socket")):
        with flood(role) as (stand, sender):
            samples = [
                [flooded(stand, sender, each, count=FLOOD, rate=0.0) for each in ("bare", "ours")]
                for _ in range(max(rounds, FEWEST_ROUNDS))
            ]
        for _, ours in samples:
            if (ours.values, ours.disordered) != (FLOOD, 0):
                raise Failed(f"{ours.values} of {FLOOD} values came, {ours.disordered} of them behind a later one")
        floor, value = (statistics.median(each.per_second for each in column) for column in zip(*samples, strict=True))
        ratio = value / floor
        goal = GOAL_INGEST if role == "library" else None
        rows.append(
            Figure(
                f"QoS 1 into one server, {by}",
                value,
                "1/s",
                LIBRARY,
                floor,
                ratio,
                goal,
                goal is None or ratio >= goal,
            )
        )
        floor, value = (
            statistics.median(each.cpu_s / each.values * 1e6 for each in column)
            for column in zip(*samples, strict=True)
        )
        rows.append(shown(f"CPU for each, {by}", value, "us", reference=LIBRARY, reference_value=floor))
    return rows


def lasting() -> list[Figure]:
    with flood("library") as (stand, sender):
        count = int(LEAST_PER_SECOND * LASTS_S)
        ours = flooded(stand, sender, "ours", count=count, rate=LEAST_PER_SECOND)
    rate = f"{LEAST_PER_SECOND:,.0f} values a second for {LASTS_S:.0f} s"
    lost = count - ours.values
    return [
        Figure(f"{rate}, lost", lost, "values", "sent", count, lost, 0, lost == 0 and not ours.disordered),
        within(f"{rate}, until the last one is at its node", ours.seconds, "s", LASTS_S + 1.0),
        shown(f"{rate}, CPU", ours.cpu_s / ours.seconds * 100, "%", reference="one core", reference_value=100.0),
    ]


# A cluster.


def node_dies() -> list[Figure]:
    with contextlib.ExitStack() as stack:
        cluster = Cluster(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "cluster")
        cluster.start()
        stack.callback(cluster.end)
        a, b, c = cluster.urls
        stand = Stand(stack, [b, c, a], sources=BRIDGES, bridges=BRIDGES)
        server = stand.start("_mqtt_subject", "ours", stand.fleet)
        time.sleep(5.0)
        senders = stand.start("_mqtt_sender", "bridges", BRIDGES, a, b, c)
        senders.tell(f"5 {BRIDGES}")
        told_by(senders)
        time.sleep(2.0)
        before_mb = taken(server)["memory_mb"]
        numbers(server)
        began = time.monotonic()
        senders.tell(f"{CLUSTER_S} {CLUSTER_RATE}")
        time.sleep(KILLED_AT_S)
        cluster.nodes["a"].end(signal.SIGKILL)
        sent = told_by(senders)
        heard = arrived(server, sent["sent"], began)
        written, statuses = numbers(server)
    count, last = sent["sent"], sent["last"]
    sending = range(last - count + 1, last + 1)
    lost = [number for number in sending if number not in written]
    again = [number for number, times in written.items() if times > 1 or number not in sending]
    for what, which in (("lost", lost), ("shown twice", again)):
        if which:
            print(f"mqtt: {what}: {', '.join(map(str, sorted(which)[:50]))}", file=sys.stderr)
    name = f"cluster, {CLUSTER_RATE:,.0f} values a second of {BRIDGES} bridges, a node killed"
    cpu = heard.cpu_s / heard.seconds * 100
    return [
        Figure(f"{name}, lost", len(lost), "values", "sent", count, len(lost), 0, not lost and not heard.disordered),
        Figure(f"{name}, shown twice", len(again), "values", "sent", count, len(again), 0, not again),
        shown(f"{name}, sources that were not Good", statuses, "times", reference="sources", reference_value=BRIDGES),
        shown(f"{name}, until the last one", heard.seconds, "s", reference="sent within", reference_value=CLUSTER_S),
        shown(f"{name}, server's CPU", cpu, "%", reference="one core", reference_value=100.0),
        shown(f"{name}, server's memory", heard.memory_mb, "MB", reference="before", reference_value=before_mb),
    ]


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    if problem := system.missing("mosquitto"):
        raise Unavailable(problem)
    rows = [*latency(rounds), *ingest(rounds), *lasting()]
    if system.missing("nats") is None:
        rows += node_dies()
    return rows
