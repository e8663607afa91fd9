"""The MQTT broker of a demonstration that asks for one: a mosquitto on loopback, which nobody else has."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Final

from ua_demo.processes import DemoFailed

__all__ = ["BROKER", "BROKER_PORT", "find_broker", "settings_text"]

BROKER: Final = "mosquitto"
BROKER_PORT: Final = 1883
_SYSTEM_PATH: Final = "/usr/sbin:/usr/local/sbin"
"""Where Debian has it, which not every user looks through."""


def find_broker() -> Path:
    """The program; raises DemoFailed where it is not installed."""
    found = shutil.which(BROKER) or shutil.which(BROKER, path=_SYSTEM_PATH)
    if found is None:
        raise DemoFailed(
            "mosquitto is not installed: run apt-get install mosquitto, or name a broker that runs, e.g. "
            "--pubsub-url mqtt://127.0.0.1:1883"
        )
    return Path(found)


def settings_text(port: int) -> str:
    """Its configuration: everybody on this machine is let in, and nothing is kept on the disk."""
    lines = [
        f"listener {port} 127.0.0.1",
        "allow_anonymous true",
        "set_tcp_nodelay true",
        "max_queued_messages 10000",
        "persistence false",
        *(["user root"] if os.geteuid() == 0 else []),
    ]
    return "\n".join(lines) + "\n"
