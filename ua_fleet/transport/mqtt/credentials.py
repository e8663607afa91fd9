"""How a process logs in to a broker: by a certificate, or by a user whose password is in a file."""

from __future__ import annotations

import ssl
import stat
from dataclasses import dataclass, field
from pathlib import Path

from ua_fleet.errors import TransportError

__all__ = ["Credentials"]

_MOST_PASSWORD_BYTES = 65_535


@dataclass(frozen=True, slots=True)
class Credentials:
    """What is shown to a broker. The password stands in no text that is made of this."""

    user: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: ssl.SSLContext | None = None
    section: str = "pubsub.broker"
    """Where `fleet.yaml` has it, for errors."""

    @classmethod
    def read(
        cls,
        folder: Path,
        *,
        has_tls: bool,
        user: str | None = None,
        password_file: str | None = None,
        ca_file: str | None = None,
        certificate_file: str | None = None,
        key_file: str | None = None,
        section: str = "pubsub.broker",
    ) -> Credentials:
        """Read the files, which are relative to a folder; raises TransportError with the key of one that is no use.

        Args:
            folder: of `fleet.yaml`.
            has_tls: whether the connection is by TLS.
            user: the user's name.
            password_file: with the user's password in its first line.
            ca_file: authorities that sign the broker's certificate; otherwise those of the system.
            certificate_file: of the process.
            key_file: its private key.
            section: of `fleet.yaml` with these keys.
        """
        password = None if password_file is None else _password(folder / password_file, section)
        if not has_tls:
            given = {"ca_file": ca_file, "certificate_file": certificate_file, "key_file": key_file}
            for key, value in given.items():
                if value is not None:
                    url = f"{section.rpartition('.')[0]}.url"
                    raise TransportError(f"{section}.{key}: `{url}` begins with mqtt://; write mqtts:// for TLS")
            return cls(user, password, None, section)
        return cls(user, password, _context(folder, ca_file, certificate_file, key_file, section), section)


def _password(path: Path, section: str) -> str:
    try:
        if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise TransportError(f"{section}.password_file: others may read {path}; run: chmod 600 {path}")
        with path.open("rb") as file:
            line = file.read(_MOST_PASSWORD_BYTES + 2).split(b"\n", 1)[0].removesuffix(b"\r")
        text = line.decode()
    except OSError as error:
        reason = (error.strerror or "it cannot be read").lower()
        raise TransportError(f"{section}.password_file: {path}: {reason}") from None
    except UnicodeDecodeError:
        raise TransportError(f"{section}.password_file: {path} is no UTF-8 text") from None
    if not text:
        raise TransportError(f"{section}.password_file: the first line of {path} is empty; write the password there")
    return text


def _context(
    folder: Path, ca_file: str | None, certificate_file: str | None, key_file: str | None, section: str
) -> ssl.SSLContext:
    authorities = None if ca_file is None else folder / ca_file
    try:  # with a file, only the authorities in it, and not the system's too
        context = ssl.create_default_context(cafile=authorities)
    except (OSError, ssl.SSLError) as error:
        raise TransportError(f"{section}.ca_file: {authorities} cannot be used: {_reason(error)}") from None
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if certificate_file is not None and key_file is not None:
        certificate, key = folder / certificate_file, folder / key_file
        try:  # a key with a passphrase would ask for it on the terminal
            context.load_cert_chain(certificate, key, password=_no_passphrase)
        except (OSError, ssl.SSLError) as error:
            reason = f"{certificate} with {key}: {_reason(error)}"
            raise TransportError(f"{section}.certificate_file: {reason}") from None
    return context


def _no_passphrase() -> str:
    return ""


def _reason(error: OSError) -> str:
    return (error.strerror or str(error) or "it cannot be read").lower()
