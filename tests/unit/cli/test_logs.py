"""What logs must not show."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator

import pytest
import structlog

from ua_fleet.cli.logs import set_up_logging


@pytest.fixture(autouse=True)
def _restored() -> Iterator[None]:
    handlers = logging.root.handlers[:]
    yield
    logging.root.handlers[:] = handlers
    structlog.reset_defaults()


@pytest.mark.parametrize("on_terminal", [False, True])
def test_a_traceback_shows_no_local_variables(
    on_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A key may be among them."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: on_terminal, raising=False)
    set_up_logging()
    key_data = "5ec4e7" * 3
    try:
        raise ValueError(len(key_data))
    except ValueError:
        structlog.get_logger().exception("a mistake")
    shown = capsys.readouterr().err
    assert "a mistake" in shown
    assert "ValueError: 18" in shown
    assert key_data not in shown
