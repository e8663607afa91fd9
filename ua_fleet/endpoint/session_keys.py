"""Session keys: what a user's client keeps in place of the password, for some days.

    {"version": 1, "keys": [{"id": "9f..", "user": "anna", "name": "anna@desk", "password": "3c..",
                             "issued": 1769860800.0, "until": 1770465600.0, "hash": "b1.."}]}

A key is given as the password of its user. The file has the SHA-256 of its secret alone, which has 256 random bits, so
that no salt and no slow hash is needed. `password` is the mark of the user's password when the key was issued: with
another password, or without the user, the key is void. The file is read again when it changes, so that `ua-fleet user
logout` takes effect in a running server. Times are seconds since 1970.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from ua_fleet.endpoint.key_text import KeyText, new_key
from ua_fleet.endpoint.users import User, UserStore
from ua_fleet.errors import UPGRADE, ServerStartError, StorageUnavailable, UaFleetError, newer_version
from ua_fleet.storage.files import write_whole
from ua_fleet.storage.private_file import exclusive, not_private, signature_of
from ua_fleet.values import StatusCode

__all__ = ["KEYS_FILE", "Issued", "KeyFileError", "KeyUnknown", "SessionKey", "SessionKeys"]

KEYS_FILE: Final = "session-keys.json"
"""In the server's `state_dir`."""
VERSION: Final = 1
MOST_OF_USER: Final = 16
"""Keys of one user; for one more, that which ends first gives way."""
MOST_NAME: Final = 64
"""Characters of a key's name that are kept."""
DAY_S: Final = 86_400.0


class KeyFileError(UaFleetError):
    """The file cannot be used."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Move the file away; users log in again with their passwords."


class KeyUnknown(UaFleetError):
    """The user has no such key."""

    ua_status = StatusCode.BAD_NODE_ID_UNKNOWN
    remedy = "Take a key from `ua-fleet user keys`."


@dataclass(frozen=True, slots=True)
class SessionKey:
    """A key as the server keeps it."""

    id: str
    user: str
    name: str
    """What its user calls it, for lists."""
    password: str
    """The mark of the user's password (`UserStore.mark`)."""
    issued: float
    until: float
    hash: str

    @classmethod
    def parse(cls, data: dict[str, Any]) -> SessionKey:
        """A key of the file; raises ValueError, KeyError or TypeError."""
        texts = [data[name] for name in ("id", "user", "name", "password", "hash")]
        if not all(isinstance(text, str) for text in texts) or len(data["hash"]) != 64:
            raise ValueError("a key's texts are wrong")
        return cls(texts[0], texts[1], texts[2], texts[3], float(data["issued"]), float(data["until"]), texts[4])


@dataclass(frozen=True, slots=True)
class Issued:
    """What was issued."""

    text: KeyText
    key: SessionKey
    ended: tuple[SessionKey, ...] = ()
    """What had to give way."""


class SessionKeys:
    """The keys of all users. Changes block for a write to the disk; nothing else does."""

    def __init__(self, path: Path, users: UserStore, longest_s: float) -> None:
        """Say where they are.

        Args:
            path: of the file.
            users: whose keys they are.
            longest_s: no key is valid for longer, also one that was issued for longer; 0: there are none.
        """
        self._path, self._users, self.longest_s = path, users, longest_s
        self._keys: dict[str, SessionKey] = {}
        self._known: dict[str, SessionKey] = {}
        """The keys when the file could be used last."""
        self._signature: tuple[int, ...] | None = None
        self._lock = threading.Lock()
        self._gone: list[SessionKey] = []
        self._is_writing = False
        """No other process changes the file meanwhile, and what we change holds once the disk has it."""

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def check(self) -> None:
        """Raise ServerStartError when the file's owner, mode or contents must not be used."""
        try:
            self.refresh()
        except KeyFileError as error:
            raise ServerStartError(str(error)) from error

    def refresh(self) -> None:
        """Read the file again if it changed; raises KeyFileError, and then no key is valid until it is mended."""
        with self._lock:
            if self._is_writing:
                return
            self._read()
            # A file that could not be used for a while has taken none away.
            self._gone += [key for key in self._known.values() if key.id not in self._keys]
            self._known = self._keys

    def _read(self) -> None:
        try:
            status = self._path.stat()
        except FileNotFoundError:
            self._keys, self._signature = {}, None
            return
        except OSError as error:
            self._keys, self._signature = {}, None
            raise KeyFileError(
                f"{self._path}: cannot be read ({error.strerror}); no key is valid until then"
            ) from error
        if signature_of(status) == self._signature:
            return
        self._keys, self._signature = {}, None
        if problem := not_private(self._path, status):
            raise KeyFileError(problem)
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
            newer = newer_version(document["version"], VERSION)
            keys = [] if newer else [SessionKey.parse(one) for one in document["keys"]]
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise KeyFileError(
                f"{self._path}: is no file of session keys ({type(error).__name__}: {error}); "
                "remove it, and users log in again"
            ) from error
        if newer:
            raise KeyFileError(f"{self._path}: {newer}; {UPGRADE}")
        self._keys, self._signature = {key.id: key for key in keys}, signature_of(status)

    def drain_gone(self, now: float) -> list[SessionKey]:
        """The keys that another process has taken away since the last call, without those that had ended anyhow."""
        with self._lock:
            gone, self._gone = self._gone, []
        return [key for key in gone if self._ends(key) > now]

    def _ends(self, key: SessionKey) -> float:
        return min(key.until, key.issued + self.longest_s)

    def _is_valid(self, key: SessionKey, now: float) -> bool:
        return now < self._ends(key) and bool(key.password) and key.password == self._users.mark(key.user)

    def holds(self, user: User, now: float) -> bool:
        """Whether the key by which a user has logged in is still valid; true for a password."""
        if not user.session_key:
            return True
        key = self._keys.get(user.session_key)
        return key is not None and key.user == user.name and self._is_valid(key, now)

    def verify(self, name: str, text: KeyText, now: float) -> User | None:
        """The user whose key this is; raises UserFileError and KeyFileError where the files cannot be used."""
        self._users.refresh()
        self.refresh()
        key, user = self._keys.get(text.id), self._users.get(name)
        if key is None or user is None or key.user != name or not self._is_valid(key, now):
            return None
        right = hmac.compare_digest(_hash(text), key.hash)
        return replace(user, session_key=key.id) if right else None

    def issue(self, user: str, name: str, lifetime_s: float, now: float) -> Issued:
        """Issue a key to a user who has shown the password.

        Args:
            user: of the users file.
            name: what the user calls it.
            lifetime_s: wanted; 0 for the longest.
            now: the time.

        Raises:
            KeyUnknown: there is no such user any more.
            KeyFileError: the file cannot be used.
            StorageUnavailable: the file cannot be written; there is no key then.
        """
        mark = self._users.mark(user)
        if not mark:
            raise KeyUnknown(f"there is no user {user} any more")
        until = now + (min(lifetime_s, self.longest_s) if lifetime_s > 0 else self.longest_s)
        text = new_key()
        made = SessionKey(text.id, user, name[:MOST_NAME], mark, now, until, _hash(text))
        with self._changing():
            kept = [key for key in self._keys.values() if self._is_valid(key, now)]
            own = sorted((key for key in kept if key.user == user), key=self._ends)
            ended = tuple(own[: max(0, len(own) + 1 - MOST_OF_USER)])
            self._write([*(key for key in kept if key not in ended), made])
        return Issued(text, made, ended)

    def revoke(self, user: str, key_id: str, now: float) -> SessionKey:
        """End a key of a user; raises KeyUnknown, KeyFileError and StorageUnavailable."""
        ended = self._revoke(lambda key: key.user == user and key.id == key_id, now)
        if not ended:
            raise KeyUnknown(f"user {user} has no session key {key_id[:32]!r}")
        return ended[0]

    def revoke_all(self, user: str, now: float) -> list[SessionKey]:
        """End all keys of a user; raises KeyFileError and StorageUnavailable."""
        return self._revoke(lambda key: key.user == user, now)

    def _revoke(self, is_meant: Callable[[SessionKey], bool], now: float) -> list[SessionKey]:
        with self._changing():
            kept = [key for key in self._keys.values() if self._is_valid(key, now)]
            ended = [key for key in kept if is_meant(key)]
            if ended:
                self._write([key for key in kept if key not in ended])
        return ended

    def list(self, now: float, user: str | None = None) -> Sequence[SessionKey]:
        """The keys that are valid, of one user or of all; the one that ends first comes first."""
        self._users.refresh()
        self.refresh()
        found = (key for key in self._keys.values() if user in (None, key.user) and self._is_valid(key, now))
        return [replace(key, until=self._ends(key)) for key in sorted(found, key=lambda key: (key.user, key.until))]

    @contextlib.contextmanager
    def _changing(self) -> Generator[None]:
        """Keep other processes out, and read what they have written."""
        try:
            with exclusive(self._path):
                self._users.refresh()
                self.refresh()
                yield
        except OSError as error:
            raise StorageUnavailable(f"{self._path}: cannot be written ({error.strerror})") from error

    def _write(self, keys: Iterable[SessionKey]) -> None:
        kept = {key.id: key for key in keys}
        document = {"version": VERSION, "keys": [asdict(key) for key in kept.values()]}
        with self._lock:
            self._is_writing = True
        try:
            write_whole(self._path, f"{json.dumps(document, indent=1)}\n".encode())
            with self._lock:
                self._keys = self._known = kept
        finally:
            with self._lock:
                self._is_writing = False


def _hash(text: KeyText) -> str:
    return hashlib.sha256(text.secret.encode()).hexdigest()
