"""What UaExpert, or any OPC UA client, needs to log in to a testbed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ua_demo.site import USER
from ua_demo.testbed.plan import IDENTITY, OPERATOR, PASSWORD, Options
from ua_fleet.client import ClientIdentity
from ua_fleet.endpoint.certificates import CertificateError, load_certificate, thumbprint
from ua_fleet.errors import ConfigError

__all__ = ["Login", "login_of"]


@dataclass(frozen=True, slots=True)
class Login:
    """See the module."""

    endpoint: str
    security: str
    user: str
    password: str
    password_file: str
    server_thumbprint: str
    """SHA-1 of the server's certificate, as OPC UA tools show it."""
    console: str
    """URL of the web console; the same user and password."""


def login_of(folder: Path, options: Options) -> Login:
    """Read it from the operator's volume; raises ConfigError where the testbed was not prepared.

    Args:
        folder: the volumes' folders stand in it.
        options: where the ports of server and console are published.
    """
    operator = folder / OPERATOR
    password = operator / PASSWORD
    try:
        word = password.read_text(encoding="utf-8").strip()
        certificate = load_certificate(ClientIdentity(operator / IDENTITY).pinned_server)
    except (OSError, CertificateError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        remedy = "start the testbed first, or run: ua-fleet testbed prepare"
        raise ConfigError(f"the testbed is not prepared: {reason}", file=str(operator), suggestion=remedy) from error
    host = "localhost" if options.published_host == "0.0.0.0" else options.published_host
    endpoint = f"opc.tcp://{host}:{options.published_port}/ua_fleet"
    console = f"http://127.0.0.1:{options.console_port}/"
    security = "Basic256Sha256, Sign & Encrypt"
    return Login(endpoint, security, USER, word, str(password), thumbprint(certificate), console)
