"""What a run cost, beside the equations."""

from __future__ import annotations

from ua_demo.talkrobots.costs import PAPER, Costs, cost_lines

from ua_fleet.storage.traffic_log import SentMessage
from ua_fleet.traffic import MessageKind

SENT = [
    SentMessage(10.0, (MessageKind.REGISTRATION,), 100),
    SentMessage(11.0, (MessageKind.REQUEST,), 60),
    SentMessage(11.5, (MessageKind.STATUS, MessageKind.TELEMETRY), 101),
    SentMessage(12.0, (), 7),
    SentMessage(13.0, (MessageKind.SENSOR,), 40),
]


def test_the_papers_own_figures() -> None:
    # Its worst case is printed as 297, which is Eq. 12 without the robot that fails.
    assert PAPER == {"measured": 284, "best": 251, "worst": 299}


def test_messages_are_counted_by_kind_from_a_moment_on() -> None:
    costs = Costs.of(SENT, since=11.0)
    assert dict(costs.messages) == {
        MessageKind.REQUEST: 1,
        MessageKind.STATUS: 1,
        MessageKind.TELEMETRY: 1,
        MessageKind.SENSOR: 1,
    }
    assert dict(costs.bytes) == {
        MessageKind.REQUEST: 60,
        MessageKind.STATUS: 51,
        MessageKind.TELEMETRY: 50,
        MessageKind.SENSOR: 40,
    }
    assert (costs.counted_messages, costs.counted_bytes) == (2, 111)


def test_the_report_has_every_kind() -> None:
    report = Costs.of(SENT, since=0.0).report()
    assert report["messages"].keys() == report["bytes"].keys() == {kind.value for kind in MessageKind}
    assert report["messages"]["token"] == 0
    assert report["paper"] == PAPER


def test_the_table_stands_beside_the_equations_for_the_same_run() -> None:
    lines = cost_lines(
        Costs.of(SENT, since=0.0),
        robots=6,
        actors=["a", "b", "a", "c", "d", "b", "c", "d", "a"],
        elapsed_s=120,
        faulty=1,
    )
    row = {line.split("  ")[0]: line.split() for line in lines}
    assert row["registration"][1:4] == ["1", "100", "42"]  # 3 x 6 + 1, 6 x 7 / 2, and 2
    assert row["request, response, status"][3:6] == ["2", "111", "36"]
    assert row["token"][1:4] == ["0", "0", "8"]  # each task is another robot's
    assert row["fault"][1:4] == ["0", "0", "2"]
    assert row["sensor"][1:4] == ["1", "40", "124"]  # 120 updates, and 4 messages of who asks
    assert row["what Eq. 12 counts"][4:7] == ["3", "211", "88"]
