"""Recordings as files: what is read is what was received, and a file is never larger than its bound."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.recording.recorded import HEADER, LEG, Recording
from ua_fleet.recording import files
from ua_fleet.recording.files import RecordingWriter, read_recording
from ua_fleet.recording.records import (
    Header,
    Record,
    RecordingBroken,
    encode_header,
    encode_record,
    key_name,
    read_records,
)
from ua_fleet.wire import SecurityMode

RECORDS = st.builds(
    Record,
    st.integers(0, (1 << 64) - 1),
    st.integers(0, 0xFFFF),
    st.tuples(st.sampled_from(["192.0.2.7", "fe80::1%3", ""]), st.integers(0, 65_535)),
    st.sampled_from(["", "t-1/7", "c-65535/4294967295"]),
    st.binary(max_size=300),
)


def blocks(content: bytes, size: int) -> list[bytes]:
    return [content[start : start + size] for start in range(0, len(content), size)]


@given(st.lists(RECORDS, max_size=20), st.integers(1, 400))
def test_what_is_read_is_what_was_written(records: list[Record], size: int) -> None:
    content = encode_header(HEADER) + b"".join(map(encode_record, records))
    header, read = read_records(blocks(content, size))
    assert header == HEADER
    assert list(read) == records


@given(st.lists(RECORDS, min_size=1, max_size=3), st.data())
def test_a_recording_that_was_cut_off_has_the_records_before(records: list[Record], data: st.DataObject) -> None:
    head, parts = encode_header(HEADER), [encode_record(record) for record in records]
    content = head + b"".join(parts)
    cut = data.draw(st.integers(len(head), len(content)))
    _, read = read_records([content[:cut]])
    whole = sum(1 for end in range(1, len(parts) + 1) if len(head) + sum(map(len, parts[:end])) <= cut)
    assert list(read) == records[:whole]


@given(st.binary(max_size=200))
def test_rubbish_is_one_error(content: bytes) -> None:
    for rubbish in (content, encode_header(HEADER)[:14] + content, encode_header(HEADER) + b"\x02" + content):
        try:
            list(read_records([rubbish])[1])
        except RecordingBroken:
            continue
        assert len(rubbish) < len(encode_header(HEADER)) + 19, "only what is cut off is no error"


def test_a_newer_file_says_so() -> None:
    content = bytearray(encode_header(HEADER))
    content[8] = 2
    with pytest.raises(RecordingBroken, match="has version 2, and this ua-fleet reads version 1; upgrade"):
        read_records([bytes(content)])


def test_a_file_is_compressed_and_read_again(tmp_path: Path) -> None:
    recording = Recording()
    recording.announce(LEG)
    for step in range(500):
        recording.now = step / 10
        recording.publish(LEG, float(step))
    path = tmp_path / "line.rec"
    with RecordingWriter(path, HEADER, 1 << 30) as writer:
        assert all(map(writer.write, recording.records))
    assert path.read_bytes()[:4] == b"\x28\xb5\x2f\xfd", "zstd"
    assert path.stat().st_size == writer.size < sum(map(len, map(encode_record, recording.records))) / 2
    header, read = read_recording(path)
    assert (header, list(read)) == (HEADER, recording.records)


def test_a_file_is_never_larger_than_its_bound(tmp_path: Path) -> None:
    random, path = Random(1), tmp_path / "line.rec"
    written = 0
    with RecordingWriter(path, HEADER, 300_000) as writer:
        while writer.write(Record(written, 0, ("192.0.2.7", 1), "", random.randbytes(1000))):
            written += 1
    assert 250_000 < path.stat().st_size <= 300_000 + 1000, "the frame of zstd ends after it"
    assert [record.time_ns for record in read_recording(path)[1]] == list(range(written))


def test_what_was_flushed_is_there_when_the_recorder_is_killed(tmp_path: Path) -> None:
    path, copy = tmp_path / "line.rec", tmp_path / "killed.rec"
    records = [Record(number, 0, ("192.0.2.7", 1), "", bytes([number]) * 50) for number in range(20)]
    with RecordingWriter(path, HEADER, 1 << 20) as writer:
        for record in records[:10]:
            writer.write(record)
        writer.flush()
        for record in records[10:]:
            writer.write(record)
        copy.write_bytes(path.read_bytes())
    assert list(read_recording(copy)[1]) == records[:10]


def test_a_small_file_never_becomes_much_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(blocks: Iterator[bytes]) -> tuple[Header, Iterator[Record]]:
        sizes.extend(map(len, blocks))
        return HEADER, iter(())

    sizes: list[int] = []
    monkeypatch.setattr(files, "read_records", measured)
    path = tmp_path / "bomb.rec"
    path.write_bytes(zstandard.ZstdCompressor().compress(bytes(16 << 20)))
    assert path.stat().st_size < 10_000
    read_recording(path)
    assert sum(sizes) == 16 << 20
    assert max(sizes) <= 256 * 1024


def test_a_file_cannot_ask_for_a_large_window(tmp_path: Path) -> None:
    path = tmp_path / "window.rec"
    parameters: Any = zstandard.ZstdCompressionParameters
    settings = parameters.from_level(3, window_log=26)
    compressor = zstandard.ZstdCompressor(compression_params=settings).compressobj()
    path.write_bytes(compressor.compress(encode_header(HEADER)) + compressor.flush())
    with pytest.raises(RecordingBroken, match=r"window\.rec: is not compressed by zstd, or broken"):
        read_recording(path)


def test_a_file_that_is_there_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "line.rec"
    path.write_text("precious")
    with pytest.raises(RecordingBroken, match="exists already"):
        RecordingWriter(path, HEADER, 1000)
    with pytest.raises(RecordingBroken, match=r"line\.rec: is not compressed by zstd"):
        read_recording(path)
    with pytest.raises(RecordingBroken, match="cannot be read"):
        read_recording(tmp_path / "no.rec")
    with pytest.raises(RecordingBroken, match="cannot be written"):
        RecordingWriter(tmp_path / "no" / "line.rec", HEADER, 1000)


@pytest.mark.parametrize("mode", [SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
def test_a_secured_message_stays_secured_and_names_its_key(mode: SecurityMode) -> None:
    recording = Recording(mode)
    recording.announce(LEG)
    recording.publish(LEG, 1.0, "secret of the cell")
    assert {record.key for record in recording.records} == {"t-1/1"}
    is_readable = any(b"secret of the cell" in record.datagram for record in recording.records)
    assert is_readable is (mode is SecurityMode.SIGN)


@pytest.mark.parametrize("datagram", [b"", b"\x00", b"\xf1\x11\x01\x00"])
def test_what_is_no_message_names_no_key(datagram: bytes) -> None:
    assert key_name(datagram, {}) == ""


def fill(writer: RecordingWriter, record: Record) -> None:
    noise = Random(5)
    for _ in range(1000):
        writer.write(record._replace(datagram=noise.randbytes(1000)))


def test_a_full_disk_is_one_line_and_what_was_written_stays(tmp_path: Path) -> None:
    file = tmp_path / "full.rec"
    record = Record(1, 0, ("192.0.2.7", 4840), "", b"x")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handled = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, before[1]))
        broken = pytest.raises(RecordingBroken, match=r"full.rec: cannot be written any more \(File too large\); free")
        with RecordingWriter(file, HEADER, 1 << 30) as writer, broken:
            fill(writer, record)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handled)
    _, records = read_recording(file)
    assert len(list(records)) > 200
