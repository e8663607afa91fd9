"""By which certificate servers know the console."""

from __future__ import annotations

import socket
from pathlib import Path

from ua_fleet.client import ClientIdentity

__all__ = ["console_identity"]


def console_identity(state_dir: Path) -> ClientIdentity:
    """The console's certificate and the servers that it knows, in its `state_dir`."""
    return ClientIdentity(
        state_dir,
        name="console",
        application_uri=f"urn:{socket.gethostname()}:ua-fleet:console",
        subject="ua-fleet console",
    )
