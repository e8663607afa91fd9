from __future__ import annotations

from ua_bridges.ros1.graph import LinkRetry, unregistered


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
