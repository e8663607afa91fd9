from __future__ import annotations

from pathlib import Path

import pytest
from ua_bridges.ros.delivered import STATE_VARIABLE, Delivered, state_folder

from ua_fleet.topics import Topic

A, B = Topic(1, 2, 1001), Topic(0, 2, 7)


def test_next_bridge_knows_the_last_message_of_each_topic(tmp_path: Path) -> None:
    first = Delivered(tmp_path, "ros2", 5)
    for topic, timestamp in ((A, 10), (B, 20), (A, 30)):
        first.note(topic, timestamp)
    assert not first.is_known(A, 30)  # it was no other bridge
    first.close()
    second = Delivered(tmp_path, "ros2", 5)
    assert second.is_known(A, 30)
    assert not second.is_known(A, 10)
    assert second.is_known(B, 20)
    second.note(A, 40)
    assert second.is_known(A, 30)
    second.close()


def test_other_bridges_know_nothing_of_it(tmp_path: Path) -> None:
    first = Delivered(tmp_path, "ros2", 5)
    first.note(A, 10)
    second = Delivered(tmp_path, "ros2", 6)
    assert not second.is_known(A, 10)
    first.close()
    second.close()


def test_nothing_is_lost_when_the_process_dies(tmp_path: Path) -> None:
    dead = Delivered(tmp_path, 1)
    dead.note(A, 10)
    (path,) = tmp_path.iterdir()
    assert path.read_bytes()[:16] == bytes((1, 0, 2, 0, 0xE9, 3, 0, 0, 10)) + bytes(7)
    dead.close()


def test_file_in_use_is_left_alone(tmp_path: Path) -> None:
    first, second = Delivered(tmp_path, 1), Delivered(tmp_path, 1)
    first.note(A, 10)
    second.note(A, 11)
    second.close()
    first.close()
    third = Delivered(tmp_path, 1)
    assert third.is_known(A, 10)
    third.close()


def test_file_grows(tmp_path: Path) -> None:
    first = Delivered(tmp_path, 1)
    for number in range(1, 2500):
        first.note(Topic(1, 2, number), number)
    first.close()
    second = Delivered(tmp_path, 1)
    assert all(second.is_known(Topic(1, 2, number), number) for number in range(1, 2500))
    second.close()


@pytest.mark.parametrize("content", [b"", b"x", bytes(100), b"\xff" * 16 * 70_000])
def test_broken_file_is_no_obstacle(tmp_path: Path, content: bytes) -> None:
    Delivered(tmp_path, 1).close()
    (path,) = tmp_path.iterdir()
    path.write_bytes(content)
    delivered = Delivered(tmp_path, 1)
    delivered.note(A, 10)
    delivered.close()


def test_without_a_folder_nothing_is_known() -> None:
    delivered = Delivered(None, 1)
    delivered.note(A, 10)
    assert not delivered.is_known(A, 10)
    delivered.close()


def test_message_without_timestamp_is_not_known(tmp_path: Path) -> None:
    delivered = Delivered(tmp_path, 1)
    delivered.note(A, None)
    assert not delivered.is_known(A, None)
    delivered.close()


def test_folder_of_somebody_else_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "open"
    monkeypatch.setenv(STATE_VARIABLE, str(folder))
    assert state_folder() == folder
    folder.chmod(0o777)
    assert state_folder() is None
    folder.rmdir()
    folder.symlink_to(tmp_path)
    assert state_folder() is None


def test_folder_is_the_users_runtime_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(STATE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert state_folder() == tmp_path / "ua_fleet"
