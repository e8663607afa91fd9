"""A fresh folder and free ports for whoever walks through a page."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests import system
from tests.docs.walkthrough import PASSWORD


@pytest.fixture
def environment(tmp_path: Path, tcp_port: int, udp_url: str) -> dict[str, str]:
    """What a reader with an activated environment has, and a server and messages that meet nobody else's."""
    here = system.clean_environment()
    return {
        "PATH": f"{Path(sys.executable).parent}:{here['PATH']}",
        "XDG_STATE_HOME": str(tmp_path / "home"),
        "UA_FLEET__SERVER__PORT": str(tcp_port),
        "UA_FLEET_ENDPOINT": f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet",
        "UA_FLEET__PUBSUB__URL": udp_url,
        "UA_FLEET_PASSWORD": PASSWORD,
        "PYTHONUNBUFFERED": "1",
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The reader's folder."""
    made = tmp_path / "cell"
    made.mkdir()
    return made
