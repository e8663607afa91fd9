"""Which client certificates are accepted (OPC 10000-4 6.1.3), and what becomes of the others.

A certificate is trusted when it stands in `trusted/`, `bridges/` or `gateways/` itself, or when its chain of issuers
ends at a CA in `trusted/`. The folders are looked at again whenever they change, so that `ua-fleet cert trust` takes
effect in a running server.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import structlog
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID

from ua_fleet.endpoint.certificates import (
    UNREADABLE,
    CertificateError,
    CertificateState,
    application_uris,
    certificate_paths,
    certificates_folder,
    is_authority,
    load_certificate,
    thumbprint,
)
from ua_fleet.endpoint.fingerprints import fingerprint_of
from ua_fleet.endpoint.rejected import RejectedCertificates
from ua_fleet.errors import ServerStartError, UaFleetError
from ua_fleet.printing import config_option
from ua_fleet.storage.files import make_private_folder, open_to_others
from ua_fleet.validity import Validity

__all__ = ["CertificateFolder", "CertificateRefused", "TrustList", "split_chain"]

_log = structlog.get_logger("ua_fleet.certificates")

MIN_KEY_BITS: Final = 2048
MAX_KEY_BITS: Final = 4096
"""Key lengths of all policies that we offer (OPC 10000-7, MinAsymmetricKeyLength and MaxAsymmetricKeyLength)."""
MAX_CHAIN: Final = 5
MAX_CHAIN_BYTES: Final = 16_384
_MOST_ASKED: Final = 1_000
_WEAK_HASHES: Final = (hashes.MD5, hashes.SHA1)


class CertificateRefused(UaFleetError):
    """A client's certificate is not accepted; `ua_status` and the text are for our log."""

    remedy = "Compare the thumbprint, then run `ua-fleet cert trust --last --show` on the server's machine."

    def __init__(self, ua_status: int, reason: str) -> None:
        self.ua_status = ua_status
        super().__init__(reason)


# OPC 10000-6 annex A; StatusCodes of certificates, which nothing else in the project needs.
INVALID: Final = 0x8012_0000
TIME_INVALID: Final = 0x8014_0000
ISSUER_TIME_INVALID: Final = 0x8015_0000
URI_INVALID: Final = 0x8017_0000
USE_NOT_ALLOWED: Final = 0x8018_0000
UNTRUSTED: Final = 0x801A_0000
REVOKED: Final = 0x801D_0000
POLICY_CHECK_FAILED: Final = 0x8114_0000


def split_chain(data: bytes) -> list[x509.Certificate]:
    """The certificates of a SenderCertificate: DER after DER, the application's own first."""
    return list(_split_chain(data))


@functools.lru_cache(256)
def _split_chain(data: bytes) -> tuple[x509.Certificate, ...]:
    """What the same bytes are is found once: they say nothing of whether the certificates are good now."""
    if len(data) > MAX_CHAIN_BYTES:
        raise CertificateRefused(INVALID, f"the certificate has {len(data)} bytes")
    chain: list[x509.Certificate] = []
    offset = 0
    try:
        while offset < len(data):
            if len(chain) == MAX_CHAIN:
                raise CertificateRefused(INVALID, f"more than {MAX_CHAIN} certificates in a chain")
            end = offset + _der_length(data[offset : offset + 6])
            chain.append(x509.load_der_x509_certificate(data[offset:end]))
            offset = end
    except (IndexError, *UNREADABLE) as error:
        raise CertificateRefused(INVALID, f"the certificate cannot be read ({error})") from error
    if not chain:
        raise CertificateRefused(INVALID, "there is no certificate")
    return tuple(chain)


def _der_length(head: bytes) -> int:
    """Length of a DER SEQUENCE with its tag and length octets."""
    if head[0] != 0x30:
        raise ValueError("no DER sequence")
    if head[1] < 0x80:
        return 2 + head[1]
    octets = head[1] & 0x7F
    if not 1 <= octets <= 3:
        raise ValueError("DER length out of bounds")
    return 2 + octets + int.from_bytes(head[2 : 2 + octets], "big")


@dataclass
class CertificateFolder:
    """The certificates of one folder, read again when the folder changes."""

    path: Path
    certificates: dict[bytes, x509.Certificate] = field(default_factory=dict[bytes, x509.Certificate])
    """By SHA-256 fingerprint."""
    names: dict[bytes, str] = field(default_factory=dict[bytes, str])
    """Names of the files, without their ending."""
    signature: tuple[int, int] | None = None
    problem: str = ""
    """Why nothing there is trusted; empty while it is."""
    generation: int = 0
    """Grows whenever the folder has changed."""

    def refresh(self) -> dict[bytes, x509.Certificate]:
        """The certificates that are there now, by fingerprint; none while others could have put them there."""
        try:
            status = self.path.stat()
            problem, before = open_to_others(self.path, status), self.problem
            self.problem = problem
            if problem:
                if problem != before:
                    _log.error("no certificate of a folder is trusted", reason=problem)
                raise PermissionError(problem)
            signature = (status.st_mtime_ns, status.st_ino)
            paths = certificate_paths(self.path) if signature != self.signature else []
        except OSError:
            self.generation += self.signature is not None
            self.certificates, self.names, self.signature = {}, {}, None
            return self.certificates
        if signature != self.signature:
            self.generation += 1
            self.signature = signature
            self.certificates, self.names = {}, {}
            for path in paths:
                try:
                    if problem := open_to_others(path):
                        raise CertificateError(problem)
                    certificate = load_certificate(path)
                except (CertificateError, OSError) as error:
                    _log.warning("certificate left out", reason=str(error))
                    continue
                fingerprint = fingerprint_of(certificate)
                self.certificates[fingerprint] = certificate
                self.names[fingerprint] = path.stem
        return self.certificates

    def name_of(self, certificate: x509.Certificate) -> str:
        """The name of the file that a certificate stands in now; empty where it is not there."""
        self.refresh()
        return self.names.get(fingerprint_of(certificate), "")


class RevocationList:
    """The certificates that a CA has revoked. What was asked once is not looked for again: a list may have 100,000."""

    def __init__(self, path: Path) -> None:
        """Read a file, DER or PEM; raises OSError or ValueError."""
        data = path.read_bytes()
        pem = data.lstrip().startswith(b"-----BEGIN")
        self._list = x509.load_pem_x509_crl(data) if pem else x509.load_der_x509_crl(data)
        self.issuer = self._list.issuer
        self._signers: dict[bytes, bool] = {}
        self._asked: dict[int, bool] = {}

    def is_signed_by(self, authority: x509.Certificate) -> bool:
        """Whether this CA has made the list."""
        mark = fingerprint_of(authority)
        known = self._signers.get(mark)
        if known is None:
            key = authority.public_key()
            known = isinstance(key, rsa.RSAPublicKey) and self._list.is_signature_valid(key)
            known = self._signers[mark] = known and authority.subject == self.issuer
        return known

    def names(self, serial_number: int) -> bool:
        """Whether a certificate of that CA is revoked."""
        known = self._asked.get(serial_number)
        if known is None:
            if len(self._asked) >= _MOST_ASKED:
                self._asked.clear()
            known = self._list.get_revoked_certificate_by_serial_number(serial_number) is not None
            self._asked[serial_number] = known
        return known


class TrustList:
    """Checks client certificates against the folders of one server."""

    def __init__(self, state_dir: Path, *, trust_all: bool = False, bridges: Mapping[str, str] | None = None) -> None:
        """Use the folders of a server.

        Args:
            state_dir: the server's.
            trust_all: accept every sound certificate.
            bridges: names of bridges that may log in, by their ApplicationUris; they only make hints better.

        Raises:
            ServerStartError: others may write into one of the folders.
        """
        self._bridge_names = bridges or {}
        folder = certificates_folder(state_dir)
        self._trust_all = trust_all
        self._trusted = CertificateFolder(folder / CertificateState.TRUSTED)
        self._bridges = CertificateFolder(folder / CertificateState.BRIDGE)
        self.gateways = CertificateFolder(folder / CertificateState.GATEWAY)
        """Certificates of clients through which many people come, by the gateways' names."""
        self._issuers = CertificateFolder(folder / CertificateState.ISSUER)
        self._revocations = folder / "crl"
        self._lists: dict[Path, tuple[tuple[int, ...], RevocationList]] = {}
        """Of each file, by what tells it from another one in its place."""
        self._sound: dict[bytes, bool] = {}
        """Certificates, by fingerprint, of which all that never changes was found good; whether each is self-signed.

        A connection has its certificate looked at three times, and many clients come again.
        """
        self._uris: dict[bytes, list[str]] = {}
        """What certificates say that they are of, by fingerprint."""
        rejected = folder / CertificateState.REJECTED
        self._rejected = RejectedCertificates(rejected)
        folders = (self._trusted, self._bridges, self.gateways, self._issuers)
        deciding = [*(each.path for each in folders), self._revocations]
        for path in (*deciding, rejected):
            make_private_folder(path)
        for path in (state_dir, folder, *deciding):
            if problem := open_to_others(path):
                raise ServerStartError(f"{problem} (any user with write access decides who is trusted)")

    @property
    def trusts_all(self) -> bool:
        """Whether every sound certificate is accepted."""
        return self._trust_all

    def check(self, chain: list[x509.Certificate]) -> None:
        """Raise CertificateRefused unless the first certificate of the chain is sound and trusted."""
        try:
            self._check(chain)
        except UNREADABLE as error:
            raise CertificateRefused(INVALID, f"the certificate cannot be read ({error!s:.100})") from error

    def _check(self, chain: list[x509.Certificate]) -> None:
        certificate = chain[0]
        mark = fingerprint_of(certificate)
        self_signed = self._sound.get(mark)
        if self_signed is None:
            self_signed = self._check_made_well(certificate)
            if len(self._sound) >= _MOST_ASKED:
                self._sound.clear()
            self._sound[mark] = self_signed
        else:
            self._check_time(certificate, TIME_INVALID)
        if self._trust_all:
            return
        trusted = self._trusted.refresh()
        # A bridge's or gateway's certificate is trusted as it is, and never as a CA.
        if mark in trusted or mark in self._bridges.refresh() or mark in self.gateways.refresh():
            self._check_not_revoked(certificate, [*trusted.values(), *self._issuers.refresh().values()])
            return
        if self_signed or not self._chain_trusted(chain):
            shown = thumbprint(certificate)[:12]
            bridge = self._bridge_of(certificate)
            as_bridge = f"--bridge {bridge} " if bridge else ""
            remedy = f"compare its thumbprint, then run: ua-fleet cert trust {as_bridge}{shown}{config_option()}"
            raise CertificateRefused(UNTRUSTED, f"{_named(certificate)} is not trusted; {remedy}")

    def _check_made_well(self, certificate: x509.Certificate) -> bool:
        """Refuse a client's certificate for what it is; whether it is signed by its own key."""
        self._check_sound(certificate, TIME_INVALID)
        _check_use(certificate)
        self_signed = certificate.issuer == certificate.subject
        if self_signed and not _issued_by(certificate, certificate):
            raise CertificateRefused(INVALID, "the certificate's own signature is wrong")
        return self_signed

    def _bridge_of(self, certificate: x509.Certificate) -> str:
        """The bridge that a certificate says it is of; whether it is, only `ua-fleet cert trust --bridge` says."""
        return next((self._bridge_names[uri] for uri in application_uris(certificate) if uri in self._bridge_names), "")

    def check_uri(self, certificate: x509.Certificate, application_uri: str) -> None:
        """Raise CertificateRefused unless the certificate is that of the application (OPC 10000-4 6.1.3)."""
        mark = fingerprint_of(certificate)
        known = self._uris.get(mark)
        if known is None:
            known = application_uris(certificate)
            if len(self._uris) >= _MOST_ASKED:
                self._uris.clear()
            self._uris[mark] = known
        if application_uri not in known:
            raise CertificateRefused(URI_INVALID, f"the certificate is not that of {application_uri[:100]!r}")

    def reject(self, certificate: x509.Certificate, address: str) -> None:
        """Keep a refused certificate, so that it can be trusted later; `address` is where it was offered from."""
        self._rejected.keep(certificate, address)

    def _check_sound(self, certificate: x509.Certificate, time_status: int) -> None:
        try:
            key = certificate.public_key()
        except (ValueError, TypeError) as error:
            raise CertificateRefused(INVALID, f"the certificate's key cannot be read ({error})") from error
        if not isinstance(key, rsa.RSAPublicKey) or not MIN_KEY_BITS <= key.key_size <= MAX_KEY_BITS:
            raise CertificateRefused(
                POLICY_CHECK_FAILED, f"the key is not RSA with {MIN_KEY_BITS} to {MAX_KEY_BITS} bits"
            )
        if isinstance(certificate.signature_hash_algorithm, _WEAK_HASHES):
            raise CertificateRefused(POLICY_CHECK_FAILED, "the certificate is signed with a weak hash")
        self._check_time(certificate, time_status)

    def _check_time(self, certificate: x509.Certificate, time_status: int) -> None:
        validity = Validity(certificate.not_valid_before_utc, certificate.not_valid_after_utc)
        if problem := validity.problem(datetime.now(UTC)):
            remedy = "check the clocks of both machines"
            if problem.startswith("expired"):
                bridge = self._bridge_of(certificate)
                again = f"run: ua-fleet cert create --bridge {bridge} --renew{config_option()}"
                remedy = again if bridge else "its owner has to renew it"
            raise CertificateRefused(time_status, f"{_named(certificate)} {problem}; {remedy}")

    def _chain_trusted(self, chain: list[x509.Certificate]) -> bool:
        """Whether the issuers of the certificate lead to a trusted CA, each of them sound and none revoked."""
        trusted = self._trusted.refresh()
        known = [*trusted.values(), *self._issuers.refresh().values()]
        current = chain[0]
        for _ in range(MAX_CHAIN):
            issuer = next((ca for ca in [*known, *chain[1:]] if is_authority(ca) and _issued_by(current, ca)), None)
            if issuer is None or issuer == current:
                return False
            self._check_sound(issuer, ISSUER_TIME_INVALID)
            self._check_not_revoked(current, [issuer])
            if fingerprint_of(issuer) in trusted:
                return True
            current = issuer
        return False

    def _check_not_revoked(self, certificate: x509.Certificate, authorities: Iterable[x509.Certificate]) -> None:
        for revocations in self._load_revocations():
            if revocations.issuer != certificate.issuer:
                continue
            if not any(revocations.is_signed_by(authority) for authority in authorities):
                continue
            if revocations.names(certificate.serial_number):
                raise CertificateRefused(REVOKED, f"certificate {thumbprint(certificate)[:12]} is revoked")

    def _load_revocations(self) -> list[RevocationList]:
        """The revocation lists that there are now; each is read again when its file is another than before."""
        if self._revocations.is_dir() and (problem := open_to_others(self._revocations)):
            raise CertificateRefused(INVALID, problem)
        known, self._lists = self._lists, {}
        for path in sorted(self._revocations.iterdir()) if self._revocations.is_dir() else []:
            try:
                status = path.stat()
                mark = (status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino)
                before = known.get(path)
                self._lists[path] = (mark, RevocationList(path)) if before is None or before[0] != mark else before
            except (OSError, ValueError) as error:
                # A list that cannot be read must not let revoked certificates in.
                raise CertificateRefused(INVALID, f"{path}: no readable revocation list ({error})") from error
        return [revocations for _, revocations in self._lists.values()]


def _named(certificate: x509.Certificate) -> str:
    return f"certificate {thumbprint(certificate)[:12]} of {certificate.subject.rfc4514_string()[:100]!r}"


def _check_use(certificate: x509.Certificate) -> None:
    try:
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
        allowed = usage.digital_signature and usage.key_encipherment and usage.data_encipherment
    except x509.ExtensionNotFound:
        allowed = False
    except ValueError as error:
        raise CertificateRefused(INVALID, f"the certificate's extensions cannot be read ({error})") from error
    try:
        extended = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        allowed = allowed and ExtendedKeyUsageOID.CLIENT_AUTH in extended
    except x509.ExtensionNotFound:
        pass
    if not allowed:
        raise CertificateRefused(USE_NOT_ALLOWED, "the certificate's key usage is not that of an OPC UA client")


def _issued_by(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True
