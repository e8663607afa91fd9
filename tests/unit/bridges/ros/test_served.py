from __future__ import annotations

from pathlib import Path

import pytest
from ua_bridges.ros.served import Served


def test_next_bridge_knows_whom_this_one_served(tmp_path: Path) -> None:
    first = Served(tmp_path, "ros2", 5)
    first.note(b"a")
    first.note(b"a")
    assert not first.before(b"a")  # it was no other bridge
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) == 16
    first.close()
    second = Served(tmp_path, "ros2", 5)
    assert second.before(b"a")
    assert not second.before(b"b")
    second.note(b"b")
    assert not second.before(b"b")
    second.close()
    third = Served(tmp_path, "ros2", 5)
    assert third.before(b"a")
    assert third.before(b"b")
    third.close()


def test_oldest_are_forgotten(tmp_path: Path) -> None:
    first = Served(tmp_path, 1)
    for number in range(5000):
        first.note(number.to_bytes(4, "big"))
    first.close()
    second = Served(tmp_path, 1)
    assert second.before((4999).to_bytes(4, "big"))
    assert not second.before((0).to_bytes(4, "big"))
    second.close()


@pytest.mark.parametrize("content", [b"", b"x", bytes(100)])
def test_broken_file_is_no_obstacle(tmp_path: Path, content: bytes) -> None:
    Served(tmp_path, 1).close()
    (path,) = tmp_path.iterdir()
    path.write_bytes(content)
    served = Served(tmp_path, 1)
    served.note(b"a")
    served.close()
    again = Served(tmp_path, 1)
    assert again.before(b"a")
    again.close()


def test_without_a_folder_or_with_the_file_in_use_nobody_was_served(tmp_path: Path) -> None:
    first, second, third = Served(tmp_path, 1), Served(tmp_path, 1), Served(None, 1)
    first.note(b"a")
    for served in (second, third):
        served.note(b"b")
        assert not served.before(b"a")
        served.close()
    first.close()
