"""Starts that cannot work: what `up` and the logs show has to be one line with the remedy.

Each begins with a prepared testbed of which one thing is spoiled; only the services that it concerns are started.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from tests.testbed.bed import PROJECT, Bed, say
from tests.testbed.engine import CommandFailed, Compose, docker

__all__ = ["wrong_starts"]

_FLEET: Final = "/var/lib/ua-fleet/fleet/fleet.yaml"
_SAID_S: Final = 40.0
_FOREIGN: Final = "import os; os.chown('/v', 0, 0)"
_OPEN: Final = "import os; os.chmod('/v', 0o755)"
_NEWER: Final = f"""
import pathlib
path = pathlib.Path("{_FLEET}".replace("/var/lib/ua-fleet/fleet", "/v"))
path.write_text(path.read_text().replace("version: 1", "version: 7", 1))
"""
# As if five years had gone: the same key and names, and dates that are over.
_EXPIRED: Final = """
import datetime, pathlib, sys
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
for file in pathlib.Path("/v").rglob("*.der"):
    keys = [key for key in file.parent.parent.rglob("*key*.pem")]
    if not keys:
        continue
    key = serialization.load_pem_private_key(keys[0].read_bytes(), None)
    old = x509.load_der_x509_certificate(file.read_bytes())
    numbers = serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    if old.public_key().public_bytes(*numbers) != key.public_key().public_bytes(*numbers):
        continue
    day = datetime.timedelta(days=1)
    now = datetime.datetime.now(datetime.timezone.utc)
    made = (x509.CertificateBuilder().subject_name(old.subject).issuer_name(old.issuer).public_key(old.public_key())
            .serial_number(old.serial_number).not_valid_before(now - 400 * day).not_valid_after(now - day))
    for extension in old.extensions:
        made = made.add_extension(extension.value, extension.critical)
    file.write_bytes(made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.DER))
    print(file)
"""


@dataclass(frozen=True, slots=True)
class _Wrong:
    what: str
    volume: str
    program: str
    """Spoils the volume, which is at /v."""
    user: str
    service: str
    """Says what is wrong."""
    words: tuple[str, ...]
    """All stand in its line."""


_CASES: Final = (
    _Wrong("a volume of another user", "server", _FOREIGN, "0", "setup", ("server", "10001", "chown")),
    _Wrong("a volume that all may read", "operator", _OPEN, "0", "setup", ("operator", "755", "chmod 700")),
    _Wrong("a fleet.yaml of a newer version", "fleet", _NEWER, "10001", "setup", ("fleet.yaml", "version", "7")),
    _Wrong("an expired certificate of the server", "server", _EXPIRED, "10001", "setup", ("certificate", "expired")),
)


def wrong_starts(bed: Bed) -> list[str]:
    """Try all; those that do not say in one line what is wrong."""
    found: list[str] = []
    for case in _CASES:
        compose = bed.compose("talkrobots")
        compose.down()
        try:
            compose("up", "--no-build", "setup")
            spoiled = docker(
                *("run", "--rm", "--network", "none", "--user", case.user),
                *("--volume", f"{PROJECT}_{case.volume}:/v", f"ua-fleet/core:{bed.options['UA_FLEET_TAG']}"),
                *("python3" if case.user == "0" else "/opt/ua-fleet/bin/python", "-c", case.program),
            )
            if case.program is _EXPIRED and not spoiled.strip():
                found.append(f"{case.what}: there was none to spoil")
                continue
            found += _try(case, compose)
        finally:
            compose.down()
    return found


def _try(case: _Wrong, compose: Compose) -> list[str]:
    """Start, and look at what is said."""
    try:
        shown = compose("up", "--no-build", "--detach", "server")
    except CommandFailed as error:
        shown = str(error)
    line = _line(case, lambda: compose.container(case.service).logs())
    if line is None:
        logged = compose.container(case.service).logs().strip().splitlines()
        return [f"{case.what}: {case.service} said {logged[-6:]}; up said {shown.splitlines()[-2:]}"]
    logged = compose.container(case.service).logs().strip().splitlines()
    errors = [each for each in logged if each.startswith("ua-fleet:") or "Traceback" in each]
    if len(set(errors)) > 1 or any("Traceback" in each for each in logged):
        return [f"{case.what}: more than one line: {errors}"]
    say(f"{case.what}: {line}")
    return []


def _line(case: _Wrong, logged: Callable[[], str]) -> str | None:
    deadline = time.monotonic() + _SAID_S
    while time.monotonic() < deadline:
        for line in logged().splitlines():
            if all(word in line for word in case.words):
                return line
        time.sleep(0.5)
    return None
