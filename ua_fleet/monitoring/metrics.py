"""All metrics: their names, labels and meaning. `python -m ua_fleet.monitoring.reference` prints them as a table.

Names follow the conventions of Prometheus: base units, `_total` for counters. Labels are bounded: causes, outcomes,
states and tables are lists of the code; spaces and groups are those of `fleet.yaml`; robots and skills are the first
`MOST_ROBOTS` and `MOST_SKILLS` that there are, whoever announces more.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric as Family

__all__ = ["METRICS", "MOST_ROBOTS", "MOST_SKILLS", "Family", "Metric", "MetricKind", "ProcessKind"]

MOST_ROBOTS: Final = 2000
"""Robots that have a label of their own."""
MOST_SKILLS: Final = 200
"""Names of skills that have a label of their own; the others are `(other)`."""


class MetricKind(StrEnum):
    """What can be done with a figure."""

    COUNTER = "counter"
    GAUGE = "gauge"
    HISTOGRAM = "histogram"


class ProcessKind(StrEnum):
    """Who has a metric."""

    SERVER = "server"
    BRIDGE = "bridge"
    MODBUS = "modbus"
    CONSOLE = "console"
    RELAY = "relay"


_ALL: Final = tuple(ProcessKind)
_PUBSUB: Final = (ProcessKind.SERVER, ProcessKind.BRIDGE, ProcessKind.RELAY)
_SERVER: Final = (ProcessKind.SERVER,)
_BRIDGE: Final = (ProcessKind.BRIDGE,)
_MODBUS: Final = (ProcessKind.MODBUS,)
_CONSOLE: Final = (ProcessKind.CONSOLE,)


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric. `name` is as it is shown, with `_total`."""

    name: str
    kind: MetricKind
    labels: tuple[str, ...]
    processes: tuple[ProcessKind, ...]
    help: str

    def one(self, value: float) -> Family:
        """It, where it has no labels."""
        return self.many([((), value)])

    def many(self, values: Iterable[tuple[tuple[str, ...], float]]) -> Family:
        """It, by the values of its labels; not for histograms."""
        family = (CounterMetricFamily if self.kind is MetricKind.COUNTER else GaugeMetricFamily)(
            self.name, self.help, labels=self.labels
        )
        for labels, value in values:
            family.add_metric(labels, value)
        return family


METRICS: Final[list[Metric]] = []
"""All of them, in the order of the table."""


def _metric(name: str, kind: MetricKind, processes: tuple[ProcessKind, ...], text: str, *labels: str) -> Metric:
    metric = Metric(f"ua_fleet_{name}", kind, labels, processes, text)
    METRICS.append(metric)
    return metric


_C, _G, _H = MetricKind.COUNTER, MetricKind.GAUGE, MetricKind.HISTOGRAM

BUILD = _metric(
    "build_info", _G, _ALL, "1; what runs: the process, its name in fleet.yaml, version and Python.",
    "process", "name", "version", "python",
)  # fmt: skip
READY = _metric("ready", _G, _ALL, "1 while /readyz answers 200.")
LOOP_LAG = _metric("loop_lag_seconds", _H, _ALL, "How late the event loop was, looked at once a second.")
MISTAKES = _metric(
    "mistakes_total", _C, _ALL, "Mistakes of this program that cost one item of a loop; each stands in the log once.",
    "loop",
)  # fmt: skip
LEFT_OUT = _metric(
    "label_values_left_out", _G, _SERVER, "Robots or skills that have no label of their own, since there are too many.",
    "label",
)  # fmt: skip

RECEIVED = _metric("dataset_messages_received_total", _C, _PUBSUB, "DataSetMessages received, before any drop.")
SENT = _metric("dataset_messages_sent_total", _C, _PUBSUB, "DataSetMessages sent, repeats and keep-alives included.")
FROM_SPACE = _metric("space_messages_received_total", _C, _BRIDGE, "Messages taken from the bridge's space.")
TO_SPACE = _metric("space_messages_published_total", _C, _BRIDGE, "Messages published into the bridge's space.")
DROPS = _metric("drops_total", _C, _PUBSUB, "Messages that were dropped; some causes are normal.", "cause")
MALFORMED = _metric("malformed_total", _C, _PUBSUB, "Messages that break the rules of OPC 10000-14.", "cause")
FORGIVEN = _metric("forgiven_total", _C, _PUBSUB, "What JSON messages did wrong and was read all the same.", "leniency")
GAPS = _metric("sequence_gaps_total", _C, _PUBSUB, "DataSetMessages that sequence numbers show as missing.")
LOOPED = _metric("looped_total", _C, _PUBSUB, "Messages delivered twice to one place; has to stay 0.")
DATAGRAMS_RECEIVED = _metric("datagrams_received_total", _C, _PUBSUB, "Datagrams received.")
DATAGRAMS_SENT = _metric("datagrams_sent_total", _C, _PUBSUB, "Datagrams sent.")
RECEIVE_BUFFER = _metric("receive_buffer_bytes", _G, _PUBSUB, "Receive buffer that the kernel gave.")
KEY_REMAINING = _metric(
    "key_remaining_seconds", _G, _PUBSUB,
    "Time until the last key of a SecurityGroup that is here is over; below 0 it is used for two lifetimes more.",
    "group",
)  # fmt: skip
KEY_SOURCE = _metric("key_source_up", _G, _PUBSUB, "1 while the key source is reachable; absent without keys.")

SPACE_CONNECTED = _metric("space_connected", _G, _BRIDGE, "1 while the bridge is connected to its space.")
DEVICE_UP = _metric(
    "device_up", _G, _BRIDGE, "1 while the device answers; where several stand behind the bridge.", "device"
)
ASIDE = _metric("sources_aside", _G, _BRIDGE, "Sources that are put aside for a while, since they misbehave.")
INLET = _metric("inlet_messages", _G, _BRIDGE, "Messages from the space that wait to be sent.")
LAG = _metric(
    "space_lag_seconds",
    _G,
    _BRIDGE,
    "What 99 of 100 messages of the last 10 s needed at most from the space to PubSub.",
)
OLDEST = _metric(
    "oldest_waiting_seconds", _G, _BRIDGE, "How long the message has waited that waits longest to be sent."
)

ROBOT_UP = _metric("robot_up", _G, _SERVER, "1 while the robot is heard.", "robot")
ROBOTS = _metric("robots", _G, _SERVER, "Robots by the state that their node shows.", "state")
BRIDGE_UP = _metric("bridge_up", _G, _SERVER, "1 while the bridge is heard.", "bridge")
SOURCES = _metric(
    "sources", _G, _SERVER, "Data sources: heard, silent, waiting (never heard) or refused (for their security).",
    "state",
)  # fmt: skip
VALUES = _metric("values", _G, _SERVER, "Values of data sources by the quality that clients see.", "quality")
SKILL_SECONDS = _metric(
    "skill_seconds", _H, _SERVER, "Time from the request of a skill to its end, by outcome.", "skill", "outcome"
)
EXECUTIONS = _metric(
    "robot_executions_total", _C, _SERVER, "Skills that robots have ended, by outcome.", "robot", "outcome"
)
UNDER_WAY = _metric("executions_under_way", _G, _SERVER, "Skills that have begun and not ended.")
RUNS = _metric("runs_under_way", _G, _SERVER, "Runs of scenarios that have not ended.")
RUNS_ENDED = _metric("runs_total", _C, _SERVER, "Runs that have ended since the server's start.", "outcome")
FAULTS = _metric("faults", _G, _SERVER, "Faults of robots: active, or waiting for their acknowledgement.", "state")
ALARMS = _metric(
    "alarms",
    _G,
    _SERVER,
    "Alarms of values: active, unacknowledged, shelved, suppressed or disabled.",
    "state",
)
ALARM_EVENTS = _metric("alarm_events_total", _C, _SERVER, "Changes of alarms of values that were sent to clients.")
DECISIONS = _metric("decisions_open", _G, _SERVER, "Replacements that an operator has to choose.")
NAMESPACE_UP = _metric(
    "namespace_up", _G, _SERVER, "1 while the broker of the Unified Namespace is connected; absent without one."
)
NAMESPACE_TOPICS = _metric("namespace_topics", _G, _SERVER, "Topics of robots in the Unified Namespace.")
NAMESPACE_WAITING = _metric(
    "namespace_waiting", _G, _SERVER, "Topics whose newest value the broker of the Unified Namespace does not have."
)
NAMESPACE_PUBLISHED = _metric(
    "namespace_published_total", _C, _SERVER, "Messages that the broker of the Unified Namespace has acknowledged."
)
NAMESPACE_DROPS = _metric(
    "namespace_drops_total", _C, _SERVER, "Values that were not published in the Unified Namespace.", "cause"
)
SESSIONS = _metric(
    "opcua_sessions",
    _G,
    _SERVER,
    "Sessions of OPC UA clients, with those whose connection is lost until their timeout.",
)
SUBSCRIPTIONS = _metric("opcua_subscriptions", _G, _SERVER, "Subscriptions of OPC UA clients.")
ITEMS = _metric("opcua_monitored_items", _G, _SERVER, "Monitored items of OPC UA clients.")
QUEUED_BYTES = _metric(
    "opcua_queued_bytes", _G, _SERVER, "Memory of the values and events that wait for OPC UA clients."
)
NOTIFICATIONS_LOST = _metric(
    "opcua_notifications_lost_total",
    _C,
    _SERVER,
    "Values and events that gave way since too much waited for their client; the Overflow bit tells it.",
)
CONNECTIONS = _metric("opcua_connections_total", _C, _SERVER, "TCP connections that clients have made.")
REFUSED = _metric("opcua_refused_total", _C, _SERVER, "What clients were refused, by what it was.", "what")
GATEWAY_LOGINS = _metric(
    "opcua_gateway_logins_total", _C, _SERVER, "Logins through gateways, by how they ended.", "gateway", "outcome"
)
REQUESTS = _metric("opcua_requests_total", _C, _SERVER, "Requests of OPC UA clients.")
REQUEST_SECONDS = _metric(
    "opcua_request_seconds",
    _H,
    _SERVER,
    "Time from an OPC UA request to its response, by service; without refused ones, Publish, and Methods that wait.",
    "service",
)
HISTORY_ROWS = _metric(
    "history_values_total",
    _C,
    _SERVER,
    "Values and events for the history: stored, lost since too many or too large ones waited, or left out (changes by"
    " one user).",
    "what",
)
HISTORY_WAITING = _metric("history_values_waiting", _G, _SERVER, "Values that wait for the store of the history.")
HISTORY_UP = _metric("history_up", _G, _SERVER, "1 while the history is stored; absent without one.")
AUDIT_LINES = _metric(
    "audit_lines_total",
    _C,
    _SERVER,
    "Lines of the audit log: written, summed up instead, lost (full disk), or not delivered to syslog.",
    "what",
)

SERVER_CONNECTED = _metric("server_connected", _G, _MODBUS, "1 while the gateway is connected to the OPC UA server.")
MODBUS_CONNECTIONS = _metric("modbus_connections", _G, _MODBUS, "PLCs that are connected.")
MODBUS_REFUSED = _metric("modbus_refused_total", _C, _MODBUS, "What PLCs were refused, by cause.", "cause")

CONSOLE_SESSIONS = _metric("console_sessions", _G, _CONSOLE, "Browsers that are logged in.")
CONSOLE_PAGES = _metric("console_pages", _G, _CONSOLE, "Pages that are open.")
CONSOLE_LINKS = _metric("console_links", _G, _CONSOLE, "OPC UA sessions of those who are logged in, by state.", "state")
CONSOLE_REFUSED = _metric(
    "console_refused_total",
    _C,
    _CONSOLE,
    "What browsers were refused or what was dropped of theirs, by cause.",
    "cause",
)
