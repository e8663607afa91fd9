"""What stands on a terminal: tables that are kept up to date, colours, and the terminal as it was at the end."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import time

from tests.integration.cli.conftest import Site, command
from tests.system import forked


def on_a_terminal(site: Site, *arguments: str, until: str, **environment: str) -> str:
    """What a command writes to a terminal until it has written a text, and until Ctrl-C has ended it."""
    ours, theirs = pty.openpty()
    variables = site.environment("olga") | {"TERM": "xterm", "COLUMNS": "100", "LINES": "30"} | environment
    process = forked(*command(*arguments), env=variables, terminal=theirs)
    os.close(theirs)
    os.set_blocking(ours, False)
    said = b""
    deadline = time.monotonic() + 30
    is_asked = False
    try:
        while process.poll() is None:
            with contextlib.suppress(BlockingIOError, OSError):
                said += os.read(ours, 65_536)
            if until.encode() in said and not is_asked:
                process.send_signal(signal.SIGINT)
                is_asked = True
            assert time.monotonic() < deadline, said
            time.sleep(0.02)
        with contextlib.suppress(BlockingIOError, OSError):
            while part := os.read(ours, 65_536):
                said += part
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    assert process.returncode == 130, said
    return said.decode()


def test_a_table_takes_the_terminal_and_gives_it_back_with_the_last_picture(site: Site) -> None:
    said = on_a_terminal(site, "watch", "rover", "--table", "--age", until="rover/State")
    assert said.startswith("\x1b[?1049h\x1b[?25l")
    pictures, _, last = said.partition("\x1b[?25h\x1b[?1049l")
    assert "\x1b[1mnode\x1b[0m" in pictures
    assert "rover/State" in last
    assert "0 (Offline)" in last


def test_the_status_is_shown_again_and_again(site: Site) -> None:
    said = on_a_terminal(site, "status", "--watch", "--every", "0.2", until="is not heard")
    assert "\x1b[31m" in said
    assert "bridge floor is not heard" in said.partition("\x1b[?1049l")[2]


def test_no_colours_where_somebody_does_not_want_them(site: Site) -> None:
    said = on_a_terminal(site, "watch", "rover.State", until="(Offline)", NO_COLOR="1")
    assert "\x1b" not in said
    assert "\x1b[1mrover.State" in on_a_terminal(site, "watch", "rover.State", until="(Offline)")
