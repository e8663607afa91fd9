"""The contexts in which this user of the machine is logged in: `contexts.json` beside the client's certificate.

A context is a server, a user, and a session key of that user: in the keyring of the desktop where there is one that
works (the package keyring), otherwise in the file, which nobody else can read. A key is given to the server that issued
it and to no other. No password is kept.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from ua_fleet.cli import keyring_store
from ua_fleet.cli.endings import NotFound, UsageError
from ua_fleet.cli.options import Policy
from ua_fleet.errors import UPGRADE, newer_version
from ua_fleet.storage.files import write_whole
from ua_fleet.storage.private_file import exclusive, not_private
from ua_fleet.storage.user_folder import default_identity_folder

__all__ = ["ContextFile", "Contexts", "LoginContext", "check_name", "names"]

VERSION: Final = 1
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_FLEET: Final = re.compile(r"urn:ua-fleet:(.+):server")
"""ApplicationUri of a fleet's server (pubsub/application.py)."""


@dataclass(frozen=True, slots=True)
class LoginContext:
    """A server, a user, and a key in place of the password."""

    name: str
    endpoint: str
    user: str
    server_uri: str
    """ApplicationUri of the server that issued the key; empty without security."""
    policy: str
    insecure: bool
    key_id: str
    valid_until: datetime
    key: str | None = field(repr=False)
    """None where it is in the keyring."""

    @property
    def login_command(self) -> str:
        """What gets another key."""
        return f"ua-fleet login -c {self.name}"

    def has_ended(self, now: datetime) -> bool:
        """Whether the key is too old; it may have ended before."""
        return now >= self.valid_until

    def secret(self) -> str:
        """The key; raises UsageError where the keyring does not give it."""
        key = self.key if self.key is not None else keyring_store.read(self.key_id)
        if key is None:
            raise UsageError(
                f"the keyring does not give the key of context {self.name}; log in again: {self.login_command}"
            )
        return key

    def dump(self) -> dict[str, Any]:
        """As it stands in the file."""
        return {
            "name": self.name,
            "endpoint": self.endpoint,
            "user": self.user,
            "server_uri": self.server_uri,
            "policy": self.policy,
            "insecure": self.insecure,
            "key_id": self.key_id,
            "valid_until": self.valid_until.isoformat(),
            "key": self.key,
        }

    @classmethod
    def parse(cls, data: dict[str, Any]) -> LoginContext:
        """A context of the file; raises KeyError, TypeError or ValueError."""
        Policy(data["policy"])
        names = ("name", "endpoint", "user", "server_uri", "policy", "key_id")
        texts = {name: data[name] for name in names}
        key = data["key"]
        if not all(isinstance(text, str) for text in texts.values()) or not isinstance(key, str | None):
            raise TypeError("a context's texts are wrong")
        until = datetime.fromisoformat(data["valid_until"])
        return cls(**texts, insecure=data["insecure"] is True, valid_until=until.astimezone(UTC), key=key)


@dataclass(frozen=True, slots=True)
class Contexts:
    """All contexts, and which of them is used where none is named."""

    current: str = ""
    all: tuple[LoginContext, ...] = ()

    def find(self, name: str) -> LoginContext | None:
        """The context of this name; None where there is none."""
        return next((context for context in self.all if context.name == name), None)

    def named(self, name: str) -> LoginContext:
        """The context of this name; raises NotFound."""
        found = self.find(name)
        if found is None:
            there = ", ".join(context.name for context in self.all) or "none"
            raise NotFound(f"no context {name!r}, but: {there}; log in: ua-fleet login ENDPOINT --user USER -c {name}")
        return found

    @property
    def chosen(self) -> LoginContext | None:
        """The current one."""
        return self.find(self.current)

    def of(self, endpoint: str, user: str | None) -> LoginContext | None:
        """The context of a server, and of a user there where one is given; the current one first."""
        ordered = sorted(self.all, key=lambda context: context.name != self.current)
        return next((one for one in ordered if one.endpoint == endpoint and user in (None, one.user)), None)

    def name_for(self, endpoint: str, user: str, server_uri: str) -> str:
        """A name for a login: that of the context which it renews, or one of the fleet's name."""
        if (known := self.of(endpoint, user)) is not None and known.server_uri == server_uri:
            return known.name
        fleet = _FLEET.fullmatch(server_uri)
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", fleet[1] if fleet else "server").strip("-.") or "server"
        wanted = [plain[:40], f"{plain[:40]}-{user}"[:60]]
        wanted += [f"{wanted[1]}-{number}" for number in range(2, len(self.all) + 3)]
        return next(name for name in wanted if self.find(name) is None)

    def with_context(self, context: LoginContext) -> Contexts:
        """With this one, in place of another of its name, as the current one."""
        others = tuple(one for one in self.all if one.name != context.name)
        return Contexts(context.name, tuple(sorted((*others, context), key=lambda one: one.name)))

    def without(self, name: str) -> Contexts:
        """Without one; where it was the current one, none is."""
        return Contexts(
            "" if self.current == name else self.current, tuple(one for one in self.all if one.name != name)
        )

    def switched(self, name: str) -> Contexts:
        """With another current one; raises NotFound."""
        return replace(self, current=self.named(name).name)


class ContextFile:
    """Reads and writes the contexts."""

    def __init__(self, folder: Path | None = None) -> None:
        """Say where: by default beside the client's certificate."""
        self.path = (folder or default_identity_folder()) / "contexts.json"

    def load(self) -> Contexts:
        """The contexts; raises UsageError where they cannot be used."""
        try:
            status = self.path.stat()
            if problem := not_private(self.path, status):
                raise UsageError(problem)
            document = json.loads(self.path.read_text(encoding="utf-8"))
            newer = newer_version(document["version"], VERSION)
            if not newer:
                return Contexts(
                    str(document["current"]), tuple(LoginContext.parse(one) for one in document["contexts"])
                )
        except FileNotFoundError:
            return Contexts()
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise UsageError(
                f"{self.path}: cannot be read ({type(error).__name__}: {error}); remove it, and log in again"
            ) from error
        raise UsageError(f"{self.path} {newer}; {UPGRADE}")

    def put(self, context: LoginContext, key: str) -> tuple[LoginContext, LoginContext | None]:
        """Keep a context and its key, as the current one; as it is kept, and the one whose place it took.

        Without a name it gets one that no other has at that moment, or that of the one which it renews.

        Raises:
            UsageError: the file cannot be read or written.
        """
        kept = replace(context, key=None if keyring_store.write(context.key_id, key) else key)
        before: LoginContext | None = None

        def add(contexts: Contexts) -> Contexts:
            nonlocal kept, before
            name = kept.name or contexts.name_for(kept.endpoint, kept.user, kept.server_uri)
            kept, before = replace(kept, name=name), contexts.find(name)
            return contexts.with_context(kept)

        self._change(add)
        return kept, before

    def remove(self, context: LoginContext) -> None:
        """Forget a context and its key; raises UsageError."""
        self.forget_key(context)
        self._change(lambda contexts: contexts.without(context.name))

    def forget_key(self, context: LoginContext) -> None:
        """Take the key of a context out of the keyring, where it is there."""
        if context.key is None:
            keyring_store.remove(context.key_id)

    def switch(self, name: str) -> Contexts:
        """Make another context the current one; raises NotFound and UsageError."""
        return self._change(lambda contexts: contexts.switched(name))

    def _change(self, change: Callable[[Contexts], Contexts]) -> Contexts:
        try:
            with exclusive(self.path):
                contexts = change(self.load())
                document = {
                    "version": VERSION,
                    "current": contexts.current,
                    "contexts": [context.dump() for context in contexts.all],
                }
                write_whole(self.path, f"{json.dumps(document, indent=1)}\n".encode())
        except OSError as error:
            raise UsageError(f"{self.path}: cannot be written ({error.strerror})") from error
        return contexts


def check_name(name: str) -> str:
    """A name that a context may have; raises UsageError."""
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is no name of a context; use 1 to 64 letters, digits and _ . @ -")
    return name


def names(prefix: str = "") -> Sequence[str]:
    """The names of contexts, for a shell that completes them; empty where they cannot be read."""
    try:
        return [context.name for context in ContextFile().load().all if context.name.startswith(prefix)]
    except UsageError:
        return []
