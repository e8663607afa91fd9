"""Reserved nonces on disk: `nonces.json` in a folder that only its owner may write.

    {"version": 1, "groups": {"t-2": {"reserved": {"7": 131072}, "pruned": 3, "pruned_number": 65536}}}

`reserved` is the highest number given for each token. The oldest tokens are pruned; should one of them ever come back,
its numbers go on above the highest of all that were pruned.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ua_fleet.errors import UPGRADE, ConfigError, newer_version
from ua_fleet.printing import config_option
from ua_fleet.pubsub.security.nonces import NoncesUnavailable
from ua_fleet.storage.files import make_private_folder, write_whole

__all__ = ["FileNonces"]

VERSION: Final = 1
MOST_TOKENS: Final = 32
"""Tokens that are kept of each group, the latest ones."""
MAX_BYTES: Final = 4 * 1024 * 1024
_NAME: Final = "nonces.json"


@dataclass(slots=True)
class _Group:
    reserved: dict[int, int] = field(default_factory=dict[int, int])
    """The latest reserved last."""
    pruned: int = 0
    """The latest token that was pruned; 0 is none."""
    pruned_number: int = 0

    def reserve(self, token_id: int, count: int) -> int:
        last = self.reserved.pop(token_id, None)
        if last is None:
            last = self.pruned_number if self.pruned and not _is_later(token_id, self.pruned) else 0
        self.reserved[token_id] = last + count
        while len(self.reserved) > MOST_TOKENS:
            oldest = next(iter(self.reserved))
            self.pruned_number = max(self.pruned_number, self.reserved.pop(oldest))
            if not self.pruned or _is_later(oldest, self.pruned):
                self.pruned = oldest
        return last + 1


def _is_later(token_id: int, other: int) -> bool:
    """Whether a token comes after another one; they begin anew after 2^32 - 1."""
    return 0 < (token_id - other) & 0xFFFF_FFFF < 1 << 31


class FileNonces:
    """NonceReservations that survive a kill. Several processes may share the folder."""

    def __init__(self, folder: Path) -> None:
        """Use a folder, which is made where it is missing.

        Raises:
            ConfigError: the file there cannot be read or understood, or others may remove it. Which nonces were used
                is not known then, so nothing may be sent with the keys there are.
        """
        self._path = folder / _NAME
        try:
            make_private_folder(folder)
            _check_rights(folder)
            with self._locked():
                self._read()
        except OSError as error:
            raise ConfigError(
                f"the reserved nonces cannot be kept ({error.strerror})",
                file=str(self._path),
                suggestion="give this user a folder that it can write",
            ) from error

    def reserve(self, group_id: str, token_id: int, count: int) -> int:
        """See NonceReservations."""
        try:
            with self._locked():
                groups = self._read()
                first = groups.setdefault(group_id, _Group()).reserve(token_id, count)
                self._write(groups)
        except OSError as error:
            raise NoncesUnavailable(
                f"{self._path}: cannot be written ({error.strerror}); sending ends with the nonces that are reserved"
            ) from error
        except ConfigError as error:
            raise NoncesUnavailable(str(error)) from error
        return first

    @contextlib.contextmanager
    def _locked(self) -> Generator[None]:
        lock = os.open(self._path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)

    def _read(self) -> dict[str, _Group]:
        try:
            with self._path.open("rb") as file:
                text = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            return {}
        try:
            if len(text) > MAX_BYTES:
                raise ValueError
            document = json.loads(text)
            newer = newer_version(document["version"], VERSION)
            if not newer:
                return _groups_of(document)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise ConfigError(
                "is no file of reserved nonces",
                file=str(self._path),
                suggestion=f"make new keys (ua-fleet keys rotate{config_option()}, or InvalidateKeys of the key "
                "service), then remove this file",
            ) from None
        raise ConfigError(newer, file=str(self._path), suggestion=UPGRADE)

    def _write(self, groups: dict[str, _Group]) -> None:
        document = {
            "version": VERSION,
            "groups": {
                group_id: {
                    "reserved": {str(token_id): number for token_id, number in group.reserved.items()},
                    "pruned": group.pruned,
                    "pruned_number": group.pruned_number,
                }
                for group_id, group in groups.items()
            },
        }
        write_whole(self._path, json.dumps(document).encode())


def _check_rights(folder: Path) -> None:
    if folder.stat().st_mode & 0o022:
        raise ConfigError(
            "others may write there, and make nonces repeat", file=str(folder), suggestion=f"run: chmod go-w {folder}"
        )


def _groups_of(document: Any) -> dict[str, _Group]:
    if document["version"] != VERSION:
        raise ValueError
    return {
        str(group_id): _Group(
            {_number(int(token_id)): _number(last) for token_id, last in group["reserved"].items()},
            _number(group["pruned"]),
            _number(group["pruned_number"]),
        )
        for group_id, group in document["groups"].items()
    }


def _number(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError
    return value
