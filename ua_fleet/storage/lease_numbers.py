"""Numbers of leases that were never given before, on disk: `lease_numbers.json` in a bridge's `state_dir`.

    {"version": 1, "reserved": 2000}

`reserved` is the highest number that may have been given. A block is reserved before the first number of it is; a
process that is killed loses the rest of its block.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from ua_fleet.errors import UPGRADE, StorageUnavailable, newer_version
from ua_fleet.storage.files import make_private_folder, write_whole

__all__ = ["LeaseNumbers"]

VERSION: Final = 1
BLOCK: Final = 1000
_GREATEST: Final = 0xFFFF_FFFF
_MAX_BYTES: Final = 4096
_NAME: Final = "lease_numbers.json"


class LeaseNumbers:
    """The numbers of all leases of one bridge. Nothing is touched before the first is needed."""

    def __init__(self, folder: Path) -> None:
        """Use a folder, which is made where it is missing. One process at a time has it (`process_lock`)."""
        self._path = folder / _NAME
        self._next = self._end = 0
        """The next number, and the one after the last that is reserved."""

    def next(self) -> int:
        """A number that is greater than all before; StorageUnavailable where that cannot be made sure of."""
        if self._next == self._end:
            self._reserve()
        number = self._next
        self._next += 1
        return number

    def _reserve(self) -> None:
        try:
            first = self._read() + 1
            if first + BLOCK > _GREATEST:
                raise StorageUnavailable(f"{self._path}: the numbers of leases are used up")
            make_private_folder(self._path.parent)
            document = {"version": VERSION, "reserved": first + BLOCK - 1}
            write_whole(self._path, json.dumps(document).encode())
        except OSError as error:
            reason = (error.strerror or "it").lower()
            raise StorageUnavailable(f"{self._path}: the numbers of leases cannot be kept: {reason}") from error
        self._next, self._end = first, first + BLOCK

    def _read(self) -> int:
        try:
            with self._path.open("rb") as file:
                document: Any = json.loads(file.read(_MAX_BYTES))
            if newer := newer_version(document["version"], VERSION):
                raise StorageUnavailable(f"{self._path}: {newer}; {UPGRADE}")
            reserved = document["reserved"]
            if document["version"] != VERSION or type(reserved) is not int or not 0 <= reserved <= _GREATEST:
                raise ValueError
        except FileNotFoundError:
            return 0
        except (ValueError, TypeError, KeyError, RecursionError):
            said = (
                "is no file of lease numbers; restore it from a backup, or remove it while no robot is driven by hand"
            )
            raise StorageUnavailable(f"{self._path}: {said}") from None
        return reserved
