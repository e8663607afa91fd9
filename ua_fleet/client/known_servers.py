"""The servers that a client has met: their certificates' thumbprints, by endpoint and ApplicationUri.

One endpoint is that of many servers in the course of time: a demonstration today, an own fleet tomorrow. Each says
which one it is by the ApplicationUri in its certificate (OPC 10000-6, 6.2.2).
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from cryptography import x509

from ua_fleet.document import as_mapping
from ua_fleet.errors import UPGRADE, AccessRefused, newer_version
from ua_fleet.printing import config_option
from ua_fleet.storage.files import write_whole
from ua_fleet.values import StatusCode

__all__ = ["KnownServer", "KnownServers", "Meeting", "application_uri_of"]

VERSION: Final = 2
"""Version 1 had no version: an object of endpoints and thumbprints."""


@dataclass(frozen=True, slots=True)
class KnownServer:
    """A server that was met."""

    endpoint: str
    application_uri: str
    """Empty where a program before version 2 has met it."""
    thumbprint: str
    """SHA-1 of its certificate, in hexadecimal."""


@dataclass(frozen=True, slots=True)
class Meeting:
    """What is to be said of a meeting with a server."""

    is_first: bool
    others: tuple[str, ...] = ()
    """ApplicationUris of the servers that were met at this endpoint before, where this is the first meeting."""


class KnownServers:
    """The file of them."""

    def __init__(self, path: Path, *, bridge: str = "") -> None:
        """Say where it is, and whose: a bridge's, or by default those of this user of the machine."""
        self._path = path
        self._bridge = bridge

    def meet(self, endpoint: str, certificate: bytes) -> Meeting:
        """Hold a server's certificate against what it showed before; remember it at the first meeting.

        On this machine, whoever has the port is the server, and another ApplicationUri another fleet, met anew. On
        another machine an impostor could say any URI and be given the password, so that a person has to say it.

        Raises:
            AccessRefused: it shows another certificate than before, or the file cannot be read.
        """
        known = self.load()
        uri, thumbprint = application_uri_of(certificate), _thumbprint(certificate)
        here = [server for server in known if server.endpoint == endpoint]
        if any((server.application_uri or uri, server.thumbprint) == (uri, thumbprint) for server in here):
            return Meeting(is_first=False)
        is_another = uri not in ("", *(server.application_uri for server in here))
        if not here or (is_another and _is_this_machine(endpoint)):
            self._save([*known, KnownServer(endpoint, uri, thumbprint)])
            return Meeting(is_first=True, others=tuple(server.application_uri for server in here))
        option = f" --bridge {self._bridge}{config_option()}" if self._bridge else ""
        before = ", ".join(f"{server.application_uri} {server.thumbprint}".lstrip() for server in here)
        raise AccessRefused(
            StatusCode.BAD_SECURITY_CHECKS_FAILED,
            f"the server at {endpoint} shows another certificate ({uri} {thumbprint}) than before ({before}); "
            f"if that is right, run: ua-fleet cert forget {endpoint}{option}",
        )

    def forget(self, endpoint: str) -> list[KnownServer]:
        """Forget the servers of an endpoint; the next one there is met anew.

        Returns:
            Those that were known.

        Raises:
            AccessRefused: the file cannot be read.
        """
        known = self.load()
        forgotten = [server for server in known if server.endpoint == endpoint]
        if forgotten:
            self._save([server for server in known if server.endpoint != endpoint])
        return forgotten

    def load(self) -> list[KnownServer]:
        """All of them; raises AccessRefused where the file cannot be read."""
        try:
            content = json.loads(self._path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return []
        except (OSError, ValueError) as error:
            raise self._unreadable(str(error)) from error
        document = as_mapping(content)
        if document is None:
            raise self._unreadable("it holds no object")
        if newer := newer_version(document.get("version"), VERSION):
            raise AccessRefused(StatusCode.BAD_SECURITY_CHECKS_FAILED, f"{self._path} {newer}; {UPGRADE}")
        try:
            if "version" not in document:
                return [KnownServer(_text(endpoint), "", _text(mark)) for endpoint, mark in document.items()]
            return [
                KnownServer(_text(one["endpoint"]), _text(one["application_uri"]), _text(one["thumbprint"]))
                for one in document["servers"]
            ]
        except (KeyError, TypeError) as error:
            raise self._unreadable("it is no list of servers") from error

    def _save(self, servers: list[KnownServer]) -> None:
        rows = [
            {"endpoint": one.endpoint, "application_uri": one.application_uri, "thumbprint": one.thumbprint}
            for one in servers
        ]
        text = json.dumps({"version": VERSION, "servers": rows}, indent=2)
        write_whole(self._path, f"{text}\n".encode(), 0o644)

    def _unreadable(self, reason: str) -> AccessRefused:
        return AccessRefused(
            StatusCode.BAD_SECURITY_CHECKS_FAILED,
            f"{self._path} cannot be read ({reason}); remove it, and servers are met anew",
        )


def application_uri_of(certificate: bytes) -> str:
    """The ApplicationUri of a certificate in DER; empty where it has none, or is no certificate at all."""
    try:
        parsed = x509.load_der_x509_certificate(certificate)
        names = parsed.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except (ValueError, x509.ExtensionNotFound):
        return ""
    return uris[0] if uris else ""


def _is_this_machine(endpoint: str) -> bool:
    try:
        host = urlsplit(endpoint).hostname or ""
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _thumbprint(certificate: bytes) -> str:
    return hashlib.sha1(certificate, usedforsecurity=False).hexdigest()


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value
