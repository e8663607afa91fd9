"""Whether the server's certificate names the hosts that clients connect to: many compare them (OPC 10000-4 6.1.3)."""

from __future__ import annotations

import ipaddress

import structlog
from cryptography import x509

from ua_fleet.endpoint.certificates import host_names
from ua_fleet.printing import config_option
from ua_fleet.transport.interfaces import machine_addresses

__all__ = ["missing_hosts", "warn_of_missing_hosts"]

_log = structlog.get_logger(__name__)


def missing_hosts(certificate: x509.Certificate, host: str) -> list[str]:
    """Which names a certificate lacks for a server that listens at `host`; of all addresses those of the machine."""
    named = {_comparable(name) for name in host_names(certificate)}
    wanted = machine_addresses() if _is_everywhere(host) else [host]
    return [name for name in wanted if _comparable(name) not in named]


def warn_of_missing_hosts(certificate: x509.Certificate, host: str) -> None:
    """Log which names the server's certificate lacks; it may be older than `server.host`, or an address."""
    if not (missing := missing_hosts(certificate, host)):
        return
    if certificate.issuer == certificate.subject:
        _log.warning(
            "the server's certificate lacks names, and clients that compare them refuse it; "
            f"run: ua-fleet cert create --renew{config_option()}, then restart the server",
            names=", ".join(missing),
        )
    else:
        _log.warning(
            "the server's certificate lacks names, and clients that compare them refuse it; have its CA issue another "
            "one with them",
            names=", ".join(missing),
        )


def _comparable(name: str) -> str:
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name.lower()


def _is_everywhere(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
