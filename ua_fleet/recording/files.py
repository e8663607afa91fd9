"""Recordings as files: compressed with zstd, never beyond their bound, readable as far as they were written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import zstandard

from ua_fleet.recording.records import Header, Record, RecordingBroken, encode_header, encode_record, read_records

__all__ = ["RecordingWriter", "read_recording"]

LEVEL: Final = 3
_FLUSH_BYTES: Final = 256 * 1024
"""So much stands uncompressed before the size of the file is known again."""
_READ_BYTES: Final = 256 * 1024
"""So much is decompressed at a time, however much a block of the file would become."""
_MOST_WINDOW_BYTES: Final = 8 * 1024 * 1024
"""So much of what was decompressed may be kept for what comes: a file could ask for 2 GiB. Ours ask for 2 MiB."""


class RecordingWriter:
    """A recording that is written; use it as a context."""

    def __init__(self, path: Path, header: Header, most_bytes: int) -> None:
        """Begin a file.

        Raises:
            RecordingBroken: there is such a file already, or it cannot be written.
        """
        self._path, self._most_bytes = path, most_bytes
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise RecordingBroken(f"{path}: exists already; name another file") from None
        except OSError as error:
            raise RecordingBroken(f"{path}: cannot be written ({error.strerror}); name another file") from error
        self._compressor = zstandard.ZstdCompressor(level=LEVEL).compressobj()
        self._is_broken = False
        self.size = 0
        """Bytes of the file."""
        self._unflushed = 0
        self._append(encode_header(header))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        try:
            if not self._is_broken:
                self._put(self._compressor.flush())
                self._flush_file()
        finally:
            with suppress(OSError):  # closing tries once more to write what the disk did not take
                self._file.close()

    def write(self, record: Record) -> bool:
        """Append a record; False where the file would grow beyond its bound. Raises RecordingBroken."""
        encoded = encode_record(record)
        if self._unflushed + len(encoded) > _FLUSH_BYTES:
            self.flush()
        if self.size + self._unflushed + len(encoded) > self._most_bytes:
            self.flush()
            if self.size + len(encoded) > self._most_bytes:
                return False
        self._append(encoded)
        return True

    def flush(self) -> None:
        """Have in the file what was written so far; raises RecordingBroken."""
        if self._unflushed:
            self._put(self._compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK))
            self._flush_file()
            self._unflushed = 0

    def _append(self, content: bytes) -> None:
        self._unflushed += len(content)
        self._put(self._compressor.compress(content))

    def _put(self, compressed: bytes) -> None:
        try:
            self._file.write(compressed)
        except OSError as error:
            raise self._failed(error) from error
        self.size += len(compressed)

    def _flush_file(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> RecordingBroken:
        self._is_broken = True
        return RecordingBroken(f"{self._path}: cannot be written any more ({error.strerror}); free some space")


def read_recording(path: Path) -> tuple[Header, Iterator[Record]]:
    """A recording, read as its records are asked for; raises RecordingBroken as `read_records` does."""
    try:
        return read_records(_blocks(path))
    except RecordingBroken as error:
        raise RecordingBroken(f"{path}: {error}") from error


def _blocks(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            decompressor = zstandard.ZstdDecompressor(max_window_size=_MOST_WINDOW_BYTES)
            reader = decompressor.stream_reader(file, read_size=_READ_BYTES, read_across_frames=True)
            while block := reader.read(_READ_BYTES):
                yield block
    except OSError as error:
        raise RecordingBroken(f"cannot be read ({error.strerror}); name another file") from error
    except zstandard.ZstdError as error:
        raise RecordingBroken(f"is not compressed by zstd, or broken: {error}") from error
