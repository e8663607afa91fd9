"""`server.audit` in `fleet.yaml`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ua_fleet.config.base import Model

__all__ = ["AuditConfig", "SyslogConfig"]


class SyslogConfig(Model, frozen=True):
    """A syslog server that gets each line of the audit log too (RFC 5424)."""

    url: Annotated[
        str, Field(pattern=r"^((tls|tcp|udp)://(\[[0-9A-Fa-f:.]+\]|[^\s/:@\[\]]+)(:[0-9]{1,5})?|unix:/[^\s]+)$")
    ]
    """`tls://HOST:6514` (RFC 5425), `unix:/dev/log`, or, in plain text, `tcp://HOST:514` or `udp://HOST:514`."""
    ca_file: str | None = None
    """`tls`: certificates (PEM) by which the server is known, in place of those that this machine trusts."""
    certificate_file: str | None = None
    """`tls`: our certificate (PEM), where the server wants one."""
    key_file: str | None = None
    """`tls`: its key (PEM), where it does not stand in the same file. Paths are relative to `fleet.yaml`."""


class AuditConfig(Model, frozen=True):
    """The audit log; see docs/security.md."""

    max_file_bytes: int = Field(default=8 * 1024 * 1024, ge=65_536, le=1024 * 1024 * 1024)
    """A new file is begun at this size."""
    files: int = Field(default=10, ge=2, le=1000)
    """Files that are kept, the newest included. Before the oldest goes, the server's log warns."""
    syslog: SyslogConfig | None = None
    """Where each line goes besides."""
