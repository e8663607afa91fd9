from __future__ import annotations

from ua_bridges.ros.names import UaNames

from ua_fleet.topics import Topic


def test_topics_of_the_own_space_are_found_once() -> None:
    watch = UaNames(1)
    assert watch.look(["/ua_1_2_7", "/rosout"]).found == [Topic(1, 2, 7)]
    assert watch.look(["/ua_1_2_7", "/ua_1_2_8"]).found == [Topic(1, 2, 8)]
    assert watch.look([]).found == []
    assert watch.look(["/ua_1_2_7"]).found == []  # the subscription is still there


def test_other_spaces_and_other_names_are_left_alone() -> None:
    news = UaNames(1).look(["/ua_2_2_7", "/ua_0_2_7", "/robot/ua_1_2_7", "/uav", "/battery_state"])
    assert news == ([], [])


def test_illegal_name_is_told_each_time_it_appears() -> None:
    watch = UaNames(1)
    names = ["/ua_1_2", "/ua_1_2_07", "/ua_240_2_7", "/ua_1_0_7", "/ua_1_2_7/x", "/ua_"]
    assert [error.text for _, error in watch.look(names).illegal] == [
        "ua_1_2",
        "ua_1_2_07",
        "240",
        "ua_1_0_7",
        "ua_1_2_7/x",
        "ua_",
    ]
    assert watch.look(names).illegal == []
    assert watch.look(names[1:]).illegal == []
    assert [error.text for _, error in watch.look(names).illegal] == ["ua_1_2"]


def test_topic_that_was_forgotten_is_found_again() -> None:
    watch = UaNames(1)
    watch.look(["/ua_1_2_7"])
    watch.forget("/ua_1_2_7")
    assert watch.look(["/ua_1_2_7"]).found == [Topic(1, 2, 7)]
