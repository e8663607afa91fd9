"""How commands print: data on stdout, messages on stderr, logs as JSON when nobody watches."""

from __future__ import annotations

import json
import logging
import os
import sys
from typing import TYPE_CHECKING, Any

import structlog

if TYPE_CHECKING:
    from ua_fleet.client import Reading

__all__ = ["message", "print_json", "print_line", "print_reading", "set_up_logging"]


def message(text: str) -> None:
    """Tell the user something that is not data."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def print_line(text: str) -> None:
    """Print a line of data at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def print_json(value: Any) -> None:
    """Print one object on a line of its own, at once."""
    print_line(json.dumps(value, ensure_ascii=False))


def print_reading(address: str, reading: Reading, *, as_json: bool) -> None:
    """Print a node's value with its quality and time."""
    time = reading.source_time or reading.server_time
    if as_json:
        print_json(
            {
                "node": address,
                "node_id": reading.node_id,
                "value": reading.value,
                "type": reading.type_name,
                "status": reading.status_text,
                "source_time": reading.source_time.isoformat() if reading.source_time else None,
                "server_time": reading.server_time.isoformat() if reading.server_time else None,
            }
        )
        return
    value = "-" if reading.value is None else json.dumps(reading.value, ensure_ascii=False)
    quality = "" if reading.status == 0 else f"  {reading.status_text}"
    stamp = f"  {time.isoformat(timespec='milliseconds')}" if time else ""
    print_line(f"{address} = {value}{quality}{stamp}")


def set_up_logging() -> None:
    """Logs of this process on stderr: for people on a terminal, one JSON object a line elsewhere.

    UA_FLEET_LOG sets the level: debug, info (default), warning, error.
    """
    level = getattr(logging, os.environ.get("UA_FLEET_LOG", "info").upper(), logging.INFO)
    on_terminal = sys.stderr.isatty()
    renderer: Any = structlog.dev.ConsoleRenderer() if on_terminal else structlog.processors.JSONRenderer()
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.StackInfoRenderer(),
            *([] if on_terminal else [structlog.processors.format_exc_info]),
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
    logging.basicConfig(stream=sys.stderr, level=max(level, logging.WARNING))
