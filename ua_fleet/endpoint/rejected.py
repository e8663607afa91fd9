"""Certificates that were refused, kept so that they can be trusted: whose, from where, since when they wait.

A stranger may offer a new certificate with each connection. So places are few, who has waited longest keeps its place,
and the address that holds the most places loses one of its own when another certificate comes.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import structlog
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from ua_fleet.endpoint.certificates import certificate_paths, thumbprint
from ua_fleet.storage.files import write_whole

__all__ = ["MAX_REJECTED", "RejectedCertificates", "Rejection", "rejection_of"]

_log = structlog.get_logger("ua_fleet.certificates")

MAX_REJECTED: Final = 32
WRITE_INTERVAL_S: Final = 1.0
"""Least time between two writes that take another's place, or bring only a time up to date."""
_MOST_BYTES: Final = 4_096


@dataclass(frozen=True, slots=True)
class Rejection:
    """When and from where a certificate was refused."""

    address: str
    """Of the client that offered it last; empty where nobody has written it down."""
    first_s: float
    """When it was refused first, in seconds of Unix time."""
    last_s: float
    """When it was refused last."""


def _note_of(certificate: Path) -> Path:
    return certificate.with_suffix(".json")


def rejection_of(certificate: Path) -> Rejection:
    """What was written down beside a certificate's file; its time is the file's where nothing was.

    Raises:
        OSError: there is no such file.
    """
    written_s = certificate.stat().st_mtime
    try:
        with _note_of(certificate).open("rb") as file:
            read: Any = json.loads(file.read(_MOST_BYTES))
        return Rejection(str(read["address"]), float(read["first_s"]), float(read["last_s"]))
    except (OSError, ValueError, TypeError, KeyError):
        return Rejection("", written_s, written_s)


def forget(certificate: Path) -> None:
    """Remove a certificate's file, and what was written down beside it."""
    certificate.unlink(missing_ok=True)
    _note_of(certificate).unlink(missing_ok=True)


def _gives_way(waiting: dict[Path, Rejection], address: str) -> Path:
    """Who loses its place: of the address that would hold most, the one that waits shortest."""
    held = Counter([rejection.address for rejection in waiting.values()])
    held[address] += 1
    most = max(held[rejection.address] for rejection in waiting.values())
    greedy = [path for path, rejection in waiting.items() if held[rejection.address] == most]
    return max(greedy, key=lambda path: (waiting[path].first_s, path))


class RejectedCertificates:
    """The folder `rejected/` of a server."""

    def __init__(self, folder: Path, wall_s: Callable[[], float] = time.time) -> None:
        """Keep certificates in a folder that is there; `wall_s` tells the Unix time in seconds."""
        self._folder, self._wall_s = folder, wall_s
        self._written_s = 0.0

    def keep(self, certificate: x509.Certificate, address: str) -> None:
        """Keep a refused certificate. What cannot be written is logged: the refusal stands without it."""
        path = self._folder / f"{thumbprint(certificate)}.der"
        now_s = self._wall_s()
        try:
            if path.exists():
                known = rejection_of(path)
                if abs(now_s - known.last_s) >= WRITE_INTERVAL_S:
                    self._write(_note_of(path), Rejection(address, known.first_s, now_s))
                return
            paths = certificate_paths(self._folder)
            if len(paths) >= MAX_REJECTED:
                if abs(now_s - self._written_s) < WRITE_INTERVAL_S:
                    return  # a flood costs no more writes than this; the audit log has each refusal
                waiting = {kept: rejection_of(kept) for kept in paths}
                while len(waiting) >= MAX_REJECTED:
                    old = _gives_way(waiting, address)
                    forget(old)
                    del waiting[old]
            self._written_s = now_s
            self._write(_note_of(path), Rejection(address, now_s, now_s))
            write_whole(path, certificate.public_bytes(Encoding.DER), 0o644)
        except OSError as error:
            _log.error("rejected certificate cannot be kept", path=str(path), reason=os.strerror(error.errno or 0))

    def _write(self, path: Path, rejection: Rejection) -> None:
        write_whole(path, json.dumps(asdict(rejection)).encode(), 0o644)
