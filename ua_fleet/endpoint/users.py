"""The users of the server: a YAML file with roles and salted scrypt hashes.

    version: 1
    users:
      alice: {role: operator, n: 32768, r: 8, p: 1, salt: <base64>, hash: <base64>}

The file must be readable and writable by its owner alone. It is read again when it changes, so that
`ua-fleet user add` and `remove` take effect in a running server.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import re
import secrets
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from ua_fleet.endpoint.key_text import looks_like_key
from ua_fleet.errors import UPGRADE, ServerStartError, UaFleetError, newer_version
from ua_fleet.printing import config_option
from ua_fleet.storage.files import write_whole
from ua_fleet.storage.private_file import exclusive, not_private, signature_of
from ua_fleet.values import StatusCode

__all__ = [
    "ANONYMOUS",
    "DEFAULT_COST",
    "PasswordLane",
    "Role",
    "ScryptCost",
    "User",
    "UserFileError",
    "UserStore",
    "check_password",
    "current_user",
]

USERS_FILE: Final = "users.yaml"
VERSION: Final = 1
MIN_PASSWORD: Final = 8
MAX_PASSWORD: Final = 1024
"""Longest password that is hashed: what is longer is no password, and costs time."""
_AT_A_TIME: Final = 2
"""Passwords that are checked at the same time."""
MAX_WAITING: Final = 32
"""Logins that may wait for their password check; then the server is too busy for more."""
MAX_WAITING_OF_ORIGIN: Final = 8
"""Of these, those that may come from one address."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_LOADER: Final[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DUMPER: Final[Any] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""In C where PyYAML was built so, which takes a tenth of the time."""
_UNREADABLE: Final = (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError, RecursionError)
"""What is wrong with a file that is no users file; an error of base64 is a ValueError."""


class Role(StrEnum):
    """What a user may do; each role may do all that the ones before it may."""

    OBSERVER = "observer"
    """Browses, reads and subscribes."""
    OPERATOR = "operator"
    """Also writes values and calls methods."""
    ENGINEER = "engineer"
    """Also calls the methods that change how the fleet behaves."""

    @property
    def rank(self) -> int:
        """Position in the order of the roles."""
        return _RANKS[self]

    def covers(self, needed: Role) -> bool:
        """Whether this role may do what `needed` may."""
        return self.rank >= needed.rank


_RANKS: Final = {role: rank for rank, role in enumerate(Role)}


@dataclass(frozen=True, slots=True)
class User:
    """A user who has proved who he is."""

    name: str
    role: Role
    anonymous: bool = False
    bridge: str = ""
    """The bridge that this is; it has proved so by its certificate. Empty for people."""
    session_key: str = ""
    """Id of the session key by which this user has proved it; empty for a password."""

    @classmethod
    def of_bridge(cls, name: str) -> User:
        """A bridge. No user of the file can have its name, which no user name's pattern allows."""
        return cls(f"bridge:{name}", Role.OBSERVER, bridge=name)

    @property
    def shown_role(self) -> str:
        """The role for a log."""
        return "bridge" if self.bridge else self.role.value


ANONYMOUS: Final = User("anonymous", Role.OBSERVER, anonymous=True)

current_user: ContextVar[User | None] = ContextVar("current_user", default=None)
"""The caller, while the implementation of a method runs."""


class UserFileError(UaFleetError):
    """The users file cannot be used as asked."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "Correct the name or the password, or the rights of the users file (docs/security.md)."


def check_password(password: str) -> None:
    """Raise UserFileError where nobody may have this password."""
    if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
        raise UserFileError(f"the password must have {MIN_PASSWORD} to {MAX_PASSWORD} characters")
    if "\0" in password:
        raise UserFileError("the password has a NUL character; choose one without")
    if looks_like_key(password):
        raise UserFileError("the password looks like a session key; choose another one")


@dataclass(frozen=True, slots=True)
class ScryptCost:
    """Cost parameters of scrypt (RFC 7914); memory is 128 * n * r bytes."""

    n: int
    r: int
    p: int

    def hash(self, password: str, salt: bytes) -> bytes:
        """The 32-byte hash of a password."""
        return hashlib.scrypt(
            password.encode(), salt=salt, n=self.n, r=self.r, p=self.p, maxmem=2 * 128 * self.n * self.r, dklen=32
        )

    def check(self) -> None:
        """Refuse parameters that are no protection, or that would take the machine's memory."""
        if self.n < 2 or self.n & (self.n - 1) or self.n > 2**20 or not 1 <= self.r <= 32 or not 1 <= self.p <= 16:
            raise ValueError(f"scrypt n={self.n}, r={self.r}, p={self.p} is out of bounds")


DEFAULT_COST: Final = ScryptCost(n=2**15, r=8, p=1)
"""32 MiB and some 0.1 s for each login."""


@dataclass(frozen=True, slots=True)
class _Entry:
    user: User
    cost: ScryptCost
    salt: bytes
    hash: bytes

    @classmethod
    def parse(cls, name: str, data: dict[str, Any]) -> _Entry:
        cost = ScryptCost(int(data["n"]), int(data["r"]), int(data["p"]))
        cost.check()
        salt, digest = (base64.b64decode(data[key], validate=True) for key in ("salt", "hash"))
        if len(salt) < 16 or len(digest) != 32:
            raise ValueError("salt or hash is too short")
        return cls(User(name, Role(data["role"])), cost, salt, digest)

    def dump(self) -> dict[str, Any]:
        encoded = {key: base64.b64encode(value).decode() for key, value in (("salt", self.salt), ("hash", self.hash))}
        return {"role": self.user.role.value, "n": self.cost.n, "r": self.cost.r, "p": self.cost.p, **encoded}


class PasswordLane(NamedTuple):
    """Where a password check waits; what waits in one lane takes no place in another."""

    name: str
    source: str
    """Whom the check counts for."""
    places: int
    """Checks that may wait in the lane."""
    places_of_source: int
    """Of these, those of one source."""


class UserStore:
    """The users file. `verify` blocks for the length of one hash; `authenticate` does not block the event loop."""

    def __init__(self, path: Path, cost: ScryptCost = DEFAULT_COST) -> None:
        self._path = path
        self._cost = cost
        self._entries: dict[str, _Entry] = {}
        self._signature: tuple[int, ...] | None = None
        self._lock = threading.Lock()
        self._decoy = _Entry(User("", Role.OBSERVER), cost, secrets.token_bytes(16), secrets.token_bytes(32))
        self._slots: asyncio.Semaphore | None = None
        # Of their own: whatever else is computed in the background keeps no login waiting.
        self._threads = ThreadPoolExecutor(_AT_A_TIME, thread_name_prefix="asyncio_passwords")
        self._waiting: dict[str, Counter[str]] = {}
        """Checks of each source, by lane."""
        self.last_check_s = 0.0
        """How long the last password check took, with the time that it waited."""
        self.generation = 0
        """Grows whenever the users have changed."""

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def check(self) -> None:
        """Raise ServerStartError when the file's owner, mode or contents must not be used."""
        try:
            self.refresh()
        except UserFileError as error:
            raise ServerStartError(str(error)) from error

    def refresh(self) -> None:
        """Read the file again if it changed. On an error there are no users until it is mended."""
        with self._lock:
            try:
                status = self._path.stat()
            except FileNotFoundError:
                self._forget()
                return
            except OSError as error:
                self._forget()
                raise UserFileError(f"{self._path}: cannot be read ({error.strerror})") from error
            signature = signature_of(status)
            if signature == self._signature:
                return
            self._forget()
            if problem := not_private(self._path, status):
                raise UserFileError(problem)
            self._entries = self._parse()
            self._signature = signature
            self.generation += 1

    def _forget(self) -> None:
        if self._entries:
            self.generation += 1
        self._entries, self._signature = {}, None

    def _parse(self) -> dict[str, _Entry]:
        try:
            document = yaml.load(self._path.read_text(encoding="utf-8"), Loader=_LOADER)  # noqa: S506 - a safe one
            newer = newer_version(document["version"], VERSION)
            if not newer and document["version"] != VERSION:
                raise ValueError(f"version {document['version']!r} is not known")
            users: dict[str, dict[str, Any]] = document["users"] or {}
            if not newer:
                return {name: _Entry.parse(name, data) for name, data in users.items()}
        except _UNREADABLE as error:
            reason = str(error).replace("\n", " ")
            raise UserFileError(
                f"{self._path}: is no users file ({type(error).__name__}: {reason}); "
                f"move it away and add the users again with: ua-fleet user add NAME{config_option()}"
            ) from error
        raise UserFileError(f"{self._path}: {newer}; {UPGRADE}")

    def add(self, name: str, password: str, role: Role, *, replace_existing: bool = False) -> User:
        """Add a user, or give an existing one a new password and role; raises UserFileError."""
        if not _NAME.fullmatch(name) or name == ANONYMOUS.name:
            raise UserFileError(f"{name!r} is no user name; use 1 to 64 letters, digits and _ . @ -")
        check_password(password)
        salt = secrets.token_bytes(16)
        entry = _Entry(User(name, role), self._cost, salt, self._cost.hash(password, salt))
        with exclusive(self._path):
            self.refresh()
            if name in self._entries and not replace_existing:
                raise UserFileError(
                    f"user {name} exists; remove it first with: ua-fleet user remove {name}{config_option()}"
                )
            self._write({**self._entries, name: entry})
        return entry.user

    def remove(self, name: str) -> None:
        """Remove a user; raises UserFileError when there is none of that name."""
        with exclusive(self._path):
            self.refresh()
            if name not in self._entries:
                raise UserFileError(f"there is no user {name}; list them with: ua-fleet user list{config_option()}")
            self._write({key: entry for key, entry in self._entries.items() if key != name})

    def list(self) -> tuple[User, ...]:
        """All users, by name."""
        self.refresh()
        return tuple(self._entries[name].user for name in sorted(self._entries))

    def get(self, name: str) -> User | None:
        """A user as last read, without looking at the file."""
        entry = self._entries.get(name)
        return entry.user if entry else None

    def mark(self, name: str) -> str:
        """What changes with a user's password, and says nothing of it; empty without such a user."""
        entry = self._entries.get(name)
        return hashlib.sha256(entry.salt + entry.hash).hexdigest() if entry is not None else ""

    def verify(self, name: str, password: str) -> User | None:
        """The user, if the password is right. Unknown users and wrong passwords take the same time."""
        self.refresh()
        entry = self._entries.get(name)
        known = entry if entry is not None else replace(self._decoy, cost=self._usual_cost())
        # PBKDF2, which scrypt begins with, fills a short key up with zeros: with a NUL another text has the same hash.
        usable = len(password) <= MAX_PASSWORD and "\0" not in password
        digest = known.cost.hash(password if usable else "", known.salt)
        right = hmac.compare_digest(digest, known.hash)
        return entry.user if entry is not None and right and usable else None

    def _usual_cost(self) -> ScryptCost:
        """The cost of the file's users, so that an unknown name is not told apart by its time."""
        return max((entry.cost for entry in self._entries.values()), key=lambda c: c.n * c.r * c.p, default=self._cost)

    async def authenticate(
        self, name: str, password: str, *, origin: str = "", lane: PasswordLane | None = None
    ) -> User | None:
        """`verify` in a thread, two at a time; raises UserFileError when too many wait.

        Args:
            name: of the user.
            password: to be checked.
            origin: the client's address, as it counts; one that has many waiting keeps no other out.
            lane: where it waits in place of that of all addresses.
        """
        if self._slots is None:
            self._slots = asyncio.Semaphore(_AT_A_TIME)
        lane = lane or PasswordLane("addresses", origin, MAX_WAITING, MAX_WAITING_OF_ORIGIN)
        waiting = self._waiting.setdefault(lane.name, Counter())
        if waiting.total() >= lane.places or waiting[lane.source] >= lane.places_of_source:
            raise UserFileError("too many logins at once")
        waiting[lane.source] += 1
        began = time.monotonic()
        try:
            async with self._slots:
                return await asyncio.get_running_loop().run_in_executor(self._threads, self.verify, name, password)
        finally:
            self.last_check_s = time.monotonic() - began
            waiting[lane.source] -= 1
            if not waiting[lane.source]:
                del waiting[lane.source]

    def _write(self, entries: dict[str, _Entry]) -> None:
        document = {"version": VERSION, "users": {name: entries[name].dump() for name in sorted(entries)}}
        write_whole(self._path, yaml.dump(document, Dumper=_DUMPER, sort_keys=False).encode())
        self.refresh()
