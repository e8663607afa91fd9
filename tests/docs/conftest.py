"""A fresh folder and free ports for whoever walks through a page, and the site of all pages."""

from __future__ import annotations

import fcntl
import sys
from pathlib import Path

import pytest

from tests import system
from tests.docs.site import build
from tests.docs.walkthrough import PASSWORD


@pytest.fixture(scope="session")
def site(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built by the first process of tests that needs it: it takes 2 s of computing."""
    folder = tmp_path_factory.getbasetemp()
    if hasattr(request.config, "workerinput"):
        folder = folder.parent  # that of all processes of this run
    with (folder / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (built := folder / "site").exists():
            build(tmp_path_factory.mktemp("pages")).rename(built)
    return built


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
