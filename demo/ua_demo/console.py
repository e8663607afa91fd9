"""The web console beside a demonstration: its settings, and the server's trust in its certificate as a gateway's."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from ua_fleet.endpoint.certificates import trust_gateway

__all__ = ["CONSOLE", "introduce_console", "settings_text", "why_no_console"]

CONSOLE: Final = "console"
"""Name of its process, of its folder, and of the gateway as which the server knows it."""


def why_no_console() -> str:
    """Why no console can run here, with the remedy; empty where one can."""
    missing = [name for name in ("starlette", "uvicorn", "websockets") if find_spec(name) is None]
    if missing:
        return f"{missing[0]} is not installed: run make setup, or install the extra console"
    from ua_fleet.console.page import page_missing

    return page_missing()


def settings_text(name: str, endpoint: str, listen: str, state_dir: str, **more: object) -> str:
    """A `console.yaml` of one fleet; JSON is YAML, and needs no care with quotes.

    Args:
        name: of the fleet, as it stands in the page's addresses.
        endpoint: URL of its server.
        listen: address and port of the console.
        state_dir: for its certificate.
        more: further keys.
    """
    settings = {
        "version": 1,
        "listen": listen,
        "fleets": {name: {"endpoint": endpoint}},
        "state_dir": state_dir,
        **more,
    }
    return json.dumps(settings, indent=2) + "\n"


async def introduce_console(server_state: Path, state_dir: Path) -> Path:
    """Make the console's certificate, unless it is there, and have the server trust it as a gateway's.

    Args:
        server_state: the server's folder.
        state_dir: the console's.

    Returns:
        The certificate.
    """
    from ua_fleet.console.identity import console_identity

    identity = console_identity(state_dir)
    await identity.ensure()
    trust_gateway(server_state, CONSOLE, identity.certificate)
    return identity.certificate
