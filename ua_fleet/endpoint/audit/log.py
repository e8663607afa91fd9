"""The audit log: one JSON line for each write, call, login and refusal.

    {"time": "2026-01-31T12:00:00.123Z", "event": "write", "user": "alice", "role": "operator", "session": "3f2a..",
     "client": "10.0.0.7:51234", "node": "ns=2;i=1001", "value": "12.5", "status": "Good", "seq": 7, "prev": ".."}

Everything is written within an allowance of its maker, so that nobody pushes older lines out, and what is beyond is
summed up. What operators and engineers change has a large one; refusals, logins and logouts, and what observers may
call, cost their maker nothing and have a small one. No password, token or nonce is ever given to this module.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import structlog

from ua_fleet.endpoint.audit.allowance import CHANGES, SUM_AT_LOGOUT_S, Allowances, Omitted
from ua_fleet.endpoint.audit.caller import Caller
from ua_fleet.endpoint.audit.chain import now_text
from ua_fleet.endpoint.audit.chained_file import ChainedFile

__all__ = ["LOG_FILE", "AuditLog", "Copy"]

_log = structlog.get_logger("ua_fleet.audit")

LOG_FILE: Final = "audit.log"
"""In the server's `state_dir`; older files are `audit.log.1` and so on."""
MAX_BYTES: Final = 8 * 1024 * 1024
BACKUPS: Final = 9
_FREE: Final = ("write", "call")
_FREE_ROLES: Final = ("operator", "engineer")
"""Who changes something: for that they have an allowance of its own."""
_TELL_LOSS_S: Final = 60.0
"""Least time between two lines of what the copy did not get."""


class Copy(Protocol):
    """Where lines go besides the file."""

    dropped: int
    """Lines that could not be delivered."""

    def put(self, line: bytes, event: str, *, refused: bool) -> None:
        """Take a line, without waiting."""
        ...

    def close(self) -> None:
        """Deliver what can be delivered soon, and end."""
        ...


class AuditLog:
    """Appends lines to the files, and to a copy elsewhere."""

    def __init__(
        self,
        path: Path,
        *,
        max_bytes: int = MAX_BYTES,
        backups: int = BACKUPS,
        clock: Callable[[], float] = time.monotonic,
        copy: Copy | None = None,
    ) -> None:
        """Open the log; raises ServerStartError.

        Args:
            path: of the newest file.
            max_bytes: size of one file.
            backups: older files that are kept.
            clock: for the allowances.
            copy: gets each line too.
        """
        self._path, self._clock, self._copy = path, clock, copy
        self._allowances, self._changes = Allowances(), Allowances(CHANGES)
        self._undelivered_told, self._undelivered_at = 0, -_TELL_LOSS_S
        self._broken = False
        self._unwritten = 0
        self.lines = 0
        """Lines written."""
        self.omitted = 0
        """Lines that were left out because their maker had too many; they are in the sums."""
        self.lost = 0
        """Lines that could not be written to the file, such as on a full disk."""
        self._file = ChainedFile(path, max_bytes=max_bytes, backups=backups)
        self._put([{"time": now_text(), **found} for found in self._file.found], refused=True)

    @property
    def undelivered(self) -> int:
        """Lines that the copy elsewhere did not get."""
        return self._copy.dropped if self._copy is not None else 0

    def record(self, event: str, caller: Caller, status: str, **details: Any) -> bool:
        """Write one line about what a user did; whether it was written, and not left for a sum."""
        return self.record_all(event, caller, [{**details, "status": status}])[0]

    def record_all(self, event: str, caller: Caller, items: Iterable[Mapping[str, Any]]) -> list[bool]:
        """Write a line for each item of one request, at once; which ones were written, and not left for a sum.

        Each item has a `status`, the name of a StatusCode. All that is not Good counts as a refusal.
        """
        now = self._clock()
        head: dict[str, Any] | None = None
        records: list[Mapping[str, Any]] = []
        written: list[bool] = []
        refused, changes = False, event in _FREE and caller.role in _FREE_ROLES
        for item in items:
            is_good = item["status"] == "Good"
            if is_good and changes:
                kind = f"{event} {item.get('node') or item.get('method', '')}"
                may = self._changes.take(caller, kind, now, str(item.get("value", "")))
            else:
                may = self._allowances.take(caller, f"{item.get('what', event)} {item['status']}", now)
            written.append(may)
            if may:
                head = head or _head(event, caller)
                records.append({**head, **item})
                refused = refused or not is_good
        self.omitted += written.count(False)
        if event == "logout":
            # Not with each logout of one who does nothing else, or these sums would be a flood.
            least_s = 0.0 if records else SUM_AT_LOGOUT_S
            for allowances in (self._allowances, self._changes):
                self._write_sums(allowances.sums(now, of=caller, least_s=least_s))
        self._put(records, refused=refused)
        return written

    def refuse(self, caller: Caller, what: str, status: str, **details: Any) -> bool:
        """Write a line about something refused, as far as its maker's allowance goes; whether it was written."""
        return self.record("refusal", caller, status, what=what, **details)

    def tick(self) -> None:
        """Time has gone on: write the sums that are due."""
        now = self._clock()
        for allowances in (self._allowances, self._changes):
            self._write_sums(allowances.sums(now))
        self._tell_loss(now)

    def _tell_loss(self, now: float) -> None:
        """Write down what the copy did not get: the file, and the copy when it takes lines again, say how much."""
        lines = self.undelivered - self._undelivered_told
        if not lines or now - self._undelivered_at < _TELL_LOSS_S:
            return
        self._undelivered_told, self._undelivered_at = self.undelivered, now
        _log.error("lines of the audit log were not delivered to the syslog server; the files have them", lines=lines)
        self._put([{"time": now_text(), "event": "undelivered", "lines": lines}], refused=True)

    def _write_sums(self, sums: Iterable[Omitted]) -> None:
        now = self._clock()
        records = [
            {
                **_head("omitted", omitted.caller),
                "lines": omitted.kinds.total(),
                "within_s": round(max(0.0, now - omitted.since), 1),
                "of": dict(omitted.kinds.most_common()),
                **({"last": omitted.last} if omitted.last else {}),
            }
            for omitted in sums
        ]
        self._put(records, refused=True)

    def _put(self, records: Sequence[Mapping[str, Any]], *, refused: bool) -> None:
        """Write records to the file and the copy. What goes wrong is told once, and counted."""
        if not records:
            return
        if self._unwritten:
            records = [{"time": now_text(), "event": "lost", "lines": self._unwritten}, *records]
        try:
            lines = self._file.append(records)
            self.lines += len(lines)
            self._broken, self._unwritten = False, 0
        except OSError as error:
            lost = len(records) - bool(self._unwritten)
            self.lost += lost
            self._unwritten += lost
            lines = [json.dumps(record, default=str).encode() for record in records]
            # A full disk must not stop the robots; say it once, not for each line.
            if not self._broken:
                self._broken = True
                _log.error("audit log cannot be written", path=str(self._path), reason=error.strerror)
        if self._copy is not None:
            for line, record in zip(lines, records, strict=True):
                self._copy.put(line, str(record["event"]), refused=refused)

    def close(self) -> None:
        """Write the last sums and close the file; nothing may be written afterwards."""
        for allowances in (self._allowances, self._changes):
            self._write_sums(allowances.all_sums())
        self._undelivered_at = -_TELL_LOSS_S
        self._tell_loss(self._clock())
        self._file.close()
        if self._copy is not None:
            self._copy.close()


def _head(event: str, caller: Caller) -> dict[str, Any]:
    who = {"user": caller.user, "role": caller.role, "session": caller.session, "client": caller.client}
    return {"time": now_text(), "event": event, **{key: value for key, value in who.items() if value}}
