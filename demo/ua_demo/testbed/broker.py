"""The MQTT broker of a testbed, a mosquitto: its configuration, its certificate, its users and what each may write."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ua_demo.testbed.plan import BROKER, BROKER_PORT, SERVER
from ua_fleet.config.connections import connection_numbers
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.certificates import CertificateError, load_certificate
from ua_fleet.storage.files import make_private_folder, write_whole
from ua_fleet.topics import SERVER_SPACE

__all__ = [
    "AUTHORITY",
    "CERTIFICATE",
    "CONFIGURATION",
    "PASSWORD",
    "RIGHTS",
    "STATE",
    "USERS",
    "prepare_broker",
    "rights_text",
    "user_line",
    "users_at",
]

PASSWORD: Final = "broker-password"  # noqa: S105 - the name of a file
AUTHORITY: Final = "broker-ca.pem"
"""These two in the folder of each process that goes to the broker."""
CONFIGURATION: Final = "mosquitto.conf"
RIGHTS: Final = "rights"
USERS: Final = "users"
STATE: Final = "state"
"""Folder of what the broker itself writes."""
CERTIFICATE, KEY = "broker.pem", "broker.key"

_VALID_DAYS: Final = 3650
_RENEWED_DAYS: Final = 30
_ITERATIONS: Final = 10_000
"""Passwords are random: nobody tries words."""
_SALT_BYTES: Final = 12


def prepare_broker(config: FleetConfig, folder: Path) -> None:
    """Write what the broker needs, and what its users do; what is there and of use stays.

    Args:
        config: of the fleet.
        folder: the volumes' folders stand in it.
    """
    broker = folder / BROKER
    users = users_at(config)
    make_private_folder(broker / STATE)
    authority = _certificate(broker, BROKER)
    known = _known_users(broker / USERS)
    lines: list[str] = []
    for user in users:
        word = _password(folder / user / PASSWORD)
        lines.append(line if _fits(line := known.get(user, ""), word) else user_line(user, word))
        _write(folder / user / AUTHORITY, authority, 0o644)
    _write(broker / USERS, "".join(f"{line}\n" for line in lines).encode())
    _write(broker / RIGHTS, rights_text(users).encode())
    _write(broker / CONFIGURATION, settings_text(broker).encode())


def users_at(config: FleetConfig) -> dict[str, int]:
    """The processes that are on a connection with a broker, by their folders, with their spaces."""
    spaces = {SERVER: SERVER_SPACE, **{name: bridge.space for name, bridge in config.bridges.items()}}
    return {
        name: space
        for name, space in spaces.items()
        if any(config.connections[number].is_brokered for number in connection_numbers(config, space))
    }


def settings_text(broker: Path) -> str:
    """The configuration.

    Args:
        broker: its folder.
    """
    lines = [
        f"listener {BROKER_PORT}",
        f"certfile {broker / CERTIFICATE}",
        f"keyfile {broker / KEY}",
        "tls_version tlsv1.2",  # the oldest
        "allow_anonymous false",
        f"password_file {broker / USERS}",
        f"acl_file {broker / RIGHTS}",
        # What is retained outlives the broker, also one that is killed.
        "persistence true",
        f"persistence_location {broker / STATE}/",
        "autosave_interval 5",
        "max_queued_messages 10000",
        "set_tcp_nodelay true",  # else small acknowledgements wait for up to 40 ms
        "log_dest stderr",  # written at once
        "log_type error",
        "log_type warning",
        "log_type notice",
    ]
    return "\n".join(lines) + "\n"


def rights_text(users: dict[str, int]) -> str:
    """Who may write what, as docs/brokers.md has it: each process its own topics, and the server asks for Actions.

    Args:
        users: with their spaces.
    """
    lines: list[str] = []
    for user, space in users.items():
        topics = [f"{space}/+", f"opcua/uadp/+/{space}/#", f"opcua/uadp/+/{space}", "opcua/uadp/probe/+"]
        if space == SERVER_SPACE:
            topics.append("opcua/uadp/action-request/#")
        lines += [f"user {user}", "topic read #", *(f"topic write {topic}" for topic in topics), ""]
    return "\n".join(lines)


def user_line(user: str, password: str, salt: bytes | None = None) -> str:
    """A line of mosquitto's password file: PBKDF2 with SHA-512, as `mosquitto_passwd` writes it."""
    salt = secrets.token_bytes(_SALT_BYTES) if salt is None else salt
    digest = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, _ITERATIONS)
    return f"{user}:$7${_ITERATIONS}${_text(salt)}${_text(digest)}"


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _known_users(path: Path) -> dict[str, str]:
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {line.partition(":")[0]: line for line in lines}


def _fits(line: str, password: str) -> bool:
    """Whether a line is of this password, and as it is written now."""
    user, _, rest = line.partition(":")
    fields: Sequence[str] = rest.split("$")
    if len(fields) != 5:
        return False
    try:
        salt = base64.b64decode(fields[3], validate=True)
    except ValueError:
        return False
    return hmac.compare_digest(line, user_line(user, password, salt))


def _password(path: Path) -> str:
    if path.exists():
        return path.read_text(encoding="utf-8").strip()
    word = secrets.token_urlsafe(24)
    write_whole(path, f"{word}\n".encode())
    return word


def _write(path: Path, content: bytes, mode: int = 0o600) -> None:
    if not path.exists() or path.read_bytes() != content:
        write_whole(path, content, mode)


def _certificate(broker: Path, host: str) -> bytes:
    """The authority that signs the broker's certificate; both are made where one is missing or soon over.

    The authority's key is not kept: nothing else is ever signed by it.
    """
    authority, certificate, key = broker / AUTHORITY, broker / CERTIFICATE, broker / KEY
    soon = datetime.now(UTC) + timedelta(days=_RENEWED_DAYS)
    try:
        if key.exists() and min(load_certificate(path).not_valid_after_utc for path in (authority, certificate)) > soon:
            return authority.read_bytes()
    except CertificateError:
        pass
    signing, serving = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    issuer, subject = _name(f"ua_fleet {host} authority"), _name(host)
    above = (
        _builder(subject=issuer, issuer=issuer, key=signing.public_key(), signing=signing)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .sign(signing, hashes.SHA256())
    )
    names = x509.SubjectAlternativeName([x509.DNSName(host), x509.DNSName("localhost")])
    below = (
        _builder(subject=subject, issuer=issuer, key=serving.public_key(), signing=signing)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(names, critical=False)
        .sign(signing, hashes.SHA256())
    )
    pem, plain = serialization.Encoding.PEM, serialization.NoEncryption()
    write_whole(key, serving.private_bytes(pem, serialization.PrivateFormat.PKCS8, plain))
    write_whole(certificate, below.public_bytes(pem), 0o644)
    write_whole(authority, above.public_bytes(pem), 0o644)
    return authority.read_bytes()


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _builder(
    *, subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, signing: ec.EllipticCurvePrivateKey
) -> x509.CertificateBuilder:
    now = datetime.now(UTC).replace(microsecond=0)
    signer = x509.SubjectKeyIdentifier.from_public_key(signing.public_key())
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=_VALID_DAYS))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(signer), critical=False)
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )
