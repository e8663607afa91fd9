"""Application instance certificates (OPC 10000-6 6.2.2) and the folders they are kept in.

<state_dir>/certificates/
    own/server.der, own/server-key.pem     our certificate and its key (mode 0600)
    trusted/                               client certificates, or CAs, that we accept
    bridges/<name>.der                     the certificate by which that bridge is known; accepted too
    gateways/<name>.der                    that of a client through which many people come; accepted too
    issuers/                               CAs that only complete a chain
    crl/                                   revocation lists of the CAs
    rejected/                              what clients offered and we refused; at most 32

Files are written whole or not at all, keys with mode 0600 from their first byte on.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Final

import structlog
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ua_fleet.errors import ServerStartError, StorageUnavailable, UaFleetError
from ua_fleet.printing import config_option
from ua_fleet.storage.files import write_whole
from ua_fleet.transport.interfaces import machine_addresses
from ua_fleet.validity import Validity
from ua_fleet.values import StatusCode

__all__ = [
    "CertificateError",
    "CertificateFiles",
    "CertificateInfo",
    "CertificateState",
    "certificates_folder",
    "create_certificate",
    "ensure_application_certificate",
    "ensure_client_certificate",
    "find_rejected",
    "host_names",
    "list_certificates",
    "load_certificate",
    "revoke",
    "revoke_bridge",
    "revoke_gateway",
    "thumbprint",
    "trust",
    "trust_bridge",
    "trust_gateway",
]

_log = structlog.get_logger("ua_fleet.certificates")

KEY_BITS: Final = 2048
VALID_DAYS: Final = 5 * 365
MAX_FILE_BYTES: Final = 65_536
_GATEWAY_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_]{0,63}")
UNREADABLE: Final = (
    ValueError,
    TypeError,
    UnsupportedAlgorithm,
    x509.InvalidVersion,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
)
"""What a part of a certificate raises that cannot be read. Parts are read late: one that was loaded may have any."""


class CertificateError(UaFleetError):
    """A certificate cannot be found, read or written."""

    ua_status = StatusCode.BAD_CONFIGURATION_ERROR
    remedy = "See `ua-fleet cert list`, and name one of the certificates there."


class CertificateState(StrEnum):
    """Which folder a certificate stands in."""

    OWN = "own"
    TRUSTED = "trusted"
    BRIDGE = "bridges"
    GATEWAY = "gateways"
    ISSUER = "issuers"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class CertificateFiles:
    """A certificate (DER) and its private key (PEM)."""

    certificate: Path
    private_key: Path


@dataclass(frozen=True, slots=True)
class CertificateInfo:
    """A certificate as `ua-fleet cert list` shows it."""

    path: Path
    state: CertificateState
    subject: str
    application_uri: str
    thumbprint: str
    validity: Validity

    @property
    def bridge(self) -> str:
        """The bridge that is known by this certificate; empty for all others."""
        return self.path.stem if self.state is CertificateState.BRIDGE else ""

    @property
    def gateway(self) -> str:
        """The gateway that is known by this certificate; empty for all others."""
        return self.path.stem if self.state is CertificateState.GATEWAY else ""

    @property
    def renewal(self) -> str:
        """What to do when it ends."""
        if self.state is CertificateState.BRIDGE:
            return f"ua-fleet cert create --bridge {self.bridge} --renew --trust{config_option()}"
        if self.state is CertificateState.GATEWAY:
            return (
                f"its owner has to renew it; then: ua-fleet cert trust --gateway {self.gateway} FILE{config_option()}"
            )
        if self.state is not CertificateState.OWN:
            return f"its owner has to renew it; then: ua-fleet cert trust FILE{config_option()}"
        if self.path.stem == "server":
            return f"ua-fleet cert create --renew{config_option()}, then restart the server"
        return f"ua-fleet cert create --client {self.path.stem} --renew{config_option()}"


def certificates_folder(state_dir: Path) -> Path:
    """The folder of all certificates."""
    return state_dir / "certificates"


def thumbprint(certificate: x509.Certificate) -> str:
    """The SHA-1 of the certificate as OPC UA tools show it (OPC 10000-4 7.2), an address and no protection."""
    return certificate.fingerprint(hashes.SHA1()).hex()  # noqa: S303 - the specification's name for a certificate


def application_uris(certificate: x509.Certificate) -> list[str]:
    """The URIs of the SubjectAltName; an application's certificate has one, its ApplicationUri."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, *UNREADABLE):
        return []
    return names.get_values_for_type(x509.UniformResourceIdentifier)


def host_names(certificate: x509.Certificate) -> set[str]:
    """The names and addresses of hosts in the SubjectAltName, with which clients compare where they have connected."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, *UNREADABLE):
        return set()
    return {*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))}


def load_certificate(path: Path) -> x509.Certificate:
    """Read a certificate, DER or PEM; raises CertificateError."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise CertificateError(f"{path}: too large for a certificate")
        data = path.read_bytes()
        if data.lstrip().startswith(b"-----BEGIN"):
            return x509.load_pem_x509_certificate(data)
        return x509.load_der_x509_certificate(data)
    except (OSError, *UNREADABLE) as error:
        raise CertificateError(f"{path}: no readable certificate ({error})") from error


def _host_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def create_certificate(
    files: CertificateFiles,
    *,
    application_uri: str,
    common_name: str,
    hostnames: Sequence[str] = (),
    days: float = VALID_DAYS,
    server: bool = False,
    key: rsa.RSAPrivateKey | None = None,
) -> x509.Certificate:
    """Make a self-signed application instance certificate, and a key unless one is given, and write what is new."""
    is_new = key is None
    key = key or rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
    name = x509.Name(
        [
            x509.NameAttribute(NameOID.COMMON_NAME, common_name[:64]),
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, "ua_fleet"),
        ]
    )
    now = datetime.now(UTC).replace(microsecond=0)
    hosts = list(dict.fromkeys(host for host in hostnames if host not in ("", "0.0.0.0", "::")))
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if server else [])]
    public = key.public_key()
    identifier = x509.SubjectKeyIdentifier.from_public_key(public)
    names = [x509.UniformResourceIdentifier(application_uri), *map(_host_name, hosts)]
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=True,
                content_commitment=True,
                key_encipherment=True,
                data_encipherment=True,
                # A self-signed certificate signs itself (OPC 10000-6 table 43).
                key_cert_sign=True,
                key_agreement=False,
                crl_sign=False,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
        .add_extension(x509.ExtendedKeyUsage(usage), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(identifier, critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier), critical=False)
        .sign(key, hashes.SHA256())
    )
    if is_new:
        plain = serialization.NoEncryption()
        write_whole(
            files.private_key, key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
        )
    write_whole(files.certificate, certificate.public_bytes(serialization.Encoding.DER), 0o644)
    return certificate


def own_files(state_dir: Path, name: str = "server") -> CertificateFiles:
    """Where a certificate of ours and its key stand."""
    own = certificates_folder(state_dir) / CertificateState.OWN
    return CertificateFiles(own / f"{name}.der", own / f"{name}-key.pem")


def ensure_application_certificate(
    state_dir: Path, application_uri: str, hostnames: Sequence[str] = (), *, renew: bool = False
) -> CertificateFiles:
    """The server's certificate, made if there is none; raises ServerStartError when the one there is of no use.

    With `renew` it is made anew, with the key that there is.
    """
    files = own_files(state_dir)
    everywhere = machine_addresses() if {"0.0.0.0", "::"} & set(hostnames) else []
    hosts = [*hostnames, *everywhere, socket.gethostname(), "localhost", "127.0.0.1"]
    return _ensure(files, application_uri, "ua_fleet server", hosts, server=True, renew=renew)


def ensure_client_certificate(
    state_dir: Path, application_uri: str, name: str = "client", *, renew: bool = False
) -> CertificateFiles:
    """A certificate for a client of our own, made if there is none, or made anew with the key that there is."""
    hosts = [socket.gethostname()]
    return _ensure(own_files(state_dir, name), application_uri, f"ua_fleet {name}", hosts, server=False, renew=renew)


def _ensure(
    files: CertificateFiles,
    application_uri: str,
    common_name: str,
    hosts: Sequence[str],
    *,
    server: bool,
    renew: bool,
) -> CertificateFiles:
    renewal = (
        f"run: ua-fleet cert create{'' if server else f' --client {files.certificate.stem}'} --renew{config_option()}"
    )
    remedy = f"move both files away and run: {renewal.removeprefix('run: ').replace(' --renew', '')}"
    wanted = partial(
        create_certificate, application_uri=application_uri, common_name=common_name, hostnames=hosts, server=server
    )
    if not files.certificate.exists() and not files.private_key.exists():
        wanted(files)
        return files
    try:
        certificate = load_certificate(files.certificate)
        mode = files.private_key.stat().st_mode & 0o777
        key = serialization.load_pem_private_key(files.private_key.read_bytes(), password=None)
    except (CertificateError, OSError, ValueError, TypeError) as error:
        raise ServerStartError(f"{files.certificate}: certificate or key cannot be read ({error}); {remedy}") from error
    if mode & 0o077:
        raise ServerStartError(
            f"{files.private_key}: others may read or write it (mode {mode:o}); run: chmod 600 {files.private_key}"
        )
    if key.public_key() != certificate.public_key():
        raise ServerStartError(f"{files.private_key}: is not the key of {files.certificate.name}; {remedy}")
    if certificate.issuer != certificate.subject:
        renewal = f"have {certificate.issuer.rfc4514_string()} renew it, and put it there"
        if renew:
            raise ServerStartError(f"{files.certificate}: is no certificate of ours; {renewal}")
    if renew:
        if not isinstance(key, rsa.RSAPrivateKey):
            raise ServerStartError(f"{files.private_key}: is no RSA key; {remedy}")
        wanted(files, key=key)
        return files
    if problem := _validity(certificate).problem(datetime.now(UTC)):
        what = renewal if problem.startswith("expired") else "check the clock of this machine"
        raise ServerStartError(f"{files.certificate}: {problem}; {what}")
    if application_uri not in application_uris(certificate):
        raise ServerStartError(f"{files.certificate}: is not for the application {application_uri}; {remedy}")
    return files


def _validity(certificate: x509.Certificate) -> Validity:
    return Validity(certificate.not_valid_before_utc, certificate.not_valid_after_utc)


def is_authority(certificate: x509.Certificate) -> bool:
    """Whether a certificate may issue others."""
    try:
        constraints = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
    except (x509.ExtensionNotFound, *UNREADABLE):
        return False
    return constraints.ca and usage.key_cert_sign


def _info(path: Path, state: CertificateState) -> CertificateInfo:
    certificate = load_certificate(path)
    try:
        subject = certificate.subject.rfc4514_string()
    except UNREADABLE as error:
        raise CertificateError(f"{path}: no readable certificate ({error})") from error
    uri = next(iter(application_uris(certificate)), "")
    return CertificateInfo(path, state, subject, uri, thumbprint(certificate), _validity(certificate))


def certificate_paths(folder: Path) -> list[Path]:
    """The certificate files of a folder, by name."""
    if not folder.is_dir():
        return []
    suffixes = (".der", ".pem", ".crt", ".cer")
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes and "-key" not in path.stem)


def list_certificates(state_dir: Path, *, strict: bool = False) -> list[CertificateInfo]:
    """Every readable certificate; the rest is logged, but StorageUnavailable for a folder with `strict`."""
    found: list[CertificateInfo] = []
    for state in CertificateState:
        folder = certificates_folder(state_dir) / state
        try:
            paths = certificate_paths(folder)
        except OSError as error:
            if strict:
                raise StorageUnavailable(f"{folder}: {error.strerror}; run this as the user of the server") from error
            _log.warning("certificates left out", reason=f"{folder}: {error.strerror}")
            continue
        for path in paths:
            try:
                found.append(_info(path, state))
            except CertificateError as error:
                _log.warning("certificate left out", reason=str(error))
    return found


def _find(state_dir: Path, what: str | Path, states: Sequence[CertificateState]) -> tuple[x509.Certificate, list[Path]]:
    """A certificate: a file, or one of these folders by the first characters of its thumbprint, with its paths."""
    source = Path(what)
    if source.is_file():
        return load_certificate(source), []
    prefix = str(what).lower().replace(":", "").replace(" ", "")
    there = [info for info in list_certificates(state_dir, strict=True) if info.state in states]
    matches = [info for info in there if prefix and info.thumbprint.startswith(prefix)]
    count = len({info.thumbprint for info in matches})
    if count != 1:
        kind = "rejected" if states[0] is CertificateState.REJECTED else "trusted"
        problem = f"{count} {kind} certificates begin with" if matches else "no file and no thumbprint:"
        raise CertificateError(f"{problem} {what}; list them with: ua-fleet cert list{config_option()}")
    return load_certificate(matches[0].path), [info.path for info in matches]


def find_rejected(state_dir: Path, what: str | Path) -> CertificateInfo:
    """A certificate that `trust` would trust: a file, or one from `rejected/` by its thumbprint's first characters."""
    _, paths = _find(state_dir, what, (CertificateState.REJECTED,))
    return _info(paths[0] if paths else Path(what), CertificateState.REJECTED)


def _move(
    certificate: x509.Certificate, sources: Sequence[Path], target: Path, state: CertificateState
) -> CertificateInfo:
    write_whole(target, certificate.public_bytes(serialization.Encoding.DER), 0o644)
    for source in sources:
        if source != target:
            source.unlink(missing_ok=True)
            source.with_suffix(".json").unlink(missing_ok=True)  # of `rejected/`: who offered it
    return _info(target, state)


def _places_of(
    state_dir: Path, certificate: x509.Certificate, states: Sequence[CertificateState]
) -> list[CertificateInfo]:
    """Where a certificate stands in these folders, under whichever name."""
    mark = thumbprint(certificate)
    return [info for info in list_certificates(state_dir) if info.state in states and info.thumbprint == mark]


def trust(state_dir: Path, what: str | Path) -> CertificateInfo:
    """Trust a certificate as that of an ordinary client, also where it was a gateway's.

    Args:
        state_dir: the server's.
        what: a file, or the first characters of the thumbprint of one in `rejected/` or `gateways/`.
    """
    certificate, sources = _find(state_dir, what, (CertificateState.REJECTED, CertificateState.GATEWAY))
    marks = [info.path for info in _places_of(state_dir, certificate, (CertificateState.GATEWAY,))]
    folder = certificates_folder(state_dir) / CertificateState.TRUSTED
    target = folder / f"{thumbprint(certificate)}.der"
    return _move(certificate, [*sources, *marks], target, CertificateState.TRUSTED)


def trust_bridge(state_dir: Path, name: str, what: str | Path) -> CertificateInfo:
    """Know a bridge by this certificate from now on, and by no other; `what` as in `trust`.

    Raises:
        CertificateError: there is no such certificate, or another bridge is known by it.
    """
    certificate, sources = _find(state_dir, what, (CertificateState.REJECTED, CertificateState.TRUSTED))
    for info in _places_of(state_dir, certificate, (CertificateState.BRIDGE,)):
        if info.bridge != name:
            raise CertificateError(
                f"bridge {info.bridge} is known by this certificate; make one for {name} with: "
                f"ua-fleet cert create --bridge {name}{config_option()}"
            )
    folder = certificates_folder(state_dir) / CertificateState.BRIDGE
    return _move(certificate, sources, folder / f"{name}.der", CertificateState.BRIDGE)


def trust_gateway(state_dir: Path, name: str, what: str | Path) -> CertificateInfo:
    """Trust a certificate as that of a gateway, which is known by no other from now on; `what` as in `trust`.

    Raises:
        CertificateError: there is no such certificate, the name is none, or it is a bridge's or another gateway's.
    """
    if not _GATEWAY_NAME.fullmatch(name):
        raise CertificateError(f"{name!r} is no name of a gateway; use 1 to 64 letters, digits and _")
    states = (CertificateState.REJECTED, CertificateState.TRUSTED)
    certificate, _ = _find(state_dir, what, states)
    for info in _places_of(state_dir, certificate, (CertificateState.BRIDGE, CertificateState.GATEWAY)):
        if info.bridge or info.gateway != name:
            whose = f"bridge {info.bridge}" if info.bridge else f"gateway {info.gateway}"
            raise CertificateError(f"{whose} is known by this certificate; a gateway has one of its own")
    sources = [info.path for info in _places_of(state_dir, certificate, states)]
    folder = certificates_folder(state_dir) / CertificateState.GATEWAY
    return _move(certificate, sources, folder / f"{name}.der", CertificateState.GATEWAY)


def revoke(state_dir: Path, what: str | Path) -> CertificateInfo:
    """Take trust from the certificate of a client or gateway, by thumbprint or file; it stands in `rejected/` then."""
    states = (CertificateState.TRUSTED, CertificateState.GATEWAY)
    certificate, _ = _find(state_dir, what, states)
    sources = [info.path for info in _places_of(state_dir, certificate, states)]
    if not sources:
        raise CertificateError(f"{what} is not trusted; list what is with: ua-fleet cert list{config_option()}")
    return _reject(certificate, sources, state_dir)


def revoke_bridge(state_dir: Path, name: str) -> CertificateInfo:
    """Know a bridge by no certificate any more; it stands in `rejected/` then."""
    path = certificates_folder(state_dir) / CertificateState.BRIDGE / f"{name}.der"
    if not path.exists():
        raise CertificateError(
            f"bridge {name} is known by no certificate; list them with: ua-fleet cert list{config_option()}"
        )
    return _reject(load_certificate(path), [path], state_dir)


def revoke_gateway(state_dir: Path, name: str) -> CertificateInfo:
    """Trust the certificate of a gateway no longer; it stands in `rejected/` then."""
    found = [info for info in list_certificates(state_dir) if info.gateway == name]
    if not found:
        raise CertificateError(f"there is no gateway {name}; list them with: ua-fleet cert list{config_option()}")
    return revoke(state_dir, found[0].path)


def _reject(certificate: x509.Certificate, sources: Sequence[Path], state_dir: Path) -> CertificateInfo:
    folder = certificates_folder(state_dir) / CertificateState.REJECTED
    return _move(certificate, sources, folder / f"{thumbprint(certificate)}.der", CertificateState.REJECTED)
