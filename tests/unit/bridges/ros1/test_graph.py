from __future__ import annotations

from ua_bridges.ros1.graph import GraphWatch, LinkRetry, unregistered

from ua_fleet.topics import Topic


def test_topics_of_the_own_space_are_found_once() -> None:
    watch = GraphWatch(1)
    assert watch.look(["/ua_1_2_7", "/rosout"]).found == [Topic(1, 2, 7)]
    assert watch.look(["/ua_1_2_7", "/ua_1_2_8"]).found == [Topic(1, 2, 8)]
    assert watch.look([]).found == []
    assert watch.look(["/ua_1_2_7"]).found == []  # the subscription is still there


def test_other_spaces_and_other_names_are_left_alone() -> None:
    news = GraphWatch(1).look(["/ua_2_2_7", "/ua_0_2_7", "/robot/ua_1_2_7", "/uav", "/battery_state"])
    assert news == ([], [])


def test_illegal_name_is_told_each_time_it_appears() -> None:
    watch = GraphWatch(1)
    names = ["/ua_1_2", "/ua_1_2_07", "/ua_240_2_7", "/ua_1_0_7", "/ua_1_2_7/x", "/ua_"]
    assert [error.text for error in watch.look(names).illegal] == [
        "ua_1_2",
        "ua_1_2_07",
        "240",
        "ua_1_0_7",
        "ua_1_2_7/x",
        "ua_",
    ]
    assert watch.look(names).illegal == []
    assert watch.look(names[1:]).illegal == []
    assert [error.text for error in watch.look(names).illegal] == ["ua_1_2"]


def test_what_the_master_has_forgotten_is_found() -> None:
    known = {"/a": ["/robot", "/ua_bridge"], "/b": ["/robot"]}
    assert unregistered(["/a", "/b", "/c"], known, "/ua_bridge") == ["/b", "/c"]


def test_retry_waits_longer_each_time_while_a_link_is_missing() -> None:
    retry = LinkRetry(first_s=1.0, longest_s=4.0)
    tried = [tenth / 10 for tenth in range(300) if retry.due(["/robot"], 0, tenth / 10)]
    assert tried == [1.0, 3.0, 7.0, 11.0, 15.0, 19.0, 23.0, 27.0]


def test_retry_begins_anew_with_another_publisher_and_ends_with_the_link() -> None:
    retry = LinkRetry(first_s=1.0, longest_s=30.0)
    assert not retry.due(["/ghost"], 0, 0.0)
    assert retry.due(["/ghost"], 0, 1.0)
    assert not retry.due(["/ghost", "/robot"], 1, 1.1)
    assert retry.due(["/ghost", "/robot"], 1, 2.1)
    assert not retry.due(["/robot"], 1, 2.2)
    assert not retry.due(["/robot"], 0, 3.0)
    assert not retry.due(["/robot"], 0, 3.9)
    assert retry.due(["/robot"], 0, 4.0)


def test_topic_that_was_forgotten_is_found_again() -> None:
    watch = GraphWatch(1)
    watch.look(["/ua_1_2_7"])
    watch.forget(Topic(1, 2, 7))
    assert watch.look(["/ua_1_2_7"]).found == [Topic(1, 2, 7)]
