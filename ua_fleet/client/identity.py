"""Who the client is, and which servers it knows: its own certificate, and server certificates.

<folder>/
    client.der, client-key.pem     our certificate and its key (mode 0600); of a bridge, bridge.der and bridge-key.pem
    servers.json                   the servers that we have met
    contexts.json                  where the command line is logged in (cli/context_file.py)
    server.der                     the one server that is trusted, where somebody has put it there (pinned)
"""

from __future__ import annotations

import asyncio
import hashlib
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import structlog
from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    generate_self_signed_app_certificate,
)
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID

from ua_fleet.client.known_servers import KnownServers, Meeting
from ua_fleet.errors import AccessRefused
from ua_fleet.printing import config_option
from ua_fleet.pubsub.application import bridge_application_uri
from ua_fleet.storage.files import write_whole
from ua_fleet.storage.private_file import exclusive
from ua_fleet.storage.user_folder import default_identity_folder
from ua_fleet.validity import Reminder, Validity
from ua_fleet.values import StatusCode

__all__ = ["ClientIdentity", "default_identity_folder"]

_log: Any = structlog.get_logger("ua_fleet.certificates")


VALID_DAYS: Final = 5 * 365
_OTHER_KEY: Final = "belongs to a key"


class ClientIdentity:
    """The client's application certificate, made on first use, and the servers that it has met."""

    def __init__(
        self,
        folder: Path,
        *,
        name: str = "client",
        application_uri: str = "",
        subject: str = "",
        renewal: str = "",
        bridge: str = "",
    ) -> None:
        """Say where the certificate is.

        Args:
            folder: of the certificate, its key and the known servers.
            name: of the certificate's file.
            application_uri: for a new certificate; by default one of this host.
            subject: common name for a new certificate.
            renewal: what to run when it has expired; without it, one that we have made ourselves is made anew.
            bridge: whose it is, where it is a bridge's.
        """
        self.folder = folder
        self.certificate = folder / f"{name}.der"
        self.key = folder / f"{name}-key.pem"
        self.pinned_server = folder / "server.der"
        self.known_servers = KnownServers(folder / "servers.json", bridge=bridge)
        self.application_uri = application_uri or f"urn:{socket.gethostname()}:ua-fleet:client"
        self._subject = subject or "ua-fleet client"
        self._renewal = renewal
        self._reminder = Reminder()

    @classmethod
    def of_bridge(cls, folder: Path, fleet_name: str, bridge_name: str) -> ClientIdentity:
        """The identity of a bridge, in its own folder (`state_dir`)."""
        uri = bridge_application_uri(fleet_name, bridge_name)
        renewal = (
            f"run: ua-fleet cert create --bridge {bridge_name} --renew{config_option()}, and on the server: "
            f"ua-fleet cert trust --bridge {bridge_name} {folder / 'bridge.der'}{config_option()}"
        )
        subject = f"ua-fleet bridge {bridge_name}"
        return cls(folder, name="bridge", application_uri=uri, subject=subject, renewal=renewal, bridge=bridge_name)

    async def ensure(self) -> None:
        """Make the certificate and its key, unless they are there.

        Raises:
            AccessRefused: they cannot be used, or cannot be shown today.
        """
        if self.certificate.exists() and self.key.exists():
            key = self._checked_key()
            certificate = self._own()
            self.tell_of_its_end()
            problem = _validity(certificate).problem(datetime.now(UTC))
            if not problem and certificate.public_key() != key.public_key():
                problem = f"{_OTHER_KEY} that is not {self.key}"
            if not problem:
                return
            self._check_may_replace(certificate, problem)
            await asyncio.to_thread(self._make, key)
        else:
            await asyncio.to_thread(self._make)

    async def renew(self) -> None:
        """Make the certificate anew with the key that there is, so that nobody ever finds a pair that does not fit.

        Raises:
            AccessRefused: the key cannot be used, or the certificate is that of a CA, which has to renew it.
        """
        if self.certificate.exists() and self.key.exists():
            key = self._checked_key()
            _check_self_signed(self._own(), self.certificate)
            await asyncio.to_thread(self._make, key)
        else:
            await self.ensure()

    def tell_of_its_end(self) -> None:
        """Log once a day that a bridge's certificate ends soon, or has ended."""
        if not self._renewal:
            return
        try:
            validity = _validity(self._own())
        except AccessRefused:
            return  # said by whoever needs it
        notice = self._reminder.due("own", validity, datetime.now(UTC))
        if notice:
            _log.warning(f"our certificate {notice}", certificate=str(self.certificate), todo=self._renewal)

    def _check_may_replace(self, certificate: x509.Certificate, problem: str) -> None:
        can_be_made = problem.startswith(("expired", _OTHER_KEY))
        if can_be_made and not self._renewal and certificate.issuer == certificate.subject:
            return
        remedy = self._renewal if can_be_made else "check the clock of this machine"
        remedy = remedy or f"have its CA issue another one, and put it there, or remove it and {self.key}"
        raise AccessRefused(StatusCode.BAD_SECURITY_CHECKS_FAILED, f"{self.certificate}: {problem}; {remedy}")

    def _make(self, kept: RSAPrivateKey | None = None) -> None:
        """Make a certificate for the key that is kept, or for a new one. A file that is kept cannot be lost."""
        with exclusive(self.key):  # two that begin at once would leave the key of the one and the other's certificate
            if kept is not None or not (self.certificate.exists() and self.key.exists()):
                self._write(kept)

    def _write(self, kept: RSAPrivateKey | None) -> None:
        key = kept or generate_private_key()
        names = [x509.UniformResourceIdentifier(self.application_uri), x509.DNSName(socket.gethostname())]
        certificate = generate_self_signed_app_certificate(
            key,
            self._subject[:64],
            {"organizationName": "ua-fleet"},
            list[x509.GeneralName](names),
            [ExtendedKeyUsageOID.CLIENT_AUTH],
            days=VALID_DAYS,
        )
        if kept is None:
            write_whole(self.key, dump_private_key_as_pem(key))
        write_whole(self.certificate, certificate.public_bytes(Encoding.DER))

    def _checked_key(self) -> RSAPrivateKey:
        """The key; raises AccessRefused for one that others can read, or that is none."""
        mode = self.key.stat().st_mode & 0o777
        if mode & 0o077:
            raise AccessRefused(
                StatusCode.BAD_SECURITY_CHECKS_FAILED,
                f"{self.key}: others may read or write it (mode {mode:o}); run: chmod 600 {self.key}",
            )
        try:
            key = load_pem_private_key(self.key.read_bytes(), password=None)
            if not isinstance(key, RSAPrivateKey):
                raise TypeError
        except (ValueError, TypeError):
            # Without the cause, which may show the key.
            raise AccessRefused(
                StatusCode.BAD_SECURITY_CHECKS_FAILED,
                f"{self.key}: no readable key without a password; remove it, and another one is made",
            ) from None
        return key

    def _own(self) -> x509.Certificate:
        """Our certificate. It says our URI, whatever the name of the host is by now."""
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
        return certificate

    def check_server(self, endpoint: str, certificate: bytes) -> Meeting:
        """Remember a server's certificate at the first meeting, and hold it against that later.

        Where `server.der` is there, that certificate and no other is the server's, from the first meeting on.

        Raises:
            AccessRefused: the server at this endpoint shows another certificate than before, or than the pinned one, or
                one that is not valid now.
        """
        _check_server_may_show(endpoint, certificate)
        if self.pinned_server.exists():
            self._check_pinned(endpoint, certificate)
            return Meeting(is_first=False)
        return self.known_servers.meet(endpoint, certificate)

    def _check_pinned(self, endpoint: str, certificate: bytes) -> None:
        try:
            data = self.pinned_server.read_bytes()
            pem = data.lstrip().startswith(b"-----BEGIN")
            pinned = x509.load_pem_x509_certificate(data) if pem else x509.load_der_x509_certificate(data)
        except (OSError, ValueError) as error:
            raise AccessRefused(
                StatusCode.BAD_SECURITY_CHECKS_FAILED, f"{self.pinned_server}: no readable certificate ({error})"
            ) from error
        if pinned.public_bytes(Encoding.DER) != certificate:
            thumbprint = hashlib.sha1(certificate, usedforsecurity=False).hexdigest()
            raise AccessRefused(
                StatusCode.BAD_SECURITY_CHECKS_FAILED,
                f"the server at {endpoint} shows a certificate ({thumbprint}) that is not {self.pinned_server}; "
                "if the server has a new one, put it there",
            )


def _validity(certificate: x509.Certificate) -> Validity:
    return Validity(certificate.not_valid_before_utc, certificate.not_valid_after_utc)


def _check_self_signed(certificate: x509.Certificate, path: Path) -> None:
    if certificate.issuer != certificate.subject:
        raise AccessRefused(
            StatusCode.BAD_SECURITY_CHECKS_FAILED,
            f"{path}: was issued by {certificate.issuer.rfc4514_string()}; have that CA renew it, and put it there",
        )


def _check_server_may_show(endpoint: str, certificate: bytes) -> None:
    try:
        problem = _validity(x509.load_der_x509_certificate(certificate)).problem(datetime.now(UTC))
    except ValueError:
        return  # no certificate at all: nobody can open a channel with it
    if problem:
        remedy = "check the clocks of both machines"
        if problem.startswith("expired"):
            remedy = f"on the server run: ua-fleet cert create --renew{config_option()}, and restart it"
        raise AccessRefused(
            StatusCode.BAD_SECURITY_CHECKS_FAILED, f"the certificate of the server at {endpoint} {problem}; {remedy}"
        )
