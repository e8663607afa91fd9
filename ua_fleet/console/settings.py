"""What the console is told: `console.yaml`, or the options of `ua-fleet console`."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

__all__ = ["ConsoleLimits", "ConsoleSettings", "FleetAddress", "TlsFiles", "default_state_dir", "split_listen"]

DEFAULT_LISTEN: Final = "127.0.0.1:8080"
_FLEET_NAME: Final = r"^[A-Za-z0-9_-]{1,32}$"


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid")


class FleetAddress(_Section):
    """Where a fleet's server is."""

    endpoint: str = Field(pattern=r"^opc\.tcp://", max_length=500)
    title: str = Field(default="", max_length=100)
    """What the page calls it; without it, its name here."""
    policy: str = "Basic256Sha256"
    insecure: bool = False
    """Neither sign nor encrypt what goes to this server, where it allows that. Passwords are then read by others."""


class TlsFiles(_Section):
    """Certificate and key of the console itself, for HTTPS; PEM or DER."""

    certificate: Path
    key: Path


class ConsoleLimits(_Section):
    """Bounds of what strangers and people can take from the console."""

    sessions: int = Field(default=500, ge=1)
    """People logged in, all together; the next one is refused."""
    sessions_per_user: int = Field(default=16, ge=1)
    """Browsers of one user; the one that was not used for longest is logged out for the next."""
    sockets: int = Field(default=500, ge=1)
    sockets_per_session: int = Field(default=16, ge=1)
    """Tabs of one browser."""
    feeds_per_socket: int = Field(default=64, ge=1)
    feeds_per_user: int = Field(default=200, ge=1)
    """Different feeds of one user at one fleet."""
    request_bytes: int = Field(default=1_100_000, ge=1024)
    """Body of a request. A scenario may have 1 MB."""
    message_bytes: int = Field(default=65_536, ge=1024)
    """Message of a page on its WebSocket."""
    messages_per_s: float = Field(default=50.0, gt=0)
    setpoints_per_s: float = Field(default=100.0, gt=0)
    """Messages of a page that drives a robot."""
    drives_per_user: int = Field(default=4, ge=1)
    """Robots that one user drives at a fleet at once, each by an OPC UA session of its own."""
    requests_at_once: int = Field(default=8, ge=1)
    """Operations of one user that have not been answered."""
    connections: int = Field(default=2000, ge=10)
    connections_per_address: int = Field(default=64, ge=1)
    """Without WebSockets of people who are logged in, and without those of trusted proxies."""
    logins_at_once: int = Field(default=8, ge=1)
    """Logins that wait for one fleet's server; half as many of one address."""


class ConsoleSettings(_Section):
    """All of it."""

    listen: str = DEFAULT_LISTEN
    """Address and port; port 0: any that is free."""
    fleets: Annotated[dict[str, FleetAddress], Field(min_length=1, max_length=100)]
    allowed_hosts: list[str] = []
    """Names by which browsers reach the console, without port; those of loopback are always among them there."""
    trusted_proxies: list[str] = []
    """Addresses or networks of reverse proxies whose X-Forwarded headers count."""
    tls: TlsFiles | None = None
    plain_http: bool = False
    """Serve without TLS on an address that is not loopback, as behind a proxy that does TLS."""
    session_idle_s: float = Field(default=4 * 3600.0, ge=60)
    """Without anything that a person does, a login ends after so long; a page that only shows is no such thing."""
    session_max_s: float = Field(default=12 * 3600.0, ge=60)
    banner: str = Field(default="", max_length=500)
    """Shown before the login."""
    state_dir: Path | None = None
    """The console's own certificate, and the servers that it knows; by default in the folder of this user."""
    monitoring_port: int | None = Field(default=None, ge=0, le=65535)
    """Where /metrics, /healthz and /readyz are answered on loopback, as by the other processes; without it nowhere."""
    limits: ConsoleLimits = ConsoleLimits()

    @field_validator("listen")
    @classmethod
    def _is_address(cls, value: str) -> str:
        split_listen(value)
        return value

    @field_validator("fleets")
    @classmethod
    def _are_names(cls, value: dict[str, FleetAddress]) -> dict[str, FleetAddress]:
        import re

        for name in value:
            if not re.fullmatch(_FLEET_NAME, name):
                raise ValueError(f"{name!r} is no name of a fleet: letters, digits, _ and -, at most 32")
        return value

    @field_validator("trusted_proxies")
    @classmethod
    def _are_networks(cls, value: list[str]) -> list[str]:
        for one in value:
            ipaddress.ip_network(one, strict=False)
        return value

    @model_validator(mode="after")
    def _is_safe(self) -> ConsoleSettings:
        if self.is_loopback:
            return self
        if not self.allowed_hosts:
            raise ValueError(
                f"allowed_hosts is missing: {self.listen} is not loopback, so say by which names browsers reach it"
            )
        if self.tls is None and not self.plain_http:
            raise ValueError(
                f"tls is missing: {self.listen} is not loopback, and passwords would be readable; "
                "where a proxy does TLS set plain_http: true"
            )
        return self

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        host, _ = split_listen(self.listen)
        return host == "localhost" or (_is_ip(host) and ipaddress.ip_address(host).is_loopback)


def _is_ip(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def split_listen(listen: str) -> tuple[str, int]:
    """Host and port of `127.0.0.1:8080`, `[::1]:8080` or `:8080` (all addresses); raises ValueError."""
    host, colon, port = listen.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise ValueError(f"{listen!r} is no address and port, such as {DEFAULT_LISTEN}")
    bare = host[1:-1] if host.startswith("[") and host.endswith("]") else host
    return bare or "0.0.0.0", int(port)


def default_state_dir() -> Path:
    """Where the console keeps its certificate: `$XDG_STATE_HOME/ua-fleet/console`."""
    from ua_fleet.client import default_identity_folder

    return default_identity_folder().parent / "console"
