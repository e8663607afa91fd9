"""Who the client is, and which servers it knows: its own certificate, and server certificates trusted on first use."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import socket
from pathlib import Path

from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography.x509.oid import ExtendedKeyUsageOID

from ua_fleet.errors import AccessRefused
from ua_fleet.values import StatusCode

__all__ = ["ClientIdentity", "default_identity_folder"]


def default_identity_folder() -> Path:
    """Where the client keeps its certificate: `$XDG_STATE_HOME/ua-fleet/client`."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "ua-fleet" / "client"


class ClientIdentity:
    """The client's application certificate, made on first use, and the servers that it has met."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.certificate = folder / "client.der"
        self.key = folder / "client-key.pem"
        self._servers = folder / "servers.json"
        host = socket.gethostname()
        self.application_uri = f"urn:{host}:ua-fleet:client"

    async def ensure(self) -> None:
        """Make the certificate and its key, unless they are there."""
        if self.certificate.exists() and self.key.exists():
            return
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        previous = os.umask(0o077)
        try:
            await asyncio.to_thread(
                lambda: asyncio.run(
                    setup_self_signed_certificate(
                        self.key,
                        self.certificate,
                        self.application_uri,
                        socket.gethostname(),
                        [ExtendedKeyUsageOID.CLIENT_AUTH],
                        {"commonName": "ua-fleet client", "organizationName": "ua-fleet"},
                    )
                )
            )
        finally:
            os.umask(previous)

    def check_server(self, endpoint: str, certificate: bytes) -> bool:
        """Remember a server's certificate at the first meeting, and hold it against that later.

        Returns:
            Whether this is the first meeting.

        Raises:
            AccessRefused: the server at this endpoint shows another certificate than before.
        """
        known: dict[str, str] = json.loads(self._servers.read_text()) if self._servers.exists() else {}
        thumbprint = hashlib.sha1(certificate, usedforsecurity=False).hexdigest()
        if endpoint in known:
            if known[endpoint] != thumbprint:
                raise AccessRefused(
                    StatusCode.BAD_SECURITY_CHECKS_FAILED,
                    f"the server at {endpoint} shows another certificate ({thumbprint}) than before "
                    f"({known[endpoint]}); if that is right, remove its line from {self._servers}",
                )
            return False
        known[endpoint] = thumbprint
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        fresh = self._servers.with_suffix(".new")
        fresh.write_text(json.dumps(known, indent=2) + "\n")
        fresh.replace(self._servers)
        return True
