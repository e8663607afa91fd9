"""Where the command line keeps what is this user's of the machine."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["default_identity_folder"]


def default_identity_folder() -> Path:
    """Where the client keeps its certificate, and where it is logged in: `$XDG_STATE_HOME/ua-fleet/client`."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "ua-fleet" / "client"
