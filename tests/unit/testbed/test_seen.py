"""What a client notes of nodes, and what robots write of themselves."""

from __future__ import annotations

from tests.testbed.ledger import Begun
from tests.testbed.watching import Seen, state_of
from tests.testbed.words import read_events, read_log


def test_all_is_good_once_all_nodes_are_told() -> None:
    seen = Seen({"a": "drone", "b": "belt"})
    assert not seen.is_all_good()
    seen.connected()
    seen.changed("a", "Good", 1.0)
    assert not seen.is_all_good(), "b may be anything"
    seen.changed("b", "Good", 1.0)
    assert seen.is_all_good()
    assert seen.noticed_after(0.0) is None


def test_the_first_trouble_counts() -> None:
    seen = Seen({"a": "drone"})
    seen.connected()
    seen.changed("a", "Good", 1.0)
    seen.changed("a", "BadNoCommunication", 5.0)
    seen.changed("a", "BadNoCommunication", 6.0)
    assert seen.troubles == [(5.0, "a", "BadNoCommunication")]
    assert seen.noticed_after(2.0) == 3.0
    assert seen.noticed_after(5.5) is None
    seen.changed("a", "Good", 7.0)
    assert seen.is_all_good()


def test_a_lost_connection_is_a_trouble_once() -> None:
    seen = Seen({"a": "drone"})
    seen.lost(0.5)
    assert seen.troubles == [], "it was never there"
    seen.connected()
    seen.changed("a", "Good", 1.0)
    seen.lost(2.0)
    seen.lost(3.0)
    assert seen.troubles == [(2.0, "connection", "lost")]
    seen.connected()
    assert not seen.is_all_good(), "what was known before may be old"


def test_which_robots_were_concerned_is_told() -> None:
    seen = Seen({"a": "drone", "b": "drone", state_of("drone"): "drone", "c": "belt"})
    seen.connected()
    for address in seen.addresses:
        seen.changed(address, "Good", 1.0)
    seen.changed("a", "BadNoCommunication", 5.0)
    assert seen.good_of(["drone"]) == ["b"]
    assert seen.good_of([]) == []
    assert seen.troubles_of(["drone"], 2.0, 6.0) == [("a", "BadNoCommunication")]
    assert seen.troubles_of(["drone"], 6.0, 9.0) == []
    assert seen.troubles_of(["drone"], 2.0, 5.0) == []
    assert seen.troubles_of(["belt"], 2.0, 9.0) == []
    seen.lost(7.0)
    assert seen.troubles_of(["belt"], 2.0, 9.0) == [("connection", "lost")]
    assert seen.troubles_of([], 2.0, 9.0) == []
    assert seen.good_of(["drone", "belt"]) == []


def test_robots_words() -> None:
    text = (
        '{"t": 12.5, "who": "drone", "what": "is ready"}\n'
        '{"t": 13.0, "who": "drone", "what": "begins land", "execution": 7}\n'
        '{"t": 14.0, "who": "ridgeback", "what": "begins load"}\n'
        '{"t": 15.0, "who": "dro'
    )
    assert read_events(text) == [Begun("drone", 13.0, "7"), Begun("ridgeback", 14.0, "")]


def test_controllers_words() -> None:
    text = "2026-01-01T00:00:01.500000000Z ready\n2026-01-01T00:00:02.250000001Z told: move by 12 mm\n"
    (begun,) = read_log("conveyor", text)
    assert (begun.robot, begun.at % 60, begun.mark) == ("conveyor", 2.25, "move by 12 mm")


def test_programs_of_the_arm_have_all_one_name() -> None:
    (begun,) = read_log("ur3", "2026-01-01T00:00:02.250000001Z told: program ua_fleet\n")
    assert begun.mark == ""
