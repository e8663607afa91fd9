"""Key files: the keys of one SecurityGroup in each, in a folder that only its owner may enter.

    {"version": 1, "group": "t-2", "policy": "PubSub-Aes256-CTR", "lifetime_s": 3600.0, "keys": [
      {"token": 7, "created": "2026-01-31T12:00:00Z", "active_from": "2026-01-31T12:00:10Z",
       "key": "68 bytes as hexadecimal digits (52 for PubSub-Aes128-CTR)"}]}

`key` is the key data that GetSecurityKeys gives too: SigningKey, EncryptingKey, KeyNonce (OPC 10000-14 8.3.2). A new
key stands in the file before it becomes current, so that every reader knows it when the first publisher uses it.
No error and no representation shows key data.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import json
import os
import re
import secrets
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, cast

from ua_fleet.errors import UPGRADE, ConfigError, newer_version
from ua_fleet.printing import config_option
from ua_fleet.storage.files import make_private_folder, write_whole
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["FileKey", "FileStamp", "KeyFile", "KeyFolder", "NoKeyFile"]

VERSION: Final = 1
MAX_BYTES: Final = 256 * 1024
MAX_KEYS: Final = 100
MAX_TOKEN_ID: Final = 0xFFFF_FFFF

_GROUP_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", re.ASCII)
_TOO_MANY: Final = "wait until the first of those to come is current"
_SUFFIX: Final = ".json"

FileStamp = tuple[int, ...]
"""Changes whenever a file or its rights do."""


class NoKeyFile(ConfigError):
    """A SecurityGroup has no key file."""


@dataclass(frozen=True, slots=True)
class FileKey:
    """One key of a SecurityGroup."""

    token_id: int
    created: float
    """Seconds since 1970, as are all times here."""
    active_from: float
    """From then on publishers use this key, until that of the next one."""
    key_data: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class KeyFile:
    """The keys of one SecurityGroup, in the order in which they become current."""

    group_id: str
    policy: SecurityPolicy
    lifetime_s: float
    """How long a key should be used before the next one is made."""
    keys: tuple[FileKey, ...]

    @classmethod
    def new(cls, group_id: str, policy: SecurityPolicy, lifetime_s: float, wall_s: float) -> KeyFile:
        """A file with a first key, current at once."""
        return cls(group_id, policy, lifetime_s, (_new_key(1, policy, wall_s, wall_s),))

    def current_index(self, wall_s: float) -> int:
        """Position of the key that publishers use at a time; the first where none is active yet."""
        return max(0, sum(key.active_from <= wall_s for key in self.keys) - 1)

    def rotated(self, wall_s: float, delay_s: float, past_keys: int) -> KeyFile:
        """With one key more, current after a delay (and after those that are to come before), without the oldest ones.

        Args:
            wall_s: the time now.
            delay_s: time for every reader to notice the new key.
            past_keys: replaced keys that stay in the file.
        """
        last = self.keys[-1]
        token_id = last.token_id % MAX_TOKEN_ID + 1
        key = _new_key(token_id, self.policy, wall_s, max(wall_s, last.active_from) + delay_s)
        kept = self.keys[max(0, self.current_index(wall_s) - past_keys) :]
        return KeyFile(self.group_id, self.policy, self.lifetime_s, (*kept, key))

    def replaced(self, wall_s: float) -> KeyFile:
        """With a new key alone, current at once: for when a key has leaked."""
        token_id = self.keys[-1].token_id % MAX_TOKEN_ID + 1
        key = _new_key(token_id, self.policy, wall_s, wall_s)
        return KeyFile(self.group_id, self.policy, self.lifetime_s, (key,))


def _new_key(token_id: int, policy: SecurityPolicy, wall_s: float, active_from: float) -> FileKey:
    return FileKey(token_id, wall_s, active_from, secrets.token_bytes(policy.key_data_bytes))


class KeyFolder:
    """The folder of key files. Only its owner (and root) may read or write it and what is in it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def path_of(self, group_id: str) -> Path:
        """The file of a group; raises ConfigError for an id that is no name of a file."""
        if not _GROUP_ID.fullmatch(group_id):
            raise ConfigError("is no name of a SecurityGroup with a key file", file=str(self.path), key=repr(group_id))
        return self.path / f"{group_id}{_SUFFIX}"

    def groups(self) -> list[str]:
        """The groups that have a file; raises ConfigError where others may get at the folder."""
        if not self.path.exists():
            return []
        self.check()
        found = (path.name.removesuffix(_SUFFIX) for path in self.path.glob(f"*{_SUFFIX}"))
        return sorted(name for name in found if _GROUP_ID.fullmatch(name))

    def check(self) -> None:
        """Raise ConfigError where the folder is missing, or others may get at it."""
        try:
            status = self.path.stat()
        except OSError as error:
            reason = (error.strerror or "it").lower()
            raise ConfigError(
                f"cannot be entered: {reason}",
                file=str(self.path),
                suggestion=f"run: ua-fleet keys create{config_option()}",
            ) from error
        _check_rights(self.path, status, 0o700)

    def stamp(self, group_id: str) -> FileStamp:
        """What tells one version of a group's file from another; raises ConfigError as `read` does."""
        self.check()
        path = self.path_of(group_id)
        try:
            return _stamp(path.stat())
        except OSError as error:
            raise _unreadable(path, error) from error

    def read(self, group_id: str) -> KeyFile:
        """The keys of a group.

        Raises:
            NoKeyFile: it has none.
            ConfigError: the file cannot be read or others can, or it is broken; with file, key and remedy.
        """
        return self.read_stamped(group_id)[0]

    def read_stamped(self, group_id: str) -> tuple[KeyFile, FileStamp]:
        """The keys of a group, and the stamp of what was read."""
        self.check()
        path = self.path_of(group_id)
        try:
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                _check_rights(path, status, 0o600)
                content = file.read(MAX_BYTES + 1)
        except OSError as error:
            raise _unreadable(path, error) from error
        return _Parser(path, group_id).file(content), _stamp(status)

    def write(self, key_file: KeyFile) -> None:
        """Write a group's file so that a reader sees the old one or the new one, whole, also after a crash."""
        path = self.path_of(key_file.group_id)
        if len(key_file.keys) > MAX_KEYS:
            raise ConfigError(f"would have more than {MAX_KEYS} keys", file=str(path), suggestion=_TOO_MANY)
        try:
            make_private_folder(self.path)
            self.check()
            write_whole(path, _text(key_file).encode())
        except OSError as error:
            reason = (error.strerror or "it").lower()
            raise ConfigError(f"cannot be written: {reason}", file=str(path)) from error

    @contextlib.contextmanager
    def exclusive(self) -> Generator[None]:
        """Keep other processes from changing keys meanwhile; makes the folder."""
        try:
            make_private_folder(self.path)
            self.check()
            lock = os.open(self.path / ".lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        except OSError as error:
            reason = (error.strerror or "it").lower()
            raise ConfigError(f"cannot be written: {reason}", file=str(self.path)) from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)


def _stamp(status: os.stat_result) -> FileStamp:
    return (status.st_mtime_ns, status.st_ino, status.st_size, status.st_mode, status.st_uid)


def _check_rights(path: Path, status: os.stat_result, wanted: int) -> None:
    if status.st_mode & 0o077:
        raise ConfigError(
            f"others may read or write it (mode {status.st_mode & 0o777:o})",
            file=str(path),
            suggestion=f"run: chmod {wanted:o} {path}",
        )
    if status.st_uid not in (os.geteuid(), 0):
        raise ConfigError("belongs to another user", file=str(path), suggestion=f"run: chown {os.geteuid()} {path}")


def _unreadable(path: Path, error: OSError) -> ConfigError:
    if isinstance(error, FileNotFoundError):
        return NoKeyFile(
            "there is no such key file",
            file=str(path),
            suggestion=f"run: ua-fleet keys create {path.stem}{config_option()}",
        )
    reason = (error.strerror or "it").lower()
    remedy = f"run: chown {os.geteuid()} {path}" if isinstance(error, PermissionError) else ""
    return ConfigError(f"cannot be read: {reason}", file=str(path), suggestion=remedy)


def _time_text(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _text(key_file: KeyFile) -> str:
    keys = [
        {
            "token": key.token_id,
            "created": _time_text(key.created),
            "active_from": _time_text(key.active_from),
            "key": key.key_data.hex(),
        }
        for key in key_file.keys
    ]
    document = {
        "version": VERSION,
        "group": key_file.group_id,
        "policy": key_file.policy.short_name,
        "lifetime_s": key_file.lifetime_s,
        "keys": keys,
    }
    return json.dumps(document, indent=2) + "\n"


class _Parser:
    """Reads one file. Its problems name the place; what stands there is shown only where it cannot be a secret."""

    def __init__(self, path: Path, group_id: str) -> None:
        self._path, self._group_id = path, group_id

    def _problem(self, key: str, message: str, suggestion: str = "") -> ConfigError:
        return ConfigError(message, file=str(self._path), key=key, suggestion=suggestion)

    def file(self, content: bytes) -> KeyFile:
        document = self._document(content)
        if newer := newer_version(document.get("version"), VERSION):
            raise self._problem("version", newer, UPGRADE)
        self._only(document, "", ("version", "group", "policy", "lifetime_s", "keys"))
        if document["version"] != VERSION:
            raise self._problem(
                "version", f"this ua-fleet reads version {VERSION} of key files", "take it from a backup"
            )
        if document["group"] != self._group_id:
            raise self._problem("group", f"the file is not that of {self._group_id}", "put the right file here")
        try:
            policy = SecurityPolicy.named(str(document["policy"]))
        except KeyError:
            known = ", ".join(known.short_name for known in SecurityPolicy)
            raise self._problem("policy", "is no policy of PubSub", f"allowed: {known}") from None
        lifetime_s = self._number(document["lifetime_s"], "lifetime_s")
        listed: Any = document["keys"]
        entries = cast("Sequence[Any]", listed) if isinstance(listed, list) else ()
        if not 0 < len(entries) <= MAX_KEYS:
            raise self._problem("keys", f"must be a list of 1 to {MAX_KEYS} keys")
        keys = tuple(self._key(entry, f"keys[{i}]", policy) for i, entry in enumerate(entries))
        for i, (before, after) in enumerate(itertools.pairwise(keys), start=1):
            if after.token_id != before.token_id % MAX_TOKEN_ID + 1:
                raise self._problem(f"keys[{i}].token", "must be the token before it, and 1")
            if after.active_from < before.active_from:
                raise self._problem(f"keys[{i}].active_from", "is before that of the key before it")
        return KeyFile(self._group_id, policy, lifetime_s, keys)

    def _document(self, content: bytes) -> Mapping[str, Any]:
        if len(content) > MAX_BYTES:
            raise self._problem("", f"is larger than {MAX_BYTES // 1024} KiB")
        try:
            document: Any = json.loads(content)
        except (ValueError, RecursionError) as error:
            # The error has the whole file, and so the keys, as an attribute.
            line = error.lineno if isinstance(error, json.JSONDecodeError) else 0
            raise ConfigError(
                "cannot be read as JSON", file=str(self._path), line=line, suggestion="take it from a backup"
            ) from None
        if not isinstance(document, dict):
            raise self._problem(
                "", "is no key file", f"move it away and run: ua-fleet keys create {self._group_id}{config_option()}"
            )
        return cast("dict[str, Any]", document)

    def _only(self, mapping: Mapping[str, Any], place: str, names: tuple[str, ...]) -> None:
        dot = f"{place}." if place else ""
        for name in names:
            if name not in mapping:
                raise self._problem(f"{dot}{name}", "is missing", "take the file from a backup")
        if len(mapping) > len(names):
            raise self._problem(place, f"has other keys than {', '.join(names)}", "remove them")

    def _number(self, value: Any, place: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e12:
            raise self._problem(place, "must be a number of seconds above 0")
        return float(value)

    def _time(self, value: Any, place: str) -> float:
        try:
            time = datetime.fromisoformat(value)
        except (TypeError, ValueError):
            time = None
        if time is None or time.tzinfo is None:
            raise self._problem(place, "must be a time like 2026-01-31T12:00:00Z")
        return time.timestamp()

    def _key(self, entry: Any, place: str, policy: SecurityPolicy) -> FileKey:
        if not isinstance(entry, dict):
            raise self._problem(place, "must have token, created, active_from and key")
        fields = cast("dict[str, Any]", entry)
        self._only(fields, place, ("token", "created", "active_from", "key"))
        token_id = fields["token"]
        if isinstance(token_id, bool) or not isinstance(token_id, int) or not 1 <= token_id <= MAX_TOKEN_ID:
            raise self._problem(f"{place}.token", f"must be a whole number, 1 to {MAX_TOKEN_ID}")
        try:
            key_data = bytes.fromhex(fields["key"])
        except (TypeError, ValueError):
            raise self._problem(f"{place}.key", "must be hexadecimal digits") from None
        wanted = policy.key_data_bytes
        if len(key_data) != wanted:
            raise self._problem(f"{place}.key", f"has {len(key_data)} bytes, and {policy.short_name} needs {wanted}")
        created = self._time(fields["created"], f"{place}.created")
        return FileKey(token_id, created, self._time(fields["active_from"], f"{place}.active_from"), key_data)
