"""What logs must show, and what they must not."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import warnings
from typing import Any

import pytest
import structlog

from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.logs import LOG_VARIABLE, set_up_logging


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    """Each line of stderr as the JSON that it has to be."""
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


@pytest.mark.parametrize("on_terminal", [False, True])
def test_a_traceback_shows_no_local_variables(
    on_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A key may be among them."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: on_terminal, raising=False)
    set_up_logging()
    key_data = "5ec4e7" * 3
    for log in (structlog.get_logger(), logging.getLogger("someone")):
        try:
            raise ValueError(len(key_data))
        except ValueError:
            log.exception("a mistake")
    shown = capsys.readouterr().err
    assert shown.count("a mistake") == 2
    assert shown.count("ValueError: 18") == 2
    assert key_data not in shown


@pytest.mark.parametrize("text", ['it said "no"', "two\nlines", "a\\b \x00 \x1b[31m ü"])
def test_whoever_speaks_each_line_is_json(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging()
    structlog.get_logger("ours").info(text, robot=text)
    logging.getLogger("theirs").warning("%s", text)
    try:
        raise OSError(text)
    except OSError:
        logging.getLogger("theirs").exception("it failed")
    ours, theirs, failed = lines(capsys)
    assert (ours["event"], ours["robot"], ours["level"]) == (text, text, "info")
    assert (theirs["event"], theirs["logger"], theirs["level"]) == (text, "theirs", "warning")
    assert failed["exception"].endswith(f"OSError: {text}")
    assert all("timestamp" in line for line in (ours, theirs, failed))


def test_a_warning_is_a_line_too(capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        set_up_logging()
        warnings.warn('this is "old"', DeprecationWarning, stacklevel=1)
        logging.captureWarnings(False)
    (line,) = lines(capsys)
    assert (line["logger"], line["level"]) == ("py.warnings", "warning")
    assert 'DeprecationWarning: this is "old"' in line["event"]


def test_packages_of_others_speak_from_warnings_on_and_ours_as_they_are_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    set_up_logging()
    for name in ("asyncua.server", "ua_bridges.tcp.link"):
        logging.getLogger(name).info("hello")
        logging.getLogger(name).debug("more")
    assert [line["logger"] for line in lines(capsys)] == ["ua_bridges.tcp.link"]


def test_each_line_names_its_process_unless_it_says_otherwise(capsys: pytest.CaptureFixture[str]) -> None:
    set_up_logging(process="bridge", bridge="cell")
    structlog.get_logger().info("one")
    structlog.get_logger().info("two", bridge="other")
    logging.getLogger("theirs").warning("three")
    assert [(line["process"], line["bridge"]) for line in lines(capsys)] == [
        ("bridge", "cell"),
        ("bridge", "other"),
        ("bridge", "cell"),
    ]


PROGRAM = """
import threading
from ua_fleet.cli.logs import set_up_logging
set_up_logging(process="server")
thread = threading.Thread(target=lambda: 1 / 0)
thread.start()
thread.join()
raise KeyError('a "quoted" name')
"""


def test_what_nobody_has_caught_is_json_too() -> None:
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 1
    said = [json.loads(line) for line in ended.stderr.splitlines()]
    assert [line["exception"].splitlines()[-1] for line in said] == [
        "ZeroDivisionError: division by zero",
        """KeyError: 'a "quoted" name'""",
    ]
    assert all(line["level"] == "critical" and line["process"] == "server" for line in said)


def test_a_level_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LOG_VARIABLE, "loud")
    with pytest.raises(UsageError, match="UA_FLEET_LOG=loud is no level of logs; use one of: debug, info"):
        set_up_logging()


def test_what_strangers_said_does_nothing_to_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    set_up_logging()
    hostile = "x\n2030 forged line\x1b[2J\x9b\u202e"
    structlog.get_logger("ua_fleet").warning(f"refused {hostile}", subject=hostile)
    logging.getLogger("asyncua").error("from %s", hostile)
    try:
        raise ValueError(hostile)
    except ValueError:
        structlog.get_logger("ua_fleet").exception("a mistake")
    said = capsys.readouterr().err
    assert "ValueError: x" in said
    assert not any(line.startswith("2030 forged") for line in said.splitlines()[:2])
    assert "\x1b[2J" not in said
    assert not {"\x9b", "\u202e"} & set(said)
