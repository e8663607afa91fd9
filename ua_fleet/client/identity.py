"""Who the client is, and which servers it knows: its own certificate, and server certificates trusted on first use."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography import x509
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
            if self._still_good():
                return
            self.certificate.unlink()
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

    def _still_good(self) -> bool:
        """Whether our certificate can be shown today. It says our URI, whatever the name of the host is by now."""
        try:
            certificate = x509.load_der_x509_certificate(self.certificate.read_bytes())
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            uris = names.get_values_for_type(x509.UniformResourceIdentifier)
        except (OSError, ValueError, x509.ExtensionNotFound) as error:
            raise AccessRefused(
                StatusCode.BAD_SECURITY_CHECKS_FAILED,
                f"{self.certificate}: no readable certificate ({error}); remove it, and another one is made",
            ) from error
        if uris:
            self.application_uri = uris[0]
        return certificate.not_valid_after_utc > datetime.now(UTC)

    def _known_servers(self) -> dict[str, str]:
        try:
            known = json.loads(self._servers.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            known, reason = None, str(error)
        else:
            reason = "it holds no object"
        if not isinstance(known, dict):
            raise AccessRefused(
                StatusCode.BAD_SECURITY_CHECKS_FAILED,
                f"{self._servers} cannot be read ({reason}); remove it, and servers are met anew",
            )
        return cast("dict[str, str]", known)

    def check_server(self, endpoint: str, certificate: bytes) -> bool:
        """Remember a server's certificate at the first meeting, and hold it against that later.

        Returns:
            Whether this is the first meeting.

        Raises:
            AccessRefused: the server at this endpoint shows another certificate than before.
        """
        known = self._known_servers()
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
        fresh.write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8")
        fresh.replace(self._servers)
        return True
