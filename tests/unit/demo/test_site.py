"""Where a demonstration runs, and what of it is said."""

from __future__ import annotations

import shutil
import socket
from pathlib import Path

import pytest
from ua_demo.commands.run_messages import check_broker
from ua_demo.pal.setting import fleet_text
from ua_demo.processes import DemoFailed
from ua_demo.site import Site, choose_site

from ua_fleet.cli.endings import UsageError
from ua_fleet.console import page

PAGE_MISSING = page.page_missing


def chosen(folder: Path, console_port: int | None) -> tuple[Site, list[str]]:
    """A site, and what was said about it; nothing else than the console is worth a word here."""
    said: list[str] = []
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    site = choose_site(
        folder,
        port=port,
        master_port=port,
        pubsub_urls=["opc.udp://239.1.2.3:4840"],
        without_ros1=True,
        secure=False,
        console_port=console_port,
        say=said.append,
    )
    return site, said


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page; the installation's own may not be built."""
    (tmp_path / "index.html").write_text("<!doctype html>")
    monkeypatch.setattr(page, "page_missing", lambda: PAGE_MISSING(tmp_path))
    return tmp_path / "index.html"


def test_the_console_takes_another_port_where_one_is_in_use(built: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as somebody:
        port = somebody.getsockname()[1]
        site, said = chosen(built.parent, port)
    assert site.console_port not in (None, port)
    assert said == [f"port {port} is in use; the web console takes {site.console_port}"]
    assert site.console_url == f"http://127.0.0.1:{site.console_port}/"


def test_without_its_page_there_is_no_console_and_a_line_says_why(built: Path) -> None:
    built.unlink()
    site, said = chosen(built.parent, 8080)
    assert (site.console_port, site.console_url) == (None, "")
    assert len(said) == 1
    assert said[0].startswith("there is no web console: the page is not built: run make setup")


def test_nothing_is_said_of_a_console_that_nobody_wants(built: Path) -> None:
    built.unlink()
    site, said = chosen(built.parent, None)
    assert (site.console_url, said) == ("", [])


def test_a_broker_s_address_is_that_of_pubsub(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as somebody:
        site = choose_site(
            tmp_path,
            port=somebody.getsockname()[1],
            master_port=11311,
            pubsub_urls=[],
            without_ros1=True,
            secure=False,
            console_port=None,
            say=lambda _: None,
            with_broker=True,
        )
    assert site.broker_port is not None
    assert site.pubsub_urls == (f"mqtt://127.0.0.1:{site.broker_port}",)
    assert f"url: {site.pubsub_urls[0]}\n" in fleet_text(site.layout("pal"), arm_space=3, mobile_space=2)


def test_a_broker_and_another_address_exclude_each_other() -> None:
    with pytest.raises(UsageError, match="leave out --pubsub-url"):
        check_broker(True, ["opc.udp://239.1.2.3:4840"])


def nowhere(_program: str, path: str | None = None) -> str | None:
    return None


def test_without_mosquitto_a_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", nowhere)
    with pytest.raises(DemoFailed, match=r"apt-get install mosquitto, or name a broker that runs"):
        check_broker(True, None)
