"""The audit log: one JSON line for each write, call, login and refusal, in a file of bounded size.

    {"time": "2026-01-31T12:00:00.123Z", "event": "write", "user": "alice", "role": "operator", "session": "3f2a..",
     "client": "10.0.0.7:51234", "node": "ns=2;i=1001", "value": "12.5", "status": "Good"}

What users and their tools did is written always. Refusals that anybody on the network can provoke are written at a
bounded rate for each address, so that nobody can push the older lines out; what is left out is counted in the next
line. No password, token or nonce is ever given to this module.
"""

from __future__ import annotations

import json
import os
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, cast

import structlog

from ua_fleet.errors import ServerStartError

__all__ = ["AuditLog", "Caller", "summary"]

_log = structlog.get_logger("ua_fleet.audit")

MAX_BYTES: Final = 8 * 1024 * 1024
BACKUPS: Final = 4
MAX_SUMMARY: Final = 200
MAX_ITEMS: Final = 8
REFUSALS_PER_MINUTE: Final = 120
MAX_ADDRESSES: Final = 1_000


@dataclass(frozen=True, slots=True)
class Caller:
    """Who did it: as much as is known at that point."""

    client: str
    user: str = ""
    role: str = ""
    session: str = ""

    @property
    def address(self) -> str:
        """The client's address without the port."""
        return self.client.rpartition(":")[0] or self.client


def summary(value: Any) -> str:
    """A value as short text for one line of the log."""
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, list | tuple) and len(cast("Sequence[Any]", value)) > MAX_ITEMS:
        return f"array of {len(cast('Sequence[Any]', value))}"
    text = repr(value[: MAX_SUMMARY + 1] if isinstance(value, str) else cast("object", value))
    return text if len(text) <= MAX_SUMMARY else text[:MAX_SUMMARY] + ".."


class _Budget:
    """Refusals that one address may still put into the log: a token bucket."""

    __slots__ = ("at", "left", "omitted")

    def __init__(self, now: float) -> None:
        self.left, self.at, self.omitted = float(REFUSALS_PER_MINUTE), now, 0

    def take(self, now: float) -> bool:
        self.left = min(REFUSALS_PER_MINUTE, self.left + (now - self.at) * REFUSALS_PER_MINUTE / 60)
        self.at = now
        if self.left < 1:
            self.omitted += 1
            return False
        self.left -= 1
        return True


class AuditLog:
    """Appends lines to a file of mode 0600, and begins a new one when it is full."""

    def __init__(
        self,
        path: Path,
        *,
        max_bytes: int = MAX_BYTES,
        backups: int = BACKUPS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path, self._max_bytes, self._backups, self._clock = path, max_bytes, backups, clock
        self._budgets: OrderedDict[str, _Budget] = OrderedDict()
        self._broken = False
        self.lines = 0
        """Lines written."""
        self.omitted = 0
        """Refusals that were left out because their address had too many."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._file = self._open()
        except OSError as error:
            raise ServerStartError(
                f"{path}: cannot write the audit log ({error.strerror}); set server.state_dir to a folder of this user"
            ) from error

    def _open(self) -> int:
        descriptor = os.open(self._path, os.O_CREAT | os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC, 0o600)
        os.fchmod(descriptor, 0o600)
        self._size = os.fstat(descriptor).st_size
        return descriptor

    def record(self, event: str, caller: Caller, status: str, **details: Any) -> None:
        """Write one line about what a user did."""
        self.record_all(event, caller, [{**details, "status": status}])

    def record_all(self, event: str, caller: Caller, items: Iterable[Mapping[str, Any]]) -> None:
        """Write a line for each item of one request, at once."""
        moment = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        who = {"user": caller.user, "role": caller.role, "session": caller.session, "client": caller.client}
        head = {"time": moment, "event": event, **{key: value for key, value in who.items() if value}}
        lines = [json.dumps({**head, **item}, ensure_ascii=True, default=str) for item in items]
        if lines:
            self.lines += len(lines)
            self._append("".join(f"{line}\n" for line in lines).encode())

    def refuse(self, caller: Caller, what: str, status: str, **details: Any) -> None:
        """Write a line about something refused, if the client's address has not had too many of them."""
        address = caller.address
        budget = self._budgets.get(address)
        now = self._clock()
        if budget is None:
            budget = self._budgets[address] = _Budget(now)
            if len(self._budgets) > MAX_ADDRESSES:
                self._budgets.popitem(last=False)
        self._budgets.move_to_end(address)
        if not budget.take(now):
            self.omitted += 1
            return
        if budget.omitted:
            details["omitted_before"], budget.omitted = budget.omitted, 0
        self.record("refusal", caller, status, what=what, **details)

    def _append(self, data: bytes) -> None:
        try:
            if self._size and self._size + len(data) > self._max_bytes:
                self._rotate()
            os.write(self._file, data)
            self._size += len(data)
            self._broken = False
        except OSError as error:
            # A full disk must not stop the robots; say it once, not for each line.
            if not self._broken:
                self._broken = True
                _log.error("audit log cannot be written", path=str(self._path), reason=error.strerror)

    def _rotate(self) -> None:
        for number in range(self._backups - 1, 0, -1):
            older = self._path.with_name(f"{self._path.name}.{number}")
            if older.exists():
                older.replace(self._path.with_name(f"{self._path.name}.{number + 1}"))
        if self._backups:
            self._path.replace(self._path.with_name(f"{self._path.name}.1"))
        else:
            self._path.unlink()
        full, self._file = self._file, self._open()
        os.close(full)

    def close(self) -> None:
        """Close the file; nothing may be written afterwards."""
        os.close(self._file)
