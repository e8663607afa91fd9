"""What processes send is written down by kind, and read back over all of them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from ua_fleet.errors import ConfigError
from ua_fleet.storage.traffic_log import TrafficLog, read_traffic
from ua_fleet.topics import Topic
from ua_fleet.traffic import MessageKind
from ua_fleet.wire import encode_probe
from ua_fleet.wire.messages import Probe, ProbeKind

PROBE = encode_probe(Probe(None, 0, ProbeKind.FIND_APPLICATIONS))


def test_messages_of_all_processes_come_back_in_their_order(tmp_path: Path) -> None:
    paths = [tmp_path / "one.jsonl", tmp_path / "two.jsonl"]
    with closing(TrafficLog(paths[0], {})) as one, closing(TrafficLog(paths[1], {})) as two:
        one.sent(PROBE, 100, 11.0)
        one.sent(PROBE, 300, 13.0)
        two.sent(PROBE, 200, 12.0)
        messages = read_traffic(paths)
    assert [(message.at, message.size) for message in messages] == [(11.0, 100), (12.0, 200), (13.0, 300)]
    assert all(message.kinds == (MessageKind.REGISTRATION,) for message in messages)


def test_what_cannot_be_decoded_is_there_without_a_kind(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with closing(TrafficLog(path, {Topic(2, 2, 1): MessageKind.SENSOR})) as log:
        log.sent(b"\xff", 1, 11.0)
    assert [(message.kinds, message.size) for message in read_traffic([path])] == [((), 1)]


def test_a_line_that_a_kill_cut_off_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with closing(TrafficLog(path, {})) as log:
        log.sent(PROBE, 9, 11.0)
    path.write_text(path.read_text() + '{"t": 12.5, "kinds": ["sta')
    assert [message.size for message in read_traffic([path])] == [9]


def test_a_process_that_is_started_again_goes_on_after_the_half_line(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text('{"t": 12.5, "kinds": ["sta')
    with closing(TrafficLog(path, {})) as log:
        log.sent(PROBE, 9, 13.0)
    assert [message.at for message in read_traffic([path])] == [13.0]


def test_a_long_log_is_kept_once_and_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with closing(TrafficLog(path, {}, most_bytes=100)) as log:
        for number in range(10):
            log.sent(PROBE, number, float(number))
    kept = [[message.size for message in read_traffic([file])] for file in (tmp_path / "log.jsonl.1", path)]
    assert kept[0] + kept[1] == list(range(10))[-len(kept[0] + kept[1]) :]
    assert kept[0]
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 300


def test_a_log_that_somebody_removes_or_blocks_ends_no_process(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with closing(TrafficLog(path, {}, most_bytes=100)) as log:
        path.unlink()
        for at in range(4):
            log.sent(PROBE, 1, float(at))
        assert path.exists()
        tmp_path.joinpath("log.jsonl.1").unlink(missing_ok=True)
        tmp_path.joinpath("log.jsonl.1").mkdir()
        for at in range(4):
            log.sent(PROBE, 1, float(at))
        assert len(read_traffic([path])) >= 4


def test_other_lines_and_a_file_that_is_gone_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_bytes(b'5\n{"t": 1}\n\xff\n{"t": 2.0, "kinds": [], "bytes": 3}\n')
    assert [message.size for message in read_traffic([path, tmp_path / "gone"])] == [3]


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing/log\.jsonl.*cannot write the traffic log"):
        TrafficLog(tmp_path / "missing" / "log.jsonl", {})
