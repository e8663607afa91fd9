from __future__ import annotations

from ua_bridges.ros2.graph import MOST_TOPICS, GraphWatch, Publisher, PublishersChanged, TopicIllegal, TopicRefused
from ua_bridges.ros2.qos import Offer

INT = "std_msgs/msg/Int32"


def publisher(gid: bytes, *, own: bool = False, kind: str = INT) -> Publisher:
    return Publisher(kind, Offer(gid, True, False), own)


class Graph:
    """A graph that can be changed, and counts what it is asked."""

    def __init__(self) -> None:
        self.topics: dict[str, list[Publisher]] = {}
        self.asked = 0

    def topic_names(self) -> list[str]:
        return list(self.topics)

    def count_publishers(self, topic_name: str) -> int:
        return len(self.topics.get(topic_name, ()))

    def publishers(self, topic_name: str) -> list[Publisher]:
        self.asked += 1
        return self.topics.get(topic_name, [])


A, B, OURS = publisher(b"a"), publisher(b"b"), publisher(b"o", own=True)


def test_topic_of_the_own_space_is_found_when_somebody_publishes_it() -> None:
    graph, watch = Graph(), GraphWatch(5)
    graph.topics = {"/ua_5_2_1": [], "/ua_1_2_1": [A], "/other": [A], "/arm/ua_5_2_1": [A]}
    assert watch.look(graph, 0.0) == []
    graph.topics["/ua_5_2_1"] = [A]
    assert watch.look(graph, 0.1) == [PublishersChanged("/ua_5_2_1", (A,))]
    assert watch.look(graph, 0.2) == []


def test_publishers_that_come_go_and_are_replaced_are_told() -> None:
    graph, watch = Graph(), GraphWatch(5)
    graph.topics["/ua_5_2_1"] = [A]
    watch.look(graph, 0.0)
    graph.topics["/ua_5_2_1"] = [B, A]
    assert watch.look(graph, 0.1) == [PublishersChanged("/ua_5_2_1", (A, B))]
    graph.topics["/ua_5_2_1"] = []
    assert watch.look(graph, 0.2) == [PublishersChanged("/ua_5_2_1", ())]
    del graph.topics["/ua_5_2_1"]
    assert watch.look(graph, 0.3) == []
    graph.topics["/ua_5_2_1"] = [A]
    watch.look(graph, 0.4)
    graph.topics["/ua_5_2_1"] = [B]  # as many as before: seen within a second
    assert watch.look(graph, 0.5) == []
    assert watch.look(graph, 1.5) == [PublishersChanged("/ua_5_2_1", (B,))]


def test_quiet_graph_is_asked_for_counts_only() -> None:
    graph, watch = Graph(), GraphWatch(5)
    graph.topics["/ua_5_2_1"] = [A]
    for look in range(10):
        watch.look(graph, look * 0.1)
    assert graph.asked == 1


def test_own_publishers_are_no_source() -> None:
    graph, watch = Graph(), GraphWatch(5, ["/cmd_vel"])
    graph.topics["/cmd_vel"] = [OURS]
    assert watch.look(graph, 0.0) == []
    graph.topics["/cmd_vel"] = [OURS, A]
    assert watch.look(graph, 0.1) == [PublishersChanged("/cmd_vel", (A,))]


def test_illegal_name_is_told_once_until_it_comes_back() -> None:
    graph, watch = Graph(), GraphWatch(5)
    graph.topics = {"/ua_5_2": [A], "/ua_240_2_1": [A]}
    changes = watch.look(graph, 0.0)
    assert {change.topic_name for change in changes} == {"/ua_5_2", "/ua_240_2_1"}
    assert all(isinstance(change, TopicIllegal) and change.reason for change in changes)
    assert watch.look(graph, 0.1) == []
    graph.topics = {}
    watch.look(graph, 0.2)
    graph.topics = {"/ua_5_2": [A]}
    assert len(watch.look(graph, 0.3)) == 1


def test_topics_are_bounded_told_once_and_forgotten() -> None:
    graph, watch = Graph(), GraphWatch(5, ["/cmd_vel"])
    graph.topics = {f"/ua_5_2_{number}": [] for number in range(1, MOST_TOPICS + 3)}
    assert [type(change) for change in watch.look(graph, 0.0)] == [TopicRefused, TopicRefused]
    assert watch.look(graph, 0.1) == []
    graph.topics = {"/ua_5_2_7": []}  # the others have gone, and had no publishers
    watch.look(graph, 0.2)
    graph.topics["/ua_5_2_9999"] = [publisher(b"1")]
    assert [type(change) for change in watch.look(graph, 0.3)] == [PublishersChanged]
    watch.forget("/ua_5_2_9999")
    assert [type(change) for change in watch.look(graph, 0.4)] == [PublishersChanged]
    watch.look_again("/ua_5_2_9999")
    assert [type(change) for change in watch.look(graph, 0.5)] == [PublishersChanged]
