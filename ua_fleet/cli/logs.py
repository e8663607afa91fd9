"""Logs of long-running commands, set up in this one place."""

from __future__ import annotations

import logging
import os
import sys
from typing import Any, Final

from ua_fleet.cli.endings import UsageError

__all__ = ["LOG_VARIABLE", "set_up_logging"]

LOG_VARIABLE: Final = "UA_FLEET_LOG"
_LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40}


def set_up_logging(default: str = "info") -> None:
    """Logs go to stderr: for people on a terminal, one JSON object a line elsewhere.

    UA_FLEET_LOG sets the level: debug, info, warning, error.

    Args:
        default: the level without UA_FLEET_LOG.

    Raises:
        UsageError: the level is none of these.
    """
    name = os.environ.get(LOG_VARIABLE) or default
    level = _LEVELS.get(name.lower())
    if level is None:
        raise UsageError(f"{LOG_VARIABLE}={name} is no level of logs; use one of: {', '.join(_LEVELS)}")
    import structlog

    on_terminal = sys.stderr.isatty()
    renderer: Any = structlog.processors.JSONRenderer()
    if on_terminal:
        # The default one shows the local variables of a traceback, and among them there may be a key.
        renderer = structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)
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
    # Packages with their own logs (asyncua is talkative) speak from warnings on, and like ours.
    shown = "%(levelname)-8s %(name)s: %(message)s"
    if not on_terminal:
        shown = '{"level": "%(levelname)s", "logger": "%(name)s", "event": "%(message)s"}'
    logging.basicConfig(stream=sys.stderr, level=max(level, logging.WARNING), format=shown)
